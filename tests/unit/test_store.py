"""The store: finished episodes, sessions, the view of the last ones; among threads, processes and kills."""

import json
import logging
import os
import random
import signal
import sqlite3
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

from drone_env.core.rewards import REWARD_PROFILES, RewardProfile
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.episodes import database
from drone_env.episodes.analysis import FinishedRow, analyse
from drone_env.episodes.memory_view import MemoryView
from drone_env.episodes.record import EpisodeRecord, parse_record, record_of, replay
from drone_env.episodes.schema import APPLICATION_ID, MIGRATIONS, migrate
from drone_env.episodes.sessions import SessionRow
from drone_env.episodes.store import FILE_NAME, Store, StoredEpisode, data_folder
from drone_env.errors import (
    CapacityError,
    EpisodeError,
    InvalidValueError,
    NoSessionError,
    SessionGoneError,
    StoreError,
    UnknownNameError,
)
from drone_env.planning.optimal import solve

EXAMPLES = int(os.environ.get("DRONE_ENV_EXAMPLES", "400"))
KILLS = max(2, EXAMPLES // 100)
HAMMERED_STEPS = max(300, EXAMPLES // 5)
WORKER = Path(__file__).with_name("store_worker.py")


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store(tmp_path / "data") as store:
        yield store


def flown(task: str = "easy", seed: int = 7, actions: str | None = None, profile: str = "tiered") -> Episode:
    """An episode flown to its end: with these actions again and again, or optimally."""
    episode = Episode(task, profile)
    episode.reset(seed)
    chosen = "".join(str(int(a)) for a in solve(task, seed).actions) if actions is None else actions
    while not episode.ended:
        episode.step(int(chosen[episode.steps % len(chosen)]))
    return episode


def opened(store: Store, task: str = "easy_delivery", seed: int = 7, capacity: int = 256) -> str:
    return store.open_session(task, 1, seed, "tiered", "someone", capacity)


def finish_in(row: SessionRow, episode: Episode, next_seed: int | None = None) -> None:
    if row.task != episode.task.id:
        row.reset(episode.task.id, 1, episode.seed, "tiered")
    for action in episode.actions:
        row.append(action)
    row.finish(episode)
    if next_seed is not None:
        row.reset(row.task, 1, next_seed, "tiered")


def view(folder: Path) -> list[StoredEpisode]:
    content = json.loads((folder / "memory.json").read_bytes())
    assert (content["format"], content["format_version"]) == ("drone_env/memory", 1)
    return [StoredEpisode.model_validate_json(json.dumps(episode)) for episode in content["episodes"]]


def eventually(holds: Any, seconds: float = 20) -> None:
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


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


def test_a_record_of_version_1_is_stored_with_its_rewards(store: Store) -> None:
    record = record_of(flown(), "ace")
    old = json.loads(record.to_json()) | {"format_version": 1}
    del old["rewards"]
    stored = store.episode(store.add_episode(parse_record(json.dumps(old), "it")))
    assert stored.record == record


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
def test_an_unknown_id_is_an_error_that_names_the_newest(episode_id: str, store: Store) -> None:
    with pytest.raises(UnknownNameError, match="the store is empty"):
        store.episode(episode_id)
    known = store.add_episode(flown(), "ace")
    with pytest.raises(UnknownNameError, match=known):
        store.episode(episode_id)


def mine() -> RewardProfile:
    return RewardProfile(id="mine", summary="")


def unlike() -> TaskConfig:
    return replace(TASKS["easy_delivery"], max_steps=30)


def flying(task: str | TaskConfig = "easy", profile: str | RewardProfile = "tiered", steps: int = 0) -> Episode:
    episode = Episode(task, profile)
    episode.reset(7)
    for _ in range(steps):
        episode.step(4)
    return episode


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


# memory.json


def test_the_view_is_there_from_the_start_and_ends_with_the_last_episode(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        assert view(tmp_path) == []
        store.add_episode(flown(seed=1), "ace")
        eventually(lambda: view(tmp_path) == store.latest(1))
        store.add_episode(flown(seed=2), "ace")
        expected = store.latest(9)[::-1]
    assert view(tmp_path) == expected
    assert sorted(path.name for path in tmp_path.iterdir()) == [FILE_NAME, "memory.json"]


def test_the_view_holds_the_last_hundred_of_all_stores_on_the_folder(tmp_path: Path) -> None:
    episode = flown()
    with Store(tmp_path) as first, Store(tmp_path) as second:
        for number in range(130):
            (first, second)[number % 2].add_episode(episode, f"ace {number}")
        expected = first.latest(100)[::-1]
        eventually(lambda: view(tmp_path) == expected)
    with Store(tmp_path):
        assert view(tmp_path) == expected
    assert [stored.record.agent for stored in expected] == [f"ace {number}" for number in range(30, 130)]


def test_an_older_view_that_overwrites_a_newer_one_is_put_right(tmp_path: Path) -> None:
    path = tmp_path / "memory.json"
    stored = [StoredEpisode.of(f"{number:016x}", flown(), "ace") for number in range(3)]
    kept = list(enumerate(stored[:1], 1))
    overtaken = threading.Event()

    def newer(after: int, n: int) -> list[tuple[int, StoredEpisode]]:
        found = kept[after:][-n:]
        if len(kept) == 2 and not overtaken.is_set():
            # Another process stores one more, and writes its view, before this one writes what it has just read.
            overtaken.set()
            kept.append((3, stored[2]))
            MemoryView(path, lambda after, n: kept[after:][-n:]).close()
            assert view(tmp_path) == stored
        return found

    memory_view = MemoryView(path, newer)
    assert view(tmp_path) == stored[:1]
    kept.append((2, stored[1]))
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
    assert [path for path in tmp_path.iterdir() if path.suffix == ".part"] == []


def test_a_view_that_cannot_be_read_is_logged_and_tried_again(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    store = Store(tmp_path)
    store.add_episode(flown(), "ace")
    eventually(lambda: len(view(tmp_path)) == 1)
    with store._database.writing() as connection:
        connection.execute(
            "UPDATE episodes SET record = replace(record, '\"format_version\":2', '\"format_version\":3')"
        )
        connection.execute("UPDATE episodes SET number = number + 1")
    store._view.refresh()
    eventually(lambda: "version 3 is newer than 2" in caplog.text)
    with store._database.writing() as connection:
        connection.execute(
            "UPDATE episodes SET record = replace(record, '\"format_version\":3', '\"format_version\":2')"
        )
    second = store.add_episode(flown(), "ace")
    store.close()
    assert view(tmp_path)[-1].id == second


def test_leftovers_of_killed_processes_are_removed_but_not_what_is_being_written(tmp_path: Path) -> None:
    old, fresh = tmp_path / "memory.json.1-2.part", tmp_path / "memory.json.3-4.part"
    for path in (old, fresh):
        path.write_text("[")
    os.utime(old, (0, 0))
    Store(tmp_path).close()
    assert (old.exists(), fresh.exists()) == (False, True)


# Analysis


def test_an_empty_analysis_knows_nothing(store: Store) -> None:
    analysis = store.analysis("hard")
    assert (analysis.task, analysis.episodes_total, analysis.episodes, analysis.deliveries) == (
        "hard_delivery",
        0,
        0,
        0,
    )
    unknown = ("average_reward", "average_score", "success_rate", "success_trend", "average_steps", "mean_regret")
    assert [getattr(analysis, name) for name in unknown] == [None] * len(unknown)
    assert set(analysis.action_distribution.values()) == {0.0}


@pytest.mark.parametrize("task", ["easy", "hard", "skyline_easy"])
def test_an_analysis_counts_what_was_flown(task: str, store: Store) -> None:
    flights = [flown(task, seed, actions) for seed, actions in enumerate(["4", "0", None, None, "0123", None])]
    for flight in flights:
        store.add_episode(flight, "someone")
    store.add_episode(flown("medium"), "someone else, elsewhere")
    analysis = store.analysis(task, patience=240)
    n = len(flights)
    assert (analysis.episodes, analysis.episodes_total, analysis.regret_episodes) == (n, n, n)
    assert analysis.average_reward == pytest.approx(sum(flight.reward_total for flight in flights) / n)
    assert analysis.average_score == pytest.approx(sum(flight.score for flight in flights) / n)
    assert analysis.average_steps == pytest.approx(sum(flight.steps for flight in flights) / n)
    assert analysis.deliveries == sum(flight.deliveries_done for flight in flights)
    assert analysis.average_deliveries == pytest.approx(analysis.deliveries / n)
    assert analysis.success_rate == sum(flight.success for flight in flights) / n
    newer, older = (sum(flight.success for flight in half) for half in (flights[3:], flights[:3]))
    assert analysis.success_trend == (newer - older) / 3
    actions = [action for flight in flights for action in flight.actions]
    assert analysis.action_distribution == {
        name: actions.count(number) / len(actions)
        for number, name in enumerate(["UP", "DOWN", "LEFT", "RIGHT", "WAIT"])
    }
    regrets = [solve(task, flight.seed).score - flight.score for flight in flights]
    assert analysis.mean_regret == pytest.approx(sum(regrets) / n, abs=1e-12)
    assert min(regrets) == 0 < max(regrets)


def test_an_analysis_looks_at_the_newest(store: Store) -> None:
    for actions in ("4", None, None):
        store.add_episode(flown(actions=actions), "someone")
    newest = store.analysis("easy", last=2, patience=240)
    assert (newest.episodes_total, newest.episodes, newest.success_rate, newest.success_trend) == (3, 2, 1, 0)
    assert newest.mean_regret == 0
    assert store.analysis("easy", last=2**70).success_rate == 2 / 3


def test_an_analysis_does_not_wait_for_optima_and_has_them_later(store: Store) -> None:
    for seed in range(200):
        store.add_episode(flown("hard", seed, "4"), "someone")
    first = store.analysis("hard", patience=0)
    assert first.episodes == 200
    assert first.regret_episodes < 200
    eventually(lambda: store.analysis("hard", patience=0).regret_episodes == 200)
    assert store.analysis("hard").mean_regret == pytest.approx(
        sum(solve("hard", seed).score - 0.01 for seed in range(200)) / 200
    )


def test_closing_stops_the_solving(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        for seed in range(200):
            store.add_episode(flown("hard", seed, "4"), "someone")
        store.analysis("hard", patience=0)
    with Store(tmp_path) as store:
        assert store.analysis("hard", patience=240).regret_episodes == 200


def test_maps_too_large_to_be_solved_are_left_out_of_regret() -> None:
    rows = [
        FinishedRow(1.0, 0.5, 10, 0, "battery_dead", "4" * 10, True, None, 1),
        FinishedRow(3.0, 0.9, 5, 1, "delivered", "01234", True, 1.0 - 1 / 16, 2),
        FinishedRow(3.0, 0.9, 5, 1, "delivered", "01234", False, None, 3),
    ]
    analysis = analyse("easy_delivery", 5, rows)
    assert (analysis.episodes_total, analysis.episodes, analysis.regret_episodes) == (5, 3, 1)
    assert analysis.mean_regret == pytest.approx(0.9375 - 0.9)
    # The middle one of three belongs to neither half.
    assert analysis.success_trend == -1
    assert analysis.action_distribution["WAIT"] == 12 / 20


def test_means_of_the_highest_and_lowest_scores_are_no_error() -> None:
    for n in range(1, 300):
        for score in (0.01, 0.99):
            row = FinishedRow(score, score, 1, 1, "delivered", "4", True, score, 1)
            assert analyse("easy_delivery", n, [row] * n).average_score == pytest.approx(score)


# Sessions


def test_a_session_is_flown_to_its_end_and_flown_again(store: Store) -> None:
    session_id = opened(store, "medium_delivery")
    for expected in ("medium_delivery", "easy_delivery"):
        episode = store.read_session(session_id).fly()
        for action in solve(expected, episode.seed).actions:
            with store.session(session_id) as row:
                assert row.actions == tuple(episode.actions)
                episode.step(action)
                row.append(action)
                if episode.ended:
                    row.finish(episode)
        row = store.read_session(session_id)
        assert row.episode_id is not None
        assert store.latest(1)[0].id == row.episode_id
        assert store.episode(row.episode_id).record == record_of(episode, "someone")
        with store.session(session_id) as row:
            row.reset("easy", 1, 8, "aligned", "another")
        row = store.read_session(session_id)
        assert (row.task, row.seed, row.reward_profile, row.agent) == ("easy_delivery", 8, "aligned", "another")
        assert (row.actions, row.episode_id) == ((), None)
        with store.session(session_id) as row:
            row.reset("easy", 1, 8, "tiered", "someone")


def test_a_session_that_flies_anew_stands_where_it_stood(store: Store) -> None:
    session_id = opened(store, "hard_delivery")
    episode = flying("hard", steps=3)
    with store.session(session_id) as row:
        for action in episode.actions:
            row.append(action)
    assert store.read_session(session_id).fly().get_state() == episode.get_state()


def test_ids_are_long_random_and_kept_from_others(store: Store) -> None:
    ids = {opened(store) for _ in range(50)}
    assert len(ids) == 50
    assert all(len(session_id) >= 32 for session_id in ids)
    assert stat.S_IMODE((store.folder / FILE_NAME).stat().st_mode) == 0o600
    assert not any(session_id in (store.folder / "memory.json").read_text() for session_id in ids)


def test_nothing_is_kept_of_a_block_that_fails(store: Store) -> None:
    session_id = opened(store)
    episode = flown(actions="4")
    with pytest.raises(InvalidValueError), store.session(session_id) as row:
        finish_in(row, episode, next_seed=-1)
    assert store.read_session(session_id).actions == ()
    assert store.latest(1) == []
    with store.session(session_id) as row:
        row.append(1)
    assert store.read_session(session_id).actions == (1,)


def test_a_full_disk_keeps_nothing_and_says_so(store: Store) -> None:
    session_id = opened(store)
    with store.session(session_id) as row:
        row.append(1)
    with store._database.writing() as connection:
        pages = connection.execute("PRAGMA page_count").fetchone()[0]
        connection.execute(f"PRAGMA max_page_count = {pages}")
    episode = flown("hard", actions="4")
    stored: list[str] = []
    with pytest.raises(StoreError, match="full"):
        stored.extend(store.add_episode(episode, "ace") for _ in range(100))
    assert [kept.id for kept in store.episodes()] == stored
    with pytest.raises(StoreError, match="full"), store.session(session_id) as row:
        finish_in(row, episode)
    assert store.read_session(session_id).actions == (1,)
    assert [kept.id for kept in store.episodes()] == stored


@pytest.mark.parametrize("action", [-1, 5, True, 1.0, "UP", None])
def test_only_actions_are_appended(action: Any, store: Store) -> None:
    session_id = opened(store)
    with pytest.raises(InvalidValueError, match="0 UP"), store.session(session_id) as row:
        row.append(action)
    assert store.read_session(session_id).actions == ()


def test_after_the_end_there_is_nothing_to_append_or_finish(store: Store) -> None:
    session_id = opened(store)
    episode = flown(actions="4")
    with store.session(session_id) as row:
        finish_in(row, episode)
        with pytest.raises(EpisodeError, match="already"):
            row.finish(episode)
    with pytest.raises(EpisodeError, match="reset"), store.session(session_id) as row:
        row.append(4)
    assert len(store.latest(9)) == 1


@pytest.mark.parametrize(
    ("episode", "error", "message"),
    [
        (flying(), EpisodeError, "has not ended"),
        (flown(seed=8, actions="4"), InvalidValueError, "this is an episode of"),
        (flown(actions="4", profile="score"), InvalidValueError, "this is an episode of"),
        (flown("medium", actions="4"), InvalidValueError, "this is an episode of"),
        (flown(actions="0"), InvalidValueError, "which are not the 60 of this episode"),
    ],
)
def test_only_its_own_finished_episode_finishes_a_session(
    episode: Episode, error: type[Exception], message: str, store: Store
) -> None:
    session_id = opened(store)
    with store.session(session_id) as row:
        for _ in range(60):
            row.append(4)
        with pytest.raises(error, match=message):
            row.finish(episode)
    assert store.latest(1) == []


@pytest.mark.parametrize(
    ("flight", "error"),
    [
        (("extreme", 1, 7, "tiered"), UnknownNameError),
        (("easy", 2, 7, "tiered"), UnknownNameError),
        (("easy", 1, 7, "mine"), UnknownNameError),
        (("easy", 1, -1, "tiered"), InvalidValueError),
        (("easy", 1, 2**53, "tiered"), InvalidValueError),
        (("easy", 1, 7, "tiered", "two\nlines"), InvalidValueError),
        (("easy", 1, 7, "tiered", "\ud800"), InvalidValueError),
    ],
)
def test_a_session_flies_only_what_can_be_flown(flight: tuple[Any, ...], error: type[Exception], store: Store) -> None:
    agent = flight[4] if len(flight) > 4 else "someone"
    with pytest.raises(error):
        store.open_session(*flight[:4], agent=agent, capacity=9)
    assert store.count_sessions() == 0
    session_id = opened(store)
    before = store.read_session(session_id)
    with store.session(session_id) as row, pytest.raises(error):
        row.reset(*flight)
    assert vars(store.read_session(session_id)) == vars(before) | {
        "touched_at": store.read_session(session_id).touched_at
    }


def test_there_is_room_for_so_many(store: Store) -> None:
    ids = [opened(store, capacity=3) for _ in range(3)]
    with pytest.raises(CapacityError, match="all 3 sessions are taken"):
        opened(store, capacity=3)
    assert store.count_sessions() == 3
    store.end_session(ids[0])
    opened(store, capacity=3)
    assert store.count_sessions() == 3


@pytest.mark.parametrize("session_id", ["", "nobody", "\ud800", "ä", "' OR 1=1"])
def test_a_session_that_never_was(session_id: str, store: Store) -> None:
    opened(store)
    with pytest.raises(NoSessionError), store.session(session_id):
        pytest.fail("the block must not be entered")
    for call in (store.read_session, store.end_session):
        with pytest.raises(NoSessionError):
            call(session_id)


def test_an_ended_session_is_gone_for_every_store(store: Store) -> None:
    session_id = opened(store)
    store.end_session(session_id)
    with Store(store.folder) as other:
        for one in (store, other):
            with pytest.raises(SessionGoneError), one.session(session_id):
                pytest.fail("the block must not be entered")
            for call in (one.read_session, one.end_session):
                with pytest.raises(SessionGoneError):
                    call(session_id)


def test_idle_sessions_expire_and_used_ones_do_not(store: Store) -> None:
    idle, used = opened(store), opened(store)
    assert store.expire_sessions(60) == []
    with sqlite3.connect(store.folder / FILE_NAME) as connection:
        connection.execute("UPDATE sessions SET touched_at = touched_at - 100")
    connection.close()
    with store.session(used):
        pass
    assert store.expire_sessions(60) == [idle]
    with pytest.raises(SessionGoneError):
        store.read_session(idle)
    assert store.read_session(used).id == used
    with sqlite3.connect(store.folder / FILE_NAME) as connection:
        connection.execute("UPDATE gone_sessions SET gone_at = gone_at - 8 * 24 * 3600")
    connection.close()
    assert store.expire_sessions(60) == []
    with pytest.raises(NoSessionError):
        store.read_session(idle)


def test_a_block_inside_a_block_is_an_error_and_no_deadlock(store: Store) -> None:
    session_id = opened(store)
    with store.session(session_id) as row:
        row.append(4)
        with pytest.raises(StoreError, match="inside another"), store.session(session_id):
            pytest.fail("the block must not be entered")
        with pytest.raises(StoreError, match="inside another"):
            opened(store)
        assert store.read_session(session_id).actions == ()
    assert store.read_session(session_id).actions == (4,)


# The file


def test_a_closed_store_says_so(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.close()
    store.close()
    for call in (lambda: store.latest(1), lambda: opened(store), lambda: store.analysis("easy")):
        with pytest.raises(StoreError, match="closed"):
            call()


def test_the_folder_is_data_or_what_the_environment_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DRONE_ENV_DATA", raising=False)
    assert data_folder() == Path("data")
    monkeypatch.setenv("DRONE_ENV_DATA", "")
    assert data_folder() == Path("data")
    monkeypatch.setenv("DRONE_ENV_DATA", "/somewhere/else")
    assert data_folder() == Path("/somewhere/else")


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


def test_a_store_that_stays_busy_is_an_error(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database, "BUSY_SECONDS", 0.2)
    session_id = opened(store)
    other = sqlite3.connect(store.folder / FILE_NAME, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    began = time.monotonic()
    with pytest.raises(StoreError, match="locked"), store.session(session_id):
        pytest.fail("the block must not be entered")
    assert time.monotonic() - began < 5
    assert store.read_session(session_id).actions == ()
    other.execute("ROLLBACK")
    other.close()
    with store.session(session_id) as row:
        row.append(4)
    assert store.read_session(session_id).actions == (4,)


# Threads, processes, kills


def worker(folder: Path, session_id: str, steps: int, seed: int, output: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, str(WORKER), str(folder), session_id, str(steps), str(seed)]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    # Into a file: a full pipe would decide when the worker stands still.
    with output.open("wb") as stdout:
        return subprocess.Popen(command, stdout=stdout, env=environment)


def said(output: Path) -> list[tuple[int, tuple[int, ...], str | None]]:
    """The whole lines that a worker printed after each step."""
    lines = [json.loads(line) for line in output.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]
    assert lines[:1] in ([], ["ready"])
    return [(seed, tuple(actions), finished) for seed, actions, finished in lines[1:]]


class ViewReader(threading.Thread):
    """Reads `memory.json` all the time, and keeps what went wrong."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        self.reads = 0
        self.error: BaseException | None = None
        self.done = threading.Event()

    def run(self) -> None:
        try:
            while not self.done.is_set():
                content = json.loads((self.folder / "memory.json").read_bytes())
                assert len(content["episodes"]) <= 100
                self.reads += 1
        except BaseException as error:
            self.error = error

    def __enter__(self) -> "ViewReader":
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.done.set()
        self.join()
        assert self.error is None
        assert self.reads > 0


def whole(store: Store, session_id: str) -> list[tuple[int, tuple[int, ...]]]:
    """(seed, actions) of all that a session has flown, checked to be what the worker's way of flying makes."""
    episodes = list(store.episodes())
    for stored in episodes:
        replay(stored.record)
    row = store.read_session(session_id)
    flown = [
        (e.record.seed, tuple(["UP", "DOWN", "LEFT", "RIGHT", "WAIT"].index(a) for a in e.record.actions))
        for e in episodes
    ]
    if row.episode_id is None:
        flown.append((row.seed, row.actions))
    else:
        assert row.episode_id == episodes[-1].id
    assert [seed for seed, _ in flown] == list(range(len(flown)))
    return flown


def test_processes_on_one_session_lose_no_step(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        session_id = opened(store, seed=0)
        with ViewReader(tmp_path):
            outputs = [tmp_path / "first", tmp_path / "second"]
            workers = [
                worker(tmp_path, session_id, HAMMERED_STEPS, seed, output) for seed, output in enumerate(outputs)
            ]
            assert [process.wait() for process in workers] == [0, 0]
        steps = [step for output in outputs for step in said(output)]
        assert len(steps) == 2 * HAMMERED_STEPS
        # Each step was kept once: no two saw the session in the same state.
        assert len({(seed, len(actions)) for seed, actions, _ in steps}) == len(steps)
        flown = dict(whole(store, session_id))
        assert sum(map(len, flown.values())) == len(steps)
        assert all(flown[seed][: len(actions)] == actions for seed, actions, _ in steps)
        finished = {episode_id for _, _, episode_id in steps if episode_id}
        assert finished == {stored.id for stored in store.episodes()}
        assert len({seed for seed, _, _ in said(outputs[0])} & {seed for seed, _, _ in said(outputs[1])}) > 0
        expected = store.latest(100)[::-1]
        assert view(tmp_path) == expected


def test_threads_on_one_session_lose_no_step(store: Store) -> None:
    session_id = opened(store, seed=0)
    errors: list[BaseException] = []

    def fly(number: int) -> None:
        rng = random.Random(number)
        try:
            for _ in range(60):
                with store.session(session_id) as row:
                    if row.episode_id is not None:
                        row.reset(row.task, 1, row.seed + 1, "tiered")
                    episode = row.fly()
                    action = rng.randrange(5)
                    episode.step(action)
                    row.append(action)
                    if episode.ended:
                        row.finish(episode)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=fly, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert sum(len(actions) for _, actions in whole(store, session_id)) == 8 * 60


def test_killed_at_any_moment_nothing_that_was_said_is_lost(tmp_path: Path) -> None:
    rng = random.Random(0)
    with Store(tmp_path) as store:
        session_id = opened(store, seed=0)
    steps = 0
    with ViewReader(tmp_path):
        for kill in range(KILLS):
            output = tmp_path / "said"
            process = worker(tmp_path, session_id, 10**9, kill, output)
            try:
                eventually(lambda output=output: output.stat().st_size, 60)
                time.sleep(rng.uniform(0, 0.5))
            finally:
                process.send_signal(signal.SIGKILL)
                process.wait()
            assert process.returncode == -signal.SIGKILL
            told = said(output)
            steps += len(told)
            with Store(tmp_path) as store:
                flown = dict(whole(store, session_id))
                for seed, actions, episode_id in told:
                    assert flown[seed][: len(actions)] == actions
                    if episode_id is not None:
                        assert store.episode(episode_id).record.seed == seed
                # At most the one step is there that was kept, but not yet told of.
                ahead = sum(map(len, flown.values())) - steps
                assert 0 <= ahead <= kill + 1
                expected = store.latest(100)[::-1]
                assert view(tmp_path) == expected
            with sqlite3.connect(tmp_path / FILE_NAME) as connection:
                assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            connection.close()
    assert steps > KILLS
