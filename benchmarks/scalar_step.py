"""What one step of one episode costs in plain Python, beside Gymnasium's CartPole: python benchmarks/scalar_step.py.

The three are timed in turn, round by round, and the median of the rounds is printed.
"""

import statistics
import time
from collections.abc import Callable

import gymnasium

import drone_env
from drone_env.core.episode import Episode

ROUNDS = 15
STEPS = 2_000


def steps_of_episode(episode: Episode) -> None:
    """Fly `STEPS` steps in a fixed pattern, resetting where an episode ends."""
    for i in range(STEPS):
        if episode.ended:
            episode.reset()
        episode.step(i * 7 // 3 % 5)


def steps_of_env(env: gymnasium.Env) -> None:
    """The same through `gymnasium.Env.step`."""
    actions = int(env.action_space.n)  # type: ignore[attr-defined]
    ended = True
    for i in range(STEPS):
        if ended:
            env.reset()
        _, _, terminated, truncated, _ = env.step(i * 7 // 3 % actions)
        ended = terminated or truncated


def main() -> None:
    """Time and print."""
    runs: dict[str, Callable[[], None]] = {}
    for name in drone_env.TASKS:
        episode = drone_env.Episode(name)
        episode.reset(0)
        runs[f"Episode.step, {name}"] = lambda episode=episode: steps_of_episode(episode)
    for env_id in ("DroneDelivery-Easy-v1", "DroneDelivery-Hard-v1", "CartPole-v1"):
        env = gymnasium.make(env_id, disable_env_checker=True)
        env.reset(seed=0)
        runs[f"Env.step, {env_id}"] = lambda env=env: steps_of_env(env)

    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(ROUNDS):
        for name, run in runs.items():
            start = time.process_time()
            run()
            times[name].append((time.process_time() - start) / STEPS * 1e6)
    medians = {name: statistics.median(values) for name, values in times.items()}
    base = medians["Env.step, CartPole-v1"]
    print(f"{'CPU microseconds per step, resets included':45} {'median':>8} {'of CartPole':>12}")
    for name, median in medians.items():
        print(f"{name:45} {median:8.2f} {median / base:12.2f}")


if __name__ == "__main__":
    main()
