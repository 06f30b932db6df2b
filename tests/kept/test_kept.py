"""What earlier versions have left is read by this one, number for number. `make.py` makes a folder at each release.

A test that fails here has found users' files that this version cannot read: mend the reader, not the folder.
"""

import json
import shutil
from collections.abc import Generator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env import __version__
from drone_env.agents import make_agent
from drone_env.cli import main
from drone_env.core.actions import Action
from drone_env.core.tasks import TASKS, get_task
from drone_env.episodes.finished import StoredEpisode
from drone_env.episodes.jsonl import read_records
from drone_env.episodes.record import EpisodeRecord, load_record, replay
from drone_env.episodes.store import Store
from drone_env.errors import SessionGoneError
from drone_env.evaluation.episodes import episodes_key, summarise
from drone_env.evaluation.folder import ResultsFolder, evaluate_keys
from drone_env.planning.optimal import solve
from drone_env.server.app import create_app
from drone_env.server.settings import Settings

from . import make
from .flights import HERE, LETTERS, MANIFEST, digests, flight_of, flown, judged

VERSIONS = sorted(path.parent.name for path in HERE.glob(f"[0-9]*/{MANIFEST}"))


class Kept:
    """A copy of a version's folder, and what its maker had in memory."""

    def __init__(self, version: str, folder: Path) -> None:
        self.original = HERE / version
        self.folder = folder / version
        self.told: dict[str, Any] = json.loads((self.original / MANIFEST).read_bytes())

    def copy(self, name: str) -> Path:
        """An artefact, to do with as one likes."""
        return shutil.copytree(self.original / name, self.folder / name)


@pytest.fixture(params=VERSIONS)
def kept(request: pytest.FixtureRequest, tmp_path: Path) -> Generator[Kept, None, None]:
    found = Kept(request.param, tmp_path)
    yield found
    assert digests(found.original) == found.told["files"], "what an earlier version has left was changed"


def current(flight: dict[str, Any]) -> bool:
    """Whether the task of a flight has got no newer version since, under which its name flies other maps."""
    return TASKS[flight["task"]].version == flight["task_version"]


def as_flight(record: EpisodeRecord) -> dict[str, Any]:
    """A record, flown again and found to be true, as the manifest tells a flight."""
    return flight_of(replay(record), record.agent)


def without(flight: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in flight.items() if name not in names}


def test_this_version_has_left_its_own() -> None:
    assert __version__ in VERSIONS, f"make kept makes the folder of {__version__}"


def test_a_folder_that_is_there_is_not_written_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(make, "HERE", tmp_path)
    (tmp_path / __version__).mkdir()
    (tmp_path / __version__ / MANIFEST).write_text('{"version": "0.0.1"}')
    for arguments, told in (((), "--again before its release"), (("--again",), "of another version")):
        monkeypatch.setattr("sys.argv", ["make", *arguments])
        with pytest.raises(SystemExit, match=told):
            make.main()


# The store


def test_the_store_gives_every_flight_and_each_is_true(kept: Kept) -> None:
    told = [without(flight, "optimum") for flight in kept.told["store"]["flights"]]
    folder = kept.copy("store")
    written = json.loads((folder / "memory.json").read_bytes())["episodes"]
    shown = [StoredEpisode.model_validate_json(json.dumps(episode)) for episode in written]
    with Store(folder, clock=lambda: kept.told["store"]["clock"]) as store:
        with pytest.raises(SessionGoneError):
            store.read_session(kept.told["store"]["gone"])
        stored = list(store.episodes())
        assert shown == stored == store.latest(100)[::-1]
    assert [as_flight(episode.record) for episode in stored] == told
    assert [(e.outcome, e.reward_total, e.steps) for e in stored] == [
        (flight["outcome"], flight["reward_total"], len(flight["actions"])) for flight in told
    ]
    rewritten = json.loads((folder / "memory.json").read_bytes())["episodes"]
    assert [StoredEpisode.model_validate_json(json.dumps(episode)) for episode in rewritten] == stored


def test_the_server_tells_the_history_and_flies_the_sessions_to_their_end(kept: Kept) -> None:
    told = kept.told["store"]
    folder = kept.copy("store")
    with TestClient(create_app(Settings(data=folder), clock=lambda: told["clock"])) as client:
        listed = client.get("/episodes").json()["episodes"][::-1]
        names = ("task", "task_version", "seed", "agent", "reward_profile", "deliveries", "reward_total", "score",
                 "outcome")  # fmt: skip
        assert [{name: episode[name] for name in names} for episode in listed] == [
            {name: flight[name] for name in names} for flight in told["flights"]
        ]
        assert [episode["optimal_score"] for episode in listed] == [flight["optimum"] for flight in told["flights"]]
        for session in told["sessions"]:
            flight, steps = session["flight"], session["steps"]
            here, before = {"X-Session-Id": session["id"]}, flown(session["flight"], session["steps"])
            state = client.get("/state", headers=here).json()
            assert [point["action"] for point in state["path_history"]] == [
                Action(LETTERS.index(letter)).name for letter in flight["actions"][:steps]
            ]
            assert (state["task_name"], state["seed"], state["step_count"]) == (flight["task"], flight["seed"], steps)
            assert (state["drone_x"], state["drone_y"]) == before.position
            assert state["battery_steps_remaining"] == before.battery_units
            for letter in flight["actions"][steps:]:
                direction = Action(LETTERS.index(letter)).name
                seen = client.post("/step", json={"direction": direction}, headers=here).json()
            assert (seen["done"], seen["score"]) == (True, flight["score"])
            finished = client.get("/state", headers=here).json()["episode_id"]
            record = EpisodeRecord.model_validate(client.get(f"/episodes/{finished}").json())
            assert as_flight(record) == flight


# Networks and checkpoints


def test_the_network_values_and_flies_as_it_did(kept: Kept) -> None:
    told, network = kept.told["training"], kept.copy("training") / "easy.npz"
    task = get_task("easy_delivery", 1)
    agent: Any = make_agent(f"pathqnet:{network}", task)
    values = judged(lambda grids, telemetry: [agent.q_values({"grid": grids[0], "telemetry": telemetry[0]})],
                    told["seeds"])  # fmt: skip
    assert values == [pytest.approx(row, abs=1e-3) for row in told["values"]["best"]]
    for flight in told["flights"]:
        episode = flown(flight, 0)
        agent.reset(flight["seed"])
        while not episode.ended:
            episode.step(agent.act(episode.observation()))
        assert flight_of(episode, "pathqnet") == flight


def test_training_goes_on_from_the_checkpoint(kept: Kept, tmp_path: Path) -> None:
    from drone_env.rl.checkpoint import load_checkpoint
    from drone_env.rl.config import TrainConfig
    from drone_env.rl.run import TrainingRun
    from drone_env.rl.trainer import Trainer

    told, folder = kept.told["training"], kept.copy("training")
    before: dict[str, Any] = load_checkpoint(folder / "easy.pth")["config"]
    names = {field.name for field in fields(TrainConfig)} & before.keys() - {"task"}
    config = TrainConfig(**{name: before[name] for name in names}, task="easy", episodes=told["episodes"])
    run = TrainingRun(Trainer(config), folder, tmp_path / "curves")
    trainer = run.trainer
    assert run.resumed
    assert (trainer.episodes, trainer.steps, trainer.updates) == (told["episodes"], told["steps"], told["updates"])
    assert trainer.best_score == told["best_score"]
    assert [[line.episode, line.steps, line.updates, line.validation] for line in trainer.history] == told["history"]
    networks = {"online": trainer.online, "target": trainer.target, "best": trainer.best_network()}
    for name, network in networks.items():
        values = judged(lambda *seen, network=network: trainer.values(*seen, network), told["seeds"])
        assert values == [pytest.approx(row, abs=1e-3) for row in told["values"][name]], name
    # The same draws from the same replay, by the same moments: each loss is that of all the updates before it.
    for _ in told["next_losses"]:
        trainer.learn()
    assert trainer.losses[-3:] == pytest.approx(told["next_losses"], rel=1e-3)
    longer = TrainingRun(Trainer(replace(config, episodes=told["episodes"] + 4)), folder, tmp_path / "curves").trainer
    for _ in longer.train():
        pass
    assert longer.episodes == told["episodes"] + 4
    assert longer.updates > told["updates"]


@pytest.mark.long
def test_the_train_command_goes_on_from_the_checkpoint(
    kept: Kept, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told, folder = kept.told["training"], kept.copy("training")
    lines = (folder / "train.log").read_text().splitlines()
    more = ("--episodes", str(told["episodes"] + 4), "--data", str(folder), "--results", str(tmp_path))
    assert main(["train", "--task", "easy", "--resume", *more]) == 0
    assert f"{told['episodes']} of {told['episodes'] + 4} episodes" in " ".join(capsys.readouterr().err.split())
    assert (folder / "train.log").read_text().splitlines()[:-1] == lines


# Folders


def test_an_evaluation_is_shown_without_a_flight(kept: Kept) -> None:
    told, folder = kept.told["evaluation"]["tasks"], kept.copy("evaluation")
    keys = {
        (task, agent): episodes_key(get_task(task, figures["version"]), agent, range(*figures["seeds"]))
        for task, figures in told.items()
        for agent in figures["agents"]
    }

    def nobody(missing: Any) -> Any:
        raise AssertionError(f"{missing} would be flown again")

    results = evaluate_keys(list(keys.values()), nobody, ResultsFolder(folder, list(keys.values())))
    for (task, agent), key in keys.items():
        # Versions differ in how they compute the interval.
        figures, then = summarise(results[key]), told[task]["agents"][agent]
        assert figures | {"score_ci95": None} == then | {"score_ci95": None}


def test_runs_of_a_model_are_true_and_gone_on_with_without_a_call(
    kept: Kept, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, data = kept.told["runs"], kept.copy("store")
    kept.copy("llm")
    # What a call would meet: nobody listens there any more, and it would be tried once.
    monkeypatch.setenv("OPENAI_API_KEY", "sk-nothing")
    monkeypatch.chdir(kept.folder)
    for run in runs:
        folder = kept.folder / run["folder"]
        assert main(["replay", str(folder / "episodes.jsonl"), "--verify"]) == 0
        assert capsys.readouterr().out.count("verified: ") == len(run["flights"])
        assert [as_flight(record) for record in read_records(folder / "episodes.jsonl")] == run["flights"]
        assert main(["leaderboard", str(folder), "--json"]) == 0
        board = json.loads(capsys.readouterr().out)
        assert board["refused"] == []
        (row,) = board["boards"][0]["rows"]
        scores = [flight["score"] for flight in run["flights"]]
        assert row["score"] == pytest.approx(sum(scores) / len(scores), rel=1e-12)
        if not all(map(current, run["flights"])):
            continue
        calls = (folder / "calls.jsonl").read_bytes()
        where = ("--out", str(folder), "--data", str(data), "--resume", "--tries", "1")
        assert main([*run["command"], *where]) == 0
        assert capsys.readouterr().out == run["log"]
        assert (folder / "calls.jsonl").read_bytes() == calls
    with Store(data) as store:
        assert len(list(store.episodes())) == len(kept.told["store"]["flights"]), "flights are kept once"


def test_a_sweep_is_told_again(kept: Kept) -> None:
    from drone_env.cluster.sweep.driver import is_done
    from drone_env.cluster.sweep.folder import SweepFolder
    from drone_env.cluster.sweep.report import sweep_report
    from drone_env.reports.pages import render

    told, folder = kept.told["sweep"], SweepFolder(kept.copy("sweep"))
    config = folder.config()
    assert is_done(folder, config)
    figures = sweep_report(folder, config)
    assert figures["trials_by_status"] == {"finished": 1, "stopped": 1, "failed": 0, "unfinished": 0}
    best, other = figures["settings"]
    assert [best["values"]["learning_rate"], other["values"]["learning_rate"]] == [1e-3, 1e-6]
    for setting, rungs in zip((best, other), told["rungs"], strict=True):
        reached = {rung: rungs[rung] for rung in setting["validation"]}
        assert setting["validation"] == pytest.approx(reached, abs=1e-12)
    assert best["validation"].keys() == told["rungs"][0].keys()
    first, trial = told["first"], figures["trials"][0]
    assert {name: trial[name] for name in ("steps", "updates", "validation_score", "network")} == {
        name: first[name] for name in ("steps", "updates", "validation_score", "network")
    }
    assert best["test"]["seed_scores"] == [pytest.approx(sum(first["test_scores"]) / 20, rel=1e-12)]
    assert trial["parts"] >= 1
    assert trial["name"] in render("sweep.md", **figures)


@pytest.mark.long
def test_the_sweep_command_trains_nothing_again(kept: Kept) -> None:
    folder = kept.copy("sweep")
    before = json.loads((folder / "report.json").read_bytes())
    # An address at which there is no cluster: none is asked for.
    assert main([*kept.told["sweep"]["command"], "--address", "127.0.0.1:1", "--out", str(folder)]) == 0
    after = json.loads((folder / "report.json").read_bytes())
    after["config"] = {name: after["config"][name] for name in before["config"]}
    assert {name: after[name] for name in before} == before


# Flights in files


def test_recorded_flights_are_verified(kept: Kept, capsys: pytest.CaptureFixture[str]) -> None:
    told, folder = kept.told["records"], kept.copy("records")
    alone, together = folder / "flight.json", folder / "flights.jsonl"
    assert [as_flight(record) for record in read_records(together)] == told
    assert as_flight(load_record(alone)) in told
    for file in (alone, together):
        assert main(["replay", str(file), "--verify"]) == 0
    ends = [f"map {f['seed']}, {len(f['actions'])} rewards, score {f['score']!r}" for f in told]
    lines = capsys.readouterr().out.splitlines()[1:]
    assert [line.endswith(end) for line, end in zip(lines, ends, strict=True)] == [True] * len(told)


def test_a_data_set_holds_the_flights_and_their_exact_values(kept: Kept) -> None:
    import pyarrow.parquet

    told = kept.told["dataset"]
    table = pyarrow.parquet.read_table(kept.copy("dataset") / "steps.parquet")
    assert table.column_names == told["columns"]
    rows: list[dict[str, Any]] = table.to_pylist()
    assert len(rows) == sum(len(flight["actions"]) for flight in told["flights"])
    for number, flight in enumerate(told["flights"]):
        steps = [row for row in rows if row["episode"] == number]
        assert "".join(LETTERS[row["action"]] for row in steps) == flight["actions"]
        episode = flown(flight, 0)
        for row, values in zip(steps, flight["q_values"], strict=True):
            seen = episode.observation()
            assert (row["task"], row["task_version"], row["seed"], row["agent"]) == (
                flight["task"], flight["task_version"], flight["seed"], flight["agent"]
            )  # fmt: skip
            assert row["grid"] == seen["grid"].ravel().tolist()
            assert row["telemetry"] == seen["telemetry"].tolist()
            assert row["action_mask"] == episode.action_mask().tolist()
            assert row["q_values"] == values
            assert row["reward"] == episode.step(row["action"])
            assert (row["score"], row["terminated"]) == (episode.score, episode.ended)
            assert (row["final_score"], row["optimal_score"]) == (flight["score"], flight["optimum"])
        assert flight_of(episode, flight["agent"]) == without(flight, "optimum", "q_values")
        assert solve(episode.task, flight["seed"]).score == flight["optimum"]
