"""PPO: what its trainer flies, learns and keeps, and its network in PyTorch and in NumPy."""

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from drone_env.agents import make_agent
from drone_env.agents.base import rollout_batch
from drone_env.agents.pathqnet import shipped_network
from drone_env.agents.ppo import load_actor
from drone_env.agents.weights_file import WEIGHTS, write_weights
from drone_env.cli import main
from drone_env.core.actions import N_ACTIONS
from drone_env.core.batch import Batch
from drone_env.core.rewards import get_reward_profile, profile_for_discount
from drone_env.core.seeds import SPLITS, split_seeds
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.envs.forms import StopEntries
from drone_env.errors import CheckpointError, UnsupportedTaskError
from drone_env.planning.nearby import NEIGHBOURS, choices
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.config import PPO_STEPS, ppo_preset
from drone_env.rl.ppo import PpoTrainer
from drone_env.rl.run import load_checkpoint, save_checkpoint
from tests.same import assert_same
from tests.unit.small_training import SMALL_PPO, finished, parameters

SHIPPED = [task for task in TASKS.values() if shipped_network(task, "ppo").exists()]


def untrained(task: str = "skyline_easy", scale: float = 1.0, **changes: Any) -> PpoTrainer:
    """A trainer whose policy has preferences; a new one hardly has any."""
    trainer = PpoTrainer(replace(SMALL_PPO, task=task, **changes))
    for network in (trainer.online, trainer.average):
        torch.nn.init.normal_(network.actor.weight, std=scale, generator=torch.Generator().manual_seed(1))
    return trainer


def exported(trainer: PpoTrainer, file: Path) -> Path:
    trainer.validate()
    write_weights(file, {name: tensor.numpy() for name, tensor in trainer.best.items()}, trainer.metadata())
    return file


# What it flies and learns


def test_it_flies_open_actions_on_train_maps_with_shaping_by_its_own_discount() -> None:
    trainer = untrained(gamma=0.9, num_steps=70)
    assert trainer.batch.reward_profile == profile_for_discount(get_reward_profile("aligned"), 0.9)
    assert max(trainer.batch.seeds.tolist()) < SPLITS["train"].stop
    _, _, masks, actions, log_probs, *_ = trainer.fly()
    assert masks.gather(1, actions[:, None]).all()
    assert len(set(actions.tolist())) == N_ACTIONS
    assert not masks.all()
    assert torch.isfinite(log_probs).all()
    assert trainer.scores


def test_with_safe_actions_alone_hardly_a_flight_runs_out_of_battery() -> None:
    """Whatever else it chooses: here it chooses at random."""
    task, seeds, rng = get_task("skyline_medium"), np.arange(200), np.random.default_rng(0)
    look, stranded = StopEntries(task), dict[bool, float]()
    for shield in (True, False):

        def act(grids: Any, telemetry: Any, shield: bool = shield) -> Any:
            masks = choices(look({"grid": grids, "telemetry": telemetry})["entries"], False, shield)
            return np.where(masks, rng.random(masks.shape), -1).argmax(axis=1)

        ends = rollout_batch(task, seeds, act, True)
        stranded[shield] = float(np.mean((ends.steps < task.max_steps) & (ends.deliveries_done < task.deliveries)))
    assert stranded[True] < 0.03
    assert stranded[False] > 0.9
    assert choices(np.array([[NEIGHBOURS]]), False, shield=True).tolist() == [[True, False, False, False, True]]


def test_on_rush_a_wait_charges_unless_nothing_else_is_open() -> None:
    task, rng, waits = get_task("rush_medium"), np.random.default_rng(0), 0
    look, batch = StopEntries(task, deliveries=True), Batch(task, 100, same_step=True)
    batch.reset(np.arange(100))
    for _ in range(30):
        units = batch.telemetry[:, 2].copy()
        entries = look({"grid": batch.grids, "telemetry": batch.telemetry})["entries"]
        masks = choices(entries, batch.telemetry[:, 2] == 1, rush=True)
        assert (masks[:, :4] == batch.action_masks[:, :4]).all()
        actions = np.where(masks, rng.random(masks.shape) + np.eye(N_ACTIONS)[4], -1).argmax(axis=1)
        batch.step(actions)
        waited = (actions == 4) & masks[:, :4].any(axis=1) & ~batch.terminated
        assert (batch.telemetry[waited, 2] > units[waited]).all()
        waits += waited.sum()
    assert waits > 20
    assert choices(np.array([[0]]), np.ones(1, np.bool_), rush=True).tolist() == [[False] * 4 + [True]]


def test_advantages_and_returns_are_those_of_the_paper() -> None:
    """Step by step from the formula, against the trainer's, over several ends."""
    trainer, other = (untrained(num_steps=60, gamma=0.9, gae_lambda=0.8) for _ in range(2))
    entries, features, _, actions, _, advantages, returns = trainer.fly()
    with torch.no_grad():
        values = trainer.online(entries, features)[1].view(60, 8)
        last = trainer.observe(trainer.batch.grids, trainer.batch.telemetry)
        following = trainer.policy(trainer.online, *last)[1]
    rewards, ends = [], []
    for chosen in actions.view(60, 8).numpy():
        other.batch.step(chosen)
        rewards.append(5.0 * other.batch.rewards)
        ends.append(other.batch.terminated.copy())
    assert np.any(ends)
    for i in range(8):
        expected, ahead = 0.0, float(following[i])
        for t in reversed(range(60)):
            alive = 0.0 if ends[t][i] else 0.9
            expected = rewards[t][i] + alive * ahead - float(values[t, i]) + alive * 0.8 * expected
            ahead = float(values[t, i])
            assert float(advantages.view(60, 8)[t, i]) == pytest.approx(expected, abs=1e-4)
            assert float(returns.view(60, 8)[t, i]) == pytest.approx(expected + ahead, abs=1e-4)


def test_an_update_gains_from_a_bounded_change_alone() -> None:
    trainer = untrained(update_epochs=1, entropy_weight=0.0, value_weight=0.0, minibatch_size=64)
    *seen, actions, log_probs, _, returns = trainer.fly()
    before = parameters(trainer.online)
    # An action that has become much likelier and was good, or much less likely and bad, changes nothing more.
    gain = torch.where(torch.arange(64) % 2 == 0, 1.0, -1.0)
    trainer.learn([*seen, actions, log_probs - gain, gain, returns])
    assert_same(parameters(trainer.online), before)
    trainer.learn([*seen, actions, log_probs + gain, gain, returns])
    assert not all(map(torch.equal, parameters(trainer.online), before))


def test_the_average_is_what_is_validated_and_the_best_is_kept() -> None:
    trainer = finished(PpoTrainer(SMALL_PPO))
    assert not all(map(torch.equal, parameters(trainer.online), parameters(trainer.average)))
    assert [line.steps for line in trainer.history] == [64, 128, 192, 256, 320]
    assert trainer.history[-1].learning_rate == 0
    validated = {line.validation for line in trainer.history[1:]}
    assert trainer.best_score == max(validated)
    trainer.best_score = 2.0
    kept = trainer.best
    trainer.validate()
    assert trainer.best is kept


def test_a_few_seconds_teach_it_to_fly_to_the_parcel() -> None:
    config = replace(ppo_preset("easy"), steps=16_384, num_envs=64, minibatch_size=512, hidden=32, learning_rate=3e-3,
                     validation_every=16_384, validation_maps=30)  # fmt: skip
    trainer = finished(PpoTrainer(config))
    assert trainer.best_score > 0.9
    assert trainer.sampled > 0.9


def test_every_preset_is_one_of_a_task() -> None:
    for name in (*PPO_STEPS, "city_small"):
        assert ppo_preset(name).identity()["task"] == get_task(name).id


# Resuming


def test_a_resumed_run_is_the_uninterrupted_one_bit_for_bit(tmp_path: Path) -> None:
    uninterrupted = finished(PpoTrainer(SMALL_PPO)).get_state()
    resumed = PpoTrainer(SMALL_PPO)
    for rounds in (1, 2, 9):
        list(islice(resumed.train(), rounds))
        save_checkpoint(tmp_path / "run.pth", resumed.get_state())
        # Another seed reveals what the checkpoint lacks.
        resumed = PpoTrainer(replace(SMALL_PPO, seed=rounds))
        resumed.config = SMALL_PPO
        resumed.set_state(load_checkpoint(tmp_path / "run.pth"))
    states = [uninterrupted, resumed.get_state()]
    for state in states:
        assert min(state.pop("cpu_seconds"), *(line.pop("cpu_seconds") for line in state["history"])) > 0
    assert_same(*states)


# Its network without PyTorch, and the command


@pytest.mark.parametrize("name", ["easy", "skyline_easy", "rush_easy", "city_small"])
def test_the_network_without_torch_is_the_same(name: str, tmp_path: Path) -> None:
    trainer, task = untrained(name, rush=name == "rush_easy"), get_task(name)
    file = exported(trainer, tmp_path / "net.safetensors")
    trainer.average.load_state_dict(trainer.best)  # rounded to float16, as the file holds it
    assert file.stat().st_size < 2 * sum(map(torch.numel, trainer.average.parameters())) + 3_000
    batch = Batch(task, 20)
    batch.reset(np.arange(20))
    seen = trainer.look({"grid": batch.grids, "telemetry": batch.telemetry})
    with torch.no_grad():
        expected = trainer.average(*map(torch.from_numpy, seen.values()))[0].numpy()
    assert np.abs(load_actor(file)(seen["entries"], seen["features"]) - expected).max() < 1e-5


def test_a_validation_is_what_evaluation_says_of_the_exported_network(tmp_path: Path) -> None:
    trainer = untrained(validation_maps=20)
    file = exported(trainer, tmp_path / "net.safetensors")
    figures = summarise(run_episodes(episodes_key("skyline_easy", f"ppo:{file}", split_seeds("validation", 20))))
    assert figures["mean_score"] == pytest.approx(trainer.best_score)
    assert trainer.sampled != trainer.best_score
    with pytest.raises(CheckpointError, match="takes 13 values of telemetry"):
        make_agent(f"ppo:{file}", "easy")
    assert make_agent(f"ppo:{file}", "skyline_hard").config["agent"] == "ppo"


@pytest.mark.parametrize("task", SHIPPED, ids=lambda task: task.short_name)
def test_the_shipped_policy_flies_as_its_card_says(task: TaskConfig) -> None:
    network = load_actor(shipped_network(task, "ppo"))
    assert (network.metadata["task"], network.metadata["task_version"]) == (task.id, task.version)
    card = (WEIGHTS / "ppo_v1.md").read_text(encoding="utf-8")
    ratio = network.metadata["validation_score"] / network.metadata["validation_optimum"]
    assert f"| {task.short_name} | {network.metadata['config']['seed']} | {ratio:.4f} |" in card
    flown = rollout_batch(task, np.array(split_seeds("validation", 200)), make_agent("ppo", task).act_batch, True)
    assert flown.scores.mean() == pytest.approx(network.metadata["validation_score"])


def test_the_shipped_policies_are_those_of_the_delivery_tasks_and_small() -> None:
    assert {"easy", "medium", "hard", "rush_easy", "rush_medium", "rush_hard"} <= {task.short_name for task in SHIPPED}
    assert sum(shipped_network(task, "ppo").stat().st_size for task in SHIPPED) < 1_600_000
    with pytest.raises(UnsupportedTaskError, match=r"as in ppo:FILE, or train one first .*--algorithm ppo --task city"):
        make_agent("ppo", "city")


def test_the_command_trains_a_network_that_flies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    small = ["--num-envs", "8", "--num-steps", "8", "--minibatch-size", "32", "--validation-maps", "3", "--hidden", "8"]
    command = ["train", "--algorithm", "ppo", "--task", "easy", *small, "--log-every", "64"]
    assert main([*command, "--steps", "128"]) == 0
    told = capsys.readouterr().err
    assert "next: drone-env evaluate --task easy --agents greedy ppo:data/ppo_easy.safetensors" in told
    assert main([*command, "--steps", "192"]) == 0
    assert "going on from data/ppo_easy.pth: 128 of 192 steps" in capsys.readouterr().err
    assert len((tmp_path / "data/train.log").read_text().splitlines()) == 3
    assert main(["evaluate", "--task", "easy", "--agents", "ppo:data/ppo_easy.safetensors", "--episodes", "3"]) == 0
    assert main([*command, "--steps", "100"]) == 0
    assert "Raise --steps to go on" in capsys.readouterr().err
