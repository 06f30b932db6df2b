"""Post-training with TRL's GRPOTrainer: the model flies by calling tools, or plans the whole route in one answer.

from trl import GRPOConfig, GRPOTrainer
from drone_env.llm.trl_environment import DroneEnvironment, flight_reward, training_maps

trainer = GRPOTrainer(
    model="Qwen/Qwen3-0.6B",
    train_dataset=training_maps("easy", maps=1000),  # plan="plan": one answer, without environment_factory
    environment_factory=DroneEnvironment,
    reward_funcs=flight_reward,  # logs the flights; pays those of one answer
    args=GRPOConfig(max_completion_length=4096, num_generations=8),
)
"""

# TRL's datasets are not installed where types are checked.
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false

from collections.abc import Callable, Sequence
from statistics import fmean
from typing import TYPE_CHECKING, Any

from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, profile_for_discount
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import EpisodeError, InvalidValueError, needs
from drone_env.llm.prompt import Prompt, get_prompt, tools_prompt
from drone_env.llm.text_episode import TextEpisode
from drone_env.models import Direction

if TYPE_CHECKING:
    from datasets import Dataset  # pyright: ignore[reportMissingImports, reportAttributeAccessIssue]


class DroneEnvironment:
    """One drone. TRL creates one per rollout, resets it for each map, and offers the model its tools.

    TRL treats every public method except `reset` and `get_reward` as a tool, and shows the model the errors that they
    raise. It knows no method that ends a rollout.
    """

    def __init__(self) -> None:
        self._flown: TextEpisode | None = None

    def reset(
        self, task: str | None = None, seed: int | None = None, reward_profile: str = DEFAULT_PROFILE, **columns: Any
    ) -> str:
        """Start a flight and return its first observation, which TRL appends to the prompt's last message.

        Args:
            task: The task: id, short name or grader.
            seed: The map, from the dataset: all rollouts of a group fly the same one.
            reward_profile: The rewards of the steps.
            columns: All other columns of the row, such as `prompt`.

        Raises:
            UnknownNameError: if there is no such task or profile.
            InvalidValueError: if the row names no task and seed, or the seed is not in [0, 2^53).
        """
        if task is None or seed is None:
            raise InvalidValueError("each row of the dataset needs the columns task and seed: see training_maps()")
        self._flown = _flight(task, seed, tools_prompt(), reward_profile)
        return self._flown.messages[-1]["content"]

    def fly(self, direction: Direction) -> str:
        """Fly the drone one step, or wait for one.

        Args:
            direction: UP is y - 1, DOWN y + 1, LEFT x - 1, RIGHT x + 1; WAIT stays.

        Returns:
            What happened, and where the drone is now.
        """
        return self._started().fly([direction])

    def fly_route(self, directions: list[Direction]) -> str:
        """Fly the drone several steps.

        Args:
            directions: The steps in order: UP is y - 1, DOWN y + 1, LEFT x - 1, RIGHT x + 1; WAIT stays.

        Returns:
            What happened, and where the drone is now.
        """
        return self._started().fly(directions)

    def goto(self, stop: str) -> str:
        """Fly the drone to a parcel or a pad by the cheapest way, and fill up on a pad.

        Args:
            stop: The letter of a stop in reach.

        Returns:
            What happened, where the drone is now, and the stops in reach from there.
        """
        return self._started().goto(stop)

    def get_reward(self) -> float:
        """The sum of the flight's rewards, undiscounted; an unfinished flight counts as waiting to its end.

        Raises:
            EpisodeError: before the first reset.
        """
        return _paid(self._started())

    def _started(self) -> TextEpisode:
        if self._flown is None:
            raise EpisodeError("no flight: call reset() first")
        return self._flown


def flight_reward(
    completions: Sequence[Sequence[dict[str, Any]]],
    environments: Sequence[object] | None = None,
    log_metric: Callable[[str, float], None] | None = None,
    **columns: Sequence[Any],
) -> list[float | None]:
    """The reward of flights by one answer, as `DroneEnvironment.get_reward`.

    Logs the means of score, success, regret, steps, and of unusable plans, as `flight/score` and so on.

    Args:
        completions: The conversations after the prompt. Without environments each is one answer with the route.
        environments: The environments that flew. They pay their own reward, so it is 0 here; None for those of other
            classes.
        log_metric: TRL's logger.
        columns: The columns of `training_maps`; all others are ignored.

    Raises:
        InvalidValueError: if there is no environment, and the columns name no plan.
        EpisodeError: if an environment was never reset.
    """
    flights: list[TextEpisode | None] = []
    if environments is not None:
        flown_by: Callable[[DroneEnvironment], TextEpisode] = DroneEnvironment._started  # pyright: ignore[reportPrivateUsage]
        flights += [flown_by(one) if isinstance(one, DroneEnvironment) else None for one in environments]
    elif "plan" not in columns:
        raise InvalidValueError("without environment_factory=DroneEnvironment the dataset is training_maps(plan=...)")
    else:
        rows = zip(*(columns[name] for name in ("task", "seed", "plan", "reward_profile")), strict=True)
        for completion, row in zip(completions, rows, strict=True):
            flight = _flight(*row)
            flight.answer(str(completion[-1].get("content") or ""))
            flights.append(flight)
    flown = [flight for flight in flights if flight is not None]
    measured: dict[str, list[float | None]] = {
        "score": [flight.score for flight in flown],
        "success": [flight.success for flight in flown],
        "regret": [flight.regret for flight in flown],
        "steps": [flight.episode.steps for flight in flown],
        "unusable": [flight.attempt == 2 for flight in flown],
    }
    for name, values in measured.items():
        known = [value for value in values if value is not None]
        if log_metric and known:
            log_metric(f"flight/{name}", fmean(known))
    if environments is not None:
        return [flight and 0.0 for flight in flights]
    return [_paid(flight) for flight in flown]


def _paid(flight: TextEpisode) -> float:
    return flight.episode.waited_out().reward_total


def training_maps(
    task: str = "easy",
    maps: int = 1000,
    split: str = "train",
    plan: str | None = None,
    reward_profile: str = DEFAULT_PROFILE,
) -> "Dataset":
    """The first maps of a split as a dataset for TRL.

    Columns: `prompt` (a conversation), `task`, `seed` and `reward_profile`; with a plan, also `plan`.

    Args:
        task: The task: id, short name or grader.
        maps: Number of maps.
        split: `train`, or `validation` for an evaluation; keep the test maps for the end.
        plan: A prompt that asks for the whole route in one answer, such as `plan`. None: flights by tool calls.
        reward_profile: The rewards of the steps.

    Raises:
        UnknownNameError: if there is no such task, split, prompt or profile.
        InvalidValueError: if `maps` is out of range, or the prompt does not ask for a route.
        MissingPackageError: if `datasets`, which comes with TRL, is not installed.
    """
    with needs("trl"):
        from datasets import Dataset  # pyright: ignore[reportMissingImports, reportAttributeAccessIssue]
    config = get_task(task)
    seeds = list(split_seeds(split, maps))
    shared = {"task": config.id, "reward_profile": reward_profile}
    if plan is None:
        # `reset` returns the user's message, which depends on the map.
        system = _flight(task, seeds[0], tools_prompt(), reward_profile).messages[0]
        prompts = [[system, {"role": "user", "content": ""}]] * len(seeds)
    else:
        chosen = get_prompt(plan)
        if not chosen.plan:
            raise InvalidValueError(f"prompt {chosen.id} asks for one action: choose one for a route, such as plan")
        shared["plan"] = chosen.id if chosen.own is None else plan
        prompts = [_flight(task, seed, chosen, reward_profile).messages for seed in seeds]
    columns = {name: [value] * len(seeds) for name, value in shared.items()}
    return Dataset.from_dict({"prompt": prompts, "seed": seeds, **columns})


def _flight(task: str, seed: int, prompt: Prompt | str, reward_profile: str) -> TextEpisode:
    """A flight whose rewards are undiscounted: their shaping gets the discount 1."""
    return TextEpisode(task, seed, prompt, profile_for_discount(get_reward_profile(reward_profile), 1))
