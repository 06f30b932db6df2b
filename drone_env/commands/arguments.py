"""Shared types of arguments."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from reprlib import repr as shortened
from typing import Annotated, Any

import tyro

from drone_env.agents import AGENTS
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.seeds import N_SEEDS, SPLITS, split_seeds
from drone_env.core.tasks import TASKS
from drone_env.envs.registry import register_city, register_reward_file
from drone_env.errors import InvalidValueError

SHORT_NAMES = [task.short_name for task in TASKS.values()]

OPTIONAL = tyro.conf.arg(help_behavior_hint="(optional)")
"""An option whose help names what happens without it; tyro would add `(default: None)`."""
TASK = "|".join((*SHORT_NAMES, "CITY.toml"))
TaskName = Annotated[str, tyro.conf.arg(metavar=TASK)]
ChosenTask = Annotated[str | None, tyro.conf.arg(metavar=TASK), OPTIONAL]
AGENT = "|".join((*AGENTS, "MODULE:NAME"))
AgentName = Annotated[str, tyro.conf.arg(metavar=AGENT)]
AgentNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar=AGENT)]
ChosenAgent = Annotated[str | None, tyro.conf.arg(metavar=AGENT), OPTIONAL]
Split = Annotated[str, tyro.conf.arg(metavar="|".join(SPLITS))]
Folders = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR...", help_behavior_hint="")]
SplitName = Annotated[str | None, tyro.conf.arg(metavar="|".join(SPLITS)), OPTIONAL]
SeedRange = Annotated[str | None, tyro.conf.arg(metavar="A:B"), OPTIONAL]
PROFILE = "|".join((*REWARD_PROFILES, "FILE.toml"))
ProfileName = Annotated[str, tyro.conf.arg(metavar=PROFILE)]
ChosenProfile = Annotated[str | None, tyro.conf.arg(metavar=PROFILE), OPTIONAL]
Seed = Annotated[int | None, tyro.conf.arg(metavar="N"), OPTIONAL]
OptionalPath = Annotated[Path | None, OPTIONAL]

REGISTERED: dict[str, Callable[[str], Any]] = {
    "--task": register_city,
    "--reward-profile": register_reward_file,
    "--reward": register_reward_file,
}
"""Functions that register a TOML file, by the options that take a name or such a file."""


def register_files(arguments: Sequence[str]) -> list[str]:
    """Register the files of cities and reward profiles, and replace them by their names."""
    names: list[str] = []
    option = ""
    for argument in arguments:
        if argument.startswith("-"):
            option = argument.partition("=")[0].replace("_", "-")
        if option in REGISTERED and argument.endswith(".toml"):
            file = argument.partition("=")[2] if argument.startswith("-") else argument
            argument = argument.removesuffix(file) + REGISTERED[option](file).id
        names.append(argument)
    return names


def parse_seeds(text: str) -> range:
    """Return the seeds A to B - 1 of `A:B`."""
    numbers = re.fullmatch(r"(\d{1,16}):(\d{1,16})", text)
    seeds = range(*map(int, numbers.groups())) if numbers else range(0)
    if not seeds or seeds.stop > N_SEEDS:
        raise InvalidValueError(
            f"--seeds takes A:B with integers 0 <= A < B <= 2^53, such as 0:100; got {shortened(text)}"
        )
    return seeds


def select_maps(seeds: str | None, split: str | None, episodes: int | None, default: int) -> tuple[str, range]:
    """Return split and seeds of `--seeds`, `--split` and `--episodes`; the split of `--seeds` is `custom`.

    Args:
        seeds: `A:B`; they replace those of the split.
        split: A split; None for test.
        episodes: Number of its first maps.
        default: The default of `episodes`.
    """
    if seeds is not None:
        return "custom", parse_seeds(seeds)
    if episodes is not None and episodes < 1:
        raise InvalidValueError(f"--episodes must be at least 1, got {episodes}")
    return split or "test", split_seeds(split or "test", episodes or default)
