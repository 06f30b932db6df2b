"""Evaluation: `run_episodes(key)` is the one unit of work, `summarise` the figures of a report."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from drone_env.agents import Agent, BatchAgent, make_agent
from drone_env.agents.base import begin, named_failures
from drone_env.agents.named import as_agent
from drone_env.core.actions import integer
from drone_env.core.episode import Episode, rollout
from drone_env.core.seeds import N_SEEDS, SPLITS, check_seed, map_key, split_of, split_seeds, task_key
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError, TooLargeError, UnknownNameError
from drone_env.results.result import EpisodesKey, Results, concatenate, repeated
from drone_env.results.statistics import Summary

if TYPE_CHECKING:
    from drone_env.results.folder import ResultsFolder

Engine = Callable[[Sequence[EpisodesKey]], Iterator[Results]]
"""Returns the results of all keys, in any order; some may come twice."""


def episodes_key(
    task: str | TaskConfig,
    agent: str,
    seeds: range,
    split: str = "custom",
    *,
    repeat: int = 0,
    made: Agent | None = None,
) -> EpisodesKey:
    """The key of flying consecutive seeds of a task with an agent.

    Args:
        task: A task or its name.
        agent: The name of the agent.
        seeds: The maps.
        split: The split that they were chosen from.
        repeat: Which flight over these maps it is, of a stochastic agent.
        made: The agent, if it exists already; else it is made by its name.

    Raises:
        UnknownNameError: if there is no such task, agent or split.
        InvalidValueError: if the seeds are not consecutive integers in [0, 2^53), there are none, they are not of the
            split, the task is not the registered one of its name, or the agent does not say what decides how it flies.
    """
    task = get_task(task)
    made = made or make_agent(agent, task)
    if get_task(task.id, task.version) != task:
        raise InvalidValueError(f"task {task.id!r} is not the one in TASKS: a key names its task, so register it first")
    if not isinstance(seeds, range) or not seeds or seeds.step != 1:  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InvalidValueError(f"seeds must be a range of at least one, with step 1; got {seeds}")
    check_seed(seeds.start)
    check_seed(seeds.stop - 1)
    if split != "custom" and split not in SPLITS:
        raise UnknownNameError("split", split, ["custom", *SPLITS])
    if split != "custom" and {split_of(seeds.start), split_of(seeds.stop - 1)} != {split}:
        raise InvalidValueError(f"seeds {seeds.start} to {seeds.stop - 1} are not of the split {split!r}")
    digest = config_hash(task, agent, made)
    return EpisodesKey(task.id, task.version, split, (seeds.start, seeds.stop), agent, digest, repeat)


def repeats_of(key: EpisodesKey, repeats: int, agent: Agent | None = None) -> tuple[EpisodesKey, ...]:
    """The keys of several flights over the maps of a key; if the agent is not stochastic, that key alone.

    Raises:
        InvalidValueError: if `repeats` is below 1.
    """
    if repeats < 1:
        raise InvalidValueError(f"repeats must be at least 1, got {repeats}")
    stochastic = getattr(agent or make_agent(key.agent, get_task(key.task, key.version)), "stochastic", False)
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


def run_episodes(key: EpisodesKey, agent: Agent | None = None) -> Results:
    """Fly every episode of a key, each beside the exact optimum of its map.

    Args:
        key: What to fly.
        agent: The agent of the key, if it exists already; else it is made by its name.

    Raises:
        UnknownNameError: if the key names a task, version or agent that does not exist.
        InvalidValueError: if the key was made under another configuration than the one that would fly now, or has no
            seeds.
        AgentError, InvalidValueError: if the agent fails, as `evaluate`.
    """
    task = get_task(key.task, key.version)
    if key.seeds[0] >= key.seeds[1]:
        raise InvalidValueError(f"the key holds no seeds: {key.seeds}")
    agent = agent or make_agent(key.agent, task)
    now = config_hash(task, key.agent, agent)
    if now != key.config_hash:
        raise InvalidValueError(
            f"the key was made under configuration {key.config_hash}, but {key.agent!r} on {key.task!r} is now {now}"
        )
    return _fly_beside_the_optimum(task, key, agent)


def _fly_beside_the_optimum(task: TaskConfig, key: EpisodesKey, agent: Agent) -> Results:
    seeds = np.arange(*key.seeds, dtype=np.int64)
    optimal = deepcopy(_fly_optimally(task, *key.seeds))  # the caller may change the arrays of the results
    if key.agent == "optimal" and optimal is not None:
        scores, steps, deliveries = deepcopy(optimal)
    else:
        scores, steps, deliveries = _fly(task, key.agent, agent, seeds, key.repeat)
    return Results(
        key=key,
        seeds=seeds,
        scores=scores,
        steps=steps,
        deliveries=deliveries,
        success=deliveries == task.deliveries,
        optimal_scores=np.full(len(seeds), np.nan) if optimal is None else optimal[0],
        optimal_steps=np.full(len(seeds), -1, np.int32) if optimal is None else optimal[1],
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
) -> Results:
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
        agent = as_agent(policy, task, wrapper)
        name = f"{agent.config.get('agent', type(agent).__name__)}"
    key = episodes_key(task, name, maps, split if seeds is None else "custom", repeat=repeat, made=agent)
    return _fly_beside_the_optimum(task, key, agent)


FIGURES = {
    "mean_score": "score",
    "score_ci95": "score_ci95",
    "success_rate": "success_rate",
    "mean_steps": "steps",
    "mean_optimal_score": "optimum",
    "score_ratio": "ratio",
    "mean_regret": "regret",
    "mean_excess_steps": "excess_steps",
}
"""The names of the figures of a report, and those of `Summary`."""


def summarise(results: Results, *again: Results) -> dict[str, Any]:
    """The figures of a report, as JSON values; what could not be measured is null.

    Of several flights over each map, `again`, the mean counts, so that intervals are over maps. `score_ci95` (see
    `results.statistics`) is null for a single map. `score_ratio` is mean score / mean optimal score on the same maps.
    `mean_excess_steps` counts the steps beyond the optimal flight's, over flights that delivered everything; null if
    there is none.

    Raises:
        InvalidValueError: if they are not flights of one agent over the same maps.
    """
    summary = Summary.of(repeated((results, *again)))
    figures = {name: getattr(summary, figure) for name, figure in FIGURES.items()}
    return figures if summary.regret_maps == summary.maps else figures | {"mean_regret": None}


def local_engine(
    keys: Sequence[EpisodesKey], agents: Mapping[tuple[str, str], Agent] | None = None
) -> Iterator[Results]:
    """Fly one key after another in this process, with the agents that exist already, by task and name."""
    return (run_episodes(key, (agents or {}).get((key.task, key.agent))) for key in keys)


def evaluate_keys(
    keys: Sequence[EpisodesKey],
    engine: Engine,
    folder: "ResultsFolder | None" = None,
    arrived: Callable[[Results], None] | None = None,
) -> dict[EpisodesKey, Results]:
    """The results of each key: those in the folder, and the rest from the engine.

    They are put together in the order of the seeds, so that they are the same in any order of arrival.

    Args:
        keys: What to fly.
        engine: What flies it.
        folder: Stores each piece before it counts.
        arrived: Called once with each piece.

    Raises:
        OSError, InvalidValueError: from the folder.
        ClusterError: from an engine on a cluster.
    """
    pieces = {key: key.pieces() for key in keys}
    flown: dict[EpisodesKey, Results] = {}

    def count(results: Results) -> None:
        flown[results.key] = results
        if arrived is not None:
            arrived(results)

    missing: list[EpisodesKey] = []
    for piece in (piece for of_key in pieces.values() for piece in of_key):
        stored = None if folder is None else folder.load(piece)
        if stored is None:
            missing.append(piece)
        else:
            count(stored)
    for results in engine(missing) if missing else ():
        if results.key not in flown:
            if folder is not None:
                folder.save(results)
            count(results)
    return {key: concatenate([flown[piece] for piece in of_key]) for key, of_key in pieces.items()}


Flown = tuple[npt.NDArray[np.float64], npt.NDArray[np.int32], npt.NDArray[np.int32]]
"""Scores, steps and deliveries of flights."""


@lru_cache(maxsize=256)
def _fly_optimally(task: TaskConfig, start: int, stop: int) -> Flown | None:
    """The optimum of each map, None where one is too large; kept, since every agent is compared with it."""
    try:
        return _fly(task, "optimal", make_agent("optimal", task), np.arange(start, stop, dtype=np.int64))
    except TooLargeError:
        return None


def _fly(task: TaskConfig, name: str, agent: Agent, seeds: npt.NDArray[np.int64], repeat: int = 0) -> Flown:
    from drone_env.agents.together import fly_together  # compiles

    agent_seeds, asked = _agent_seeds(seeds, repeat), 0
    if isinstance(agent, BatchAgent):

        def act_batch(grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
            nonlocal asked
            asked += 1
            return agent.act_batch(grids, telemetry)

        with named_failures(name, task, lambda: f"maps {seeds[0]} to {seeds[-1]}, step {asked}"):
            agent.reset_batch(agent_seeds)
            return fly_together(task, seeds, act_batch, getattr(agent, "stateless", False))
    flown: list[tuple[float, int, int]] = []
    for seed, agent_seed in zip(seeds.tolist(), agent_seeds.tolist(), strict=True):
        episode = Episode(task, seed=seed)
        rollout(episode, begin(agent, name, episode, agent_seed))
        flown.append((episode.score, episode.steps, episode.deliveries_done))
    scores, steps, deliveries = zip(*flown, strict=True)
    return np.array(scores), np.array(steps, np.int32), np.array(deliveries, np.int32)


def _agent_seeds(seeds: npt.NDArray[np.int64], repeat: int) -> npt.NDArray[np.int64]:
    """The seeds of an agent's random choices, int64[n] in [0, 2^53): at first the map seeds, then others."""
    if repeat == 0:
        return seeds
    as_integers: Any = seeds  # arrays of 64-bit integers wrap as compiled ones do
    keys: Any = map_key(task_key("evaluation/repeat", repeat), as_integers)
    return keys & (N_SEEDS - 1)
