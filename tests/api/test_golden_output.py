"""The JSON and the tables that people read, to the last byte.

After an intended change write the file again: `python -m tests.api.test_golden_output`.
"""

import contextlib
import io
import json
import os
import re
import tempfile
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from drone_env.cli import main
from drone_env.flights.store import Store
from drone_env.llm.report import report, write_report
from drone_env.llm.run_folder import read_run
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.browser.flights import fill, flown, put_evaluation
from tests.llm.stored_run import put_run

GOLDEN = Path(__file__).with_name("golden_output.json")
MAPS = range(14, 18)
OF_THIS_RUN = {
    r'"[0-9a-f]{16}"': '"ID"',
    r'"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9:.+]+"': '"TIME"',
    r'"package": "[^"]+"': '"package": "VERSION"',
}
REQUESTS = (
    "leaderboard/easy",
    "leaderboard/easy/maps?agent=greedy",
    "leaderboard/easy/runs",
    "paired/easy?a=greedy&b=random",
    "analyse/easy",
    "analyse/hard",
    "memory_logs",
    "episodes?task=easy&limit=2",
)


def printed(*arguments: str) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert main(list(arguments)) == 0
    return out.getvalue()


def outputs(data: Path) -> dict[str, list[str]]:
    """What is shown of the same flights everywhere, by name, in lines."""
    labels = [("greedy", 1), ("greedy", 2), ("random", 2), ("random", 3), ("greedy", 3), ("greedy", 3)]
    fill(data, [flown("easy", seed, agent) for agent, seed in labels])
    model = put_run(data, "model", "greedy", MAPS, repeats=2)
    waiting = put_run(data, "waiting", "WAIT", MAPS, model="waits")
    agents = [put_evaluation(data, agent, agent, MAPS, repeats=2) for agent in ("random", "greedy")]
    with Store(data) as store:
        store.listed(99)
    tasks = ("--task", "easy", "skyline_easy", "--seeds", "14:18")
    flyers = ("--agents", "random", "pathqnet", "optimal", "--repeats", "2", "--against", "random")
    evaluate = ("evaluate", *tasks, *flyers)
    board = ("leaderboard", *map(str, (model, waiting, *agents)))
    kept = str(data / "kept")
    found = {
        "evaluate --json": printed(*evaluate, "--json"),
        "evaluate": printed(*evaluate),
        "evaluate --out": printed("evaluate", "--task", "easy", "--agents", "random", "--seeds", "0:3", "--out", kept),
        "evaluation.json": (data / "kept" / "evaluation.json").read_text(),
        "pieces": "\n".join(sorted(path.name for path in (data / "kept" / "pieces").iterdir())),
        "leaderboard": printed(*board),
    }
    write_report(report(read_run(model)))
    found["report.json"] = (model / "report.json").read_text()
    with TestClient(create_app(Settings(data=data))) as client:
        answers = {path: client.get(f"/{path}").json() for path in REQUESTS}
    # Shipped results change with the agents.
    runs = answers["leaderboard/easy/runs"]
    runs["boards"] = [board for board in runs["boards"] if not board["rows"][0]["shipped"]]
    found |= {path: json.dumps(answer, indent=1) for path, answer in answers.items()}
    shown: dict[str, list[str]] = {}
    for name, text in found.items():
        for pattern, word in OF_THIS_RUN.items():
            text = re.sub(pattern, word, text)
        shown[name] = text.splitlines()
    return shown


@pytest.mark.feature("H5", "H7")
def test_what_people_read_stays_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))
    monkeypatch.chdir(tmp_path)
    shown = outputs(Path("data"))
    assert shown.keys() == golden.keys()
    for name, lines in golden.items():
        assert shown[name] == lines, name


if __name__ == "__main__":
    golden = GOLDEN.resolve()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        text = json.dumps(outputs(Path("data")), indent=0, ensure_ascii=False)
    golden.write_text(f"{text}\n", encoding="utf-8")
