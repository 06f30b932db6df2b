"""The batch, compiled, against single episodes, in plain Python: equal to the last bit, step by step."""

import os
from typing import Any

import numpy as np
import pytest

from drone_env.core.actions import N_ACTIONS
from drone_env.core.batch import Batch
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TASKS, TaskConfig
from tests.parity.test_compiled import CUSTOM

STEPS = int(os.environ.get("DRONE_ENV_PARITY_STEPS", "1000000"))
"""Steps in all, over every combination of task, profile and mode."""
ALL_TASKS = {**TASKS, **{name: CUSTOM[name] for name in ("drain", "pads", "impassable")}}
SHARE = STEPS // (len(ALL_TASKS) * len(REWARD_PROFILES) * 2)
N = 32


class Reference:
    """N single episodes that begin anew as the batch does."""

    def __init__(self, task: TaskConfig, profile: str, same_step: bool) -> None:
        self.episodes = [Episode(task, profile) for _ in range(N)]
        self.same_step = same_step
        self.finals: list[dict[str, Any]] = []

    def reset(self, seeds: list[int]) -> None:
        for episode, seed in zip(self.episodes, seeds, strict=True):
            episode.reset(seed)

    def step(self, actions: list[int]) -> tuple[list[float], list[bool]]:
        rewards, terminated = [], []
        self.finals = []
        for i, (episode, action) in enumerate(zip(self.episodes, actions, strict=True)):
            if episode.ended:
                episode.reset()
                rewards.append(0.0)
                terminated.append(False)
                continue
            rewards.append(episode.step(action))
            terminated.append(episode.ended)
            if episode.ended:
                self.finals.append(
                    {
                        "episode": i,
                        "score": episode.score,
                        "steps": episode.steps,
                        "deliveries": episode.deliveries_done,
                        "seed": episode.seed,
                        **episode.observation(),
                    }
                )
                if self.same_step:
                    episode.reset()
        return rewards, terminated


def assert_same_state(batch: Batch, reference: Reference) -> None:
    observations = [episode.observation() for episode in reference.episodes]
    assert np.array_equal(batch.grids, np.stack([observation["grid"] for observation in observations]))
    telemetry = np.stack([observation["telemetry"] for observation in observations])
    assert batch.telemetry.tobytes() == telemetry.tobytes()
    masks = np.stack([episode.action_mask() for episode in reference.episodes])
    assert np.array_equal(batch.action_masks, masks)
    assert batch.seeds.tolist() == [episode.seed for episode in reference.episodes]


@pytest.mark.parametrize("same_step", [False, True], ids=["next_step", "same_step"])
@pytest.mark.parametrize("profile", REWARD_PROFILES)
@pytest.mark.parametrize("task", ALL_TASKS.values(), ids=ALL_TASKS)
def test_batch_and_single_episodes_agree_to_the_last_bit(task: TaskConfig, profile: str, same_step: bool) -> None:
    rng = np.random.default_rng(len(profile) + task.width)
    batch = Batch(task, N, profile, same_step=same_step, num_threads=2 if same_step else 1)
    reference = Reference(task, profile, same_step)
    seeds = rng.integers(2**53, size=N)
    batch.reset(seeds)
    reference.reset(seeds.tolist())
    assert_same_state(batch, reference)
    ended = flown = 0
    while flown < SHARE:
        # Straight legs reach further than single random steps.
        actions = rng.integers(N_ACTIONS, size=N)
        for _ in range(rng.integers(1, 4)):
            batch.step(actions)
            flown += N
            rewards, terminated = reference.step(actions.tolist())
            assert batch.rewards.tobytes() == np.array(rewards).tobytes()
            assert batch.terminated.tolist() == terminated
            assert_same_state(batch, reference)
            finals, observed = reference.finals, batch.finals()
            ended += len(finals)
            assert batch.ended.tolist() == [final["episode"] for final in finals]
            for name in ("score", "steps", "deliveries", "seed"):
                assert observed[name].tolist() == [final[name] for final in finals]
            for k, final in enumerate(finals):
                assert np.array_equal(batch.final_grids[k], final["grid"])
                assert np.array_equal(batch.final_telemetry[k], final["telemetry"])
    assert ended > 0
