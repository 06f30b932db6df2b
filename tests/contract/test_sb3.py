"""The Stable-Baselines3 environment against SB3's own vectorisation of the single one, and SB3's learners on it."""

import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

from drone_env import evaluate, summarise
from drone_env.core.seeds import SPLITS, next_seed
from drone_env.core.tasks import TASKS, get_task
from drone_env.envs import sb3
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.sb3 import FORMS, DroneDeliveryVecEnv
from drone_env.errors import EpisodeError, InvalidValueError, UnknownNameError
from drone_env.installer import pip

N = 6
PAGE = Path(__file__).parents[2] / "docs" / "sb3.md"


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def actions_of(step: int) -> np.ndarray:
    return (np.arange(N) * 3 + step * step // 3) % 5


def assert_same(got: Any, want: Any) -> None:
    """Equal observations, whatever their form."""
    if isinstance(want, dict):
        assert got.keys() == want.keys()
        for name in want:
            assert_same(got[name], want[name])
    else:
        assert got.dtype == want.dtype
        assert np.array_equal(got, want)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("task", [TASKS["easy_delivery"], TASKS["skyline_easy"]], ids=lambda task: task.id)
def test_it_does_what_sb3s_own_vectorisation_of_single_drones_does(task: Any, form: str) -> None:
    ours = DroneDeliveryVecEnv(task, N, observation=form)
    theirs = DummyVecEnv([lambda: Monitor(FORMS[form](DroneDeliveryEnv(task)))] * N)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.seed(11) == theirs.seed(11) == list(range(11, 11 + N))
    got, want = ours.reset(), theirs.reset()
    flown = [info["seed"] for info in ours.reset_infos]
    assert flown == list(range(11, 11 + N))
    ended = 0
    for step in range(3 * task.max_steps):
        assert_same(got, want)
        got, rewards, dones, infos = ours.step(actions_of(step))
        want, expected_rewards, expected_dones, expected_infos = theirs.step(actions_of(step))
        assert_same(rewards, expected_rewards)
        assert_same(dones, expected_dones)
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


def test_infos_of_episodes_that_fail_and_that_succeed() -> None:
    env = DroneDeliveryVecEnv("easy", N)
    env.seed(1)
    env.reset()
    for _ in range(10):
        env.step(np.full(N, 3))
    env.seed(1)
    env.reset()  # the steps before it do not count
    returns = np.zeros(N)
    for _ in range(60):
        _, rewards, dones, infos = env.step(np.full(N, 4))
        returns += rewards
    assert dones.all()
    assert [info["episode"]["r"] for info in infos] == pytest.approx(returns.tolist(), abs=1e-5)
    for seed, info in enumerate(infos, start=1):
        told = {name: info[name] for name in ("score", "deliveries", "seed", "is_success")}
        assert told == {"score": 0.01, "deliveries": 0, "seed": seed, "is_success": False}
        assert info["episode"]["l"] == 60
    env.seed(0)
    observations, successes = env.reset(), 0
    for _ in range(60):
        assert isinstance(observations, dict)
        x, y, _, target_x, target_y = observations["telemetry"].T
        actions = np.select([target_y < y, target_y > y, target_x < x, target_x > x], [0, 1, 2, 3], 4)
        observations, _, dones, infos = env.step(actions)
        for i in np.flatnonzero(dones):
            assert (infos[i]["is_success"], infos[i]["deliveries"]) == (True, 1)
            assert infos[i]["score"] > 0.9
            successes += 1
    assert successes > N


@pytest.mark.parametrize("form", FORMS)
def test_what_was_returned_stays_as_it_is(form: str) -> None:
    env = DroneDeliveryVecEnv("easy", N, observation=form)
    env.seed(0)
    kept = []
    env.reset()
    for step in range(130):
        observations, rewards, dones, infos = env.step(actions_of(step))
        arrays = [rewards, dones, env.action_masks()]
        for form_of in (observations, *(info["terminal_observation"] for info in infos if info)):
            arrays += form_of.values() if isinstance(form_of, dict) else [form_of]
        kept += [(array, array.copy()) for array in arrays]
    assert all(np.array_equal(array, copy) for array, copy in kept)


@pytest.mark.parametrize("copied", [deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"])
def test_a_copy_flies_on_as_the_original_does(copied: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(sb3, "time", SimpleNamespace(perf_counter=lambda: now))
    env = DroneDeliveryVecEnv("easy", N)
    now = 105.0
    env.seed(0)
    env.reset()
    for step in range(20):
        env.step(actions_of(step))
    twin = copied(env)
    now = 106.0
    episodes = 0
    for step in range(70):
        (got, *outcome, infos), (want, *expected, wanted) = twin.step(actions_of(step)), env.step(actions_of(step))
        assert_same(got, want)
        assert all(map(np.array_equal, outcome, expected))
        for info, expected_info in zip(infos, wanted, strict=True):
            assert info.keys() == expected_info.keys()
            if info:
                episodes += 1
                assert info["episode"]["t"] == 6.0
                for name in ("episode", "score", "seed"):
                    assert info[name] == expected_info[name]
    assert episodes >= N
    assert twin.reset_infos == env.reset_infos
    assert twin.batch is not env.batch


@pytest.mark.parametrize("num_threads", [2, 64])
def test_threads_change_nothing(num_threads: int) -> None:
    envs = [DroneDeliveryVecEnv("easy", N, num_threads=n, observation="flat") for n in (1, num_threads)]
    for env in envs:
        env.seed(0)
        env.reset()
    for step in range(130):
        want, got = (env.step(actions_of(step)) for env in envs)
        assert all(map(np.array_equal, got[:3], want[:3]))
        assert [info.get("score") for info in got[3]] == [info.get("score") for info in want[3]]


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
    drawn = env.seed()
    assert flown() == drawn
    env.seed(7)
    for wrong in (-1, 2**53, 2**53 - N + 1, 1.5):
        with pytest.raises(InvalidValueError, match="seed must be"):
            env.seed(wrong)  # type: ignore[arg-type]
    assert flown() == list(range(7, 13))


def test_attributes_are_shared() -> None:
    env = DroneDeliveryVecEnv("easy", N)
    assert env.render_mode is None
    assert env.get_attr("render_mode") == [None] * N
    assert env.get_attr("task", indices=[0, 2]) == [get_task("easy")] * 2
    assert env.get_attr("task", indices=3) == [get_task("easy")]
    assert env.has_attr("action_masks")
    assert not env.has_attr("nothing")
    env.set_attr("note", "mine")
    assert env.get_attr("note") == ["mine"] * N
    with pytest.raises(InvalidValueError, match="share their attributes"):
        env.set_attr("note", "yours", indices=[0, 1])
    assert env.get_attr("note") == ["mine"] * N
    env.close()


def test_action_masks_as_maskable_ppo_asks_for_them() -> None:
    env = DroneDeliveryVecEnv("easy", N)
    singles = [DroneDeliveryEnv("easy") for _ in range(N)]
    env.seed(0)
    env.reset()
    for seed, single in enumerate(singles):
        single.reset(seed=seed)
    for _ in range(12):
        masks = np.stack(env.env_method("action_masks"))
        assert masks.dtype == np.bool_
        assert masks.shape == (N, 5)
        assert np.array_equal(masks, env.action_masks())
        assert np.array_equal(masks, [single.action_masks() for single in singles])
        assert np.array_equal(env.env_method("action_masks", indices=[1, 4]), masks[[1, 4]])
        _, _, dones, _ = env.step(np.zeros(N, int))
        for i, single in enumerate(singles):
            single.step(0)
            if dones[i]:
                single.reset()
    assert not masks[:, 0].all()
    with pytest.raises(UnknownNameError, match="action_masks"):
        env.env_method("fly")


def test_sb3s_wrappers_and_its_evaluation_work() -> None:
    env = DroneDeliveryVecEnv("easy", N, observation="flat")
    assert env.env_is_wrapped(Monitor) == [True] * N
    assert env.env_is_wrapped(DroneDeliveryEnv, indices=[0]) == [False]
    model = PPO("MlpPolicy", env, seed=0, device="cpu")
    returns, lengths = evaluate_policy(model, env, n_eval_episodes=12, return_episode_rewards=True)
    assert len(returns) == 12  # type: ignore[arg-type]
    assert max(lengths) <= 60  # type: ignore[type-var]
    normalized = VecNormalize(env)
    normalized.reset()
    with pytest.warns(UserWarning, match="already wrapped"):
        monitored = VecMonitor(normalized, info_keywords=("score",))
    monitored.reset()
    for _ in range(60):
        *_, infos = monitored.step(np.full(N, 4))
    assert [info["episode"]["score"] for info in infos] == [0.01] * N


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"observation": "text"}, "unknown observation form 'text'; allowed: dict, flat"),
        ({"task": "trivial"}, "unknown task"),
        ({"version": 99}, "version"),
        ({"reward_profile": "generous"}, "aligned"),
        ({"num_envs": 0}, "num_envs must be an integer of at least 1, got 0"),
        ({"num_envs": 2.0}, "num_envs must be an integer of at least 1, got 2.0"),
        ({"num_threads": 0}, "num_threads"),
    ],
)
def test_what_does_not_exist_is_refused_with_what_is_allowed(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((UnknownNameError, InvalidValueError), match=message):
        DroneDeliveryVecEnv(**{"task": "easy", "num_envs": N, **arguments})


def test_calls_that_do_not_fit_are_refused() -> None:
    env = DroneDeliveryVecEnv("easy", N)
    with pytest.raises(EpisodeError, match="reset"):
        env.step(np.zeros(N, int))
    env.reset()
    for actions in (np.full(N, 5), np.zeros(N), np.zeros(N - 1, int)):
        with pytest.raises(InvalidValueError, match="actions must be"):
            env.step(actions)
    env.set_options({})
    for options in ({"seed": 1}, [{}, {"seed": 1}]):
        with pytest.raises(InvalidValueError, match="no options"):
            env.set_options(options)


def test_without_stable_baselines3_the_import_says_what_to_install() -> None:
    code = "import sys; sys.modules['stable_baselines3'] = None; import drone_env.envs.sb3"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert f"drone_env.envs.sb3 needs Stable-Baselines3: {pip()} install stable-baselines3" in run.stderr


@pytest.mark.long
def test_ppo_learns_to_deliver() -> None:
    env = DroneDeliveryVecEnv("easy", 64, observation="flat")
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=256, n_epochs=4, learning_rate=1e-3, ent_coef=0.01, seed=0,
                device="cpu")  # fmt: skip

    def score() -> float:
        flown = evaluate(model, "easy", "validation", 200, wrapper="FlatObservation", sampled=True)
        return summarise(flown)["mean_score"]

    assert score() < 0.3
    model.learn(100_000)
    assert score() > 0.45
    assert np.mean(list(model.ep_success_buffer or [])) > 0.3


def test_dqn_trains_on_the_dict() -> None:
    env = DroneDeliveryVecEnv("easy", 16)
    model = DQN("MultiInputPolicy", env, buffer_size=2_000, learning_starts=500, batch_size=64, gradient_steps=4,
                seed=0, device="cpu")  # fmt: skip
    before = [parameter.detach().clone() for parameter in model.q_net.parameters()]
    model.learn(2_000)
    assert model.ep_info_buffer
    for parameter, old in zip(model.q_net.parameters(), before, strict=True):
        assert torch.isfinite(parameter).all()
        assert not torch.equal(parameter, old)


def test_the_page_about_it_runs_as_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code = "\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))
    shorter, found = re.subn(r"total_timesteps=[\d_]+", "total_timesteps=8_192", code)
    shorter, often = re.subn(r"eval_freq=\d+", "eval_freq=64", shorter)
    assert (found, often) == (3, 1)
    exec(compile(shorter, str(PAGE), "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["PPO", "DQN", "4,096", "8,192"]
    assert all(re.search(r" 0\.\d+", line) for line in lines)
    assert (tmp_path / "data" / "ppo" / "best_model.zip").is_file()
