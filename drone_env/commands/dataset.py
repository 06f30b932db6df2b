"""`drone-env dataset`: states, actions and their exact values; conversations."""

from pathlib import Path
from typing import Annotated

from drone_env.commands.arguments import OPTIONAL, AgentNames, ProfileName, Split, TaskName
from drone_env.commands.printing import progress_bar
from drone_env.core.rewards import DEFAULT_PROFILE
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.results.tables import plural


def dataset(
    out: Path,
    task: TaskName = "easy",
    maps: int = 100,
    split: Split = "train",
    offset: int = 0,
    agents: AgentNames = ("optimal", "greedy", "random"),
    epsilon: float = 0.1,
    reward_profile: ProfileName = DEFAULT_PROFILE,
    prompt: Annotated[str | None, OPTIONAL] = None,
    minari: bool = False,
) -> None:
    """Write a dataset of flights with the exact values of every step.

    For imitation learning, offline reinforcement learning and process rewards: states, actions, rewards, V*, Q* of all
    actions, the set of optimal actions, and regret. The same arguments give the same rows. The folder contains
    steps.parquet, whose schema describes the columns and contains the configuration. If an error occurs, nothing is
    left. Needs the extra `data`.

    For libraries of offline reinforcement learning, `--minari` also writes the flights as a Minari dataset.

    For language models, `--prompt` also writes chat.jsonl: each request that `drone-env infer` sends with this prompt,
    and the agent's answer, as TRL's SFTTrainer reads them.

    Example: drone-env dataset --task hard --maps 1000 --out hard-steps

    Example: drone-env dataset --prompt compass --agents optimal --out easy-chat

    Args:
        out: The folder to make, in one that exists.
        task: The task, by its short name, id or grader.
        maps: Number of maps.
        split: Split of the maps. Do not train on validation or test maps that you evaluate on.
        offset: Index of the first map within the split.
        agents: The agents that fly each map, one or more.
        epsilon: Probability that a step takes a uniformly random action instead of the agent's.
        reward_profile: A reward profile, or a TOML file with one. V*, Q* and regret are in score and do not depend on
            it.
        prompt: The prompt of conversations: name (the newest version), id, or your own file. Default: none are written.
        minari: Also write a Minari dataset (Python 3.11 or newer). A flight takes about 50 KB (easy) to 500 KB (city).
    """
    from drone_env.datasets.build import build_dataset  # slow to load
    from drone_env.datasets.trajectories import DatasetConfig

    if maps < 1:
        raise InvalidValueError(f"--maps must be at least 1, got {maps}")
    seeds = split_seeds(split, maps, offset)
    config = DatasetConfig(get_task(task), seeds, split, agents, epsilon, reward_profile, prompt, minari)
    with progress_bar(f"{config.task.short_name} maps", maps) as advance:
        rows = build_dataset(config, out, on_map=advance)
    print(f"{out}: {rows:,} steps of {plural(config.episodes, 'flight')} over {plural(maps, 'map')}")
