"""Evaluation: `run_episodes(key)` is the unit of work; `summarise` returns the statistics of a report."""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from drone_env.agents import make_agent
from drone_env.agents.base import Agent, BatchAgent, begin, rollout_batch
from drone_env.agents.custom import as_agent
from drone_env.core.episode import Episode, rollout
from drone_env.core.seeds import N_SEEDS, SPLITS, map_key, split_seeds, task_key
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError, TooLargeError, UnknownNameError
from drone_env.planning.optimal import solve
from drone_env.results.result import EpisodesKey, Results, concatenate, repeated
from drone_env.results.statistics import Summary

if TYPE_CHECKING:
    from drone_env.results.folder import ResultsFolder

Engine = Callable[[Sequence[EpisodesKey]], Iterator[Results]]
"""Returns the results of all keys in any order; it may repeat some."""


def episodes_key(
    task: str | TaskConfig,
    agent: str,
    seeds: range,
    split: str = "custom",
    *,
    repeat: int = 0,
    made: Agent | None = None,
) -> EpisodesKey:
    """Return the key of an agent on consecutive seeds of a task.

    Args:
        task: A task or its name.
        agent: The name of the agent.
        seeds: The maps.
        split: The split of the seeds, or `custom`.
        repeat: The number of the repeat, for a stochastic agent.
        made: The agent, if it exists already; None to make it by its name.

    Raises:
        UnknownNameError: if there is no such task, agent or split.
        InvalidValueError: if the seeds are not one or more consecutive integers in [0, 2^53) and in the split, the task
            differs from the registered one of its name, or the agent has no `config`.
    """
    if isinstance(task, str):
        task = get_task(task)
    made = made or make_agent(agent, task)
    if get_task(task.id, task.version) != task:
        raise InvalidValueError(f"task {task.id!r} is not the one in TASKS: a key names its task, so register it first")
    if not isinstance(seeds, range) or not seeds or seeds.step != 1:  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InvalidValueError(f"seeds must be a range of at least one, with step 1; got {seeds}")
    if split != "custom" and split not in SPLITS:
        raise UnknownNameError("split", split, ["custom", *SPLITS])
    first, stop = SPLITS.get(split, (0, N_SEEDS))
    if not first <= seeds.start < seeds.stop <= stop:
        raise InvalidValueError(
            f"seeds {seeds.start} to {seeds.stop - 1} are not of the split {split!r}, {first} to {stop - 1}"
        )
    digest = config_hash(task, agent, made)
    return EpisodesKey(task.id, task.version, split, (seeds.start, seeds.stop), agent, digest, repeat)


def repeats_of(key: EpisodesKey, repeats: int, agent: Agent | None = None) -> tuple[EpisodesKey, ...]:
    """Return one key per repeat; only the given key if the agent is not stochastic.

    Raises:
        InvalidValueError: if `repeats` is below 1.
    """
    if repeats < 1:
        raise InvalidValueError(f"repeats must be at least 1, got {repeats}")
    stochastic = getattr(agent or make_agent(key.agent, get_task(key.task, key.version)), "stochastic", False)
    return tuple(key._replace(repeat=repeat) for repeat in range(repeats if stochastic else 1))


def config_hash(task: TaskConfig, name: str, agent: Agent) -> str:
    """Return 16 hex digits that change with any number of the task and with the configuration of the agent.

    Raises:
        InvalidValueError: if `agent.config` is not a mapping of JSON values.
    """
    config: Any = getattr(agent, "config", None)
    try:
        text = json.dumps({"task": task.rules(), "agent": dict(config)}, sort_keys=True)
    except (TypeError, ValueError):
        message = "a mapping of JSON values that determines its actions"
        raise InvalidValueError(f"agent {name!r} must have `config`, {message}; got {config!r}") from None
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def run_episodes(key: EpisodesKey) -> Results:
    """Fly every episode of a key and solve its map.

    Raises:
        UnknownNameError: if the key contains an unknown task, version or agent.
        InvalidValueError: if the key was made under another configuration.
        AgentError, InvalidValueError: if the agent fails, as `evaluate`.
    """
    return _fly_and_solve(get_task(key.task, key.version), key, _agent_of(key))


def _agent_of(key: EpisodesKey) -> Agent:
    """Return the agent of a key, whose configuration must be that of the key."""
    task = get_task(key.task, key.version)
    agent = make_agent(key.agent, task)
    digest = config_hash(task, key.agent, agent)
    if digest != key.config_hash:
        raise InvalidValueError(
            f"the key was made under configuration {key.config_hash}, but {key.agent!r} on {key.task!r} is now {digest}"
        )
    return agent


def _fly_and_solve(task: TaskConfig, key: EpisodesKey, agent: Agent) -> Results:
    seeds = np.arange(*key.seeds, dtype=np.int64)
    optimal = _fly_optimally(task, *key.seeds)
    if key.agent == "optimal" and optimal is not None:
        # Copies, because the caller may change the arrays of the results.
        scores, steps, deliveries = optimal[0].copy(), optimal[1].copy(), optimal[2].copy()
    else:
        scores, steps, deliveries = _fly(task, key.agent, agent, seeds, key.repeat)
    return Results(
        key=key,
        seeds=seeds,
        scores=scores,
        steps=steps,
        deliveries=deliveries,
        success=deliveries == task.deliveries,
        optimal_scores=np.full(len(seeds), np.nan) if optimal is None else optimal[0].copy(),
        optimal_steps=np.full(len(seeds), -1, np.int32) if optimal is None else optimal[1].copy(),
    )


def evaluate(
    policy: Any,
    task: str | TaskConfig,
    split: str = "test",
    episodes: int = 1000,
    *,
    seeds: range | None = None,
    repeat: int = 0,
) -> Results:
    """Fly maps with any policy and solve each map; pass the results to `summarise`.

    Models and agents with `act_batch` fly all maps in one batch; other policies fly one map at a time.

    Args:
        policy: The name of an agent as `make_agent` takes it, an agent (`reset`, `act`), a class of one, a function
            from an observation to an action, or a model of Stable-Baselines3.
        task: A task or its name.
        split: The split.
        episodes: Fly this many of its first maps.
        seeds: Fly these maps instead of a split's.
        repeat: The number of the repeat; it seeds a stochastic agent.

    Raises:
        UnknownNameError: if there is no such task, split, version or agent.
        InvalidValueError: if the maps or the policy are invalid, or the policy returns an invalid action.
        AgentError: if the code of the policy fails; the message contains the map and the step.
        UnsupportedTaskError, CheckpointError, OSError: from the agent.
    """
    task = get_task(task)
    maps, name = split_seeds(split, episodes) if seeds is None else seeds, f"{policy}"
    if isinstance(policy, str):
        agent = make_agent(policy, task)
    else:
        agent = as_agent(policy, task)
        name = f"{agent.config.get('agent', type(agent).__name__)}"
    key = episodes_key(task, name, maps, split if seeds is None else "custom", repeat=repeat, made=agent)
    return _fly_and_solve(task, key, agent)


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
"""The keys of a report, and the fields of `Summary` that they contain."""


def summarise(results: Results, *again: Results) -> dict[str, Any]:
    """Return the statistics of a report as JSON values; null if unknown.

    With repeats (`again`), the flights over each map are averaged first, so intervals are over maps. `score_ci95` (see
    `results.statistics`) is null for a single map. `score_ratio` is mean score / mean optimal score on the same maps.
    `mean_excess_steps` counts the steps beyond the optimal flight's, over flights that delivered everything; null if
    there is none.

    Raises:
        InvalidValueError: if they are not flights of one agent over the same maps.
    """
    return figures_of(Summary.of(repeated((results, *again))))


def figures_of(summary: Summary) -> dict[str, Any]:
    """Return the statistics of `summarise` from a summary."""
    figures = {name: getattr(summary, figure) for name, figure in FIGURES.items()}
    return figures if summary.regret_maps == summary.maps else figures | {"mean_regret": None}


def local_engine(keys: Sequence[EpisodesKey], agents: dict[tuple[str, str], Agent] | None = None) -> Iterator[Results]:
    """Fly one key after another in this process.

    Args:
        keys: The keys; those of one task and agent follow each other.
        agents: The agents of the keys by task and name, which lose each one that flies; None to make them.
    """
    for (task_id, name), chunks in groupby(keys, lambda key: (key.task, key.agent)):
        agent = None if agents is None else agents.pop((task_id, name))
        for key in chunks:
            agent = agent or _agent_of(key)
            yield _fly_and_solve(get_task(task_id, key.version), key, agent)


def evaluate_keys(
    keys: Sequence[EpisodesKey],
    engine: Engine,
    folder: "ResultsFolder | None" = None,
    arrived: Callable[[Results], None] | None = None,
) -> dict[EpisodesKey, Results]:
    """Return the results of each key from the folder, and from the engine if they are missing there.

    The rows are in the order of the seeds, whatever the order of arrival.

    Args:
        keys: The keys.
        engine: Flies the missing chunks.
        folder: Stores each chunk as it arrives.
        arrived: Called once with each chunk.

    Raises:
        OSError, InvalidValueError: from the folder.
        ClusterError: from an engine on a cluster.
    """
    chunks = {key: key.chunks() for key in keys}
    flown: dict[EpisodesKey, Results] = {}

    def count(results: Results) -> None:
        flown[results.key] = results
        if arrived is not None:
            arrived(results)

    missing: list[EpisodesKey] = []
    for chunk in (chunk for of_key in chunks.values() for chunk in of_key):
        stored = None if folder is None else folder.load(chunk)
        if stored is None:
            missing.append(chunk)
        else:
            count(stored)
    for results in engine(missing) if missing else ():
        if results.key not in flown:
            if folder is not None:
                folder.save(results)
            count(results)
    return {key: concatenate([flown[chunk] for chunk in of_key], key) for key, of_key in chunks.items()}


Flown = tuple[npt.NDArray[np.float64], npt.NDArray[np.int32], npt.NDArray[np.int32]]
"""Scores, steps and deliveries of flights."""


@lru_cache(maxsize=256)
def _fly_optimally(task: TaskConfig, start: int, stop: int) -> Flown | None:
    """Return the optimal flight over each map, None if a map is too large; cached for the comparison of all agents."""
    try:
        best = [solve(task, seed) for seed in range(start, stop)]
    except TooLargeError:
        return None
    scores, steps, deliveries = zip(*((flight.score, flight.steps, flight.deliveries) for flight in best), strict=True)
    return np.array(scores), np.array(steps, np.int32), np.array(deliveries, np.int32)


def _fly(task: TaskConfig, name: str, agent: Agent, seeds: npt.NDArray[np.int64], repeat: int = 0) -> Flown:
    agent_seeds = _agent_seeds(seeds, repeat)
    if isinstance(agent, BatchAgent):
        reset = partial(agent.reset_batch, agent_seeds)
        return rollout_batch(task, seeds, agent.act_batch, getattr(agent, "stateless", False), name, reset)
    flown: list[tuple[float, int, int]] = []
    for seed, agent_seed in zip(seeds.tolist(), agent_seeds.tolist(), strict=True):
        episode = Episode(task, seed=seed)
        rollout(episode, begin(agent, name, episode, agent_seed))
        flown.append((episode.score, episode.steps, episode.deliveries_done))
    scores, steps, deliveries = zip(*flown, strict=True)
    return np.array(scores), np.array(steps, np.int32), np.array(deliveries, np.int32)


def _agent_seeds(seeds: npt.NDArray[np.int64], repeat: int) -> npt.NDArray[np.int64]:
    """Return the seeds of an agent's random numbers, int64[n] in [0, 2^53): the map seeds at repeat 0."""
    if repeat == 0:
        return seeds
    as_integers: Any = seeds  # arrays of 64-bit integers wrap like compiled code
    keys: Any = map_key(task_key("evaluation/repeat", repeat), as_integers)
    return keys & (N_SEEDS - 1)
