"""The Stable-Baselines3 environment against SB3's own vectorisation of the single one, and SB3's learners on it."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from drone_env.core.seeds import SPLITS, next_seed
from drone_env.core.tasks import TASKS, get_task
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.sb3 import FORMS, DroneDeliveryVecEnv
from drone_env.errors import InvalidValueError, UnknownNameError
from tests.contract.test_vector import N, actions_of
from tests.docs.pages import ROOT, blocks
from tests.same import assert_same

PAGE = ROOT / "docs" / "libraries.md"


@pytest.mark.parametrize(
    ("task", "form"),
    [(TASKS["easy_delivery"], "dict"), (TASKS["skyline_easy"], "flat"), (TASKS["skyline_easy"], "stops")],
)
def test_it_does_what_sb3s_own_vectorisation_of_single_drones_does(task: Any, form: str) -> None:
    ours = DroneDeliveryVecEnv(task, N, observation=form)
    theirs = DummyVecEnv([lambda: Monitor(FORMS[form](DroneDeliveryEnv(task)))] * N)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.seed(11) == theirs.seed(11) == list(range(11, 11 + N))
    got, want = ours.reset(), theirs.reset()
    flown = [info["seed"] for info in ours.reset_infos]
    assert flown == list(range(11, 11 + N))
    ended, kept = 0, []
    for step in range(3 * task.max_steps):
        assert_same(got, want)
        masks = ours.env_method("action_masks")
        assert_same(np.stack(masks), np.stack(theirs.env_method("action_masks")))
        assert_same(np.stack(ours.env_method("action_masks", indices=[1, 4])), np.stack([masks[1], masks[4]]))
        kept += [(array, array.copy()) for array in (got.values() if isinstance(got, dict) else [got])]
        got, rewards, dones, infos = ours.step(actions_of(step))
        want, expected_rewards, expected_dones, expected_infos = theirs.step(actions_of(step))
        assert_same(rewards, expected_rewards)
        assert_same(dones, expected_dones)
        kept += [(array, array.copy()) for array in (rewards, dones)]
        for i, (info, expected) in enumerate(zip(infos, expected_infos, strict=True)):
            assert ours.reset_infos[i]["seed"] == theirs.reset_infos[i]["seed"]
            if not dones[i]:
                assert info == {}
                continue
            ended += 1
            assert_same(info["terminal_observation"], expected["terminal_observation"])
            assert info["TimeLimit.truncated"] is expected["TimeLimit.truncated"] is False
            assert info["episode"]["r"] == pytest.approx(expected["episode"]["r"], abs=1e-6)
            assert info["episode"]["l"] == expected["episode"]["l"]
            assert info["score"] == expected["score"]
            assert info["seed"] == expected["seed"] == flown[i]
            assert info["is_success"] is (expected["outcome"] == "delivered")
            flown[i] = next_seed(flown[i])
    assert ended > N
    # Later steps do not change returned arrays.
    assert all(np.array_equal(array, copy) for array, copy in kept)


def test_a_seed_holds_for_one_reset_and_the_walk_goes_on_from_there() -> None:
    env = DroneDeliveryVecEnv("easy", N)

    def flown() -> list[int]:
        env.reset()
        return [info["seed"] for info in env.reset_infos]

    first = flown()
    assert all(seed < SPLITS["train"].stop for seed in first)
    assert env.seed(40) == list(range(40, 46))
    assert [info["seed"] for info in env.reset_infos] == first
    assert flown() == list(range(40, 46))
    assert flown() == [next_seed(seed) for seed in range(40, 46)]
    env.seed(2**53 - N + 1)
    with pytest.raises(InvalidValueError, match="seed must be"):
        env.reset()


def test_attributes_are_shared() -> None:
    env = DroneDeliveryVecEnv("easy", N)
    assert env.env_is_wrapped(Monitor) == [True] * N
    assert env.get_attr("task", indices=[0, 2]) == [get_task("easy")] * 2
    env.set_attr("note", "mine")
    assert env.get_attr("note") == ["mine"] * N
    with pytest.raises(InvalidValueError, match="apply to all"):
        env.set_attr("note", "yours", indices=[0, 1])
    with pytest.raises(UnknownNameError):
        DroneDeliveryVecEnv("easy", N, observation="text")


@pytest.mark.long
def test_the_page_about_it_runs_as_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code = "\n".join(block.text for block in blocks(PAGE) if "test_sb3" in (block.not_run or ""))
    shorter, found = re.subn(r"total_timesteps=[\d_]+", "total_timesteps=2_048", code)
    shorter, often = re.subn(r"n_calls % \d+", "n_calls % 16", shorter)
    assert (found, often) == (2, 1)
    exec(compile(shorter, str(PAGE), "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["PPO", "1,024", "2,048"]
    assert all(re.search(r" 0\.\d+", line) for line in lines)
    assert (tmp_path / "best_model.zip").is_file()
