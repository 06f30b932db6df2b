"""Tasks, reward profiles and agents that are registered from outside the package."""

from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import gymnasium
import pytest

import drone_env
from drone_env.agents import GreedyAgent, register_agent
from drone_env.cli import main
from drone_env.core.actions import Event
from drone_env.core.episode import Episode
from drone_env.core.rewards import RewardProfile
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.envs.registry import register_reward_profile, register_task
from drone_env.errors import InvalidTaskError, InvalidValueError
from drone_env.graders import GRADERS
from drone_env.models import DroneState
from drone_env.planning.optimal import solve
from drone_env.results.evaluate import episodes_key, run_episodes
from tests.toy import PLUGIN_OF_HOPS

GRADER = "drone_env.graders:grade_courier"


@pytest.fixture
def courier() -> TaskConfig:
    task = replace(get_task("medium"), id="courier", short_name="courier", grader=GRADER, width=8, height=8)
    return register_task(task)


def test_a_registered_task_is_known_everywhere(courier: TaskConfig) -> None:
    assert get_task("courier") is get_task(GRADER) is courier
    env = gymnasium.make("DroneDelivery-Courier-v1")
    observation, _ = env.reset(seed=7)
    assert observation["grid"].shape == (8, 8)
    envs = gymnasium.make_vec("DroneDelivery-Courier-v1", num_envs=3)
    assert envs.reset(seed=7)[0]["grid"].shape == (3, 8, 8)
    results = run_episodes(episodes_key("courier", "optimal", range(7, 9)))
    assert results.scores[0] == solve("courier", 7).score > 0.9
    from drone_env.graders import grade_courier  # type: ignore[attr-defined]

    state = DroneState.of(Episode("courier", seed=7).fly(solve("courier", 7).actions))
    assert grade_courier(state) == GRADERS["courier"](state) == results.scores[0]


def test_registering_again_changes_nothing_and_names_cannot_be_taken(courier: TaskConfig) -> None:
    assert register_task(courier) is TASKS["courier"]
    grade_easy = GRADERS["easy_delivery"]
    register_task(get_task("easy"))
    assert GRADERS["easy_delivery"] is grade_easy
    for names in ({"id": "courier"}, {"short_name": "easy"}, {"grader": "drone_env.graders:grade_hard"}):
        fresh = {"id": "other", "short_name": "other", "grader": "drone_env.graders:grade_other", "width": 9, **names}
        with pytest.raises(InvalidTaskError, match="already names the task"):
            register_task(replace(courier, **fresh))
    assert "other" not in TASKS


def test_a_registered_profile_pays_by_its_name() -> None:
    profile = RewardProfile(id="parcels", summary="a parcel pays", events=((Event.DELIVERY, Decimal(3)),))
    assert drone_env.register_reward_profile(profile) is profile
    episode = Episode("easy", "parcels", 14)
    assert [episode.step(action) for action in solve("easy", 14).actions] == [0, 0, 3]
    with pytest.raises(InvalidTaskError, match="another profile has this id"):
        register_reward_profile(replace(profile, summary="another"))


def test_a_registered_agent_flies_by_its_name() -> None:
    register_agent("mine", GreedyAgent)
    register_agent("mine", GreedyAgent)
    mine, greedy = (run_episodes(episodes_key("easy", name, range(7, 9))) for name in ("mine", "greedy"))
    assert mine.scores.tolist() == greedy.scores.tolist()
    for name in ("mine", "greedy", "pathqnet:mine"):
        with pytest.raises(InvalidValueError, match="has a colon or is that of another agent: random, greedy"):
            register_agent(name, lambda task: GreedyAgent(task))


def test_the_command_line_imports_the_modules_it_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "hops.py").write_text(PLUGIN_OF_HOPS)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("DRONE_ENV_PLUGINS", "hops")
    assert main(["solve", "--task", "hops", "--seed", "7"]) == 0
