"""A city's file as a task, in every command."""

import json
import os
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from pydantic import ValidationError

from drone_env.city.city_file import City, city_task, task_of, write_city
from drone_env.cli import main
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.envs.registry import PLUGINS, load_plugins, register_city
from drone_env.errors import InvalidValueError, StoreError
from drone_env.flights.store import Store
from drone_env.llm.config import RunConfig
from drone_env.rl.config import TourConfig, TrainConfig
from tests.llm.stored_run import run_config
from tests.unit.stores import sessions_of

GRID = np.array([[0, 0, 1, 0], [0, 2, 3, 0], [0, 0, 0, 8], [0, 0, 0, 0]], np.uint8)


@pytest.fixture
def yard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a city."""
    monkeypatch.setenv(PLUGINS, "")
    write_city(City(GRID, numbers={"deliveries": 3}), tmp_path / "yard.toml")
    return tmp_path / "yard.toml"


def test_a_city_is_a_task_of_its_counts_and_numbers(yard: Path) -> None:
    task = city_task(yard)
    assert (task.id, task.gym_id, task.width, task.height) == ("yard", "DroneDelivery-Yard-v1", 4, 4)
    assert (task.buildings, task.trees, task.obstacles, task.pads, task.deliveries) == (1, 1, 1, 1, 3)
    assert (task.max_steps, task.battery_capacity, task.charge_rate) == (40, 12, 5)
    roads = np.zeros((4, 4), np.uint8)
    assert (task_of(City(roads), "a").battery_capacity, task_of(City(roads), "a").charge_rate) == (40, 0)
    assert task_of(City(roads, numbers={"max_steps": 9}), "a").battery_capacity == 9
    assert task_of(City(roads, numbers={"pads": 2}), "a").pads == 2
    wide = task_of(City(np.zeros((8, 30), np.uint8), numbers={"width": 10, "height": 6}), "a")
    assert (wide.width, wide.height, wide.pads, wide.max_steps, wide.battery_capacity) == (10, 6, 4, 80, 24)
    fixed = task_of(City(roads, start=(1, 1), parcels=((0, 0), (3, 3))), "a")
    assert (fixed.deliveries, fixed.terrain and fixed.terrain.start) == (2, (1, 1))


def test_commands_take_the_file_in_place_of_a_task(yard: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", "--task", str(yard), "--seed", "3"]) == 0
    best = capsys.readouterr().out
    assert "with 3 of 3 delivered" in best
    assert main(["solve", f"--task={yard}", "--seed", "3"]) == 0
    assert capsys.readouterr().out == best
    assert main(["fly", "--task", str(yard.with_name("none.toml"))]) == 2
    assert f"{yard.with_name('none.toml')}: No such file or directory" in capsys.readouterr().err
    # Other options name files of their own.
    other = yard.with_name("other.toml")
    other.write_bytes(yard.read_bytes())
    assert main(["audit", "--task", "easy", "--reward", str(other), "--maps", "1"]) == 2
    assert "reward profile" in capsys.readouterr().err
    assert "other" not in TASKS


def test_plugins_and_started_processes_know_cities(yard: Path) -> None:
    assert [module.__name__ for module in load_plugins(["json", str(yard)])] == ["json"]
    with pytest.raises(InvalidValueError, match=r"modules and files that end in .toml: "):
        load_plugins(["./towns"])
    env = gymnasium.make("DroneDelivery-Yard-v1")
    assert env.reset(seed=3)[0]["grid"].shape == (4, 4)
    register_city(yard)
    register_city(yard)
    assert os.environ[PLUGINS] == str(yard)


def test_a_record_is_of_one_city_alone(yard: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = yard.with_name("flight.json")
    assert main(["fly", "--task", str(yard), "--agent", "optimal", "--seed", "3", "--record", str(file)]) == 0
    assert main(["replay", str(file)]) == 0
    kept = json.loads(file.read_text())
    assert kept["terrain"] == TASKS["yard"].terrain.digest()[:16]  # type: ignore[union-attr]
    del TASKS["yard"]
    write_city(City(np.roll(GRID, 1, axis=0), numbers={"deliveries": 3}), yard)
    register_city(yard)
    capsys.readouterr()
    assert main(["replay", str(file)]) == 2
    told = capsys.readouterr()
    assert "the record is of another city 'yard'" in told.err
    assert told.out == ""


def test_what_goes_on_goes_on_with_the_same_task_alone(yard: Path) -> None:
    register_city(yard)
    configs = [TrainConfig(task="yard"), TourConfig(task="yard")]
    before, run = [config.identity() for config in configs], run_config("minimal", "yard", range(2))
    with Store(yard.parent) as store:
        session = sessions_of(store).open(Episode("yard", "tiered", 7), "someone")
    Store(yard.parent).close()
    del TASKS["yard"]
    write_city(City(GRID, numbers={"deliveries": 3, "max_steps": 39}), yard)
    register_city(yard)
    for config, identity in zip(configs, before, strict=True):
        assert [name for name, value in config.identity().items() if value != identity[name]] == ["rules of yard"]
    with pytest.raises(ValidationError, match="the task 'yard' has changed since the run"):
        RunConfig.model_validate(dict(run))
    with pytest.raises(StoreError, match="has flights of another task 'yard'"):
        Store(yard.parent)
    del TASKS["yard"]
    with Store(yard.parent) as store:
        register_city(yard)
        with pytest.raises(StoreError, match="another task"):
            sessions_of(store).use(session, lambda row: row.begin(Episode("yard", "tiered", 8)))
        with pytest.raises(StoreError, match="another task"):
            store.add_episode(Episode("yard", seed=7).fly([0] * 39), "someone")
