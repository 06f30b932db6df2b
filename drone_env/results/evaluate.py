"""Evaluation: `run_episodes(key)` is the one unit of work, `summarise` the figures that stand in reports."""

import hashlib
import json
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from statistics import fmean
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.agents import Agent, BatchAgent, make_agent
from drone_env.agents.base import begin, named_failures
from drone_env.agents.named import as_agent
from drone_env.core.actions import integer
from drone_env.core.episode import Episode
from drone_env.core.episode import rollout
from drone_env.core.seeds import N_SEEDS, SPLITS, check_seed, map_key, split_of, split_seeds, task_key
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError, TooLargeError, UnknownNameError
from drone_env.results.interval import SCORES, ci95, with_interval

if TYPE_CHECKING:
    from drone_env.agents.together import Ends


class EpisodesKey(NamedTuple):
    """What a piece of evaluation is: equal keys give equal results.

    `seeds` are [start, stop); `split` is the split that they were chosen from, or `custom`. `repeat` numbers the
    flights of a stochastic agent over one map, from 0: each draws other lots.
    """

    task: str
    version: int
    split: str
    seeds: tuple[int, int]
    agent: str
    config_hash: str
    repeat: int = 0


@dataclass(frozen=True, eq=False)
class EpisodeResults:
    """The results of the episodes of one key, one entry per episode, in the order of the seeds.

    Attributes:
        key: What was flown.
        seeds: int64[n].
        scores: float64[n], the graded scores.
        steps: int32[n], steps flown.
        deliveries: int32[n], parcels delivered.
        success: bool[n], whether all were.
        optimal_scores: float64[n], the exact optimum of each map; NaN where no planner knows it.
        optimal_steps: int32[n], steps of the optimal flight; -1 where no planner knows it.
    """

    key: EpisodesKey
    seeds: npt.NDArray[np.int64]
    scores: npt.NDArray[np.float64]
    steps: npt.NDArray[np.int32]
    deliveries: npt.NDArray[np.int32]
    success: npt.NDArray[np.bool_]
    optimal_scores: npt.NDArray[np.float64]
    optimal_steps: npt.NDArray[np.int32]

    def __repr__(self) -> str:
        """The figures in three lines of at most 80 columns."""
        figures, key = summarise(self), self.key
        mean, interval, optimum = figures["mean_score"], figures["score_ci95"], figures["mean_optimal_score"]
        score = with_interval(mean, interval) + ("" if interval is None else " (95 %)")
        best = "unknown" if optimum is None else f"{optimum:.4f}"
        what = f" on {key.task} v{key.version}"
        room = 80 - len(what)
        return (
            f"{key.agent if len(key.agent) <= room else f'…{key.agent[1 - room :]}'}{what}\n"
            f"maps {key.seeds[0]} to {key.seeds[1] - 1} ({len(self.seeds)}, split {key.split})\n"
            f"score {score}, optimum {best}, "
            f"success {figures['success_rate']:.1%}, steps {figures['mean_steps']:.1f}"
        )


COLUMNS: dict[str, type[np.generic]] = {
    "seeds": np.int64,
    "scores": np.float64,
    "steps": np.int32,
    "deliveries": np.int32,
    "success": np.bool_,
    "optimal_scores": np.float64,
    "optimal_steps": np.int32,
}
"""The columns of the results, and the types of their arrays."""
AVERAGED = ("scores", "success", "steps")
"""What differs from flight to flight over a map."""


def episodes_key(task: str | TaskConfig, agent: str, seeds: range, split: str = "custom") -> EpisodesKey:
    """The key of flying consecutive seeds of a task with an agent.

    Raises:
        UnknownNameError: if there is no such task, agent or split.
        InvalidValueError: if the seeds are not consecutive integers in [0, 2^53), there are none, they are not of the
            split, the task is not the registered one of its name, or the agent does not say what decides how it flies.
    """
    task = get_task(task)
    return _key(task, agent, seeds, split, make_agent(agent, task))


def _key(task: TaskConfig, name: str, seeds: range, split: str, agent: Agent, repeat: int = 0) -> EpisodesKey:
    if get_task(task.id, task.version) != task:
        raise InvalidValueError(f"task {task.id!r} is not the one in TASKS: a key names its task, so register it first")
    if not seeds or seeds.step != 1:
        raise InvalidValueError(f"seeds must be a range of at least one, with step 1; got {seeds}")
    check_seed(seeds.start)
    check_seed(seeds.stop - 1)
    if split != "custom" and split not in SPLITS:
        raise UnknownNameError("split", split, ["custom", *SPLITS])
    if split != "custom" and {split_of(seeds.start), split_of(seeds.stop - 1)} != {split}:
        raise InvalidValueError(f"seeds {seeds.start} to {seeds.stop - 1} are not of the split {split!r}")
    digest = config_hash(task, name, agent)
    return EpisodesKey(task.id, task.version, split, (seeds.start, seeds.stop), name, digest, repeat)


def repeats_of(key: EpisodesKey, repeats: int) -> tuple[EpisodesKey, ...]:
    """The keys of flying the maps of a key several times; of an agent that draws no lots, that key alone.

    Raises:
        InvalidValueError: if `repeats` is below 1.
    """
    if repeats < 1:
        raise InvalidValueError(f"repeats must be at least 1, got {repeats}")
    stochastic = getattr(make_agent(key.agent, get_task(key.task, key.version)), "stochastic", False)
    return tuple(key._replace(repeat=repeat) for repeat in range(repeats if stochastic else 1))


def config_hash(task: TaskConfig, name: str, agent: Agent) -> str:
    """16 hex digits that change with any number of the task and with anything that decides how the agent flies.

    Raises:
        InvalidValueError: if the agent does not say what decides how it flies.
    """
    flies: Any = getattr(agent, "config", None)
    try:
        text = json.dumps({"task": task.rules(), "agent": dict(flies)}, sort_keys=True)
    except (TypeError, ValueError):
        message = "a mapping of JSON values, of all that decides how it flies"
        raise InvalidValueError(f"agent {name!r} must have `config`, {message}; got {flies!r}") from None
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def run_episodes(key: EpisodesKey) -> EpisodeResults:
    """Fly every episode of a key, each beside the exact optimum of its map.

    Raises:
        UnknownNameError: if the key names a task, version or agent that does not exist.
        InvalidValueError: if the key was made under another configuration than the one that would fly now, or holds
            no seeds.
        AgentError, InvalidValueError: if the agent fails, as `evaluate`.
    """
    task = get_task(key.task, key.version)
    if key.seeds[0] >= key.seeds[1]:
        raise InvalidValueError(f"the key holds no seeds: {key.seeds}")
    agent = make_agent(key.agent, task)
    now = config_hash(task, key.agent, agent)
    if now != key.config_hash:
        raise InvalidValueError(
            f"the key was made under configuration {key.config_hash}, but {key.agent!r} on {key.task!r} is now {now}"
        )
    return _beside_the_optimum(task, key, agent)


def _beside_the_optimum(task: TaskConfig, key: EpisodesKey, agent: Agent) -> EpisodeResults:
    seeds = np.arange(*key.seeds, dtype=np.int64)
    optimal = _fly_optimally(task, *key.seeds)
    is_optimal = key.agent == "optimal"
    flights = deepcopy(optimal) if optimal and is_optimal else _fly(task, key.agent, agent, seeds, key.repeat)
    optimal = deepcopy(optimal)  # what is kept stays as it is, whatever the caller does with the results
    return EpisodeResults(
        key=key,
        seeds=seeds,
        scores=flights.scores,
        steps=flights.steps,
        deliveries=flights.deliveries_done,
        success=flights.deliveries_done == task.deliveries,
        optimal_scores=np.full(len(seeds), np.nan) if optimal is None else optimal.scores,
        optimal_steps=np.full(len(seeds), -1, np.int32) if optimal is None else optimal.steps,
    )


def evaluate(
    policy: Any,
    task: str | TaskConfig,
    split: str = "test",
    episodes: int = 1000,
    *,
    seeds: range | None = None,
    repeat: int = 0,
    wrapper: Any = None,
    sampled: bool = False,
) -> EpisodeResults:
    """Fly maps with anything that can fly, each beside the exact optimum; `summarise` makes figures of it.

    An agent with `act_batch`, and a model, fly all maps together; anything else is asked drone by drone.

    Args:
        policy: The name of an agent as `make_agent` takes it, an agent (`reset`, `act`), a class of one, a function
            from an observation to an action, or a model of Stable-Baselines3.
        task: A task or its name.
        split: Whose first maps to fly.
        episodes: How many.
        seeds: The maps to fly instead.
        repeat: Which flight over these maps it is, of an agent that draws lots: another number, other lots.
        wrapper: The wrapper of observations that a model was trained behind, or its name.
        sampled: Whether a model draws its actions; else it takes the likeliest.

    Raises:
        UnknownNameError: if there is no such task, split, version or agent.
        InvalidValueError: if the maps or the policy are not as said above, or the policy names an action that there is
            not.
        AgentError: if the code of the policy fails; the message says on which map, at which step.
        UnsupportedTaskError, CheckpointError, OSError: from the agent.
    """
    task = get_task(task)
    for count, least, said in ((episodes, 1, "episodes"), (repeat, 0, "repeat")):
        number = integer(count)
        if number is None or number < least:
            raise InvalidValueError(f"{said} must be an integer of at least {least}, got {count!r}")
    maps, name = split_seeds(split, episodes) if seeds is None else seeds, f"{policy}"
    if isinstance(policy, str):
        agent = make_agent(policy, task)
    else:
        agent = as_agent(policy, task, wrapper, sampled)
        name = f"{agent.config.get('agent', type(agent).__name__)}"
    return _beside_the_optimum(task, _key(task, name, maps, split if seeds is None else "custom", agent, repeat), agent)


PIECE = 1000
"""Episodes that are flown together by the command line, on any engine."""


def pieces_of(key: EpisodesKey, size: int = PIECE) -> list[EpisodesKey]:
    """The keys of neighbouring pieces of at most `size` episodes each."""
    start, stop = key.seeds
    return [key._replace(seeds=(first, min(first + size, stop))) for first in range(start, stop, size)]


def concatenate(pieces: Sequence[EpisodeResults]) -> EpisodeResults:
    """One result from the results of neighbouring pieces.

    Raises:
        InvalidValueError: if there are none, or they are not neighbours of one configuration.
    """
    keys = [piece.key for piece in pieces]
    if not keys:
        raise InvalidValueError("there are no results to put together")
    for left, right in pairwise(keys):
        if left._replace(seeds=right.seeds) != right or left.seeds[1] != right.seeds[0]:
            raise InvalidValueError(f"these results are not neighbours: {left} and {right}")
    return EpisodeResults(
        key=keys[0]._replace(seeds=(keys[0].seeds[0], keys[-1].seeds[1])),
        **{name: np.concatenate([getattr(piece, name) for piece in pieces]) for name in COLUMNS},
    )


def summarise(results: EpisodeResults, *again: EpisodeResults) -> dict[str, Any]:
    """The figures of a report, as JSON values; what could not be measured is null.

    Of several flights over each map, `again`, the mean counts, so that intervals are over maps. `score_ci95` (see
    `statistics`) is null for a single map. `score_ratio` is mean score / mean optimal score on the same maps.
    `mean_excess_steps` counts the steps beyond the optimal flight's, over flights that
    delivered everything; null where there is none.

    Raises:
        InvalidValueError: if they are not flights of one agent over the same maps.
    """
    for one in again:
        if one.key._replace(repeat=results.key.repeat) != results.key:
            raise InvalidValueError(
                f"these are not flights of one agent over the same maps: {results.key} and {one.key}"
            )
    # Sums are correctly rounded: the same figures in any order that the episodes were flown.
    scores, success, steps = (np.array([getattr(r, name) for r in (results, *again)]) for name in AVERAGED)
    of_maps = scores.mean(axis=0)
    mean = fmean(of_maps)
    solved = not np.isnan(results.optimal_scores).any()
    optimal = fmean(results.optimal_scores) if solved else None
    excess = (steps - results.optimal_steps)[success]
    return {
        "mean_score": mean,
        "score_ci95": ci95(of_maps, SCORES),
        "success_rate": fmean(success.flat),
        "mean_steps": fmean(steps.flat),
        "mean_optimal_score": optimal,
        "score_ratio": None if optimal is None else mean / optimal,
        "mean_regret": fmean(results.optimal_scores - of_maps) if solved else None,
        "mean_excess_steps": fmean(excess) if solved and len(excess) else None,
    }


@lru_cache(maxsize=256)
def _fly_optimally(task: TaskConfig, start: int, stop: int) -> "Ends | None":
    """The optimum of each map, None where one is too large; kept, since every agent is compared with it."""
    try:
        return _fly(task, "optimal", make_agent("optimal", task), np.arange(start, stop, dtype=np.int64))
    except TooLargeError:
        return None


def _fly(task: TaskConfig, name: str, agent: Agent, seeds: npt.NDArray[np.int64], repeat: int = 0) -> "Ends":
    from drone_env.agents.together import Ends, fly_together  # compiles, which only who evaluates should wait for

    lots, asked = _lots(seeds, repeat), 0
    if isinstance(agent, BatchAgent):

        def act_batch(grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
            nonlocal asked
            asked += 1
            return agent.act_batch(grids, telemetry)

        with named_failures(name, task, lambda: f"maps {seeds[0]} to {seeds[-1]}, step {asked}"):
            agent.reset_batch(lots)
            return fly_together(task, seeds, act_batch, getattr(agent, "stateless", False))
    ends: list[tuple[float, int, int]] = []
    for seed, lot in zip(seeds.tolist(), lots.tolist(), strict=True):
        episode = Episode(task, seed=seed)
        rollout(episode, begin(agent, name, episode, lot))
        ends.append((episode.score, episode.steps, episode.deliveries_done))
    scores, steps, deliveries_done = zip(*ends, strict=True)
    return Ends(np.array(scores), np.array(steps, np.int32), np.array(deliveries_done, np.int32))


def _lots(seeds: npt.NDArray[np.int64], repeat: int) -> npt.NDArray[np.int64]:
    """What an agent draws its lots from, int64[n] in [0, 2^53): at first the numbers of the maps, then others."""
    if repeat == 0:
        return seeds
    as_integers: Any = seeds  # arrays of 64-bit integers wrap as compiled ones do
    keys: Any = map_key(task_key("evaluation/repeat", repeat), as_integers)
    return keys & (N_SEEDS - 1)
