"""The adapters to Inspect and TRL as far as they go without those packages; with them: `tests/adapters`."""

import inspect
import json
import re
import sys

import pytest

from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile, profile_for_discount
from drone_env.errors import EpisodeError, InvalidValueError, MissingPackageError, UnknownNameError, install_command
from drone_env.llm.trl_environment import DroneEnvironment, flight_reward, training_maps
from drone_env.planning.optimal import solve
from drone_env.planning.stops import next_stops


def test_a_flight_by_tool_calls() -> None:
    # Map 14 of easy by hand, as in the tests of `fly`.
    drone = DroneEnvironment()
    told = drone.reset(prompt=[], task="easy", seed=14, reward_profile="score")
    episode = Episode("easy", seed=14)
    x, y = episode.position
    assert f"Position: ({x}, {y})" in told
    assert drone.fly("LEFT") == (
        f"On the way. Position: ({x - 1}, {y}). Battery: 59 units. Nearest parcel: {episode.target}. Delivered: 0 of 1."
    )
    assert drone.get_reward() == 0.01  # as if it waited to the end
    assert drone.fly_route(["UP", "UP", "UP"]) == "On the way. Delivered: 1 of 1. Mission accomplished."
    assert drone.get_reward() == 0.99
    for again in (drone.fly("DOWN"), drone.fly_route(["UP"] * 60)):
        assert again.startswith("Nothing done: the episode has ended")
    assert drone.get_reward() == 0.99
    logged: dict[str, float] = {}
    # Trainers add both rewards.
    assert flight_reward([[]] * 2, [drone, object()], logged.__setitem__) == [0.0, None]
    assert (logged["flight/score"], logged["flight/success"]) == (0.99, 1)


def test_an_answer_with_the_whole_route_is_paid_and_logged() -> None:
    best = [action.name for action in solve("easy", 14).actions]
    answers = [json.dumps({"actions": best}), f"<think>Hm.</think>{best[0]}", "I would go up.", None]
    columns = {"task": "easy", "seed": 14, "plan": "plan-2", "reward_profile": "score"}
    logged: dict[str, float] = {}
    completions = [[{"role": "assistant", "content": answer}] for answer in answers]
    rows = {name: [value] * 4 for name, value in columns.items()}
    pay = flight_reward(completions, log_metric=logged.__setitem__, **rows)
    assert pay == [0.99, 0.01, 0.01, 0.01]
    lost = solve("easy", 14).score - sum(pay) / 4
    means = {"score": sum(pay) / 4, "success": 1 / 4, "regret": lost, "steps": 4 / 4, "unusable": 2 / 4}
    assert logged == {f"flight/{name}": pytest.approx(value) for name, value in means.items()}
    with pytest.raises(InvalidValueError, match="environment_factory"):
        flight_reward([[]], task=["easy"])


def test_where_there_are_pads_each_answer_tells_what_lies_below() -> None:
    drone = DroneEnvironment()
    assert drone.reset(task="skyline_easy", seed=0).endswith("\nBelow the drone: road")
    assert " Below the drone: " in drone.fly("WAIT")


def test_a_stop_is_flown_to_by_its_letter() -> None:
    drone, episode = DroneEnvironment(), Episode("skyline_easy", seed=3)
    told = drone.reset(task="skyline_easy", seed=3)
    while stops := next_stops(episode):
        stop = stops[-1]  # a pad, as long as one is in reach
        assert f"\n{stop.label} {'parcel' if stop.is_parcel else 'pad'} " in told
        told = drone.goto(stop.label.lower())
        episode.fly(stop.actions)
        assert told.startswith(episode.message) == episode.ended
        with pytest.raises(InvalidValueError, match="is no stop in reach"):
            drone.goto("Z")
    assert drone._started().episode.actions == episode.actions


@pytest.mark.parametrize("profile", ["tiered", "aligned"])
def test_the_reward_is_what_the_profile_pays_to_the_end(profile: str) -> None:
    drone, actions = DroneEnvironment(), solve("hard", 3).actions[:5]
    drone.reset(task="hard", seed=3, reward_profile=profile)
    drone.fly_route([action.name for action in actions])
    episode = Episode("hard", profile_for_discount(get_reward_profile(profile), 1), 3).fly(actions)
    assert drone.get_reward() == episode.waited_out().reward_total


def test_bad_calls_are_told_and_fly_nothing() -> None:
    methods = [name for name, _ in inspect.getmembers(DroneEnvironment, inspect.isfunction) if name[0] != "_"]
    assert methods == ["fly", "fly_route", "get_reward", "goto", "reset"]
    drone = DroneEnvironment()
    with pytest.raises(EpisodeError, match="reset"):
        drone.fly_route(["UP"])
    with pytest.raises(InvalidValueError, match="columns task and seed"):
        drone.reset(prompt=[])
    drone.reset(task="easy", seed=1)
    for wrong in ("NORTH", 0, None, ["UP"]):
        with pytest.raises(InvalidValueError, match=r"is not an action\. Directions are UP"):
            drone.fly(wrong)  # type: ignore[arg-type]
        with pytest.raises(InvalidValueError, match=r"is not an action\. Directions are UP"):
            drone.fly_route(["UP", wrong])  # type: ignore[list-item]
    for route in ([], "UP", None, {"UP": 1}, ["UP"] * 61):
        with pytest.raises(InvalidValueError, match="A route is a list of 1 to 60 directions"):
            drone.fly_route(route)  # type: ignore[arg-type]
    assert "Battery: 59 units" in drone.fly("wait")  # type: ignore[arg-type]
    with pytest.raises(UnknownNameError, match="allowed"):
        drone.reset(task="easy", seed=1, reward_profile="generous")


def test_without_the_packages_the_extras_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "datasets", None)
    with pytest.raises(MissingPackageError, match=re.escape(install_command("trl"))):
        training_maps()
    monkeypatch.setitem(sys.modules, "inspect_ai", None)
    monkeypatch.delitem(sys.modules, "drone_env.llm.inspect_task", raising=False)
    with pytest.raises(MissingPackageError, match=re.escape(install_command("inspect"))):
        import drone_env.llm.inspect_task  # noqa: F401
