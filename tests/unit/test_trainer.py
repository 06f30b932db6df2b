"""The trainer: what it flies, what it learns from, what it reports, and that it goes on as if it had never stopped."""

import random
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

from drone_env.agents.network import load_network
from drone_env.agents.pathqnet import shipped_network
from drone_env.core.rewards import get_reward_profile, profile_for_discount
from drone_env.core.seeds import SPLITS, split_of, split_seeds
from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import CheckpointError
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.checkpoint import export_network, load_checkpoint, save_checkpoint
from drone_env.rl.model import PathQNet
from drone_env.rl.trainer import Trainer
from drone_env.rl.validation import Validation, Validator
from tests.unit.small_training import SMALL, assert_same, finished


class Landed(NamedTuple):
    """An episode that was seen to its end."""

    started: tuple[int, int]
    """The step before which it started, and its place."""
    ended: int
    """The step that ended it."""
    reward: float
    """Undiscounted, added up from the batch."""
    score: float
    steps: int
    deliveries: int


class Flown(NamedTuple):
    """One whole run of `SMALL`, with what was seen beside it."""

    trainer: Trainer
    seeds: set[int]
    """All maps that were flown."""
    landed: list[Landed]
    """In the order in which they ended."""
    told: list[int]
    """How many had ended at each line of the log."""


@pytest.fixture(scope="module")
def whole() -> Flown:
    trainer = Trainer(SMALL)
    flown = Flown(trainer, set(trainer.batch.seeds.tolist()), [], [])
    batch, paid, started = trainer.batch, np.zeros(SMALL.num_envs), [0] * SMALL.num_envs
    for step, lines in enumerate(trainer.train(), start=1):
        paid += batch.rewards
        finals = batch.finals()
        for k, i in enumerate(batch.ended.tolist()):
            came = float(finals["score"][k]), int(finals["steps"][k]), int(finals["deliveries"][k])
            flown.landed.append(Landed((started[i], i), step, float(paid[i]), *came))
            paid[i], started[i] = 0, step
        flown.seeds.update(batch.seeds.tolist())
        flown.told.extend(step for _ in lines)
    return flown


def flown_for(trainer: Trainer, steps: int) -> Trainer:
    for _ in range(steps):
        trainer.fly()
    return trainer


def parameters(network: PathQNet) -> list[torch.Tensor]:
    return [parameter.detach().clone() for parameter in network.parameters()]


# What it flies


def test_training_stays_on_train_maps(whole: Flown) -> None:
    assert len(whole.seeds) > SMALL.num_envs
    assert {split_of(seed) for seed in whole.seeds} == {"train"}
    assert max(whole.seeds) < SPLITS["validation"].start


def test_the_replay_holds_what_was_flown() -> None:
    """The same batch flown beside it by the actions that were kept."""
    trainer = Trainer(replace(SMALL, replay_size=8 * 70, gamma=0.9))
    profile = profile_for_discount(get_reward_profile(SMALL.reward_profile), 0.9)
    assert trainer.batch.reward_profile == profile != get_reward_profile(SMALL.reward_profile)
    seen, ended = [], 0
    for _ in range(65):
        seen.append((trainer.batch.grids.copy(), trainer.batch.telemetry.copy()))
        trainer.fly()
        row = trainer.replay.added - 1
        ended += int(trainer.batch.terminated.sum())
        assert (trainer.replay.terminated[row] == trainer.batch.terminated).all()
        assert np.allclose(trainer.replay.rewards[row], 10 * trainer.batch.rewards)
    assert ended >= SMALL.num_envs  # easy flights last 60 steps
    for row, (grids, telemetry) in enumerate(seen):
        assert (trainer.replay.grids[row] == grids).all()
        assert (trainer.replay.telemetry[row] == telemetry).all()


def test_it_flies_by_the_online_network_but_for_chance() -> None:
    greedy = Trainer(replace(SMALL, epsilon_start=0.0, epsilon_end=0.0))
    with torch.no_grad():
        for parameter in greedy.target.parameters():
            parameter += torch.randn_like(parameter)
    grids, telemetry = greedy.batch.grids.copy(), greedy.batch.telemetry.copy()
    greedy.fly()
    assert greedy.replay.actions[0].tolist() == greedy.values(grids, telemetry, greedy.online).argmax(axis=1).tolist()
    assert greedy.values(grids, telemetry).tolist() == greedy.values(grids, telemetry, greedy.target).tolist()
    by_chance = flown_for(Trainer(replace(SMALL, epsilon_start=1.0, epsilon_end=1.0)), 10)
    assert set(by_chance.replay.actions[:10].ravel().tolist()) == set(range(5))


def test_chance_and_step_size_fall_as_they_should() -> None:
    linear = Trainer(SMALL)
    assert linear.epsilon == 1
    linear.steps = 250
    assert linear.epsilon == pytest.approx(0.75)
    linear.episodes = 10
    assert linear.learning_rate == pytest.approx(0.75 * 5e-4 + 0.25 * 1e-5)
    multiplicative = Trainer(replace(SMALL, exploration="multiplicative"))
    multiplicative.steps, multiplicative.episodes = 250, 10
    assert multiplicative.epsilon == pytest.approx(0.995**10)


# What it learns from


@pytest.mark.parametrize(
    ("double", "share", "n_step", "loss"),
    [(True, 0.0, 1, "mse"), (False, 0.0, 3, "mse"), (True, 0.7, 3, "huber"), (False, 0.7, 1, "mse")],
)
def test_the_network_is_fitted_to_the_targets_of_the_papers(double: bool, share: float, n_step: int, loss: Any) -> None:
    """Transition by transition from the formulas, where the trainer works on whole batches."""
    config = replace(SMALL, double=double, advantage_learning=share, n_step=n_step, loss=loss, gamma=0.9,
                     target_update="episodes")  # fmt: skip
    trainer = flown_for(Trainer(config), 30)
    # The end of each flight is in it: half of what is drawn is held to have ended there.
    trainer.replay.terminated[:30, ::2] = True
    with torch.no_grad():
        for parameter in trainer.target.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
    drawn = trainer.replay.sample(16, n_step, 0.9, np.random.default_rng(0))
    trainer.rng = np.random.default_rng(0)

    def values(network: PathQNet, grids: Any, telemetry: Any, i: int) -> list[float]:
        return trainer.values(grids[i : i + 1], telemetry[i : i + 1], network)[0].tolist()

    errors = []
    for i in range(16):
        later = values(trainer.target, drawn.next_grids, drawn.next_telemetry, i)
        chooser = values(trainer.online, drawn.next_grids, drawn.next_telemetry, i) if double else later
        present = values(trainer.target, drawn.grids, drawn.telemetry, i)
        wanted = float(drawn.returns[i]) + float(drawn.discounts[i]) * later[chooser.index(max(chooser))]
        wanted -= share * (max(present) - present[drawn.actions[i]])
        errors.append(abs(wanted - values(trainer.online, drawn.grids, drawn.telemetry, i)[drawn.actions[i]]))
    assert sorted(set(drawn.discounts.tolist())) == [0, pytest.approx(0.9**n_step)]
    trainer.learn()
    costs = [error**2 if loss == "mse" else error**2 / 2 if error < 1 else error - 0.5 for error in errors]
    assert trainer.losses == [pytest.approx(np.mean(costs), rel=1e-4)]


def test_long_gradients_are_shortened_and_others_are_not() -> None:
    def length(max_grad_norm: float) -> float:
        trainer = flown_for(Trainer(replace(SMALL, max_grad_norm=max_grad_norm)), 10)
        trainer.learn()
        return float(torch.cat([parameter.grad.ravel() for parameter in trainer.online.parameters()]).norm())

    unbounded = length(0)
    assert unbounded > 0.01
    assert length(0.01) == pytest.approx(0.01, rel=1e-3)
    assert length(2 * unbounded) == pytest.approx(unbounded)


def test_an_update_takes_a_step_of_the_present_size() -> None:
    """Adam's first step is as long as the learning rate, whatever the gradient."""
    trainer = flown_for(Trainer(replace(SMALL, learning_rate=0.01, final_learning_rate=0.001)), 10)
    trainer.episodes = SMALL.episodes // 2
    before = parameters(trainer.online)
    trainer.learn()
    moved = max(float((a - b).abs().max()) for a, b in zip(before, parameters(trainer.online), strict=True))
    assert moved == pytest.approx(0.0055, rel=0.01)


def test_a_soft_target_follows_a_little_at_every_update() -> None:
    trainer = flown_for(Trainer(replace(SMALL, tau=0.3)), 10)
    assert_same(parameters(trainer.target), parameters(trainer.online))
    for _ in range(2):
        before = parameters(trainer.target)
        trainer.learn()
        expected = [0.7 * ours + 0.3 * theirs for ours, theirs in zip(before, parameters(trainer.online), strict=True)]
        assert not all(torch.equal(a, b) for a, b in zip(before, expected, strict=True))
        for found, wanted in zip(parameters(trainer.target), expected, strict=True):
            assert torch.allclose(found, wanted, atol=1e-7)


def test_a_target_by_episodes_is_copied_every_so_many() -> None:
    trainer = Trainer(replace(SMALL, episodes=16, target_update="episodes", target_every=8))
    first, copies = parameters(trainer.target), {}

    for _ in trainer.train():
        copies[trainer.episodes // 8] = all(map(torch.equal, parameters(trainer.target), first))
    assert trainer.updates > 0
    assert copies == {0: True, 1: False, 2: False}
    assert_same(parameters(trainer.target), parameters(trainer.online))  # the last step ended with a copy


def test_it_learns_as_often_as_it_says() -> None:
    trainer = Trainer(SMALL)
    updates = []
    trainer.learn = lambda: updates.append(trainer.steps)  # type: ignore[method-assign]
    next(step for step in trainer.train() if trainer.steps == 400)
    # From the first step beyond 50 on, every 32 steps of the 8 episodes together.
    assert updates == list(range(56 + 3 * 8, 401, 32))


def test_training_learns() -> None:
    """On a map of 3 x 3 the network soon delivers what chance seldom does."""
    task = replace(get_task("easy"), id="tiny_city", short_name="tiny_city", width=3, height=3, buildings=0, trees=0,
                   obstacles=0, max_steps=9, battery_capacity=9)  # fmt: skip
    TASKS[task.id] = task
    try:
        config = replace(SMALL, task="tiny_city", episodes=400, num_envs=16, batch_size=64, steps_per_update=8,
                         learning_rate=2e-3, replay_size=8000, epsilon_steps=2000, validation_every=100,
                         validation_maps=100)  # fmt: skip
        trainer = Trainer(config)
        untrained = trainer.validator.validate(lambda grids, seen: trainer.values(grids, seen).argmax(axis=1)).score
        finished(trainer)
    finally:
        del TASKS[task.id]
    assert untrained < 0.6 * trainer.validator.optimum
    assert trainer.best_score > 0.95 * trainer.validator.optimum


# What it reports


def test_its_figures_are_those_of_its_flights(whole: Flown) -> None:
    history = whole.trainer.history
    assert [line.episode for line in history] == list(range(5, 41, 5))
    before = 0
    for line, step in zip(history, whole.told, strict=True):
        # Of all that have ended when it is told (of those of the last step only up to this number) ...
        ended = [landed for landed in whole.landed if landed.ended <= step][: line.episode]
        started = {(landed.ended, landed.started[1]) for landed in whole.landed if landed.ended <= step}
        flying = (started | {(0, i) for i in range(SMALL.num_envs)}) - {landed.started for landed in ended}
        # ... those that started before every one that still flies.
        of_age = sorted(landed for landed in ended if landed.started < min(flying))
        told = of_age[-max(len(of_age) - before, 5) :]
        before = len(of_age)
        if not told:
            assert np.isnan([line.reward, line.score, line.success, line.length]).all()
            continue
        assert line.reward == pytest.approx(np.mean([landed.reward for landed in told]))
        assert line.score == pytest.approx(np.mean([landed.score for landed in told]))
        assert line.length == pytest.approx(np.mean([landed.steps for landed in told]))
        assert line.success == pytest.approx(np.mean([landed.deliveries == 1 for landed in told]))
        assert line.validation_optimum == whole.trainer.validator.optimum
    assert before > 20
    assert [line.steps for line in history] == sorted(line.steps for line in history)
    assert history[-1].steps == whole.trainer.steps
    assert history[-1].updates == whole.trainer.updates > 0
    assert history[-1].epsilon == whole.trainer.epsilon < history[0].epsilon
    # From the first validation on, after 10 episodes, each line tells the last one.
    assert [bool(np.isnan(line.validation)) for line in history] == [True] + 7 * [False]
    assert history[-1].validation == whole.trainer.validation.score


def test_short_flights_are_not_told_before_the_long_ones_of_their_age() -> None:
    """Those that end first went well: told as they end, a run seems to unlearn from its first line on."""
    config = replace(SMALL, num_envs=64, episodes=128, log_every=16, replay_size=4000, epsilon_end=1.0)
    trainer = finished(Trainer(replace(config, learning_starts=10**6)))  # all by chance, from first to last
    told = [line for line in trainer.history if not np.isnan(line.score)]
    assert len(told) > 3
    assert all(line.success < 0.7 and line.length > 35 for line in told), told


def test_the_last_line_is_logged_and_judged_wherever_it_falls() -> None:
    trainer = finished(Trainer(replace(SMALL, episodes=12)))
    assert [line.episode for line in trainer.history] == [5, 10, 12]
    assert trainer.validated_updates == trainer.updates
    assert (trainer.losses, trainer.untold) == ([], 0)


def test_losses_are_the_mean_since_the_line_before() -> None:
    trainer = Trainer(SMALL)
    assert np.isnan(trainer.log().loss)
    trainer.losses = [1.0, 3.0]
    assert [trainer.log().loss for _ in range(2)] == [2.0, 2.0]  # no update between them: still the last that is known
    trainer.losses = [5.0]
    assert trainer.log().loss == 5.0


def test_a_validation_is_what_evaluation_says_of_the_same_maps(whole: Flown, tmp_path: Path) -> None:
    task, net = get_task("easy"), tmp_path / "net.npz"
    export_network(whole.trainer.judged, net, {"telemetry_size": 5})
    # One that hardly delivers, and one whose flights end at many moments.
    for network, agent in ((net, f"pathqnet:{net}"), (shipped_network(task), "pathqnet")):
        maps = split_seeds("validation", 40)
        expected = summarise(run_episodes(episodes_key("easy", agent, maps, "validation")))
        values = load_network(network)
        found = Validator(task, 40).validate(lambda grids, seen, values=values: values(grids, seen).argmax(axis=1))
        assert found.score == pytest.approx(expected["mean_score"])
        assert found.optimum == pytest.approx(expected["mean_optimal_score"])
        assert found.success == expected["success_rate"]
    assert found.success == 1


def test_the_best_network_is_kept() -> None:
    trainer = Trainer(SMALL)
    scores = iter([0.3, 0.5, 0.4, 0.5])
    trainer.validator.validate = lambda _: Validation(next(scores), 0.9, 0.0)  # type: ignore[method-assign]
    kept = []
    for number in range(4):
        with torch.no_grad():
            for parameter in trainer.judged.parameters():
                parameter.fill_(number)
        trainer.validate()
        kept.append((trainer.best_score, parameters(trainer.best_network())[0].ravel()[0].item()))
    # Of two that fly alike, the later one has learned from more.
    assert kept == [(0.3, 0), (0.5, 1), (0.5, 1), (0.5, 3)]


@pytest.mark.parametrize(("target_update", "judged"), [("soft", "target"), ("episodes", "online")])
def test_the_moving_average_is_what_is_judged(target_update: Any, judged: str) -> None:
    trainer = flown_for(Trainer(replace(SMALL, target_update=target_update)), 10)
    trainer.learn()
    states = {name: getattr(trainer, name).state_dict() for name in ("online", "target")}
    assert not all(torch.equal(states["online"][name], tensor) for name, tensor in states["target"].items())
    grids, telemetry = trainer.batch.grids, trainer.batch.telemetry
    assert trainer.values(grids, telemetry).tolist() == (
        trainer.values(grids, telemetry, getattr(trainer, judged)).tolist()
    )
    trainer.validate()
    assert_same(trainer.best, dict(states[judged]))


# That it goes on


@pytest.mark.parametrize("task", ["easy", "skyline_easy"])
def test_a_resumed_run_is_the_uninterrupted_one_bit_for_bit(task: str, tmp_path: Path, whole: Flown) -> None:
    # A network that takes six values of telemetry is only shown to go on, as it takes longer.
    config = SMALL if task == "easy" else replace(SMALL, task=task, episodes=16, validation_maps=2)
    uninterrupted = whole.trainer if task == "easy" else finished(Trainer(config))
    rng = random.Random(0)
    resumed, stops = Trainer(config), 0
    while resumed.episodes < config.episodes:
        for _ in islice(resumed.train(), rng.randint(1, 60 if task == "easy" else 8)):
            pass
        stops += 1
        save_checkpoint(tmp_path / "run.pth", resumed.get_state())
        # Another seed, for what the checkpoint fails to bring with it; its configuration is the same.
        resumed = Trainer(replace(config, seed=config.seed + stops))
        resumed.config = config
        resumed.set_state(load_checkpoint(tmp_path / "run.pth"))
    assert stops > 2
    assert_same(uninterrupted.get_state(), resumed.get_state())


def test_one_that_is_asked_for_more_later_is_the_same_from_then_on(whole: Flown) -> None:
    """Also where several episodes end in the step that ends the first part."""
    steps = [landed.ended for landed in whole.landed]
    part = next(n for n in range(1, SMALL.episodes) if steps[n - 1] == steps[n])
    config = replace(SMALL, final_learning_rate=SMALL.learning_rate, episodes=part + 12)
    once, twice = finished(Trainer(config)), finished(Trainer(replace(config, episodes=part)))
    assert twice.episodes == part
    state, twice = twice.get_state(), Trainer(config)
    twice.set_state(state)
    finished(twice)
    # But for the validation and the line of the log that end the first part.
    same = ("online", "optimizer", "replay", "batch", "rng", "rewards", "numbers", "ended", "early")
    for name in same:
        assert_same(once.get_state()[name], twice.get_state()[name])
    assert (once.steps, once.updates, once.episodes) == (twice.steps, twice.updates, twice.episodes)


def test_equal_seeds_make_equal_runs_and_others_do_not(whole: Flown) -> None:
    short = replace(SMALL, episodes=16, final_learning_rate=SMALL.learning_rate)
    runs = [finished(Trainer(replace(short, seed=seed))) for seed in (0, 0, 1)]
    assert_same(runs[0].get_state(), runs[1].get_state())
    assert runs[0].history != runs[2].history


def test_a_checkpoint_of_another_run_is_refused_and_changes_nothing(whole: Flown) -> None:
    other = Trainer(replace(SMALL, gamma=0.9, n_step=2))
    before = parameters(other.online)
    state = whole.trainer.get_state()
    with pytest.raises(CheckpointError, match=r"gamma 0\.99 \(now 0\.9\), n_step 1 \(now 2\)"):
        other.set_state(state)
    assert_same(before, parameters(other.online))
