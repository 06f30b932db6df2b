"""The store: finished episodes and the file that holds them."""

import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta, timezone
from decimal import Decimal
from pathlib import Path

import pytest

from drone_env.core.episode import Episode
from drone_env.core.rewards import REWARD_PROFILES, RewardProfile
from drone_env.core.tasks import TASKS
from drone_env.errors import (
    EpisodeError,
    InvalidValueError,
    StoreError,
    UnknownNameError,
)
from drone_env.files import data_folder
from drone_env.flights.record import record_of
from drone_env.flights.store import FILE_NAME, Store
from tests.unit.stores import actions, flown, latest, opened, sessions_of, view

# Finished episodes


@pytest.mark.parametrize("task", TASKS)
def test_an_episode_comes_back_as_it_was_flown(task: str, store: Store) -> None:
    episode = flown(task, actions="01234", profile="composite")
    before = datetime.now(timezone.utc)
    stored = store.episode(store.add_episode(episode, "someone"))
    assert stored.record == record_of(episode, "someone")
    assert (stored.steps, stored.reward_total) == (episode.steps, episode.reward_total)
    assert stored.outcome == episode.outcome.name.lower()
    assert stored.deliveries_total == episode.task.deliveries
    assert before - timedelta(seconds=1) < stored.finished_at <= datetime.now(timezone.utc)


def test_the_latest_come_first_of_one_task_or_of_all(store: Store) -> None:
    ids = [store.add_episode(flown(task, seed), "ace") for seed in range(3) for task in ("easy", "medium")]
    assert [row.id for row in store.listed(100)] == ids[::-1]
    assert [row.id for row in store.listed(2)] == ids[:-3:-1]
    assert [row.id for row in store.listed(2, "easy")] == [ids[4], ids[2]]
    assert store.listed(9, "hard") == store.listed(0) == []


def test_an_unknown_id_is_an_error_that_names_no_other_flight(store: Store) -> None:
    episode_id = "0123456789abcdef"
    store.add_episode(flown(), "ace")
    with pytest.raises(UnknownNameError) as refused:
        store.episode(episode_id)
    assert str(refused.value) == f"there is no episode {episode_id!r}"


@pytest.mark.parametrize(
    ("episode", "agent", "error", "message"),
    [
        (Episode("easy", "tiered", 7), "ace", EpisodeError, "has not ended"),
        (flown(), "two\u2028lines", InvalidValueError, "one printable line"),
    ],
)
def test_an_unfinished_or_nameless_flight_is_not_stored(
    episode: Episode, agent: str, error: type[Exception], message: str, store: Store
) -> None:
    with pytest.raises(error, match=message):
        store.add_episode(episode, agent)
    assert latest(store, 9) == []


# The file


def test_a_closed_store_says_so(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.close()
    store.close()
    with pytest.raises(StoreError, match="closed"):
        latest(store, 1)


def test_the_folder_is_data_or_what_the_environment_names(monkeypatch: pytest.MonkeyPatch) -> None:
    assert data_folder() == Path("data")
    monkeypatch.setenv("DRONE_ENV_DATA", "")
    assert data_folder() == Path("data")
    assert [data_folder(part) for part in ("", "results")] == [Path("data"), Path("results")]
    monkeypatch.setenv("DRONE_ENV_DATA", "/somewhere/else")
    assert data_folder() == Path("/somewhere/else")
    assert data_folder("results") == Path("/somewhere/else/results")


@pytest.mark.parametrize(
    ("sql", "message"),
    [
        ("PRAGMA user_version = 99", "has version 99, this drone-env reads version 1: use another data folder"),
        (None, "not a database"),
    ],
)
def test_a_file_that_is_no_store_of_this_version_is_left_as_it_is(
    sql: str | None, message: str, tmp_path: Path
) -> None:
    Store(tmp_path).close()
    file = tmp_path / FILE_NAME
    if sql is None:
        file.write_text("buy milk\n" * 1000)
    else:
        connection = sqlite3.connect(file)
        connection.execute(sql)
        connection.close()
    before = file.read_bytes()
    with pytest.raises(StoreError, match=message):
        Store(tmp_path)
    assert file.read_bytes() == before


def test_many_may_open_a_new_folder_at_once(tmp_path: Path) -> None:
    start = threading.Barrier(8)

    def open_it(_: int) -> None:
        start.wait()
        with Store(tmp_path / "new") as store:
            store.add_episode(flown(), "ace")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(open_it, range(8)))
    assert len(view(tmp_path / "new")) == 8


def test_a_store_that_stays_busy_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []
    monkeypatch.setattr("drone_env.flights.database.sleep", waited.append)
    monkeypatch.setattr("drone_env.flights.database.BUSY_SECONDS", 0.1)
    with Store(tmp_path) as store:
        sessions = sessions_of(store)
        session_id = opened(sessions)
        other = sqlite3.connect(tmp_path / FILE_NAME, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        # Those behind the first in the queue have waited, too.
        for waits in (True, False):
            waited.clear()
            with pytest.raises(StoreError, match="locked"):
                sessions.use(session_id, lambda session: session.fly(4))
            assert bool(waited) == waits
        with pytest.raises(StoreError, match="last write failed"):
            store.check()
        assert actions(sessions.read(session_id)) == []
        other.execute("ROLLBACK")
        other.close()
        sessions.expire()
        store.check()
        sessions.use(session_id, lambda session: session.fly(4))
        assert actions(sessions.read(session_id)) == [4]


def test_a_profile_that_changed_is_an_error_and_the_flight_is_left_out(
    store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(REWARD_PROFILES, "mine", RewardProfile("mine", "", shaping=Decimal("0.5")))
    episode_id = store.add_episode(flown(profile="mine"), "ace")
    monkeypatch.setitem(REWARD_PROFILES, "mine", RewardProfile("mine", "", shaping=Decimal("0.25")))
    with pytest.raises(InvalidValueError, match="reward profile 'mine' has changed since this flight"):
        store.episode(episode_id)
    monkeypatch.delitem(REWARD_PROFILES, "mine")
    with pytest.raises(UnknownNameError, match="mine"):
        store.episode(episode_id)
    kept = store.add_episode(flown(), "ace")
    assert [stored.id for stored in store.episodes()] == [kept]
    assert f"flight {episode_id} is left out: " in caplog.text
    assert len(store.listed(9)) == 2
