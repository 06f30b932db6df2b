"""Sessions: flights that go on, in memory and as rows of the store."""

import sqlite3
import stat
import time
from contextlib import closing

import pytest

from drone_env.core.episode import Episode
from drone_env.errors import CapacityError, InvalidValueError, NoSessionError, StoreError
from drone_env.flights.provenance import Provenance
from drone_env.flights.sessions import Session, Sessions
from drone_env.flights.store import FILE_NAME, Store
from tests.unit.stores import actions, failing, flown, latest, open_sessions, opened, rows, sessions_of


def test_a_step_is_flown_in_place_and_appended(store: Store) -> None:
    sessions = sessions_of(store)
    session_id = opened(sessions)
    seen: list[Episode] = []

    def fly(session: Session) -> float:
        seen.append(session.episode)
        return session.fly(1)

    for _ in range(3):
        sessions.use(session_id, fly)
    assert seen[0] is seen[1] is seen[2]
    (flight,) = rows(store.folder).values()
    assert flight == ("someone", "111", None)
    read = sessions.read(session_id)
    sessions.use(session_id, fly)
    assert actions(read) == [1] * 3, "a reader has a copy"
    # Looking at a session does not disturb who flies it.
    assert [sessions_of(store).use(session_id, lambda session: session.revision) for _ in range(2)] == [4, 4]


def test_two_processes_fly_one_session_in_turns(store: Store) -> None:
    one, two = sessions_of(store), sessions_of(store)
    session_id = opened(one, "hard")
    for number in range(12):
        (one, two)[number % 2].use(session_id, lambda session, action=number % 5: session.fly(action))
    assert actions(one.read(session_id)) == actions(two.read(session_id)) == [n % 5 for n in range(12)]
    # Begun anew on the same map, and flown as far, but otherwise.
    two.use(session_id, lambda session: session.begin(Episode("hard", "tiered", 7)))
    two.use(session_id, lambda session: [session.fly(4) for _ in range(12)])
    one.use(session_id, lambda session: session.fly(0))
    assert actions(two.read(session_id)) == [4] * 12 + [0]
    two.use(session_id, lambda session: session.undo())
    assert one.read(session_id).provenance.undo_used
    two.end(session_id)
    for call in (one.read, one.end, lambda id_: one.use(id_, lambda session: session.fly(0))):
        with pytest.raises(NoSessionError):
            call(session_id)
    assert rows(store.folder) == {}


@pytest.mark.parametrize("action", [5, True, "UP", None])
def test_nothing_is_kept_of_a_change_that_fails(action: int, store: Store) -> None:
    sessions = sessions_of(store)
    session_id = opened(sessions, steps=2)

    def fly(session: Session) -> None:
        for flight in (flown(actions="4").actions, [action]):
            for one in flight:
                session.fly(one)
            session.begin(Episode("easy", "tiered", 8))

    with pytest.raises(InvalidValueError, match="0 UP"):
        sessions.use(session_id, fly)
    with pytest.raises(InvalidValueError, match="one printable line"):
        sessions.use(session_id, lambda session: session.begin(Episode("easy", "tiered", 8), "two\nlines"))
    assert (actions(sessions.read(session_id)), latest(store, 1)) == ([4, 4], [])


@pytest.mark.parametrize("what", ["UPDATE ON flights", "UPDATE ON sessions"])
def test_a_step_that_cannot_be_stored_is_not_flown(what: str, store: Store) -> None:
    sessions = sessions_of(store)
    session_id = opened(sessions, steps=1)
    rest = flown("easy", 7, "4").steps - 1
    with failing(store.folder, what), pytest.raises(StoreError, match="the disk is gone"):
        sessions.use(session_id, lambda session: [session.fly(4) for _ in range(rest)])
    assert latest(store) == []
    assert sessions.use(session_id, lambda session: (session.fly(1), actions(session))[1]) == [4, 1]


def test_a_full_disk_keeps_nothing_and_says_so(store: Store) -> None:
    sessions = sessions_of(store)
    session_id = opened(sessions, steps=1)
    with store.database.writing() as connection:
        pages = connection.execute("PRAGMA page_count").fetchone()[0]
        connection.execute(f"PRAGMA max_page_count = {pages}")
    stored: list[str] = []
    with pytest.raises(StoreError, match="full"):
        stored.extend(store.add_episode(flown("hard", actions="4"), "ace") for _ in range(1000))
    assert actions(sessions.read(session_id)) == [4]
    assert [row.id for row in store.episodes()] == stored


def test_ids_are_long_random_and_kept_from_others(store: Store) -> None:
    sessions = sessions_of(store)
    ids = {opened(sessions) for _ in range(9)}
    assert all(len(session_id) >= 32 for session_id in ids)
    assert stat.S_IMODE((store.folder / FILE_NAME).stat().st_mode) == 0o600
    store.close()
    assert not any(session_id in (store.folder / "memory.json").read_text() for session_id in ids)


@pytest.mark.parametrize("session_id", ["", "nobody", "\ud800", "' OR 1=1"])
def test_a_session_that_never_was(session_id: str, store: Store) -> None:
    sessions = sessions_of(store)
    opened(sessions)
    for call in (sessions.read, sessions.end, lambda id_: sessions.use(id_, lambda session: session.fly(0))):
        with pytest.raises(NoSessionError):
            call(session_id)


def test_no_more_episodes_are_in_memory_than_sessions_may_be_open(store: Store) -> None:
    sessions = sessions_of(store, capacity=2)
    for number in range(5):
        session_id = opened(sessions, seed=number)
        sessions.use(session_id, lambda session: session.fly(4))
        assert len(sessions._in_memory) <= 2
        sessions_of(store).end(session_id)  # as another process would, which tells nobody


# Room


def is_open(sessions: Sessions, session_id: str) -> bool:
    try:
        sessions.check(session_id)
    except NoSessionError:
        return False
    return True


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_of_the_finished_the_one_that_was_not_used_for_longest_gives_way(store: Store) -> None:
    clock = Clock()
    sessions = sessions_of(store, 3, 900, clock)
    ids = [opened(sessions, steps=1) for _ in range(3)]
    with pytest.raises(CapacityError, match="all 3 sessions are taken"):
        opened(sessions)
    for session_id in (ids[1], ids[0]):
        clock.now += 10
        sessions.use(session_id, lambda session: [session.fly(4) for _ in range(60)])
    opened(sessions)
    assert [is_open(sessions, id_) for id_ in ids] == [True, False, True]


def test_a_session_without_steps_gives_way_first_and_an_address_keeps_to_its_share(store: Store) -> None:
    clock = Clock()
    sessions = sessions_of(store, 8, 900, clock)

    def opened_by(owner: str, steps: int = 0) -> str:
        clock.now += 1
        return opened(sessions, owner=owner, steps=steps)

    held = {owner: [opened_by(owner) for _ in range(20)] for owner in ("greedy", "second")}
    # The greedy one has half of the places, the second half of the rest; each evicts only its own.
    left = {owner: [id_ for id_ in ids if is_open(sessions, id_)] for owner, ids in held.items()}
    assert left == {"greedy": held["greedy"][-4:], "second": held["second"][-2:]}
    flying = [opened_by("greedy", steps=1) for _ in range(4)]
    with pytest.raises(CapacityError, match="4 of 8 sessions, its share"):
        opened_by("greedy")
    newcomers = [opened_by(name, steps=1) for name in ("a", "b")]
    # Now all places are taken: a newcomer gets that of a session without steps.
    assert open_sessions(store.folder) == 8
    newcomers += [opened_by(name, steps=1) for name in ("c", "d")]
    assert not any(is_open(sessions, id_) for id_ in held["second"])
    assert all(is_open(sessions, id_) for id_ in (*flying, *newcomers))
    with pytest.raises(CapacityError, match="all 8 sessions are taken"):
        opened_by("e")


def test_idle_sessions_end_for_every_process_and_make_room(store: Store) -> None:
    clock = Clock()
    sessions, other = (sessions_of(store, 2, 60, clock) for _ in range(2))
    idle, used = (opened(sessions, steps=1) for _ in range(2))
    clock.now += 59
    assert sessions.expire() == 0
    sessions.use(used, lambda session: session.fly(4))
    sessions.read(idle)
    clock.now += 1
    assert other.expire() == 1
    assert (is_open(sessions, idle), actions(other.read(used))) == (False, [4, 4])
    opened(other, steps=1)
    clock.now += 60
    opened(other, steps=1)
    assert open_sessions(store.folder) == 1


def test_the_sweep_moves_the_log_of_the_store_to_its_file(store: Store) -> None:
    sessions = sessions_of(store)
    opened(sessions)
    sessions.expire()
    # An immutable file is read without its log.
    with closing(sqlite3.connect(f"file:{store.folder / FILE_NAME}?immutable=1", uri=True)) as file:
        assert file.execute("SELECT count(*) FROM sessions").fetchone() == (1,)


@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_wall_clock_that_jumps_ends_no_session_and_fills_no_place(
    jump: float, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    sessions = Sessions(store, capacity=2, idle_seconds=60)
    finished = opened(sessions, steps=1)
    sessions.use(finished, lambda session: [session.fly(4) for _ in range(60)])
    flying, wall = opened(sessions, steps=1), time.time
    monkeypatch.setattr(time, "time", lambda: wall() + jump)
    assert sessions.expire() == 0
    assert actions(sessions.read(flying)) == [4]
    sessions.end(finished)
    opened(sessions)


@pytest.mark.parametrize("boot", [-900.0, 100_000.0])
def test_idle_time_begins_anew_with_a_server(boot: float, store: Store) -> None:
    clock = Clock()
    session_id = opened(sessions_of(store, 1, 60, clock), steps=1)
    # The machine was started again, or this is another one: its clock begins elsewhere.
    clock.now += boot
    sessions = sessions_of(store, 1, 60, clock)
    sessions.touch()
    clock.now += 59
    assert sessions.expire() == 0
    clock.now += 1
    assert sessions.expire() == 1
    assert not is_open(sessions, session_id)


def test_a_flight_keeps_who_flew_before_its_fork(store: Store) -> None:
    sessions = sessions_of(store)
    fork = Provenance(pilot="greedy").forked(1, "random").forked(2, "human").named("Ada")
    session_id = sessions.open(Episode("easy", "tiered", 7).fly([4, 4, 4]), fork)
    assert sessions_of(store).read(session_id).provenance == fork
    assert store.listed(9) == [], "unfinished flights are in no list"
    sessions.end(session_id)
    assert rows(store.folder) == {}
    fork_id = store.add_episode(flown(actions="4"), fork)
    (row,) = store.listed(2)
    assert (row.id, row.agent, row.parent) == (
        fork_id,
        "human (Ada) from step 2 of random from step 1 of greedy",
        fork.parent,
    )
    assert store.episode(fork_id).record.provenance == fork
