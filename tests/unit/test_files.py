"""Files that are written whole or not at all, and read only if they are files, and small."""

import tracemalloc
from collections.abc import Callable
from itertools import count
from pathlib import Path
from unittest.mock import Mock

import pytest

from drone_env.agents.pathqnet import load_network
from drone_env.agents.ppo import load_actor
from drone_env.agents.tour_network import load_tour_network
from drone_env.city.city_file import read_city
from drone_env.city.openstreetmap import import_city
from drone_env.errors import DroneEnvError, InvalidValueError
from drone_env.files import append_line, is_begun, locked, write_text
from drone_env.flights.record import load_record, read_records
from drone_env.llm.prompt import read_prompt
from drone_env.llm.run_folder import load_config
from drone_env.llm.transcript import read_calls
from drone_env.results.folder import stored_results
from drone_env.reward_file import load_reward_profile
from drone_env.rl.run import load_checkpoint
from tests.tools import limited

READERS: dict[str, Callable[[Path], object]] = {
    "city.toml": read_city,
    "reward.toml": load_reward_profile,
    "prompt.toml": read_prompt,
    "town.osm": import_city,
    "easy.safetensors": load_network,
    "tournet.safetensors": load_tour_network,
    "ppo_easy.safetensors": load_actor,
    "easy.pth": load_checkpoint,
    "flight.json": load_record,
    "flights of records.jsonl": lambda path: list(read_records(path)),
    "calls.jsonl": lambda path: list(read_calls(path)),
    "run.json": lambda path: load_config(path.parent),
    "evaluation.json": lambda path: stored_results(path.parent),
}
"""Readers of files that somebody else may have written, by the name of the file."""
DAMAGE = {
    "nested": b"[" * 200_000 + b"\n",
    "bytes": bytes(range(255, 127, -1)) * 100 + b"\n",
}


def refused(name: str, path: Path) -> str:
    """The error message of a file that is refused."""
    tracemalloc.start()
    try:
        with pytest.raises((DroneEnvError, OSError)) as raised:
            READERS[name](path)
        assert tracemalloc.get_traced_memory()[1] < 40_000_000
    finally:
        tracemalloc.stop()
    said = str(raised.value)
    assert path.name in said
    assert len(said.splitlines()) == 1
    assert len(said) < 500 + len(str(path))
    return said


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("name", READERS)
def test_what_is_damaged_is_refused_by_name(name: str, damage: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(DAMAGE[damage])
    refused(name, path)


@pytest.mark.parametrize("name", READERS)
def test_what_is_too_large_is_not_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(1 << 33)
    refused(name, path)


def test_a_full_disk_is_reported_with_the_file(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    with limited(resource.RLIMIT_FSIZE, 10), pytest.raises(OSError, match="text"):
        write_text(tmp_path / "text", "x" * 20)
    assert list(tmp_path.iterdir()) == []


def test_a_line_that_finds_no_room_is_taken_back(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    with (tmp_path / "lines").open("ab", buffering=0) as file:
        append_line(file, "first")
        with limited(resource.RLIMIT_FSIZE, 10), pytest.raises(OSError, match="could not be written whole"):
            append_line(file, "second")
        append_line(file, "third")
    assert (tmp_path / "lines").read_text() == "first\nthird\n"


@pytest.mark.parametrize("look", [0, 1])
def test_a_folder_in_which_another_process_begins_meanwhile_has_no_other_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, look: int
) -> None:
    exists, looks = Path.exists, count()

    def begins(path: Path) -> bool:
        there = exists(path)
        if next(looks) == look:
            (tmp_path / "run.json").touch()
        return there

    monkeypatch.setattr(Path, "exists", begins)
    is_begun(tmp_path, "run.json", "a run")


@pytest.mark.parametrize("error", [None, FileExistsError])
def test_a_lock_whose_folder_another_process_has_just_removed_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[OSError] | None
) -> None:
    monkeypatch.setattr(Path, "mkdir", Mock(side_effect=error))
    with pytest.raises(InvalidValueError, match="taken"), locked(tmp_path / "gone" / "lock", "taken"):
        pass
