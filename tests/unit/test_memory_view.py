"""memory.json, the view of the last episodes."""

import logging
import threading
from pathlib import Path

import pytest

from drone_env.files import write_text
from drone_env.flights.store import Store
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


def test_an_older_view_that_overwrites_a_newer_one_is_put_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    overtaken = threading.Event()

    def write_late(path: Path, text: str) -> None:
        if not overtaken.is_set():
            # Another process stores one more, and writes its view, before this one writes what it has just read.
            overtaken.set()
            with Store(tmp_path) as other:
                other.add_episode(flown(), "late")
            assert len(view(tmp_path)) == 1
        write_text(path, text)

    monkeypatch.setattr("drone_env.flights.store.write_text", write_late)
    with Store(tmp_path):
        eventually(overtaken.is_set)
    assert [stored.record.agent for stored in view(tmp_path)] == ["late"]


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
