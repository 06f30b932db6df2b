"""`drone-env train`: train a network to fly a task."""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import tyro

from drone_env.commands.arguments import TASK, OptionalPath, ProfileName, TaskName
from drone_env.commands.printing import progress_bar
from drone_env.core.rewards import DEFAULT_PROFILE, REWARD_PROFILES
from drone_env.core.tasks import get_task
from drone_env.errors import CheckpointError, InvalidValueError, UnknownNameError, needs
from drone_env.files import data_folder
from drone_env.rl.config import PpoConfig, TourConfig, TrainConfig, check_value, ppo_preset, preset
from drone_env.toml_text import parse_toml

AlgorithmName = Literal["dqn", "ppo", "tournet"]
AGENTS = {"dqn": "pathqnet", "ppo": "ppo", "tournet": "tournet"}
"""The agent that flies by a trained network, by algorithm."""


@dataclass(frozen=True)
class Settings(TrainConfig):
    """The settings of DQN."""

    task: TaskName = "easy"
    """The task, by its short name, id or grader."""
    reward_profile: ProfileName = DEFAULT_PROFILE
    """Reward profile, or a TOML file with one. Potential-based shaping, if the profile has it, uses `gamma`."""


@dataclass(frozen=True)
class PpoSettings(PpoConfig):
    """The settings of PPO."""

    task: TaskName = "easy"
    """The task, by its short name, id or grader."""
    reward_profile: ProfileName = DEFAULT_PROFILE
    """Reward profile, or a TOML file with one. Potential-based shaping, if the profile has it, uses `gamma`."""


@dataclass(frozen=True)
class TourSettings(TourConfig):
    """The settings of the tour network."""

    task: Annotated[str, tyro.conf.arg(metavar=f"{TASK}|all")] = "all"
    """`all` for one network that flies every registered task, or one task."""


AnySettings = TypeVar("AnySettings", Settings, PpoSettings, TourSettings)
SETTINGS = {"dqn": TrainConfig, "ppo": PpoConfig, "tournet": TourConfig}


@dataclass(frozen=True)
class RunOptions:
    """Where the settings come from, and where the files of the training go."""

    config: OptionalPath = None
    """TOML file of settings, such as the `config.toml` of another run. Options on the command line win over it."""
    fresh: bool = False
    """Start from scratch; the earlier checkpoint is kept under the next free number, such as `easy.pth.1`."""
    data: OptionalPath = None
    """Folder of checkpoint, network and log; the default is DRONE_ENV_DATA, else data."""
    results: OptionalPath = None
    """Folder of settings, tables and curves; the default is results/ in DRONE_ENV_DATA, else results."""


NO_OPTIONS = RunOptions()
Unnamed = tyro.conf.arg(name="")


def expand_config(arguments: Sequence[str]) -> list[str]:
    """Put the options in the file of `--config` before the arguments, which take precedence as the later ones.

    Raises:
        OSError: if the file cannot be read.
        InvalidValueError: if it is not TOML, or if a key is unknown, or a value of the wrong type or out of range.
    """
    given = _given(arguments)
    if not given.config:
        return list(arguments)
    options: list[str] = []
    try:
        table = parse_toml(Path(given.config).read_bytes())
        algorithm = given.algorithm or table.get("algorithm", "dqn")
        if algorithm not in tuple(SETTINGS):
            raise UnknownNameError("algorithm", algorithm, SETTINGS)
        known = {"algorithm", *(field.name for field in fields(SETTINGS[algorithm]))}
        known |= {"preset"} if algorithm == "dqn" else set()
        for name, value in table.items():
            if name not in known:
                raise UnknownNameError(f"setting of {algorithm}", name, known)
            check_value(SETTINGS[algorithm], name, value)
            option = name.replace("_", "-")
            flag = {True: f"--{option}", False: f"--no-{option}"}
            options.append(flag[value] if isinstance(value, bool) else f"--{option}={value}")
    except (InvalidValueError, UnknownNameError) as error:
        raise InvalidValueError(f"{given.config}: {error}") from None
    return [*options, *arguments]


def train_command(arguments: Sequence[str]) -> Callable[..., int]:
    """The subcommand for these arguments, with the defaults of its preset or checkpoint."""
    given = _given(arguments)
    if given.algorithm == "tournet":
        tour = TourSettings(task=given.task or "all")
        return _tour_command(_resumed(tour, tour.name, given))
    if given.task == "all":
        raise InvalidValueError("DQN and PPO learn one task at a time: name it, or add --algorithm tournet")
    task = given.task or "easy"
    if given.algorithm == "ppo":
        ppo = PpoSettings(**vars(ppo_preset(task)))
        return _ppo_command(_resumed(ppo, ppo.name, given))
    episodes = int(given.episodes) if given.episodes and given.episodes.isdecimal() else None
    defaults = Settings(**vars(preset(given.preset or "fast", task, episodes)))
    # The number of environments depends on the first number of episodes, which only the checkpoint has.
    return _train_command(defaults if given.preset else _resumed(defaults, get_task(task).short_name, given))


def _train_command(defaults: Settings) -> Callable[..., int]:
    def train(
        settings: Annotated[Settings, Unnamed] = defaults,
        algorithm: AlgorithmName = "dqn",
        preset: Literal["fast", "original"] = "fast",
        options: Annotated[RunOptions, Unnamed] = NO_OPTIONS,
    ) -> int:
        """Train a network to fly a task, and validate it against the exact optimum.

        The command continues from `data/TASK.pth` if that exists, with its settings; Ctrl-C saves and ends. The best
        network by validation is `data/TASK.safetensors`. `drone-env serve` in the same folder uses it; so does
        `drone-env evaluate --agents pathqnet:data/TASK.safetensors`.

        The defaults below are those of the preset for the task and the number of episodes. `original` has the
        hyperparameters of the first version of this project, `fast` learns fastest. Other algorithms have other
        settings: `drone-env train --algorithm ppo --help`.

        Example: drone-env train --task hard

        Args:
            settings: The settings.
            algorithm: `dqn` learns the values of actions on one task (PathQNet), `ppo` a policy on one task, both from
                rewards; `tournet` learns the next parcel or pad from exact values, on all tasks at once.
            preset: The preset of the defaults.
            options: File of settings, and folders.
        """
        with needs("train"):
            from drone_env.rl.trainer import Trainer
        return _train(Trainer(settings), options)

    return train


train = _train_command(Settings(**vars(preset("fast", "easy"))))
"""The subcommand in the overview of all commands."""


def _ppo_command(defaults: PpoSettings) -> Callable[..., int]:
    def train(
        settings: Annotated[PpoSettings, Unnamed] = defaults,
        algorithm: AlgorithmName = "ppo",
        options: Annotated[RunOptions, Unnamed] = NO_OPTIONS,
    ) -> int:
        """Train a policy by PPO to fly a task, and validate it against the exact optimum.

        The command continues from `data/ppo_TASK.pth` if that exists, with its settings; Ctrl-C saves and ends. The
        best network by validation is `data/ppo_TASK.safetensors`. `drone-env serve` in the same folder offers it; to
        evaluate it, type `drone-env evaluate --agents ppo:data/ppo_TASK.safetensors`.

        The defaults below are those for the task.

        Example: drone-env train --algorithm ppo --task skyline_easy

        Args:
            settings: The settings.
            algorithm: `ppo`.
            options: File of settings, and folders.
        """
        with needs("train"):
            from drone_env.rl.ppo import PpoTrainer
        return _train(PpoTrainer(settings), options)

    return train


def _tour_command(defaults: TourSettings) -> Callable[..., int]:
    def train(
        settings: Annotated[TourSettings, Unnamed] = defaults,
        algorithm: AlgorithmName = "tournet",
        options: Annotated[RunOptions, Unnamed] = NO_OPTIONS,
    ) -> int:
        """Train a tour network, and validate it against the exact optimum.

        It learns from the exact value of each option (`drone_env.planning.legs`), on maps of the train split. The
        command continues from `data/tournet.pth` if that exists, with its settings; Ctrl-C saves and ends. The network
        is `data/tournet.safetensors`; to fly it, type `drone-env evaluate --agents
        tournet:data/tournet.safetensors`. A network for one task is `tournet_TASK` instead of `tournet`.

        Example: drone-env train --algorithm tournet --task all

        Args:
            settings: The settings.
            algorithm: `tournet`.
            options: File of settings, and folders.
        """
        with needs("train"):
            from drone_env.rl.tournet import TourTrainer
        return _train(TourTrainer(settings), options)

    return train


def _given(arguments: Sequence[str]) -> argparse.Namespace:
    """The arguments that the defaults depend on; tyro reports their errors."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for flag in ("--config", "--algorithm", "--task", "--preset", "--episodes", "--data"):
        parser.add_argument(flag, nargs="?")
    parser.add_argument("--fresh", action=argparse.BooleanOptionalAction)
    return parser.parse_known_args(arguments)[0]


def _resumed(defaults: AnySettings, name: str, given: argparse.Namespace) -> AnySettings:
    """The settings of the checkpoint, if there is one."""
    checkpoint = Path(given.data or data_folder()) / f"{name}.pth"
    if given.fresh or not checkpoint.exists():
        return defaults
    try:
        from drone_env.rl.run import load_checkpoint

        stored = load_checkpoint(checkpoint)["config"]
        omitted = {"task", *({"reward_profile"} if stored.get("reward_profile") not in REWARD_PROFILES else ())}
        names = [field.name for field in fields(defaults) if field.name in stored and field.name not in omitted]
        return type(defaults)(**vars(defaults) | {name: stored[name] for name in names})
    except (CheckpointError, OSError, ModuleNotFoundError, KeyError, TypeError, InvalidValueError):
        return defaults  # `TrainingRun` reports the error


def _train(trainer: Any, options: RunOptions) -> int:
    from drone_env.rl.run import TrainingRun

    data, results = options.data or data_folder(), options.results or data_folder("results")
    run = TrainingRun(trainer, data, results, options.fresh)
    unit, total = run.unit, run.total

    def log(message: str) -> None:
        print(message, file=sys.stderr, flush=True)

    if run.done >= total:
        log(f"{run.checkpoint} has {run.done} of {total} {unit}: nothing to do.")
        more = "Add" if unit == "updates" else f"Raise --{unit} to go on, or add"
        log(f"{more} --fresh to start again; the old training is kept.")
        return 0
    if run.resumed:
        log(f"going on from {run.checkpoint}: {run.done} of {total} {unit}")
    shown, every = run.done, run.trainer.config.validation_every
    with progress_bar(run.name, total, shown) as advance, run.stopping_on_interrupt():
        for line in run.train():
            before, shown = shown, run.done
            advance(shown - before, f"{run.name}  {line.summary}")
            if not sys.stderr.isatty() and shown // every > before // every:
                log(f"{shown}/{total} {unit}  {line.summary}")
    if run.stopped:
        command = "the same command without --fresh" if options.fresh else "the same command"
        log(f"stopped after {run.done} {unit}, saved as {run.checkpoint}; {command} goes on")
        return 130
    log(f"trained: {run.trainer.result} on the validation maps; network {run.network}, curves {run.results}")
    task = run.trainer.config.task
    task = task if task == "all" else get_task(task).short_name
    log(f"next: drone-env evaluate --task {task} --agents greedy {AGENTS[trainer.config.algorithm]}:{run.network}")
    return 0
