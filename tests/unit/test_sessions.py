"""Sessions, rows of the store."""

import stat
from pathlib import Path
from typing import cast

import pytest

from drone_env.core.episode import Episode
from drone_env.errors import CapacityError, InvalidValueError, NoSessionError, StoreError
from drone_env.results.sessions import Session, advance
from drone_env.results.store import FILE_NAME, Store
from tests.unit.stores import finish_in, flown, latest, opened


def test_nothing_is_kept_of_a_block_that_fails(store: Store) -> None:
    session_id = opened(store)

    def finish_and_fly(row: Session, action: object) -> None:
        finish_in(row, flown(actions="4"))
        row.begin(Episode("easy", "tiered", 8))
        advance(row, cast(int, action))

    for action in (5, True, "UP", None):
        with pytest.raises(InvalidValueError, match="0 UP"), store.session(session_id) as row:
            finish_and_fly(row, action)
    with pytest.raises(InvalidValueError, match="one printable line"), store.session(session_id) as row:
        row.begin(Episode("medium", "tiered", 8), "two\nlines")
    assert (store.read_session(session_id).actions, latest(store, 1)) == ((), [])
    with pytest.raises(InvalidValueError, match="one printable line"):
        store.open_session(Episode("easy", "tiered", 7), "\ud800", 9)


def test_a_full_disk_keeps_nothing_and_says_so(store: Store) -> None:
    session_id = opened(store)
    with store.session(session_id) as row:
        advance(row, 1)
    with store._database.writing() as connection:
        pages = connection.execute("PRAGMA page_count").fetchone()[0]
        connection.execute(f"PRAGMA max_page_count = {pages}")
    stored: list[str] = []
    with pytest.raises(StoreError, match="full"):
        stored.extend(store.add_episode(flown("hard", actions="4"), "ace") for _ in range(100))
    with pytest.raises(StoreError, match="full"), store.session(session_id) as row:
        finish_in(row, flown("hard", actions="4"))
    assert store.read_session(session_id).actions == (1,)
    assert [row.id for row in store.episodes()] == stored


def test_ids_are_long_random_and_kept_from_others(store: Store) -> None:
    ids = {opened(store) for _ in range(50)}
    assert len(ids) == 50
    assert all(len(session_id) >= 32 for session_id in ids)
    assert stat.S_IMODE((store.folder / FILE_NAME).stat().st_mode) == 0o600
    assert not any(session_id in (store.folder / "memory.json").read_text() for session_id in ids)


def test_of_the_finished_the_one_that_was_not_used_for_longest_gives_way(tmp_path: Path) -> None:
    now = 1_000_000.0
    with Store(tmp_path, lambda: now) as store:
        ids = [opened(store, capacity=3, steps=1) for _ in range(3)]
        for session_id in (ids[1], ids[0]):
            now += 10
            with store.session(session_id) as row:
                finish_in(row, flown(actions="4"))
        now += 19.9
        with pytest.raises(CapacityError, match="all 3 sessions are taken"):
            opened(store, capacity=3)
        now += 60
        opened(store, capacity=3)
        assert store.count_sessions() == 3
        with pytest.raises(NoSessionError):
            store.read_session(ids[1])
        assert [store.read_session(id_).id for id_ in (ids[0], ids[2])] == [ids[0], ids[2]]


def test_a_session_without_steps_gives_way_first_and_an_address_keeps_to_its_share(tmp_path: Path) -> None:
    now = 1_000_000.0

    def opened_by(owner: str, steps: int = 0) -> str:
        nonlocal now
        now += 1
        return opened(store, capacity=8, owner=owner, steps=steps)

    with Store(tmp_path, lambda: now) as store:
        held = {owner: [opened_by(owner) for _ in range(20)] for owner in ("greedy", "second")}
        # The greedy one has half of the places, the second half of the rest; each evicts only its own.
        left = {owner: [id_ for id_ in ids if _is_open(store, id_)] for owner, ids in held.items()}
        assert left == {"greedy": held["greedy"][-4:], "second": held["second"][-2:]}
        flying = [opened_by("greedy", steps=1) for _ in range(4)]
        with pytest.raises(CapacityError, match="4 of 8 sessions, its share"):
            opened_by("greedy")
        newcomers = [opened_by(name, steps=1) for name in ("a", "b")]
        # Now all places are taken: a newcomer gets that of a session without steps.
        assert store.count_sessions() == 8
        newcomers += [opened_by(name, steps=1) for name in ("c", "d")]
        assert not any(_is_open(store, id_) for id_ in held["second"])
        assert all(_is_open(store, id_) for id_ in (*flying, *newcomers))
        with pytest.raises(CapacityError, match="all 8 sessions are taken"):
            opened_by("e")


def _is_open(store: Store, session_id: str) -> bool:
    try:
        return store.read_session(session_id).id == session_id
    except NoSessionError:
        return False


@pytest.mark.parametrize("session_id", ["", "nobody", "\ud800", "' OR 1=1"])
def test_a_session_that_never_was(session_id: str, store: Store) -> None:
    opened(store)
    for call in (store.read_session, store.end_session):
        with pytest.raises(NoSessionError):
            call(session_id)


def test_idle_and_ended_sessions_are_gone_for_every_store(tmp_path: Path) -> None:
    now = 1_000_000.0
    with Store(tmp_path, lambda: now) as store, Store(tmp_path, lambda: now) as other:
        idle, used, ended = (opened(store) for _ in range(3))
        store.end_session(ended)
        now += 59
        assert store.expire_sessions(60) == 0
        with store.session(used):
            pass
        now += 1
        assert other.expire_sessions(60) == 1
        for call in (store.read_session, store.end_session, other.read_session):
            for session_id in (idle, ended):
                with pytest.raises(NoSessionError):
                    call(session_id)
        assert other.read_session(used).id == used


def test_a_block_inside_a_block_is_an_error_and_no_deadlock(store: Store) -> None:
    session_id = opened(store)
    with store.session(session_id) as row:
        advance(row, 4)
        with pytest.raises(StoreError, match="within a transaction"), store.session(session_id):
            pytest.fail("the block must not be entered")
        with pytest.raises(StoreError, match="within a transaction"):
            opened(store)
        assert store.read_session(session_id).actions == ()
    assert store.read_session(session_id).actions == (4,)
