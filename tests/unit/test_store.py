"""The store: finished episodes and the file that holds them."""

import json
import sqlite3
import threading
import time
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

from drone_env.core.episode import Episode
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.tasks import TASKS
from drone_env.errors import (
    EpisodeError,
    InvalidValueError,
    StoreError,
    UnknownNameError,
)
from drone_env.files import data_folder
from drone_env.results.database import APPLICATION_ID, MIGRATIONS, migrate
from drone_env.results.record import EpisodeRecord, parse_record, record_of, replay
from drone_env.results.store import FILE_NAME, Store
from tests.unit.stores import flown, flying, mine, opened, unlike, view

# Finished episodes


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("profile", REWARD_PROFILES)
def test_an_episode_comes_back_as_it_was_flown(task: str, profile: str, store: Store) -> None:
    episode = flown(task, actions="01234", profile=profile)
    before = datetime.now(timezone.utc)
    stored = store.episode(store.add_episode(episode, "someone"))
    assert stored.record == record_of(episode, "someone")
    assert replay(stored.record).rewards == episode.rewards
    assert (stored.steps, stored.reward_total) == (episode.steps, episode.reward_total)
    assert stored.outcome == episode.outcome.name.lower()
    assert stored.deliveries_total == episode.task.deliveries
    assert before - timedelta(seconds=1) < stored.finished_at <= datetime.now(timezone.utc)


def test_a_record_is_stored_as_its_episode(store: Store) -> None:
    episode = flown()
    a, b = store.add_episode(episode, "ace"), store.add_episode(record_of(episode, "ace"))
    assert a != b
    assert store.episode(a).record == store.episode(b).record


def test_the_latest_come_first_of_one_task_or_of_all(store: Store) -> None:
    ids = [store.add_episode(flown(task, seed), "ace") for seed in range(3) for task in ("easy", "medium")]
    assert [stored.id for stored in store.latest(100)] == ids[::-1]
    assert [stored.id for stored in store.latest(2)] == ids[:-3:-1]
    assert [stored.id for stored in store.latest(2, "easy")] == [ids[4], ids[2]]
    assert [stored.id for stored in store.latest(9, "drone_env.graders:grade_medium")] == ids[5::-2]
    assert store.latest(0) == []
    assert store.latest(9, "hard") == []
    assert len(store.latest(2**70)) == 6


def test_all_come_oldest_first_over_several_pages(store: Store) -> None:
    episode = flown()
    ids = [store.add_episode(episode, "ace") for _ in range(230)]
    assert [stored.id for stored in store.episodes()] == ids
    iterator = store.episodes()
    first = next(iterator).id
    last = store.add_episode(episode, "ace")
    assert [first, *(stored.id for stored in iterator)] == [*ids, last]


def test_a_store_opened_again_holds_what_it_held(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        episode_id, session_id = store.add_episode(flown(), "ace"), opened(store)
        with store.session(session_id) as row:
            row.append(4)
        kept = store.episode(episode_id)
    with Store(str(tmp_path)) as store:
        assert store.episode(episode_id) == kept
        assert store.read_session(session_id).actions == (4,)


@pytest.mark.parametrize("episode_id", ["0123456789abcdef", "", "\ud800", "ä", "'; DROP TABLE episodes"])
def test_an_unknown_id_is_an_error_that_names_no_other_flight(episode_id: str, store: Store) -> None:
    store.add_episode(flown(), "ace")
    with pytest.raises(UnknownNameError) as refused:
        store.episode(episode_id)
    assert str(refused.value) == f"there is no episode {episode_id!r}"


@pytest.mark.parametrize(
    ("episode", "agent", "error", "message"),
    [
        (Episode(), "ace", EpisodeError, "has not ended"),
        (flying(), "ace", EpisodeError, "has not ended"),
        (record_of(flying(), "ace"), None, EpisodeError, "has not ended"),
        (flown(), None, InvalidValueError, "agent belongs to an Episode"),
        (record_of(flown(), "ace"), "ace", InvalidValueError, "agent belongs to an Episode"),
        (flown(), "", InvalidValueError, "one printable line"),
        (flown(), "two\nlines", InvalidValueError, "one printable line"),
        (flown(), "\ud800", InvalidValueError, "one printable line"),
        (flown(), "two\u2028lines", InvalidValueError, "one printable line"),
        (flown(), "x" * 201, InvalidValueError, "200 characters"),
        (flying(profile=mine(), steps=60), "ace", UnknownNameError, "tiered"),
        (flying(task=unlike(), steps=60), "ace", InvalidValueError, "registered"),
    ],
)
def test_what_cannot_be_flown_again_is_not_stored(
    episode: Episode | EpisodeRecord, agent: str | None, error: type[Exception], message: str, store: Store
) -> None:
    with pytest.raises(error, match=message):
        store.add_episode(episode, agent)
    assert store.latest(9) == []


def test_a_record_that_lies_is_not_stored(store: Store) -> None:
    lie = json.loads(record_of(flown(actions="4"), "ace").to_json()) | {"deliveries": 1}
    with pytest.raises(InvalidValueError, match="deliveries 1 where the flight gives 0"):
        store.add_episode(parse_record(json.dumps(lie), "it"))
    assert store.latest(9) == []


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda store: store.latest(-1), InvalidValueError),
        (lambda store: store.latest(1, "extreme"), UnknownNameError),
        (lambda store: store.analysis("extreme"), UnknownNameError),
        (lambda store: store.analysis("easy", last=0), InvalidValueError),
    ],
)
def test_questions_that_make_no_sense_are_refused(call: Any, error: type[Exception], store: Store) -> None:
    with pytest.raises(error):
        call(store)


# The file


def test_a_closed_store_says_so(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.close()
    store.close()
    for call in (lambda: store.latest(1), lambda: opened(store), lambda: store.analysis("easy")):
        with pytest.raises(StoreError, match="closed"):
            call()


def test_the_folder_is_data_or_what_the_environment_names(monkeypatch: pytest.MonkeyPatch) -> None:
    assert data_folder() == Path("data")
    monkeypatch.setenv("DRONE_ENV_DATA", "")
    assert data_folder() == Path("data")
    assert [data_folder(part) for part in ("results", "sweep")] == [Path("results"), Path("runs/sweep")]
    monkeypatch.setenv("DRONE_ENV_DATA", "/somewhere/else")
    assert data_folder() == Path("/somewhere/else")
    assert data_folder("sweep") == Path("/somewhere/else/sweep")


def test_a_file_that_is_newer_is_left_as_it_is(tmp_path: Path) -> None:
    Store(tmp_path).close()
    connection = sqlite3.connect(tmp_path / FILE_NAME)
    connection.execute("PRAGMA user_version = 99")
    connection.close()
    before = (tmp_path / FILE_NAME).read_bytes()
    with pytest.raises(StoreError, match=f"has version 99, this drone-env knows {len(MIGRATIONS)} and older"):
        Store(tmp_path)
    assert (tmp_path / FILE_NAME).read_bytes() == before


def test_a_file_of_another_program_is_left_as_it_is(tmp_path: Path) -> None:
    connection = sqlite3.connect(tmp_path / FILE_NAME)
    connection.execute("CREATE TABLE milk (litres INTEGER)")
    connection.close()
    before = (tmp_path / FILE_NAME).read_bytes()
    with pytest.raises(StoreError, match="another program"):
        Store(tmp_path)
    assert (tmp_path / FILE_NAME).read_bytes() == before


def test_a_file_that_is_no_database_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_text("buy milk\n" * 1000)
    with pytest.raises(StoreError, match="not a database"):
        Store(tmp_path)
    assert (tmp_path / FILE_NAME).read_text() == "buy milk\n" * 1000


def test_a_store_without_its_tables_is_an_error(tmp_path: Path) -> None:
    connection = sqlite3.connect(tmp_path / FILE_NAME)
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {len(MIGRATIONS)}")
    connection.close()
    with pytest.raises(StoreError, match="no such table"):
        Store(tmp_path)


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        Store(tmp_path / "file" / "data")


SCRIPTS = (
    "CREATE TABLE one (a INTEGER); INSERT INTO one VALUES (1)",
    "ALTER TABLE one ADD COLUMN b INTEGER DEFAULT 2; CREATE TABLE two (c INTEGER)",
    "INSERT INTO two SELECT a + b FROM one",
)


@pytest.mark.parametrize("version", range(len(SCRIPTS) + 1))
def test_a_file_of_any_version_is_brought_to_the_last(version: int, tmp_path: Path) -> None:
    path = tmp_path / "file"
    connection = sqlite3.connect(path, isolation_level=None)
    if version:
        migrate(connection, path, SCRIPTS[:version])
    for _ in range(2):
        migrate(connection, path, SCRIPTS)
        assert connection.execute("PRAGMA user_version").fetchone() == (3,)
        assert connection.execute("SELECT a, b FROM one").fetchall() == [(1, 2)]
        assert connection.execute("SELECT c FROM two").fetchall() == [(3,)]
    connection.close()


def test_a_migration_that_fails_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "file"
    connection = sqlite3.connect(path, isolation_level=None)
    migrate(connection, path, SCRIPTS[:1])
    before = list(connection.iterdump())
    with pytest.raises(sqlite3.OperationalError, match="nowhere"):
        migrate(connection, path, (*SCRIPTS, "CREATE TABLE four (a); INSERT INTO nowhere VALUES (1)"))
    assert list(connection.iterdump()) == before
    assert connection.execute("PRAGMA user_version").fetchone() == (1,)
    connection.close()


def test_a_store_of_the_first_version_keeps_what_is_in_it(tmp_path: Path) -> None:
    connection = sqlite3.connect(tmp_path / FILE_NAME, isolation_level=None)
    migrate(connection, tmp_path / FILE_NAME, MIGRATIONS[:1])
    now = time.time()
    values = [(name, "easy_delivery", 1, 7, "tiered", "someone", "03", None, now, now - age)
              for name, age in (("new", 0), ("idle", 900))]  # fmt: skip
    connection.executemany("INSERT INTO sessions VALUES (?,?,?,?,?,?,?,?,?,?)", values)
    connection.close()
    with Store(tmp_path) as store:
        assert store.read_session("new").actions == (0, 3)
        assert store.expire_sessions(600) == ["idle"]
        assert store.count_sessions() == 1


def test_many_may_open_a_new_folder_at_once(tmp_path: Path) -> None:
    errors: list[BaseException] = []
    start = threading.Barrier(8)

    def open_it() -> None:
        try:
            start.wait()
            with Store(tmp_path / "new") as store:
                store.add_episode(flown(), "ace")
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=open_it) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert len(view(tmp_path / "new")) == 8


def test_a_store_that_stays_busy_is_an_error(tmp_path: Path) -> None:
    with Store(tmp_path, busy_seconds=0.1) as store:
        session_id = opened(store)
        other = sqlite3.connect(tmp_path / FILE_NAME, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(StoreError, match="locked"), store.session(session_id):
            pytest.fail("the block must not be entered")
        assert store.read_session(session_id).actions == ()
        other.execute("ROLLBACK")
        other.close()
        with store.session(session_id) as row:
            row.append(4)
        assert store.read_session(session_id).actions == (4,)
