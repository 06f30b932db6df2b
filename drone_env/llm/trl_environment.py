"""The drone as an environment of TRL's GRPOTrainer: the model flies by calling the tool `fly`.

from trl import GRPOConfig, GRPOTrainer
from drone_env.llm.trl_environment import DroneEnvironment, training_maps

trainer = GRPOTrainer(
    model="Qwen/Qwen3-0.6B",
    train_dataset=training_maps("easy", maps=1000),
    environment_factory=DroneEnvironment,
    args=GRPOConfig(max_completion_length=4096, num_generations=8),
)
"""

# TRL's data sets are in no environment in which types are checked.
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false

from typing import TYPE_CHECKING, Any

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, profile_for_discount
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import EpisodeError, InvalidValueError, needs
from drone_env.llm.prompt import FOLDER, below_text, first_texts, read_prompt, repair_text
from drone_env.models import NAMES, Direction

if TYPE_CHECKING:
    from datasets import Dataset  # pyright: ignore[reportMissingImports, reportAttributeAccessIssue]

PROMPT = read_prompt(FOLDER / "tools" / "fly-2.toml")


class DroneEnvironment:
    """One drone; TRL makes one for each rollout, resets it for each map, and gives the model its one tool.

    TRL takes every public method but `reset` and `get_reward` for a tool, so there is none but `fly`.

    Args:
        reward_profile: What is paid, undiscounted: its shaping, if it has one, gets the discount 1.

    Raises:
        UnknownNameError: if there is no such profile.
    """

    def __init__(self, reward_profile: str = DEFAULT_PROFILE) -> None:
        self._reward_profile = profile_for_discount(get_reward_profile(reward_profile), 1)
        self._episode = Episode("easy", self._reward_profile)

    def reset(self, task: str | None = None, seed: int | None = None, **columns: Any) -> str:
        """Start a map and say what there is to see; TRL appends it to the last message of the prompt.

        Args:
            task: The task: id, short name or grader.
            seed: The map. All rollouts of a group have to fly the same one, so it comes from the data set.
            columns: All other columns of the row, such as `prompt`.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if the row names no task and seed, or the seed is not in [0, 2^53).
        """
        if task is None or seed is None:
            raise InvalidValueError("each row of the data set needs the columns task and seed, as of training_maps()")
        self._episode = episode = Episode(task, self._reward_profile, seed)
        return first_texts(PROMPT, episode)[1]

    def fly(self, direction: Direction) -> str:
        """Fly the drone one step, or wait for one.

        Args:
            direction: UP is y - 1, DOWN y + 1, LEFT x - 1, RIGHT x + 1; WAIT stays.

        Returns:
            What happened, and where the drone is now.
        """
        if str(direction) not in Action.__members__:
            # TRL shows the model what is raised here and counts it.
            raise InvalidValueError(repair_text(PROMPT, f"{str(direction)[:40]!r} is no direction"))
        episode = self._episode
        episode.step(Action[direction])
        if episode.ended:
            return episode.message
        below = below_text(episode.task, NAMES[episode.under])
        return (
            f"{episode.message} Position: {episode.position}. Battery: {episode.battery_units} units. "
            f"Nearest parcel: {episode.target}. Delivered: {episode.deliveries_done} of {episode.task.deliveries}."
        ) + (f" {below}." if below else "")

    def get_reward(self) -> float:
        """What the flight paid; one that the model left unfinished as if it waited to its end.

        Raises:
            EpisodeError: before the first reset.
        """
        if not self._episode.started:
            raise EpisodeError("no flight to pay for: call reset() first")
        return self._episode.waited_out().reward_total


def training_maps(task: str = "easy", maps: int = 1000, split: str = "train") -> "Dataset":
    """The first maps of a split as a data set of TRL: columns `prompt` (a conversation), `task` and `seed`.

    Args:
        task: The task: id, short name or grader.
        maps: How many.
        split: `train`, or `validation` for an evaluation; keep the test maps for the end.

    Raises:
        UnknownNameError: if there is no such task or split.
        InvalidValueError: if `maps` is out of range.
        MissingPackageError: if `datasets`, which comes with TRL, is not installed.
    """
    with needs("trl"):
        from datasets import Dataset  # pyright: ignore[reportMissingImports, reportAttributeAccessIssue]
    config = get_task(task)
    seeds = list(split_seeds(split, maps))
    system, _ = first_texts(PROMPT, Episode(config, seed=seeds[0]))
    # What is on the map comes from `reset`.
    prompt = [{"role": "system", "content": system}, {"role": "user", "content": ""}]
    return Dataset.from_dict({"prompt": [prompt] * len(seeds), "task": [config.id] * len(seeds), "seed": seeds})
