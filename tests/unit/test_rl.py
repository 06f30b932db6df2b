"""Training: the network, the replay, the schedules, and that a run goes on as if it had never stopped."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from drone_env.agents import make_agent
from drone_env.agents.network import load_network, pooling
from drone_env.agents.pathqnet import PathQNetAgent, shipped_network
from drone_env.cli import main
from drone_env.core.batch import Batch
from drone_env.core.cells import N_CELL_KINDS
from drone_env.core.seeds import SPLITS, split_of, split_seeds
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import CheckpointError, InvalidValueError, UnknownNameError, UnsupportedTaskError
from drone_env.evaluation import episodes_key, run_episodes, summarise
from drone_env.rl.checkpoint import load_checkpoint, save_checkpoint
from drone_env.rl.config import FAST, ORIGINAL, TrainConfig, preset
from drone_env.rl.export import export_network
from drone_env.rl.model import PathQNet
from drone_env.rl.policy import EpsilonGreedyPolicy, LinearSchedule, MultiplicativeSchedule, epsilon_greedy
from drone_env.rl.replay_buffer import ReplayBuffer
from drone_env.rl.run import Run
from drone_env.rl.trainer import Trainer

SMALL = TrainConfig(
    task="easy",
    episodes=40,
    num_threads=1,
    num_envs=8,
    batch_size=16,
    replay_size=400,
    learning_starts=50,
    steps_per_update=8,
    epsilon_steps=500,
    validation_every=10,
    validation_maps=5,
    log_every=5,
    checkpoint_seconds=3600,
)


KILLS = 20 if int(os.environ.get("DRONE_ENV_EXAMPLES", "0")) >= 10_000 else 1


SHIPPED = ("easy", "medium", "hard")


def do_nothing(*_: object) -> None:
    """A callback."""


# The network


@pytest.mark.parametrize(("height", "width"), [(10, 10), (14, 14), (18, 18), (7, 11), (3, 2)])
@pytest.mark.parametrize("telemetry_size", [5, 6])
def test_the_network_without_torch_is_the_same(height: int, width: int, telemetry_size: int, tmp_path: Path) -> None:
    torch.manual_seed(height)
    network = PathQNet(telemetry_size)
    export_network(network, tmp_path / "net.npz", {"telemetry_size": telemetry_size})
    rng = np.random.default_rng(0)
    grids = rng.integers(0, N_CELL_KINDS, (20, height, width), dtype=np.uint8)
    telemetry = rng.random((20, telemetry_size), dtype=np.float32)
    with torch.no_grad():
        expected = network(torch.from_numpy(grids), torch.from_numpy(telemetry)).numpy()
    found = load_network(tmp_path / "net.npz")(grids, telemetry)
    assert found.shape == (20, 5)
    assert np.abs(found - expected).max() < 1e-5


@pytest.mark.parametrize("size", [4, 10, 14, 18, 3])
def test_pooling_as_a_matrix_is_adaptive_average_pooling(size: int) -> None:
    x = torch.rand(1, 1, size, size)
    expected = torch.nn.functional.adaptive_avg_pool2d(x, 4)[0, 0].numpy()
    assert np.allclose(pooling(size) @ x[0, 0].numpy() @ pooling(size).T, expected, atol=1e-6)


# Policy


def test_schedules() -> None:
    line = LinearSchedule(1.0, 0.05, 5000)
    assert [line(0), line(5000), line(10**9)] == [1.0, pytest.approx(0.05), pytest.approx(0.05)]
    assert line(2500) == pytest.approx(0.525)
    factor = MultiplicativeSchedule(1.0, 0.05, 0.995)
    assert factor(0) == 1
    assert factor(1) == 0.995
    assert factor(10_000) == 0.05
    with pytest.raises(InvalidValueError):
        LinearSchedule(1, 0, 0)
    with pytest.raises(InvalidValueError):
        MultiplicativeSchedule(1, 0, 1.5)


def test_epsilon_greedy_explores_as_often_as_it_says() -> None:
    q_values = np.tile(np.array([0, 0, 9, 0, 0], np.float32), (100_000, 1))
    assert (epsilon_greedy(q_values, 0.0, np.random.default_rng(0)) == 2).all()
    actions = epsilon_greedy(q_values, 0.5, np.random.default_rng(0))
    assert np.bincount(actions, minlength=5) / len(actions) == pytest.approx([0.1, 0.1, 0.6, 0.1, 0.1], abs=0.01)
    policy = EpsilonGreedyPolicy()
    assert (policy.epsilon(0), policy.epsilon(5000)) == (1.0, pytest.approx(0.05))
    with pytest.raises(InvalidValueError, match="probability"):
        EpsilonGreedyPolicy(eps_start=2)


# Replay


def test_the_replay_sums_rewards_up_to_the_end_of_an_episode() -> None:
    replay = ReplayBuffer(capacity=10, num_envs=2, height=1, width=1, telemetry_size=5)
    ends = {(0, 2), (1, 3)}
    for t in range(5):
        marks = np.array([t, 100 + t])
        replay.add(
            marks.reshape(2, 1, 1).astype(np.uint8),
            np.zeros((2, 5), np.float32),
            np.array([t % 5, 4 - t % 5]),
            marks.astype(float),
            np.array([(env, t) in ends for env in range(2)]),
        )
    seen = set()
    sampled = replay.sample(500, n_step=2, gamma=0.5, rng=np.random.default_rng(0))
    for k in range(500):
        mark = int(sampled.grids[k, 0, 0])
        env, t = divmod(mark, 100)
        seen.add((env, t))
        over = [(env, t + i) in ends for i in range(2)]
        expected = mark if over[0] else mark + 0.5 * (mark + 1)
        assert sampled.returns[k] == expected
        assert sampled.discounts[k] == (0 if any(over) else 0.25)
        assert sampled.actions[k] == (t % 5 if env == 0 else 4 - t % 5)
        if not any(over):
            assert sampled.next_grids[k, 0, 0] == mark + 2
    assert seen == {(env, t) for env in range(2) for t in range(3)}


def test_the_replay_forgets_the_oldest_row_first() -> None:
    replay = ReplayBuffer(capacity=7, num_envs=2, height=1, width=1, telemetry_size=5)
    assert not replay.can_sample(1)
    with pytest.raises(InvalidValueError, match="needed"):
        replay.sample(1, 1, 0.9, np.random.default_rng(0))
    for t in range(10):
        replay.add(
            np.full((2, 1, 1), t, np.uint8),
            np.zeros((2, 5), np.float32),
            np.zeros(2, int),
            np.zeros(2),
            np.zeros(2, bool),
        )
    assert len(replay) == 6
    sampled = replay.sample(200, 1, 0.9, np.random.default_rng(0))
    assert set(sampled.grids.ravel().tolist()) == {7, 8}
    assert (sampled.next_grids == sampled.grids + 1).all()
    with pytest.raises(InvalidValueError, match="does not hold"):
        ReplayBuffer(3, 2, 1, 1, 5)


# Configuration


def test_the_original_preset_is_the_originals() -> None:
    assert (ORIGINAL.gamma, ORIGINAL.batch_size, ORIGINAL.learning_rate, ORIGINAL.replay_size) == (
        0.99,
        64,
        1e-4,
        10_000,
    )
    assert (ORIGINAL.target_update, ORIGINAL.target_every, ORIGINAL.checkpoint_episodes) == ("episodes", 10, 50)
    assert (ORIGINAL.epsilon_start, ORIGINAL.epsilon_end, ORIGINAL.epsilon_factor) == (1.0, 0.05, 0.995)
    assert ORIGINAL.exploration == "multiplicative"


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_both_presets(task: str) -> None:
    assert get_task(preset("fast", task).task).id == task
    assert preset("original", task) == replace(ORIGINAL, task=task)
    assert set(FAST) <= set(TASKS)


@pytest.mark.parametrize(
    "wrong",
    [{"episodes": 0}, {"gamma": 1.5}, {"num_envs": 0}, {"learning_rate": 0.0}, {"replay_size": 10}, {"seed": -1}],
)
def test_numbers_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidValueError, match=next(iter(wrong))):
        replace(SMALL, **wrong)
    with pytest.raises(UnknownNameError):
        replace(SMALL, task="impossible")
    with pytest.raises(InvalidValueError, match="preset"):
        preset("slow", "easy")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_said() -> None:
    with pytest.raises(InvalidValueError, match="CUDA"):
        Trainer(replace(SMALL, gpu=True))


# Training


def test_training_stays_on_train_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = Trainer(SMALL)
    seen: set[str] = set()
    trainer.train(do_nothing, lambda: seen.update(split_of(seed) for seed in trainer.batch.seeds.tolist()))
    assert seen == {"train"}
    assert {split_of(seed) for seed in trainer.validator._seeds.tolist()} == {"validation"}
    assert trainer.batch.seeds.max() < SPLITS["validation"].start


def test_training_learns() -> None:
    """On a map of 4 x 4 the network soon delivers what chance seldom does."""
    task = replace(get_task("easy"), id="tiny_city", short_name="tiny_city", width=4, height=4, buildings=0, trees=0,
                   obstacles=0, max_steps=12, battery_capacity=12)  # fmt: skip
    TASKS[task.id] = task
    try:
        config = replace(SMALL, task="tiny_city", episodes=600, num_envs=16, batch_size=64, steps_per_update=4,
                         replay_size=8000, epsilon_steps=3000, validation_every=200, validation_maps=200)  # fmt: skip
        trainer = Trainer(config)
        untrained = trainer.validator.validate(trainer.values).score
        trainer.train(do_nothing, do_nothing)
    finally:
        del TASKS[task.id]
    assert untrained < 0.6 * trainer.validator.optimum
    assert trainer.best_score > 0.95 * trainer.validator.optimum


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("share", [0.0, 0.7])
def test_the_network_is_fitted_to_the_targets_of_the_papers(
    double: bool, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Transition by transition from the formulas, where the trainer works on whole batches."""
    trainer = Trainer(replace(SMALL, double=double, advantage_learning=share, loss="mse", target_update="episodes"))
    for _ in range(20):
        trainer.fly()
    with torch.no_grad():
        for parameter in trainer.target.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
    drawn = trainer.replay.sample(16, 1, 0.99, np.random.default_rng(0))
    monkeypatch.setattr(trainer.replay, "sample", lambda *_: drawn)

    def values(network: PathQNet, grids: Any, telemetry: Any, i: int) -> list[float]:
        return trainer.values(grids[i : i + 1], telemetry[i : i + 1], network)[0].tolist()

    errors = []
    for i in range(16):
        later = values(trainer.target, drawn.next_grids, drawn.next_telemetry, i)
        chooser = values(trainer.online, drawn.next_grids, drawn.next_telemetry, i) if double else later
        present = values(trainer.target, drawn.grids, drawn.telemetry, i)
        wanted = float(drawn.returns[i]) + float(drawn.discounts[i]) * later[chooser.index(max(chooser))]
        wanted -= share * (max(present) - present[drawn.actions[i]])
        errors.append(wanted - values(trainer.online, drawn.grids, drawn.telemetry, i)[drawn.actions[i]])
    trainer.learn()
    assert trainer.losses == [pytest.approx(np.mean(np.square(errors)), rel=1e-4)]


def test_the_moving_average_is_what_is_judged() -> None:
    for target_update, judged in (("soft", "target"), ("episodes", "online")):
        trainer = Trainer(replace(SMALL, episodes=16, target_update=target_update))
        trainer.train(do_nothing, do_nothing)
        assert trainer.updates > 0
        state = getattr(trainer, judged).state_dict()
        assert any(not torch.equal(state[name], tensor) for name, tensor in trainer.online.state_dict().items()) == (
            judged == "target"
        )
        trainer.best_score = -1.0
        trainer.validate()
        assert_same(trainer.best, dict(state))


def assert_same(a: Any, b: Any) -> None:
    if isinstance(a, torch.Tensor):
        assert torch.equal(a, b)
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, (list, tuple)):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b or (a != a and b != b)  # NaN is equal to NaN here


class Stop(Exception):  # noqa: N818
    """Ends a run."""


@pytest.mark.parametrize("task", ["easy", "skyline_easy"])
def test_a_resumed_run_is_the_uninterrupted_one_bit_for_bit(task: str, tmp_path: Path) -> None:
    config = replace(SMALL, task=task)
    whole = Trainer(config)
    whole.train(do_nothing, do_nothing)
    rng = random.Random(0)
    resumed = Trainer(config)
    while resumed.episodes < config.episodes:
        left = rng.randint(1, 60)

        def after_step() -> None:
            nonlocal left
            left -= 1
            if left == 0:
                raise Stop

        try:
            resumed.train(do_nothing, after_step)
        except Stop:
            save_checkpoint(tmp_path / "run.pth", resumed.get_state())
            resumed = Trainer(config)
            resumed.set_state(load_checkpoint(tmp_path / "run.pth"))
    assert_same(whole.get_state(), resumed.get_state())


def test_equal_seeds_make_equal_runs_and_others_do_not() -> None:
    runs = [Trainer(replace(SMALL, seed=seed)) for seed in (0, 0, 1)]
    for run in runs:
        run.train(do_nothing, do_nothing)
    assert_same(runs[0].get_state(), runs[1].get_state())
    assert runs[0].history != runs[2].history


# Checkpoints


def test_a_file_that_is_no_checkpoint_is_said_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "easy.pth"
    trainer = Trainer(SMALL)
    save_checkpoint(path, trainer.get_state())
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:100], b"", b"not a checkpoint"):
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match="cut short, or no checkpoint"):
            load_checkpoint(path)
        with pytest.raises(CheckpointError, match="--fresh"):
            Run(SMALL, tmp_path, tmp_path / "results")
        assert path.read_bytes() == content
    torch.save({"weights": torch.zeros(3)}, path)
    with pytest.raises(CheckpointError, match="not a checkpoint of this project"):
        load_checkpoint(path)
    save_checkpoint(path, {"version": 99})
    with pytest.raises(CheckpointError, match="version 99; this program reads version 1"):
        load_checkpoint(path)
    assert [file.name for file in tmp_path.iterdir()] == ["easy.pth"]


def test_a_checkpoint_that_could_run_code_is_not_loaded(tmp_path: Path) -> None:
    path = tmp_path / "evil.pth"
    torch.save({"format": "drone_env/checkpoint", "version": 1, "code": Path.home}, path)
    with pytest.raises(CheckpointError):
        load_checkpoint(path)


def test_a_checkpoint_of_another_run_names_the_difference(tmp_path: Path) -> None:
    Run(SMALL, tmp_path, tmp_path / "results").save()
    with pytest.raises(CheckpointError, match=r"gamma 0.99 \(now 0.9\).*--fresh"):
        Run(replace(SMALL, gamma=0.9), tmp_path, tmp_path / "results")
    run = Run(replace(SMALL, gamma=0.9), tmp_path, tmp_path / "results", fresh=True)
    assert not run.resumed
    assert (tmp_path / "easy.pth.old").exists()


# The command


TRAIN = [
    "train", "--task", "easy", "--episodes", "40", "--num-threads", "1", "--num-envs", "8", "--batch-size", "16",
    "--replay-size", "400", "--learning-starts", "50", "--steps-per-update", "8", "--validation-every", "10",
    "--validation-maps", "5", "--log-every", "5",
]  # fmt: skip


def test_the_command_trains_and_leaves_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(TRAIN) == 0
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "on the validation maps" in captured.err
    log = (tmp_path / "data/train.log").read_text().splitlines()
    assert [line.split()[0] for line in log] == [f"episode={n}" for n in range(5, 41, 5)]
    history = (tmp_path / "results/easy/history.csv").read_text().splitlines()
    assert len(history) == 9
    for name in ("reward", "loss", "epsilon", "validation"):
        assert (tmp_path / f"results/easy/{name}.png").read_bytes().startswith(b"\x89PNG")
    assert list((tmp_path / "results/easy/tensorboard").glob("events.*"))
    # The network flies, without PyTorch, by its file.
    assert main(["evaluate", "--task", "easy", "--agents", "pathqnet", "--checkpoint", "data/easy.npz",
                 "--episodes", "20", "--json", "-"]) == 0  # fmt: skip
    figures = json.loads(capsys.readouterr().out)["tasks"]["easy_delivery"]["agents"]["pathqnet:data/easy.npz"]
    assert 0.01 <= figures["mean_score"] <= 0.99
    # There is nothing left to do, until more is asked for.
    assert main(TRAIN) == 0
    assert "has 40 episodes already" in capsys.readouterr().err
    assert main([*TRAIN, "--episodes", "50"]) == 0
    assert "going on from" in capsys.readouterr().err
    assert len((tmp_path / "data/train.log").read_text().splitlines()) == 10


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--resume", "--fresh"], "one of them"),
        (["--resume"], "there is no checkpoint"),
        (["--episodes", "0"], "episodes must be above 0"),
        (["--task", "impossible"], "allowed: easy"),
        (["--reward-profile", "generous"], "allowed: aligned"),
    ],
)
def test_the_command_refuses(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.MonkeyPatch.context():
        try:
            status = main(["train", *arguments])
        except SystemExit as ended:
            status = int(ended.code or 0)
    assert status == 2
    assert message in "".join(capsys.readouterr())
    assert list(tmp_path.iterdir()) == []


def test_killed_at_random_moments_the_run_comes_to_the_same_end(tmp_path: Path) -> None:
    episodes = 60 + 20 * KILLS

    def command(folder: Path) -> list[str]:
        return [sys.executable, "-m", "drone_env.cli", *TRAIN, "--episodes", str(episodes), "--checkpoint-seconds",
                "0.2", "--data", str(folder / "data"), "--results", str(folder / "results")]  # fmt: skip

    subprocess.run(command(tmp_path / "whole"), check=True, capture_output=True, timeout=1200)
    rng, log = random.Random(KILLS), tmp_path / "killed/data/train.log"
    for lines in sorted(rng.sample(range(1, episodes // 5 - 10), KILLS)):
        process = subprocess.Popen(command(tmp_path / "killed"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not log.exists() or log.read_text().count("\n") < lines:
            assert process.poll() is None, "the run ended before it could be killed"
            time.sleep(0.005)
        time.sleep(rng.uniform(0, 0.1))
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    subprocess.run(command(tmp_path / "killed"), check=True, capture_output=True, timeout=1200)
    whole, killed = (load_checkpoint(tmp_path / name / "data/easy.pth") for name in ("whole", "killed"))
    assert whole.pop("seconds") > 0 < killed.pop("seconds")
    assert_same(whole, killed)
    logs = [(tmp_path / name / "data/train.log").read_text() for name in ("whole", "killed")]
    assert logs[0] == logs[1]


def test_interrupted_the_run_saves_and_ends_cleanly(tmp_path: Path) -> None:
    arguments = [sys.executable, "-m", "drone_env.cli", *TRAIN, "--episodes", "100000",
                 "--data", str(tmp_path / "data"), "--results", str(tmp_path / "results")]  # fmt: skip
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    log = tmp_path / "data/train.log"
    for _ in range(600):
        if log.exists() and log.read_text():
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert out == ""
    assert "the same command goes on from" in err
    assert "Traceback" not in err
    assert load_checkpoint(tmp_path / "data/easy.pth")["counters"][2] > 0


# The agent


def test_the_agent_flies_alone_as_in_a_batch(tmp_path: Path) -> None:
    torch.manual_seed(3)
    path = tmp_path / "net.npz"
    export_network(PathQNet(), path, {"telemetry_size": 5})
    agent = make_agent(f"pathqnet:{path}", "easy")
    assert isinstance(agent, PathQNetAgent)
    episodes = [Episode("easy") for _ in range(30)]
    for seed, episode in enumerate(episodes):
        episode.reset(seed)
    observations = [episode.observation() for episode in episodes]
    together = agent.act_batch(
        np.stack([observation["grid"] for observation in observations]),
        np.stack([observation["telemetry"] for observation in observations]),
    )
    assert [agent.act(observation) for observation in observations] == together.tolist()


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_network_has_a_card(name: str) -> None:
    task = get_task(name)
    path = shipped_network(task)
    network = load_network(path)
    assert (network.metadata["task"], network.metadata["task_version"]) == (task.id, task.version)
    card = path.with_suffix(".md").read_text(encoding="utf-8")
    assert f"`drone-env train --task {task.short_name}" in card
    assert f"{network.metadata['updates']:,} updates" in card
    assert PathQNetAgent(task).config == make_agent(f"pathqnet:{path}", task).config


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_network_is_the_same_in_torch(name: str) -> None:
    task = get_task(name)
    shipped = load_network(shipped_network(task))
    network = PathQNet(task.telemetry_size)
    network.load_state_dict({name: torch.from_numpy(array) for name, array in shipped.parameters.items()})
    batch = Batch(task, 64)
    batch.reset(np.array(split_seeds("test", 64)))
    for _ in range(30):
        found = shipped(batch.grids, batch.telemetry)
        with torch.no_grad():
            expected = network(torch.from_numpy(batch.grids), torch.from_numpy(batch.telemetry)).numpy()
        assert np.abs(found - expected).max() < 1e-5 * max(1, np.abs(expected).max())
        batch.step(found.argmax(axis=1))


@pytest.mark.parametrize("task", SHIPPED)
def test_the_shipped_network_flies_as_its_card_says(task: str) -> None:
    figures = summarise(run_episodes(episodes_key(task, "pathqnet", split_seeds("test", 300), "test")))
    assert figures["success_rate"] > 0.99
    assert figures["score_ratio"] > 0.995


def test_a_network_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "net.npz"
    export_network(PathQNet(), path, {"telemetry_size": 5})
    with pytest.raises(CheckpointError, match="takes 5 values of telemetry"):
        make_agent(f"pathqnet:{path}", "skyline_easy")
    path.write_bytes(b"nothing")
    with pytest.raises(CheckpointError, match="not an exported network"):
        make_agent(f"pathqnet:{path}", "easy")
    with pytest.raises(FileNotFoundError):
        make_agent(f"pathqnet:{tmp_path / 'gone.npz'}", "easy")
    with pytest.raises(UnsupportedTaskError, match="no network is shipped"):
        make_agent("pathqnet", "skyline_hard")
