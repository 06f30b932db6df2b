"""`drone-env dataset`: states, actions and their exact values, to learn from."""

from pathlib import Path
from typing import Annotated

import tyro

from drone_env.commands.arguments import AgentNames, ProfileName, Split, TaskName, say_trusted
from drone_env.commands.printing import progress_bar
from drone_env.core.rewards import DEFAULT_PROFILE
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError

FormatNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar="parquet|minari")]


def dataset(
    out: Path,
    task: TaskName = "easy",
    maps: int = 100,
    split: Split = "train",
    offset: int = 0,
    agents: AgentNames = ("optimal", "greedy", "random"),
    epsilon: float = 0.1,
    reward_profile: ProfileName = DEFAULT_PROFILE,
    formats: FormatNames = ("parquet", "minari"),
) -> None:
    """Write a data set of flights in which every step stands beside the exact values of its state.

    For imitation learning, offline reinforcement learning and process rewards: states, actions, rewards, V*, Q* of all
    actions, the set of optimal actions, and regret. The same arguments give the same rows. The folder holds
    steps.parquet, a Minari data set and a README.md that explains every column; it is there whole or not at all. A
    progress bar goes to standard error. Needs the extra `data`.

    Example: drone-env dataset --task hard --maps 1000 --out hard-steps

    Args:
        out: The folder to make, in one that exists.
        task: The task, by its short name, id or grader.
        maps: How many maps of the split.
        split: Whose maps to fly. What is trained on validation or test maps can no longer be judged by them.
        offset: The number of the first map within the split.
        agents: Who flies each map, one or more.
        epsilon: The probability with which a step flies a uniformly random action instead of the agent's.
        reward_profile: What steps pay: a reward profile, or a TOML file with one. V*, Q* and regret are in score and do
            not depend on it.
        formats: One or both. Minari takes some 45 to 80 KB a flight, Parquet some 25 bytes a step.
    """
    from drone_env.datasets.build import build_dataset  # compiles, which only those who solve should wait for
    from drone_env.datasets.config import DatasetConfig

    if maps < 1:
        raise InvalidValueError(f"--maps must be at least 1, got {maps}")
    say_trusted(agents)
    config = DatasetConfig(get_task(task), split_seeds(split, maps, offset), split, agents, epsilon, reward_profile)
    with progress_bar(f"{config.task.short_name} maps", maps) as advance:
        rows = build_dataset(config, out, formats, on_map=advance)
    print(f"{out}: {rows:,} steps of {config.episodes:,} flights over {maps:,} maps")
