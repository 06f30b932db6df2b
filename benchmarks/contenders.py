"""What `simulator.py` times: the batch and its peers, each ready to fly random actions."""

import time
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple, cast

import gymnasium
import numpy as np
import numpy.typing as npt

import drone_env
from drone_env.core.batch import Batch

WINDOWS = 1021
"""Random actions are windows into one long array, so no two steps of an episode repeat each other's for long."""


class Contender(NamedTuple):
    """Something to time.

    Attributes:
        name: Name in the table.
        per_call: Steps that one call flies, one in each episode.
        run: Makes this many calls.
    """

    name: str
    per_call: int
    run: Callable[[int], None]

    def time(self, calls: int) -> float:
        """CPU seconds of this many calls."""
        began = time.process_time()
        self.run(calls)
        return time.process_time() - began


def random_actions(num_envs: int, n_actions: int) -> list[npt.NDArray[np.int64]]:
    """`WINDOWS` arrays of N actions."""
    random = np.random.default_rng(0)
    pool = random.integers(0, n_actions, num_envs + WINDOWS)
    return [pool[start : start + num_envs] for start in random.permutation(WINDOWS)]


def repeat(step: Callable[[Any], Any], actions: list[Any]) -> Callable[[int], None]:
    """A function that makes this many calls of `step`, cycling through the actions."""
    at = 0

    def run(calls: int) -> None:
        nonlocal at
        for _ in range(calls):
            step(actions[at])
            at = (at + 1) % len(actions)

    return run


def spread_out(batch: Batch, actions: list[Any]) -> None:
    """Reset the episodes at different times, so that they also end at different times."""
    batch.reset(np.arange(batch.num_envs))
    period = 2 * WINDOWS // 10
    for t in range(period):
        batch.step(actions[t])
        chosen = np.arange(batch.num_envs) % period == t
        if chosen.any():
            batch.reset(np.arange(batch.num_envs), chosen)


def bare(task: str, num_envs: int) -> Contender:
    """`Batch.step` alone."""
    batch, actions = Batch(task, num_envs), random_actions(num_envs, 5)
    spread_out(batch, actions)
    return Contender(f"Batch {task} {num_envs}", num_envs, repeat(batch.step, actions))


def vector(task: str, num_envs: int, mode: str, copy: bool) -> Contender:
    """The same through `gymnasium.make_vec`."""
    name, actions = drone_env.get_task(task).gym_id, random_actions(num_envs, 5)
    env = gymnasium.make_vec(name, num_envs, "vector_entry_point", autoreset_mode=mode, copy=copy)
    env.reset(seed=0)
    inner: Any = env.unwrapped
    spread_out(inner.batch, actions)
    shown = f"make_vec {task} {num_envs}, {mode}, {'copies' if copy else 'copy=False'}"
    return Contender(shown, num_envs, repeat(env.step, actions))


def cart_pole(num_envs: int) -> Contender:
    """Gymnasium's own vector environment, written in NumPy."""
    env = gymnasium.make_vec("CartPole-v1", num_envs, "vector_entry_point")
    env.reset(seed=0)
    return Contender(unit_of(num_envs), num_envs, repeat(env.step, random_actions(num_envs, 2)))


def unit_of(num_envs: int) -> str:
    """The name of the CartPole with as many episodes."""
    return f"Gymnasium CartPole vector {num_envs}"


def mini_grid(name: str) -> Contender:
    """One MiniGrid environment in plain Python."""
    import_module("minigrid")
    env: Any = gymnasium.make(name, disable_env_checker=True)
    env.reset(seed=0)

    def step(action: int) -> None:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    actions = random_actions(WINDOWS, int(env.action_space.n))[0].tolist()
    return Contender(f"{name} 1", 1, repeat(step, actions))


def env_pool(name: str, num_envs: int) -> Contender:
    """EnvPool's MiniGrid, in C++, with one thread."""
    env = import_module("envpool").make(name, env_type="gymnasium", num_envs=num_envs, num_threads=1, seed=0)
    env.reset()
    actions = [window.astype(np.int32) for window in random_actions(num_envs, 7)]
    return Contender(f"EnvPool's {name} {num_envs}", num_envs, repeat(env.step, cast(list[Any], actions)))


def batches(quick: bool) -> Iterator[Contender]:
    """`Batch.step` of each task, for each number of episodes."""
    for task in ["hard", "skyline_hard"] if quick else [task.short_name for task in drone_env.TASKS.values()]:
        for num_envs in sizes(quick):
            yield bare(task, num_envs)


def sizes(quick: bool) -> list[int]:
    """Numbers of episodes at which all are compared."""
    return [4096] if quick else [1024, 4096, 16384]


def contenders(quick: bool) -> Iterator[Contender]:
    """All of them, or a few of each kind; MiniGrid and EnvPool if they are installed."""
    yield from map(cart_pole, sizes(quick))
    yield from batches(quick)
    for mode in ["NextStep"] if quick else ["NextStep", "SameStep"]:
        for copy in (True, False):
            yield vector("hard", 4096, mode, copy)
    if find_spec("minigrid"):
        yield mini_grid("MiniGrid-Empty-8x8-v0")
    if find_spec("envpool"):
        yield env_pool("MiniGrid-Empty-8x8-v0", 1024)
