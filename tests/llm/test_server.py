"""Flights that a server follows, and the store of the data folder."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from drone_env.client import DroneEnvClient
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError, StoreError
from drone_env.flights.store import FILE_NAME, Store
from drone_env.llm import on_server
from drone_env.llm.budget import Options
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.tools import reserved_port

from .conftest import Start
from .stored_run import Scripted, fly


def test_a_server_repeats_flights_of_the_same_rules(
    endpoint: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with TestClient(create_app(Settings(data=tmp_path / "data"))) as http:
        monkeypatch.setattr(on_server, "DroneEnvClient", lambda _: DroneEnvClient(http=http))
        done = endpoint(pilot="greedy").infer("--seeds", "14:15", "--server", "http://server")
        assert (done.status, done.turns) == (0, {"ok": 3}), done.err
        (stored,) = http.get("/memory_logs").json()["episodes"]
        assert (stored["seed"], stored["agent"], stored["score"]) == (14, "scripted", 0.99)
        # Here the battery is smaller than the server's.
        smaller = Episode(replace(get_task("easy"), battery_capacity=25), "tiered", 14)
        with pytest.raises(InvalidValueError, match=r"other rules: map 14, step 0: battery_steps.* is 60, must be 25"):
            on_server.repeat_on_server("http://server", smaller, "mine")


def test_the_store_contains_each_finished_flight_once(tmp_path: Path) -> None:
    run, two = tmp_path / "run", {"seeds": (14, 16)}
    with Store(tmp_path / "data") as store:
        flown = fly(Scripted(), run, Options(concurrency=1, max_calls=6), store, **two)
        assert [flight.status for flight in flown.result.flights] == ["finished", "budget_stop"]
        (stored,) = store.listed(9)
        assert (stored.agent, stored.seed, stored.steps, stored.success) == ("scripted", 14, 3, True)
        # As if the run had been killed before it could store the flight.
        with closing(sqlite3.connect(tmp_path / "data" / FILE_NAME)) as file:
            file.execute("DELETE FROM flights")
            file.commit()
        for _ in range(2):
            fly(Scripted(), run, store=store, **two)
            assert [episode.seed for episode in store.listed(9)] == [15, 14]
            assert store.listed(9)[1].id == stored.id
        # Another run of the same flight is another flight.
        fly(Scripted(), tmp_path / "other", store=store)
        assert len(store.listed(9)) == 3


def test_a_store_that_fails_costs_no_paid_flight(
    endpoint: Start, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def full(*_: object) -> None:
        raise StoreError("no space")

    monkeypatch.setattr(Store, "add_episode", full)
    done = endpoint(pilot="greedy").infer("--seeds", "14:16", DRONE_ENV_DATA=str(tmp_path / "kept"))
    assert (done.status, len(done.flights)) == (0, 2)
    assert done.err.count(" is not in the store, --resume adds it: no space\n") == 2
    assert (tmp_path / "kept" / FILE_NAME).exists()


def test_without_a_server_or_docker_nothing_is_sent(
    endpoint: Start, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scripted = endpoint(pilot="greedy")
    monkeypatch.setenv("PATH", str(tmp_path))
    for option, told in (
        (("--server", f"http://127.0.0.1:{reserved_port()}"), "failed"),
        (("--use-image",), "needs Docker"),
    ):
        done = scripted.infer("--seeds", "14:15", *option)
        assert (done.status, done.out, told in done.err) == (2, "", True)
    assert scripted.requests() == []
