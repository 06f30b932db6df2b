"""The numbers of the tasks, their names, and the splits of the seeds."""

import __future__

import itertools
import pickle
import re
import sys
from dataclasses import fields, replace
from decimal import Decimal
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from drone_env.core import tasks
from drone_env.core.cells import Cell
from drone_env.core.rewards import REWARD_PROFILES, RewardProfile, get_reward_profile
from drone_env.core.seeds import SPLITS, split_of, split_seeds
from drone_env.core.tasks import TASKS, TaskConfig, get_task, withdrawal
from drone_env.errors import DroneEnvError, InvalidTaskError, InvalidValueError, UnknownNameError, WithdrawnError

EASY = TASKS["easy_delivery"]


class TestStandardTasks:
    @pytest.mark.feature("E6")
    @pytest.mark.parametrize(
        ("name", "side", "terrain", "deliveries", "steps", "r_delivery", "r_other"),
        [
            ("easy_delivery", 10, (4, 4, 3), 1, 60, 0.95, 0.10),
            ("medium_delivery", 14, (8, 6, 6), 3, 100, 0.90, 0.15),
            ("hard_delivery", 18, (12, 10, 10), 5, 160, 0.85, 0.25),
        ],
    )
    def test_numbers(
        self,
        name: str,
        side: int,
        terrain: tuple[int, int, int],
        deliveries: int,
        steps: int,
        r_delivery: float,
        r_other: float,
    ) -> None:
        task = TASKS[name]
        assert (task.id, task.version) == (name, 1)
        assert (task.width, task.height) == (side, side)
        assert (task.buildings, task.trees, task.obstacles, task.pads) == (*terrain, 0)
        assert task.deliveries == deliveries
        assert (task.max_steps, task.battery_capacity) == (steps, steps)
        assert task.r_delivery == r_delivery
        others = (task.r_step, task.r_wait, task.r_building, task.r_tree, task.r_obstacle, task.r_battery_dead)
        assert (*others, task.r_wall, task.r_blocked) == (r_other,) * 8

    @pytest.mark.parametrize("task", [TASKS[f"{level}_delivery"] for level in ("easy", "medium", "hard")])
    def test_everything_is_passable_and_drains_one_unit(self, task: TaskConfig) -> None:
        assert (task.impassable, task.drain, task.charge_rate) == (frozenset(), (), 0)
        assert task.uniform
        assert task.telemetry_size == 5
        assert (task.street_spacing, task.efficiency_needs_all) == (0, False)

    @pytest.mark.parametrize(
        ("task", "gym_id"),
        [
            ("easy", "DroneDelivery-Easy-v1"),
            ("medium", "DroneDelivery-Medium-v1"),
            ("hard", "DroneDelivery-Hard-v1"),
            ("skyline_easy", "DroneDelivery-Skyline-Easy-v2"),
            ("skyline_medium", "DroneDelivery-Skyline-Medium-v2"),
            ("skyline_hard", "DroneDelivery-Skyline-Hard-v2"),
        ],
    )
    def test_gymnasium_ids(self, task: str, gym_id: str) -> None:
        assert get_task(task).gym_id == gym_id


class TestSkylineTasks:
    @pytest.mark.parametrize(
        ("name", "side", "counts", "deliveries", "battery", "steps", "charge"),
        [
            ("skyline_easy", 8, (18, 6, 3, 5), 3, 11, 60, 4),
            ("skyline_medium", 12, (40, 14, 8, 4), 4, 18, 100, 4),
            ("skyline_hard", 16, (80, 24, 14, 5), 5, 26, 160, 5),
        ],
    )
    def test_numbers(
        self,
        name: str,
        side: int,
        counts: tuple[int, int, int, int],
        deliveries: int,
        battery: int,
        steps: int,
        charge: int,
    ) -> None:
        task = TASKS[name]
        assert (task.id, task.short_name, task.version) == (name, name, 2)
        assert (task.width, task.height, task.street_spacing) == (side, side, 4)
        assert (task.buildings, task.trees, task.obstacles, task.pads) == counts
        assert (task.deliveries, task.battery_capacity, task.max_steps) == (deliveries, battery, steps)
        assert task.charge_rate == charge
        assert task.drain == ((Cell.BUILDING, 3), (Cell.TREE, 2))
        assert task.impassable == {Cell.OBSTACLE}
        assert task.efficiency_needs_all
        assert not task.uniform
        assert task.telemetry_size == 13
        standard = TASKS[f"{name.removeprefix('skyline_')}_delivery"]
        for event in ("delivery", "battery_dead", "wall", "blocked", "obstacle", "building", "tree", "wait", "step"):
            assert getattr(task, f"r_{event}") == getattr(standard, f"r_{event}")

    @pytest.mark.parametrize("name", ["skyline_easy", "skyline_medium", "skyline_hard"])
    def test_id_and_grader_name_the_task(self, name: str) -> None:
        assert get_task(name) is get_task(f"drone_env.graders:grade_{name}") is TASKS[name]

    def test_families(self) -> None:
        families = [task.family for task in TASKS.values()]
        assert families == ["standard"] * 3 + ["skyline"] * 3 + ["city"] * 2

    def test_the_family_is_no_rule(self) -> None:
        assert "family" not in EASY.rules()
        assert replace(EASY, family="courier").rules() == EASY.rules() != replace(EASY, trees=5).rules()

    def test_with_the_standard_tasks_these_are_all(self) -> None:
        names = ["easy", "medium", "hard"]
        skyline = [f"skyline_{name}" for name in names]
        assert list(TASKS) == [f"{name}_delivery" for name in names] + skyline + ["city_small", "city"]


class TestNames:
    @pytest.mark.parametrize("short", ["easy", "medium", "hard"])
    def test_id_short_name_and_grader_name_the_task(self, short: str) -> None:
        task = TASKS[f"{short}_delivery"]
        assert get_task(f"{short}_delivery") is task
        assert get_task(short) is task
        assert get_task(f"drone_env.graders:grade_{short}") is task
        assert get_task(task) is task

    @pytest.mark.parametrize("name", ["", "EASY", "easy ", "expert", "drone_env.graders:grade_expert"])
    def test_unknown_name_lists_the_valid_ones(self, name: str) -> None:
        with pytest.raises(UnknownNameError) as caught:
            get_task(name)
        assert isinstance(caught.value, DroneEnvError)
        assert isinstance(caught.value, LookupError)
        for known in ("easy", "medium", "hard"):
            assert known in caught.value.allowed
            assert f" {known}, " in str(caught.value)

    def test_unknown_profile_lists_the_valid_ones(self) -> None:
        with pytest.raises(UnknownNameError, match="aligned, composite, score, tiered"):
            get_reward_profile("sparse")

    @pytest.mark.parametrize("name", ["tiered", "composite", "aligned", "score"])
    def test_profiles(self, name: str) -> None:
        assert get_reward_profile(name).id == name
        assert get_reward_profile(REWARD_PROFILES[name]) is REWARD_PROFILES[name]

    def test_shaping_gamma_is_recorded(self) -> None:
        assert REWARD_PROFILES["aligned"].shaping_gamma == Decimal("0.99")
        assert [p.id for p in REWARD_PROFILES.values() if p.shaping_gamma is not None] == ["aligned"]


class TestVersions:
    def test_version_of_a_name(self) -> None:
        assert get_task("easy", 1) is EASY

    def test_unknown_version_lists_the_valid_ones(self) -> None:
        with pytest.raises(UnknownNameError, match="version of task 'easy_delivery' 2; allowed: 1"):
            get_task("easy", 2)

    def test_a_past_version_keeps_working_and_the_newest_is_the_default(self, monkeypatch: pytest.MonkeyPatch) -> None:
        newest = replace(EASY, version=2, max_steps=50)
        monkeypatch.setitem(tasks.TASKS, "easy_delivery", newest)
        monkeypatch.setattr(tasks, "PAST_TASKS", (EASY,))
        assert get_task("easy") is newest
        assert get_task("easy", 2) is newest
        assert get_task("easy", 1) is EASY
        with pytest.raises(UnknownNameError, match="3; allowed: 1, 2"):
            get_task("easy", 3)

    @pytest.mark.parametrize("name", ["skyline_easy", "skyline_medium", "skyline_hard"])
    def test_a_withdrawn_version_is_told_with_the_one_that_replaces_it(self, name: str) -> None:
        told = f"version 1 of task '{name}' is withdrawn: .*; version 2 replaces it"
        with pytest.raises(WithdrawnError, match=told) as caught:
            get_task(name, 1)
        assert isinstance(caught.value, UnknownNameError)
        assert (caught.value.given, caught.value.allowed) == (1, ["2"])
        assert re.fullmatch(told, str(pickle.loads(pickle.dumps(caught.value))))
        assert get_task(name) is get_task(name, 2) is TASKS[name]
        with pytest.raises(UnknownNameError, match="3; allowed: 2"):
            get_task(name, 3)

    @pytest.mark.parametrize(
        "said", [("easy_delivery", 1), ("skyline_easy", 2), ("skyline_easy", "1"), ([], {}), (None, None)]
    )
    def test_nothing_else_is_withdrawn(self, said: tuple[object, object]) -> None:
        assert withdrawal(*said) is None


class TestInvalidTasks:
    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"width": 1}, "width and height must be 2 to 128"),
            ({"width": 129}, "width and height must be 2 to 128"),
            ({"height": 1}, "width and height must be 2 to 128"),
            ({"height": 129}, "width and height must be 2 to 128"),
            ({"deliveries": 0}, "deliveries must be 1 to 16"),
            ({"deliveries": 17}, "deliveries must be 1 to 16"),
            ({"buildings": -1}, "must not be negative"),
            ({"trees": -1}, "must not be negative"),
            ({"obstacles": -1}, "must not be negative"),
            ({"pads": -1}, "must not be negative"),
            ({"buildings": 92}, "101 things do not fit on 100 cells"),
            ({"max_steps": 0}, "max_steps must be 1 to 32000"),
            ({"max_steps": 32_001}, "max_steps must be 1 to 32000"),
            ({"battery_capacity": 0}, "battery_capacity must be 1 to 32000"),
            ({"battery_capacity": 32_001}, "battery_capacity must be 1 to 32000"),
            ({"drain": ((Cell.DRONE, 1),)}, "drain is for kinds under the drone"),
            ({"drain": ((Cell.UNKNOWN, 1),)}, "drain is for kinds under the drone"),
            ({"drain": ((Cell.TREE, -1),)}, "drain must be 0 to 32000"),
            ({"drain": ((Cell.TREE, 32_001),)}, "drain must be 0 to 32000"),
            ({"impassable": frozenset({Cell.ROAD})}, "impassable may hold"),
            ({"impassable": frozenset({Cell.TREE, Cell.DELIVERY})}, "impassable may hold"),
            ({"impassable": frozenset({Cell.PAD})}, "impassable may hold"),
            ({"charge_rate": -1}, "charge_rate must be 0 to 32000"),
            ({"charge_rate": 32_001}, "charge_rate must be 0 to 32000"),
            ({"version": 0}, "version must be at least 1"),
        ],
    )
    def test_is_refused_and_says_why(self, changes: dict[str, Any], message: str) -> None:
        with pytest.raises(InvalidTaskError, match=f"^task 'easy_delivery': .*{message}") as caught:
            replace(EASY, **changes)
        assert isinstance(caught.value, InvalidValueError)
        assert isinstance(caught.value, ValueError)

    def test_a_number_is_checked_where_annotations_are_not_evaluated(self, monkeypatch: pytest.MonkeyPatch) -> None:
        module = ModuleType("tasks_of_texts")
        monkeypatch.setitem(sys.modules, module.__name__, module)
        source = Path(str(tasks.__file__)).read_text(encoding="utf-8")
        exec(compile(source, "tasks", "exec", flags=__future__.annotations.compiler_flag), vars(module))
        assert {field.type for field in fields(module.TaskConfig)} >= {"int", "float"}
        easy = module.TASKS["easy_delivery"]
        for changes, message in (
            ({"width": 10.0}, "width must be an integer"),
            ({"r_step": "x"}, "r_step must be a fini"),
        ):
            with pytest.raises(InvalidTaskError, match=message):
                replace(easy, **changes)

    @pytest.mark.parametrize(
        "changes",
        [
            {"width": 2, "height": 2, "buildings": 2, "trees": 0, "obstacles": 0},
            {"width": 64, "height": 64, "deliveries": 16, "max_steps": 32_000, "battery_capacity": 32_000},
            {"max_steps": 1, "battery_capacity": 1, "buildings": 91},
            {"drain": ((Cell.DELIVERED, 0), (Cell.PAD, 32_000)), "charge_rate": 32_000},
            {"impassable": frozenset({Cell.BUILDING, Cell.TREE, Cell.OBSTACLE})},
        ],
    )
    def test_the_bounds_themselves_are_allowed(self, changes: dict[str, Any]) -> None:
        assert replace(EASY, **changes) != EASY

    def test_reward_profile_with_crossed_clamp_is_refused(self) -> None:
        with pytest.raises(InvalidTaskError, match="clamp"):
            RewardProfile("odd", "", clamp=(Decimal("0.9"), Decimal("0.1")))

    @pytest.mark.parametrize("gamma", ["-0.1", "1.1"])
    def test_reward_profile_with_a_discount_outside_0_to_1_is_refused(self, gamma: str) -> None:
        with pytest.raises(InvalidTaskError, match="shaping_gamma"):
            RewardProfile("odd", "", shaping_gamma=Decimal(gamma))

    @pytest.mark.parametrize(
        ("changes", "uniform", "size"),
        [
            ({"battery_capacity": 50}, True, 6),
            ({"drain": ((Cell.TREE, 2),)}, False, 6),
            ({"drain": ((Cell.TREE, 1),)}, True, 5),
            ({"impassable": frozenset({Cell.TREE})}, False, 6),
            ({"impassable": frozenset({Cell.TREE}), "trees": 0}, True, 5),
            ({"pads": 1}, True, 13),
            ({"charge_rate": 1}, True, 5),
            ({"pads": 1, "charge_rate": 1}, False, 13),
        ],
    )
    def test_uniform_means_one_unit_per_step_and_a_free_way(
        self, changes: dict[str, Any], uniform: bool, size: int
    ) -> None:
        task = replace(EASY, **changes)
        assert (task.uniform, task.telemetry_size) == (uniform, size)


class TestSplits:
    def test_ranges(self) -> None:
        assert SPLITS == {"train": (0, 2**52), "validation": (2**52, 2**52 + 2**51), "test": (2**52 + 2**51, 2**53)}

    def test_are_disjoint_and_cover_all_seeds(self) -> None:
        spans = sorted(SPLITS.values())
        assert (spans[0].start, spans[-1].stop) == (0, 2**53)
        assert all(left.stop == right.start for left, right in itertools.pairwise(spans))

    @pytest.mark.parametrize("split", SPLITS)
    def test_split_of_a_seed(self, split: str) -> None:
        assert split_of(SPLITS[split].start) == split_of(SPLITS[split].stop - 1) == split

    def test_the_thousand_test_maps_are_the_first_of_the_split(self) -> None:
        seeds = split_seeds("test", 1000)
        assert (seeds[0], seeds[-1], len(seeds)) == (2**52 + 2**51, 2**52 + 2**51 + 999, 1000)

    def test_offset(self) -> None:
        assert list(split_seeds("validation", 3, offset=5)) == [2**52 + 5, 2**52 + 6, 2**52 + 7]

    def test_may_be_empty_or_everything(self) -> None:
        assert len(split_seeds("train", 0)) == 0
        assert split_seeds("test", 2**51) == range(2**52 + 2**51, 2**53)

    @pytest.mark.parametrize(("episodes", "offset"), [(-1, 0), (1, -1), (2**51 + 1, 0), (1, 2**51), (2**51, 1)])
    def test_asking_for_more_than_the_split_holds_is_refused(self, episodes: int, offset: int) -> None:
        with pytest.raises(InvalidValueError, match="split 'test' holds 2251799813685248 seeds"):
            split_seeds("test", episodes, offset)

    def test_unknown_split_lists_the_valid_ones(self) -> None:
        with pytest.raises(UnknownNameError, match="test, train, validation"):
            split_seeds("dev", 1)
