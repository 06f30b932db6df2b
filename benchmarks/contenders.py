"""What `simulator.py` times: the batch and its peers, each made ready to fly random actions."""

import time
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import gymnasium
import numpy as np
import numpy.typing as npt

import drone_env
from drone_env.core.batch import Batch

if TYPE_CHECKING:
    from numpy_reference import NumpyBatch

WINDOWS = 1021
"""Random actions are windows into one long array: no two steps of one episode repeat each other's for long."""
COPIED = "copied"
"""The unit of the contenders that only copy memory."""
KIB, MIB = 1 << 10, 1 << 20


class Contender(NamedTuple):
    """Something to time.

    Attributes:
        name: Name in the table.
        per_call: Steps that one call flies, one in each episode, or bytes that it copies.
        observation: Bytes of one observation.
        run: Makes this many calls.
        unit: "steps" or `COPIED`.
    """

    name: str
    per_call: int
    observation: float
    run: Callable[[int], None]
    unit: str = "steps"

    def time(self, calls: int) -> tuple[float, float]:
        """Make this many calls: seconds of CPU time, and of the clock."""
        cpu, wall = time.process_time(), time.perf_counter()
        self.run(calls)
        return time.process_time() - cpu, time.perf_counter() - wall


def random_actions(num_envs: int, n_actions: int, dtype: npt.DTypeLike = np.int64) -> list[npt.NDArray[Any]]:
    """`WINDOWS` arrays of N actions, drawn beforehand."""
    random = np.random.default_rng(0)
    pool = random.integers(0, n_actions, num_envs + WINDOWS).astype(dtype)
    return [pool[start : start + num_envs] for start in random.permutation(WINDOWS)]


def repeat(step: Callable[[Any], Any], actions: list[Any]) -> Callable[[int], None]:
    """A function that makes this many calls of `step`, going round the actions."""
    at = 0

    def run(calls: int) -> None:
        nonlocal at
        for _ in range(calls):
            step(actions[at])
            at = (at + 1) % len(actions)

    return run


def spread_out(batch: "Batch | NumpyBatch", maps: npt.NDArray[Any], actions: list[Any]) -> None:
    """Reset the episodes at different times, so that they also end at different times."""
    batch.reset(maps)
    period = 2 * WINDOWS // 10
    for t in range(period):
        batch.step(actions[t])
        chosen = np.arange(batch.num_envs) % period == t
        if chosen.any():
            batch.reset(maps, chosen)


def bytes_of(observations: Any, num_envs: int) -> float:
    """Bytes of one observation in a batch of them."""
    arrays: list[Any] = (
        [*cast(dict[str, Any], observations).values()] if isinstance(observations, dict) else [observations]
    )
    return sum(array.nbytes for array in arrays) / num_envs


def bare(task: str, num_envs: int, dtype: npt.DTypeLike = np.int64, rewards: str = "aligned") -> Contender:
    """`Batch.step` and nothing around it."""
    batch = Batch(task, num_envs, rewards)
    actions = random_actions(num_envs, 5, dtype)
    spread_out(batch, np.arange(num_envs), actions)
    notes = "".join(
        [
            f", {np.dtype(dtype)} actions" if dtype is not np.int64 else "",
            f", {rewards}" if rewards != "aligned" else "",
        ]
    )
    size = bytes_of({"grid": batch.grids, "telemetry": batch.telemetry}, num_envs)
    return Contender(f"Batch {task} {num_envs}{notes}", num_envs, size, repeat(batch.step, actions))


def vector(task: str, num_envs: int, mode: str, copy: bool) -> Contender:
    """The same through `gymnasium.make_vec`."""
    env = gymnasium.make_vec(
        drone_env.get_task(task).gym_id,
        num_envs=num_envs,
        vectorization_mode="vector_entry_point",
        autoreset_mode=mode,
        copy=copy,
    )
    observations, _ = env.reset(seed=0)
    actions = random_actions(num_envs, 5)
    inner: Any = env.unwrapped
    spread_out(inner.batch, np.arange(num_envs), actions)
    name = f"make_vec {task} {num_envs}, {mode}, {'copies' if copy else 'copy=False'}"
    return Contender(name, num_envs, bytes_of(observations, num_envs), repeat(env.step, actions))


def numpy_rules(task: str, num_envs: int) -> Contender:
    """The same rules in NumPy, once it has been seen that they are the same."""
    config = drone_env.get_task(task)
    from numpy_reference import NumpyBatch, check, make_pool  # another checkout may have other tables

    pool = make_pool(config, 4096)
    check(config, pool)
    batch = NumpyBatch(config, num_envs, pool)
    actions = random_actions(num_envs, 5)
    spread_out(batch, np.arange(num_envs) % len(pool.seeds), actions)
    size = bytes_of({"grid": batch.grids, "telemetry": batch.telemetry}, num_envs)
    return Contender(f"NumPy rules {task} {num_envs}, tiered", num_envs, size, repeat(batch.step, actions))


def cart_pole(num_envs: int) -> Contender:
    """Gymnasium's own vector environment, written in NumPy."""
    env = gymnasium.make_vec("CartPole-v1", num_envs=num_envs, vectorization_mode="vector_entry_point")
    observations, _ = env.reset(seed=0)
    actions = random_actions(num_envs, 2)
    return Contender(
        f"Gymnasium CartPole vector {num_envs}", num_envs, bytes_of(observations, num_envs), repeat(env.step, actions)
    )


def alone(name: str) -> Contender:
    """One environment in plain Python, through `gymnasium.Env.step`."""
    if name.startswith("MiniGrid"):
        import_module("minigrid")
    env: Any = gymnasium.make(name, disable_env_checker=True)
    first, _ = env.reset(seed=0)
    actions = random_actions(WINDOWS, int(env.action_space.n))[0].tolist()

    def step(action: int) -> None:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    shown = cast("dict[str, Any]", first) if isinstance(first, dict) else {"": first}
    arrays = {key: np.asarray(value) for key, value in shown.items() if key != "mission"}
    return Contender(f"{name} 1", 1, bytes_of(arrays, 1), repeat(step, actions))


def bare_alone(task: str) -> Contender:
    """`Episode.step` in plain Python; it makes no observation."""
    episode = drone_env.Episode(task, seed=0)

    def step(action: int) -> None:
        if episode.ended:
            episode.reset()
        episode.step(action)

    return Contender(f"Episode {task} 1", 1, 0, repeat(step, random_actions(WINDOWS, 5)[0].tolist()))


def env_pool(name: str, num_envs: int) -> Contender:
    """EnvPool's MiniGrid, in C++, with one thread."""
    env = import_module("envpool").make(name, env_type="gymnasium", num_envs=num_envs, num_threads=1, seed=0)
    observations, _ = env.reset()
    shown = {key: value for key, value in observations.items() if key != "mission"}
    actions = random_actions(num_envs, 7, np.int32)
    return Contender(f"EnvPool's {name} {num_envs}", num_envs, bytes_of(shown, num_envs), repeat(env.step, actions))


def copying(size: int, name: str) -> Contender:
    """One buffer copied into another, again and again."""
    source, target = np.ones(size, np.uint8), np.zeros(size, np.uint8)

    def run(calls: int) -> None:
        for _ in range(calls):
            np.copyto(target, source)

    return Contender(name, size, size, run, COPIED)


def batches(quick: bool) -> Iterator[Contender]:
    """`Batch.step` of each task, for each number of episodes."""
    for task in ["hard", "skyline_hard"] if quick else [task.short_name for task in drone_env.TASKS.values()]:
        for num_envs in sizes(quick):
            yield bare(task, num_envs)


def sizes(quick: bool) -> list[int]:
    """Numbers of episodes at which all are compared."""
    return [4096] if quick else [1024, 4096, 16384]


def contenders(quick: bool, envpool: bool) -> Iterator[Contender]:
    """All of them, or a few of each kind; CartPole at each size, for it is the unit."""
    tasks = ["hard"] if quick else ["easy", "medium", "hard"]
    for num_envs in sizes(quick):
        yield cart_pole(num_envs)
    yield from batches(quick)
    yield bare("hard", 4096, rewards="tiered")
    yield bare("hard", 4096, dtype=np.uint8)
    for task in tasks:
        for mode in ["NextStep"] if quick else ["NextStep", "SameStep"]:
            for copy in (True, False):
                yield vector(task, 4096, mode, copy)
    for task in tasks:
        yield numpy_rules(task, 4096)
    yield alone("CartPole-v1")
    for task in tasks:
        yield bare_alone(task)
        yield alone(drone_env.get_task(task).gym_id)
    for name in ["MiniGrid-Empty-8x8-v0"] if quick else ["MiniGrid-Empty-8x8-v0", "MiniGrid-DoorKey-8x8-v0"]:
        yield alone(name)
        if envpool:
            yield env_pool(name, 1024)
    yield copying(256 * KIB, "in cache (256 KiB)")
    yield copying(256 * MIB, "out of cache (256 MiB)")
