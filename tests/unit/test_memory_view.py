"""memory.json, the view of the last episodes."""

import logging
import threading
from pathlib import Path

import pytest

from drone_env.flights.memory_view import MemoryView
from drone_env.flights.provenance import Provenance
from drone_env.flights.store import Store, StoredEpisode
from tests.tools import eventually
from tests.unit.stores import flown, latest, view


@pytest.mark.feature("L6")
def test_the_view_holds_the_last_hundred_of_all_stores_on_the_folder(tmp_path: Path) -> None:
    episode = flown()
    with Store(tmp_path) as first, Store(tmp_path) as second:
        for number in range(130):
            (first, second)[number % 2].add_episode(episode, f"ace {number}")
        expected = latest(first, 100)[::-1]
        eventually(lambda: (tmp_path / "memory.json").exists() and view(tmp_path) == expected)
    assert [stored.record.agent for stored in expected] == [f"ace {number}" for number in range(30, 130)]


def test_an_older_view_that_overwrites_a_newer_one_is_put_right(tmp_path: Path) -> None:
    path = tmp_path / "memory.json"
    stored = [StoredEpisode.of(f"{number:016x}", number, flown(), Provenance(pilot="ace")) for number in range(3)]
    texts = [(number, one.model_dump_json()) for number, one in enumerate(stored, 1)]
    rows = texts[:1]
    overtaken = threading.Event()

    def newer(after: int) -> list[tuple[int, str]]:
        found = rows[after:]
        if len(rows) == 2 and not overtaken.is_set():
            # Another process stores one more, and writes its view, before this one writes what it has just read.
            overtaken.set()
            rows.append(texts[2])
            MemoryView(path, lambda after: rows[after:]).close()
            assert view(tmp_path) == stored
        return found

    memory_view = MemoryView(path, newer)
    eventually(lambda: path.exists() and view(tmp_path) == stored[:1])
    rows.append(texts[1])
    memory_view.refresh()
    memory_view.close()
    assert overtaken.is_set()
    assert view(tmp_path) == stored


def test_a_view_that_was_lost_or_spoilt_is_made_anew(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        store.add_episode(flown(), "ace")
    whole = view(tmp_path)
    for spoil in (Path.unlink, lambda path: path.write_text("{")):
        spoil(tmp_path / "memory.json")
        Store(tmp_path).close()
        assert view(tmp_path) == whole


def test_an_episode_counts_as_stored_even_where_the_view_cannot_be_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "memory.json").mkdir()
    with caplog.at_level(logging.WARNING), Store(tmp_path) as store:
        episode_id = store.add_episode(flown(), "ace")
        assert store.episode(episode_id).id == episode_id
    assert "memory.json could not be written" in caplog.text
    assert list(tmp_path.glob("memory*")) == [tmp_path / "memory.json"]
