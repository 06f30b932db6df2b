"""What a sweep is: everything that decides its trials and their results. Speed is not among that."""

import json
import shlex
from dataclasses import asdict, fields, replace
from typing import Any, Literal, NamedTuple

from pydantic import Field

from drone_env.core.rewards import RewardProfile
from drone_env.core.tasks import get_task, own_rules
from drone_env.envs.registry import register_reward_profile, task_argument
from drone_env.errors import InvalidValueError
from drone_env.files import differences
from drone_env.models import Message
from drone_env.reward_file import load_reward_profile
from drone_env.rl.config import TrainConfig, preset

ELSEWHERE = {
    "task": "--task",
    "seed": "--seeds",
    "num_threads": "--cpus-per-trial",
    "gpu": "drone-env train --gpu: a sweep trains on CPUs",
    "checkpoint_episodes": "--checkpoint-seconds",
    "checkpoint_seconds": "--checkpoint-seconds",
}
"""What is no setting, and where it is said instead."""

Value = bool | int | float | str
Setting = dict[str, Value]


class Trial(NamedTuple):
    """One training run of a sweep."""

    setting: int
    seed: int

    @property
    def name(self) -> str:
        """Its folder."""
        return f"setting{self.setting}-seed{self.seed}"


class SweepConfig(Message):
    """The identity of a sweep: a sweep's folder is gone on with under an equal one only."""

    format: Literal["drone_env/sweep"] = "drone_env/sweep"
    format_version: Literal[1] = 1
    task: str
    task_version: int = Field(ge=1)
    rules: dict[str, str] = Field(default={}, description="Digest of the task's rules, where it is not the package's.")
    preset: str
    fixed: Setting = Field(description="Every value of the training that has no other place, as the preset has it.")
    settings: tuple[Setting, ...] = Field(strict=False, min_length=1, description="What each setting changes of it.")
    rewards: dict[str, RewardProfile] = Field(default={}, description="Reward profiles from files, by the file.")
    seeds: int = Field(ge=1, le=1000, description="Each setting is trained with the seeds from 0 up to this.")
    cpus_per_trial: int = Field(ge=1, description="Threads of a trial: other numbers differ in the last bits.")
    early_stopping: bool
    test_maps: int = Field(ge=1, description="How many test maps each finished network flies.")

    def trials(self) -> list[Trial]:
        """All trials, one setting after the other."""
        return [Trial(setting, seed) for setting in range(len(self.settings)) for seed in range(self.seeds)]

    def training(self, trial: Trial, checkpoint_seconds: float = 60.0) -> TrainConfig:
        """How a trial is trained.

        Raises:
            InvalidValueError: if a value is out of range, or the id of a profile from a file is that of another one.
        """
        values: dict[str, Any] = {**self.fixed, **self.settings[trial.setting]}
        if values["reward_profile"] in self.rewards:  # whoever trains, on whatever machine, has to know it
            values["reward_profile"] = register_reward_profile(self.rewards[values["reward_profile"]]).id
        return TrainConfig(
            **values,
            task=get_task(self.task, self.task_version).short_name,
            seed=trial.seed,
            num_threads=self.cpus_per_trial,
            checkpoint_seconds=checkpoint_seconds,
        )

    def common(self) -> Setting:
        """What all settings change alike."""
        first, *others = self.settings
        return {name: value for name, value in first.items() if all(other[name] == value for other in others)}

    def label(self, setting: int) -> str:
        """A setting in words: what is not the same in all."""
        common = self.common()
        own = {name: value for name, value in self.settings[setting].items() if name not in common}
        return " ".join(f"{name}={value}" for name, value in own.items()) or "the only setting"

    def command(self, trial: Trial) -> str:
        """The command that trains the same network alone, in a folder of its own."""
        training = self.training(trial)
        # As the command finds them: those that are not said follow from the number of episodes, which is.
        usual = preset(self.preset, training.task).episodes
        defaults = replace(preset(self.preset, training.task, training.episodes), episodes=usual)
        named = task_argument(get_task(training.task))
        words = ["python", "train.py", "--task", named, "--preset", self.preset, "--seed", str(trial.seed)]
        given = asdict(training) | {"reward_profile": {**self.fixed, **self.settings[trial.setting]}["reward_profile"]}
        for name, value in given.items():
            if name in ("task", "seed", "checkpoint_seconds") or value == getattr(defaults, name):
                continue
            flag = name.replace("_", "-")
            words += (
                [f"--{flag}" if value else f"--no-{flag}"] if isinstance(value, bool) else [f"--{flag}", f"{value}"]
            )
        folder = f"alone/{trial.name}"
        return shlex.join([*words, "--data", folder, "--results", folder])

    def differences(self, other: "SweepConfig") -> list[str]:
        """What differs, one line for each field."""
        before, now = self.model_dump(mode="json"), other.model_dump(mode="json")
        if not self.rules:  # sweeps from before tell none
            now["rules"] = {}
        for values in (before, now):
            values.update(values.pop("rules"))
            values.update({f"{name} of the preset": value for name, value in values.pop("fixed").items()})
            values.update({f"rewards of {name}": value for name, value in values.pop("rewards").items()})
        return differences(before, now)


def make_config(
    task: str,
    preset_name: str,
    settings: list[Setting],
    seeds: int,
    cpus_per_trial: int,
    early_stopping: bool,
    test_maps: int,
) -> SweepConfig:
    """The configuration of a sweep, every trial of it checked.

    Raises:
        UnknownNameError: if there is no such task or reward profile.
        OSError: if the file of a reward profile cannot be read.
        InvalidValueError: if a value is out of range or no reward profile, a setting is there twice, or settings cannot
            be compared early.
    """
    counts = (("seeds", seeds, 1000), ("cpus-per-trial", cpus_per_trial, 4096), ("test-maps", test_maps, 1_000_000))
    for name, value, most in counts:
        if not 1 <= value <= most:
            raise InvalidValueError(f"--{name} must be from 1 to {most}, got {value}")
    twice = [setting for i, setting in enumerate(settings) if setting in settings[:i]]
    if twice:
        raise InvalidValueError(f"a setting is there twice: {json.dumps(twice[0])}")
    known = get_task(task)
    paid = [str(setting.get("reward_profile", "")) for setting in settings]
    defaults = asdict(preset(preset_name, task))
    config = SweepConfig(
        task=known.id,
        task_version=known.version,
        rules=own_rules(known),
        preset=preset_name,
        fixed={field.name: defaults[field.name] for field in fields(TrainConfig) if field.name not in ELSEWHERE},
        settings=tuple(settings),
        rewards={name: load_reward_profile(name) for name in paid if name.endswith(".toml")},
        seeds=seeds,
        cpus_per_trial=cpus_per_trial,
        early_stopping=early_stopping,
        test_maps=test_maps,
    )
    trainings = [config.training(trial) for trial in config.trials()]
    for name in ("episodes", "validation_every", "validation_maps", "log_every"):
        if early_stopping and len({getattr(training, name) for training in trainings}) > 1:
            raise InvalidValueError(
                f"settings with different {name} cannot be compared half way: add --no-early-stopping"
            )
    return config
