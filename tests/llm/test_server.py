"""Flying in a server beside the rules here."""

import asyncio
import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError, StoreError
from drone_env.llm.follow import following
from drone_env.results.store import FILE_NAME, Store
from tests.api.serving import serving
from tests.tools import reserved_port

from .conftest import Start


def test_a_server_flies_along(endpoint: Start, tmp_path: Path) -> None:
    async def follow(episode: Episode) -> None:
        with following(server.url, "mine") as on_step:
            assert on_step is not None
            await on_step(episode)

    with serving(tmp_path / "data", ("-m", "drone_env.cli", "serve")) as server:
        done = endpoint(pilot="greedy").infer("--seeds", "14:15", "--server", server.url)
        assert (done.status, done.turns) == (0, {"ok": 3}), done.err
        (stored,) = server.client.get("/memory_logs").json()["episodes"]
        assert (stored["seed"], stored["agent"], stored["score"]) == (14, "scripted", 0.99)
        # Here the battery is smaller than the server's.
        with pytest.raises(InvalidValueError, match=r"other rules: map 14, step 0: battery_steps.* is 60, must be 25"):
            asyncio.run(follow(Episode(replace(get_task("easy"), battery_capacity=25), "tiered", 14)))


def test_the_store_of_the_data_folder_contains_each_finished_flight_once(endpoint: Start) -> None:
    waiting = {"sends": json.dumps({"choices": [{"message": {"content": "WAIT"}, "finish_reason": "stop"}]})}
    scripted = endpoint(pilot="greedy", faults=[[0, 0, waiting]])
    done = scripted.infer("--seeds", "14:16", "--concurrency", "1", "--max-calls", "5")
    assert [flight["status"] for flight in done.flights] == ["finished", "budget_stop"], done.err
    with Store(scripted.folder / "data") as store:
        (stored,) = store.listed(9)
        assert (stored.agent, stored.seed, stored.steps, stored.success) == ("scripted", 14, 4, True)
        # As if the run had been killed before it could store the flight.
        with closing(sqlite3.connect(scripted.folder / "data" / FILE_NAME)) as file:
            file.execute("DELETE FROM episodes")
            file.commit()
        for _ in range(2):
            assert scripted.infer("--seeds", "14:16", "--resume", folder=done.folder).status == 0
            assert [episode.seed for episode in store.listed(9)] == [15, 14]
            assert store.listed(9)[1].id == stored.id
        # Another run of the same flight is another flight.
        assert scripted.infer("--seeds", "14:15").status == 0
        assert len(store.listed(9)) == 3


def test_a_store_that_fails_costs_no_paid_flight(
    endpoint: Start, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scripted = endpoint(pilot="greedy")

    def full(*_: object) -> None:
        raise StoreError("no space")

    monkeypatch.setattr(Store, "add_episode", full)
    done = scripted.infer("--seeds", "14:16", DRONE_ENV_DATA=str(tmp_path / "kept"))
    assert (done.status, len(done.flights)) == (0, 2)
    assert f"2 flights are not in the store: no space; to add them, give the same options with --out {done.folder}" in (
        done.err
    )
    assert (tmp_path / "kept" / "drone_env.sqlite3").exists()


def test_without_a_server_or_docker_nothing_is_sent(
    endpoint: Start, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scripted = endpoint(pilot="greedy")
    done = scripted.infer("--seeds", "14:15", "--server", f"http://127.0.0.1:{reserved_port()}")
    assert (done.status, done.out, "failed" in done.err) == (2, "", True)
    monkeypatch.setenv("PATH", str(tmp_path))
    done = scripted.infer("--seeds", "14:15", "--use-image")
    assert (done.status, "needs Docker" in done.err) == (2, True)
    assert scripted.requests() == []
