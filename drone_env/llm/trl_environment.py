"""An environment for TRL's GRPOTrainer: the model flies by calling the tool `fly`.

from trl import GRPOConfig, GRPOTrainer
from drone_env.llm.trl_environment import DroneEnvironment, training_maps

trainer = GRPOTrainer(
    model="Qwen/Qwen3-0.6B",
    train_dataset=training_maps("easy", maps=1000),
    environment_factory=DroneEnvironment,
    args=GRPOConfig(max_completion_length=4096, num_generations=8),
)
"""

# TRL's datasets are not installed where types are checked.
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false

from typing import TYPE_CHECKING, Any

from drone_env.core.actions import Action
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, profile_for_discount
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import EpisodeError, InvalidValueError, needs
from drone_env.llm.prompt import FOLDER, below_text, read_prompt
from drone_env.llm.text_episode import TextEpisode
from drone_env.models import NAMES, Direction

if TYPE_CHECKING:
    from datasets import Dataset  # pyright: ignore[reportMissingImports, reportAttributeAccessIssue]

PROMPT = read_prompt(FOLDER / "tools" / "fly-2.toml")


class DroneEnvironment:
    """One drone. TRL creates one per rollout, resets it for each map, and offers its tool `fly` to the model.

    TRL treats every public method except `reset` and `get_reward` as a tool.

    Args:
        reward_profile: The rewards of the steps, undiscounted: their shaping gets the discount 1.

    Raises:
        UnknownNameError: if there is no such profile.
    """

    def __init__(self, reward_profile: str = DEFAULT_PROFILE) -> None:
        self._reward_profile = profile_for_discount(get_reward_profile(reward_profile), 1)
        self._flight: TextEpisode | None = None

    def reset(self, task: str | None = None, seed: int | None = None, **columns: Any) -> str:
        """Start a flight and return its first observation, which TRL appends to the prompt's last message.

        Args:
            task: The task: id, short name or grader.
            seed: The map, from the dataset: all rollouts of a group fly the same one.
            columns: All other columns of the row, such as `prompt`.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if the row names no task and seed, or the seed is not in [0, 2^53).
        """
        if task is None or seed is None:
            raise InvalidValueError("each row of the dataset needs the columns task and seed: see training_maps()")
        self._flight = TextEpisode(task, seed, PROMPT, self._reward_profile)
        return self._flight.messages[1]["content"]

    def fly(self, direction: Direction) -> str:
        """Fly the drone one step, or wait for one.

        Args:
            direction: UP is y - 1, DOWN y + 1, LEFT x - 1, RIGHT x + 1; WAIT stays.

        Returns:
            What happened, and where the drone is now.
        """
        if str(direction) not in Action.__members__:
            # TRL shows this error to the model and counts it.
            raise InvalidValueError(PROMPT.repair_text(f"{str(direction)[:40]!r} is no direction"))
        episode = self._started().episode
        episode.step(Action[direction])
        if episode.ended:
            return episode.message
        below = below_text(episode.task, NAMES[episode.under])
        return (
            f"{episode.message} Position: {episode.position}. Battery: {episode.battery_units} units. "
            f"Nearest parcel: {episode.target}. Delivered: {episode.deliveries_done} of {episode.task.deliveries}."
        ) + (f" {below}." if below else "")

    def get_reward(self) -> float:
        """The sum of the flight's rewards; an unfinished flight counts as waiting to its end.

        Raises:
            EpisodeError: before the first reset.
        """
        return self._started().episode.waited_out().reward_total

    def _started(self) -> TextEpisode:
        if self._flight is None:
            raise EpisodeError("no flight: call reset() first")
        return self._flight


def training_maps(task: str = "easy", maps: int = 1000, split: str = "train") -> "Dataset":
    """The first maps of a split as a dataset for TRL: columns `prompt` (a conversation), `task` and `seed`.

    Args:
        task: The task: id, short name or grader.
        maps: Number of maps.
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
    # `reset` returns the user's message, which depends on the map.
    prompt = [TextEpisode(config, seeds[0], PROMPT).messages[0], {"role": "user", "content": ""}]
    return Dataset.from_dict({"prompt": [prompt] * len(seeds), "task": [config.id] * len(seeds), "seed": seeds})
