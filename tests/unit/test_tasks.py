"""The numbers of the tasks, their names, and the splits of the seeds."""

import itertools
from dataclasses import replace
from decimal import Decimal
from typing import Any

import pytest

from drone_env.core.cells import Cell
from drone_env.core.rewards import REWARD_PROFILES, get_reward_profile
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import InvalidTaskError, InvalidValueError, UnknownNameError

EASY = TASKS["easy_delivery"]
# side; buildings, trees, obstacles, pads; deliveries; battery, steps, charge; rewards of a delivery and else
NUMBERS = {
    "easy": (10, (4, 4, 3, 0), 1, (60, 60, 0), (0.95, 0.10)),
    "medium": (14, (8, 6, 6, 0), 3, (100, 100, 0), (0.90, 0.15)),
    "hard": (18, (12, 10, 10, 0), 5, (160, 160, 0), (0.85, 0.25)),
    "skyline_easy": (8, (18, 6, 3, 5), 3, (11, 60, 4), (0.95, 0.10)),
    "skyline_medium": (12, (40, 14, 8, 4), 4, (18, 100, 4), (0.90, 0.15)),
    "skyline_hard": (16, (80, 24, 14, 5), 5, (26, 160, 5), (0.85, 0.25)),
    "rush_easy": (8, (18, 6, 1, 2), 9, (9, 16, 3), (0.95, 0.10)),
    "rush_medium": (12, (40, 14, 2, 3), 9, (13, 32, 2), (0.90, 0.15)),
    "rush_hard": (16, (80, 24, 4, 3), 10, (16, 40, 2), (0.85, 0.25)),
}
EVENTS = ("battery_dead", "wall", "blocked", "obstacle", "building", "tree", "wait", "step")


@pytest.mark.feature("E6")
@pytest.mark.parametrize("name", NUMBERS)
def test_numbers(name: str) -> None:
    task = get_task(name)
    standard = task.family == "standard"
    rewards = task.r_delivery, *{getattr(task, f"r_{event}") for event in EVENTS}
    counts = (task.buildings, task.trees, task.obstacles, task.pads)
    units = (task.battery_capacity, task.max_steps, task.charge_rate)
    assert (task.width, counts, task.deliveries, units, rewards) == NUMBERS[name]
    assert task.height == task.width
    assert (task.id, task.version) == (f"{name}_delivery" if standard else name, 1 + (task.family == "skyline"))
    assert task.gym_id == f"DroneDelivery-{name.replace('_', '-').title()}-v{task.version}"
    assert get_task(task.id) is get_task(f"drone_env.graders:grade_{name}") is get_task(task) is task
    rules = (task.drain, task.impassable, task.street_spacing, task.efficiency_needs_all, task.telemetry_size)
    if standard:
        assert rules == ((), frozenset(), 0, False, 5)
    else:
        assert rules == (((Cell.BUILDING, 3), (Cell.TREE, 2)), {Cell.OBSTACLE}, 4, True, 13)
    assert task.uniform == standard


def test_families() -> None:
    assert [task.short_name for task in TASKS.values()] == [*NUMBERS, "city_small", "city"]
    families = ["standard"] * 3 + ["skyline"] * 3 + ["rush"] * 3 + ["city"] * 2
    assert [task.family for task in TASKS.values()] == families
    assert replace(EASY, family="courier").rules() == EASY.rules() != replace(EASY, trees=5).rules()
    assert "family" not in EASY.rules()


class TestNames:
    @pytest.mark.parametrize("task", ["easy", EASY])
    def test_another_version_is_unknown(self, task: Any) -> None:
        assert get_task(task, 1) is EASY
        with pytest.raises(LookupError, match="version of task 'easy_delivery' 2; allowed: 1"):
            get_task(task, 2)

    def test_profiles(self) -> None:
        assert list(REWARD_PROFILES) == ["tiered", "composite", "aligned", "score"]
        for name, profile in REWARD_PROFILES.items():
            assert get_reward_profile(name) is get_reward_profile(profile) is profile
            assert profile.shaping_gamma == (Decimal("0.99") if name == "aligned" else None)
        with pytest.raises(UnknownNameError, match="aligned, composite, score, tiered"):
            get_reward_profile("sparse")


class TestInvalidTasks:
    @pytest.mark.parametrize(
        ("names", "low", "high"),
        [
            ("width height", 2, 128),
            ("max_steps battery_capacity", 1, 32_000),
            ("buildings trees obstacles pads", 0, None),
        ],
    )
    def test_a_number_out_of_its_range_is_refused(self, names: str, low: int, high: int | None) -> None:
        allowed = f"at least {low}" if high is None else f"{low} to {high}"
        for name, value in itertools.product(names.split(), [low - 1, *([] if high is None else [high + 1])]):
            with pytest.raises(InvalidTaskError, match=f"^task 'easy_delivery': {name} must be {allowed}, got {value}"):
                replace(EASY, **{name: value})

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"buildings": 92}, "101 things do not fit on 100 cells"),
            ({"drain": ((Cell.DRONE, 1),)}, "drain is for kinds under the drone"),
            ({"drain": ((Cell.TREE, 32_001),)}, "drain must be 0 to 32000"),
            ({"impassable": frozenset({Cell.TREE, Cell.DELIVERY})}, "impassable may hold"),
            ({"street_spacing": 32, "width": 64, "height": 64}, "street_spacing must be 0, or 2 to 16 and divide"),
            ({"width": 10.0}, "width must be an integer"),
            ({"r_step": "x"}, "r_step must be a finite number"),
        ],
    )
    def test_is_refused_and_says_why(self, changes: dict[str, Any], message: str) -> None:
        with pytest.raises(InvalidTaskError, match=f"^task 'easy_delivery': .*{message}") as caught:
            replace(EASY, **changes)
        assert isinstance(caught.value, ValueError)

    @pytest.mark.parametrize(
        ("changes", "uniform", "size"),
        [
            ({"battery_capacity": 50}, True, 6),
            ({"impassable": frozenset({Cell.TREE})}, False, 6),
            ({"pads": 1, "charge_rate": 1}, False, 13),
        ],
    )
    def test_uniform_means_one_unit_per_step_and_a_free_way(
        self, changes: dict[str, Any], uniform: bool, size: int
    ) -> None:
        task = replace(EASY, **changes)
        assert (task.uniform, task.telemetry_size) == (uniform, size)


class TestSplits:
    def test_offset(self) -> None:
        assert split_seeds("validation", 3, offset=5) == range(2**52 + 5, 2**52 + 8)
        assert split_seeds("test", 2**51) == range(2**52 + 2**51, 2**53)

    @pytest.mark.parametrize(("episodes", "offset"), [(-1, 0), (1, -1), (2**51, 1)])
    def test_asking_for_more_than_the_split_holds_is_refused(self, episodes: int, offset: int) -> None:
        with pytest.raises(InvalidValueError, match="split 'test' has 2251799813685248 seeds"):
            split_seeds("test", episodes, offset)
