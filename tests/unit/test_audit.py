"""The audit of rewards against every flight there is, and by hand."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import pytest

from drone_env import cli
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import REWARD_PROFILES, RewardProfile, get_reward_profile, profile_for_discount
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidTaskError
from drone_env.planning.audit import audit_map
from drone_env.reward_file import load_reward_profile
from tests.property.test_episode import custom_task


def tiny_tasks(count: int) -> list[TaskConfig]:
    """Tasks of every mechanic, on few cells and of few steps."""
    small = (task for task in map(custom_task, itertools.count()) if task.width * task.height <= 9)
    return [
        replace(task, max_steps=min(task.max_steps, 5), battery_capacity=min(task.battery_capacity, 5))
        for task in itertools.islice(small, count)
    ]


def every_flight(task: TaskConfig, seed: int, profile: RewardProfile, gamma: float) -> tuple[float, float]:
    """The highest return of all action sequences, and the lowest score that comes with it."""
    episode = Episode(task, profile, seed)
    ends: list[tuple[float, float]] = []

    def fly_on(state: object, earned: float, discount: float) -> None:
        for action in Action:
            episode.set_state(state)  # type: ignore[arg-type]
            total = earned + discount * episode.step(action)
            if episode.ended:
                ends.append((total, episode.score))
            else:
                fly_on(episode.get_state(), total, discount * gamma)

    fly_on(episode.get_state(), 0.0, 1.0)
    highest = max(total for total, _ in ends)
    return highest, min(score for total, score in ends if total >= highest - 1e-9)


@pytest.mark.parametrize("profile", REWARD_PROFILES)
def test_the_maximiser_is_the_best_of_all_flights(profile: str) -> None:
    for seed, (task, gamma) in enumerate(zip(tiny_tasks(8), itertools.cycle([1.0, 0.99, 0.7]), strict=False)):
        audited = audit_map(task, seed, profile, gamma)
        highest, lowest_score = every_flight(task, seed, REWARD_PROFILES[profile], gamma)
        assert audited.maximum == pytest.approx(highest, abs=1e-9)
        assert audited.score == lowest_score
        episode = Episode(task, profile, seed)
        earned = sum(gamma**t * episode.step(action) for t, action in enumerate(audited.actions))
        assert episode.ended
        assert (earned, episode.score) == (pytest.approx(highest, abs=1e-9), audited.score)


SEEDS = [("easy", seed) for seed in split_seeds("test", 4)] + [("medium", 0)]


@pytest.mark.parametrize("profile", ["aligned", "score"])
def test_rewards_that_pay_the_score_are_aligned(profile: str) -> None:
    for task, seed in SEEDS:
        audited = audit_map(task, seed, profile_for_discount(get_reward_profile(profile), 0.99), 0.99)
        assert audited.score == audited.optimum
        assert audited.maximum >= audited.honest - 1e-9


def test_shaping_for_another_discount_is_found_out() -> None:
    profile = profile_for_discount(get_reward_profile("aligned"), 0.99)
    assert not all(audit_map("medium", seed, profile, 1.0).aligned for seed in split_seeds("test", 12))


def test_waiting_for_rewards_on_one_easy_map_by_hand() -> None:
    audited = audit_map("easy", 14, "tiered", 1.0)
    # Three steps to the parcel (see the log lines in the README): 0.15 + 0.15 + 0.99.
    assert audited.honest == pytest.approx(1.29)
    # The same with 57 waits at 0.10 before the last step.
    assert audited.maximum == pytest.approx(1.29 + 5.7)
    assert audited.score == 0.8


# Files


MINE = """
id = "mine"
summary = "deliveries pay, time costs"
shaping = 0.05
clamp = [-1.0, 1]
[events]
delivery = 1
step = -0.01
"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id = 'x'\nshaping = 'much'", "shaping: Input should be a valid decimal"),
        ("id = 'x'\nclamp = [2, 1]", "the lower bound of clamp is above the upper"),
        ("id = 'score'", "taken by a profile of the package"),
        ("id = 'x'\n[events]\ncrash = 1", "events.crash.*'delivery', 'battery_dead'"),
    ],
)
def test_a_file_that_is_no_reward_profile_says_why(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InvalidTaskError, match=message):
        load_reward_profile(path)


# The command


def test_the_command_prints_json_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(MINE)
    status = cli.main(["audit", "--task", "easy", "--reward", str(path), "--maps", "2", "--gamma", "0.99", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert (status, report["verdict"], report["share_aligned"]) == (0, "aligned", 1)
    assert (report["reward"], report["maps"], report["gamma"]) == ("mine", 2, 0.99)
    assert set(report["mean_returns"]) == {"maximiser", "honest"}
    assert cli.main(["audit", "--gamma", "2"]) == 2
    assert "--gamma 0 to 1; got 20 and 2" in capsys.readouterr().err
