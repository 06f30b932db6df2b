"""The adapters to Inspect and TRL as far as they go without those packages; with them: `tests/adapters`."""

import inspect
import re
import sys

import pytest

from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile, profile_for_discount
from drone_env.errors import EpisodeError, InvalidValueError, MissingPackageError, UnknownNameError, install_command
from drone_env.llm.trl_environment import DroneEnvironment, training_maps
from drone_env.planning.optimal import solve


def test_a_flight_by_tool_calls() -> None:
    # Map 14 of easy by hand, as in the tests of `fly`.
    drone = DroneEnvironment("score")
    told = drone.reset(prompt=[], task="easy", seed=14)
    episode = Episode("easy", seed=14)
    x, y = episode.position
    assert f"Position: ({x}, {y})" in told
    assert drone.fly("LEFT") == (
        f"On the way. Position: ({x - 1}, {y}). Battery: 59 units. Nearest parcel: {episode.target}. Delivered: 0 of 1."
    )
    assert drone.get_reward() == 0.01  # as if it waited to the end
    drone.fly("UP")
    assert drone.fly("UP") == "Delivered: 1 of 1. Mission accomplished."
    assert drone.get_reward() == 0.99
    assert drone.fly("DOWN").startswith("Nothing done: the episode has ended")
    assert drone.get_reward() == 0.99


def test_where_there_are_pads_each_answer_tells_what_lies_below() -> None:
    drone = DroneEnvironment()
    assert drone.reset(task="skyline_easy", seed=0).endswith("\nBelow the drone: road")
    assert " Below the drone: " in drone.fly("WAIT")


@pytest.mark.parametrize("profile", ["tiered", "aligned"])
def test_the_reward_is_what_the_profile_pays_to_the_end(profile: str) -> None:
    drone = DroneEnvironment(profile)
    drone.reset(task="hard", seed=3)
    actions = solve("hard", 3).actions[:5]
    for action in actions:
        drone.fly(action.name)
    episode = Episode("hard", profile_for_discount(get_reward_profile(profile), 1), 3).fly(actions)
    assert drone.get_reward() == episode.waited_out().reward_total


def test_the_only_tool_is_fly_and_bad_calls_are_told() -> None:
    methods = [name for name, _ in inspect.getmembers(DroneEnvironment, inspect.isfunction) if name[0] != "_"]
    assert methods == ["fly", "get_reward", "reset"]
    drone = DroneEnvironment()
    with pytest.raises(EpisodeError, match="reset"):
        drone.get_reward()
    with pytest.raises(InvalidValueError, match="columns task and seed"):
        drone.reset(prompt=[])
    drone.reset(task="easy", seed=1)
    for wrong in ("NORTH", "up", None, ["UP"]):
        with pytest.raises(InvalidValueError, match=r"is no direction\. Directions are UP"):
            drone.fly(wrong)  # type: ignore[arg-type]
    with pytest.raises(UnknownNameError, match="allowed"):
        DroneEnvironment("generous")


def test_without_the_packages_the_extras_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "datasets", None)
    with pytest.raises(MissingPackageError, match=re.escape(install_command("trl"))):
        training_maps()
    monkeypatch.setitem(sys.modules, "inspect_ai", None)
    monkeypatch.delitem(sys.modules, "drone_env.llm.inspect_task", raising=False)
    with pytest.raises(MissingPackageError, match=re.escape(install_command("inspect"))):
        import drone_env.llm.inspect_task  # noqa: F401
