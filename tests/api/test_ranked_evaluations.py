"""Evaluations that lie in the data folder of a server: agents on the boards of language models."""

import json
import os
import shutil
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.browser.flights import put_evaluation
from tests.llm.stored_run import put_run

MAPS = range(14, 18)


def boards(data: Path) -> Any:
    with TestClient(create_app(Settings(data=data))) as client:
        return client.get("/leaderboard/easy/runs").raise_for_status().json()


def test_where_files_lie_is_not_told(tmp_path: Path) -> None:
    folder = put_evaluation(tmp_path, "mine", "random", MAPS)
    config = folder / "evaluation.json"
    config.write_text(config.read_text().replace('"random"', '"pathqnet:/home/me/model.safetensors"'))
    assert boards(tmp_path)["boards"][0]["rows"][0]["agent"] == "pathqnet:model.safetensors"
    (piece,) = (folder / "pieces").iterdir()
    piece.write_bytes(b"no piece")
    damaged = boards(tmp_path)["unranked"][0]["reason"]
    assert damaged.startswith("mine/pieces/easy_delivery-v1-")


def test_an_evaluation_of_too_many_maps_is_not_looked_at(tmp_path: Path) -> None:
    folder = put_evaluation(tmp_path, "mine", "random", MAPS)
    config = folder / "evaluation.json"
    told = json.loads(config.read_text())
    told["keys"][0][3] = [0, 20_000]
    config.write_text(json.dumps(told))
    (unranked,) = boards(tmp_path)["unranked"]
    assert unranked["reason"] == "it has 20000 maps; at most 10000 are ranked here"


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Generator[tuple[TestClient, Path], None, None]:
    """A server with a whole evaluation and a whole run, and its data folder."""
    data = tmp_path_factory.mktemp("damaged")
    put_evaluation(data, "whole", "greedy", MAPS)
    put_run(data, "whole", "WAIT", MAPS)
    with TestClient(create_app(Settings(data=data))) as client:
        yield client, data


def column(**columns: Any) -> Callable[[Path], object]:
    """Other columns in a piece."""

    def put(path: Path) -> None:
        with np.load(path) as file:
            held = dict(file)
        np.savez(path, **held | columns)

    return put


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


ANYWHERE: dict[str, Callable[[Path], object]] = {
    "nested": lambda path: path.write_bytes(b"[" * 200_000),
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-20]),
    "huge": lambda path: os.truncate(path, 1 << 33),
    "pipe": pipe,
}
PIECES: dict[str, Callable[[Path], object]] = {
    **ANYWHERE,
    "objects": column(scores=np.array([None] * 4)),
    "a table": column(scores=np.full((4, 1), 0.5)),
    "other maps": column(seeds=np.arange(4)),
}
RUNS = ("run.json", "calls.jsonl")


@pytest.mark.parametrize(
    ("file", "damage"),
    [
        *(pytest.param("evaluation.json", put, id=f"evaluation.json-{name}") for name, put in ANYWHERE.items()),
        *(pytest.param("pieces/*.npz", put, id=f"piece-{name}") for name, put in PIECES.items()),
        *(pytest.param(file, ANYWHERE[name], id=f"{file}-{name}") for file in RUNS for name in ("cut", "pipe")),
    ],
)
def test_what_is_damaged_is_named_and_stops_nothing(
    file: str, damage: Callable[[Path], object], damaged: tuple[TestClient, Path]
) -> None:
    client, data = damaged
    kind = "llm" if file in RUNS else "evaluations"
    bad = data / kind / "bad"
    shutil.copytree(data / kind / "whole", bad)
    try:
        (path,) = bad.glob(file)
        damage(path)
        answer = client.get("/leaderboard/easy/runs").json()
        assert [row["kind"] for row in answer["boards"][0]["rows"]] == ["agent", "model"]
        (unranked,) = answer["unranked"]
        assert (unranked["run"], str(data) in unranked["reason"]) == ("bad", False)
        assert 0 < len(unranked["reason"]) < 500
    finally:
        shutil.rmtree(bad)
