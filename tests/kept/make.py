"""Makes the folder of this version that every later version has to read: `make kept`, in two minutes.

When: at each release, after its version is in `drone_env/__init__.py` and before its tag. `make kept ARGS=--again`
makes it anew as long as the version is not handed out. From then on the folder is never changed, like all before it.

Each artefact is made by the program's own commands, or over its server. What the tests compare it with stands in
`manifest.json`: numbers of episodes, trainers and tables in memory, flown or trained here beside the commands, none
read back from an artefact. Left out is what nobody reads again: checkpoints, networks and pictures of the sweep, and
the server's log of requests. In `parts.jsonl` the name of the machine is replaced.
"""

import argparse
import contextlib
import io
import json
import os
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from drone_env import __version__
from drone_env.cli import main as run_program
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.planning.optimal import solve
from tests.kept.flights import HERE, LETTERS, MANIFEST, digests, flight_of, fly, fly_surely, judged

ROOT = HERE.parents[1]

STORED = (
    ("easy", 14, "optimal", "tiered"),
    ("medium", 7, "greedy", "composite"),
    ("hard", 7, "optimal", "aligned"),
    ("hard", 8, "random", "tiered"),
    ("skyline_easy", 3, "optimal", "tiered"),
    ("skyline_medium", 3, "greedy", "aligned"),
    ("skyline_hard", 3, "greedy", "tiered"),
)
"""Flights over the server: task, map, agent, reward profile."""
IN_FLIGHT = (("medium", 11, "greedy", "tiered", 9), ("skyline_medium", 5, "optimal", "aligned", 5))
"""Sessions that the server is stopped under, and after how many steps."""
CLOCK = 1_800_000_000.0
"""By which the sessions of the store were used, in seconds since 1970."""
RECORDED = (
    ("easy", 14, "greedy"),
    ("hard", 9, "pathqnet"),
    ("skyline_easy", 4, "optimal"),
    ("skyline_hard", 4, "random"),
)
EVALUATED = ("--task", "easy", "skyline_easy", "--agents", "random", "greedy", "--seeds", "0:12")
TRAINED = {
    "num_threads": 1,
    "num_envs": 8,
    "batch_size": 16,
    "replay_size": 400,
    "learning_starts": 50,
    "steps_per_update": 8.0,
    "validation_every": 40,
    "validation_maps": 5,
    "log_every": 40,
}
"""A small replay; what makes the checkpoint large are three networks and the two moments of Adam, 0.3 MB each."""
EPISODES = 200
SWEPT = ("num_envs=8", "batch_size=16", "replay_size=400", "learning_starts=50", "steps_per_update=8",
         "validation_every=10", "validation_maps=5", "log_every=5", "episodes=40", "lr=1e-3,1e-6")  # fmt: skip
SWEEP = ("--task", "easy", "--seeds", "1", "--test-maps", "20", *(word for text in SWEPT for word in ("--set", text)))
SAID = {"role": "assistant", "content": "Up, I think"}
UNUSABLE = json.dumps({"choices": [{"index": 0, "message": SAID, "finish_reason": "stop"}]})
CALLED = (
    ("text", {"pilot": "greedy", "faults": [[1, 1, {"status": 500}], [3, 3, {"sends": UNUSABLE}]]},
     ("--task", "easy", "--seeds", "14:17")),
    ("json", {"pilot": "greedy"}, ("--task", "skyline_easy", "--seeds", "3:4", "--answers", "json", "--history", "2")),
)  # fmt: skip
"""Runs of a scripted model: name, script, options."""
DATA_SET = {"task": "skyline_easy", "maps": 2, "agents": ("optimal", "random"), "epsilon": 0.2}


# The artefacts


def program(*arguments: str) -> str:
    """Run `drone-env` here, and return what it printed.

    Raises:
        SystemExit: if it failed.
    """
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        status = run_program(list(arguments))
    if status:
        raise SystemExit(f"drone-env {' '.join(arguments)} ended with {status}")
    return told.getvalue()


def make_runs(folder: Path) -> list[dict[str, Any]]:
    """Runs of a language model; their flights go to the store too."""
    from tests.llm.conftest import serving_scripts, tell

    runs: list[dict[str, Any]] = []
    with serving_scripts() as url:
        for name, script, options in CALLED:
            tell(f"{url}/{name}", {"log": os.devnull, **script})
            where = ["--base-url", f"{url}/{name}/v1", "--model", f"scripted-{name}", *options, "--concurrency", "1"]
            words = ["infer", *where, "--no-report", "--backoff", "0.01"]
            log = program(*words, "--data", str(folder / "store"), "--out", str(folder / "llm" / name))
            flights: list[dict[str, Any]] = []
            for number, lines in enumerate(log.split("[START]")[1:]):
                start = int(options[options.index("--seeds") + 1].partition(":")[0])
                episode = Episode(options[1])
                episode.reset(start + number)
                for line in lines.splitlines():
                    if line.startswith("[STEP]"):
                        episode.step(Action[line.partition("action=")[2].split()[0]])
                flights.append(flight_of(episode, f"scripted-{name}"))
            runs.append({"folder": f"llm/{name}", "command": words, "log": log, "flights": flights})
    return runs


def make_store(folder: Path, told: list[dict[str, Any]]) -> dict[str, Any]:
    """A server's data folder: finished flights (after those of `told`), sessions in mid-flight, one that is gone."""
    from starlette.testclient import TestClient

    from drone_env.server.app import create_app
    from drone_env.server.settings import Settings

    flights, sessions = [dict(flight) for flight in told], []
    with TestClient(create_app(Settings(data=folder / "store"), clock=lambda: CLOCK)) as client:

        def ask(method: str, path: str, session: str, body: Any = None) -> Any:
            answer = client.request(method, path, json=body, headers={"X-Session-Id": session})
            answer.raise_for_status()
            return answer.json() if answer.content else None

        def start(flight: dict[str, Any], steps: int) -> str:
            named = {"task_name": flight["task"], "reward_profile": flight["reward_profile"]}
            session = ask("POST", "/reset", "new", {**named, "seed": flight["seed"], "agent": flight["agent"]})
            for letter in flight["actions"][:steps]:
                ask("POST", "/step", session["session_id"], {"direction": Action(LETTERS.index(letter)).name})
            return session["session_id"]

        for task, seed, agent, profile in STORED:
            flights.append(fly(task, seed, agent, profile))
            session = start(flights[-1], len(flights[-1]["actions"]))
            ask("DELETE", "/session", session)
        for task, seed, agent, profile, steps in IN_FLIGHT:
            flight = fly(task, seed, agent, profile)
            sessions.append({"id": start(flight, steps), "steps": steps, "flight": flight})
        for flight in flights:
            flight["optimum"] = solve(get_task(flight["task"], flight["task_version"]), flight["seed"]).score
        # The store solves the maps in a thread of its own, and keeps what it has found.
        deadline = time.monotonic() + 300
        while any(episode["optimal_score"] is None for episode in ask("GET", "/episodes", session)["episodes"]):
            if time.monotonic() > deadline:
                raise SystemExit("the optima of the stored maps are not known after 5 minutes")
            time.sleep(0.2)
    return {"clock": CLOCK, "flights": flights, "sessions": sessions, "gone": session}


def make_training(folder: Path, elsewhere: Path) -> dict[str, Any]:
    """A checkpoint with the network beside it, and what the same training comes to in memory."""
    from drone_env.rl.config import preset
    from drone_env.rl.trainer import Trainer

    flags = [word for name, value in TRAINED.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    command = ["train", "--task", "easy", *flags]
    place = ("--data", str(folder / "training"), "--results", str(elsewhere / "curves"))
    program(*command, "--episodes", str(EPISODES), *place)
    trainer = Trainer(replace(preset("fast", "easy", EPISODES), **TRAINED))
    for _ in trainer.train():
        pass
    seeds = list(split_seeds("test", 12))
    best = trainer.best_network()
    networks = {"online": trainer.online, "target": trainer.target, "best": best}
    kept: dict[str, Any] = {
        "command": command,
        "episodes": trainer.episodes,
        "steps": trainer.steps,
        "updates": trainer.updates,
        "best_score": trainer.best_score,
        "history": [[line.episode, line.steps, line.updates, line.validation] for line in trainer.history],
        "seeds": seeds,
        "values": {
            name: judged(lambda *seen, network=network: trainer.values(*seen, network), seeds)
            for name, network in networks.items()
        },
        "flights": fly_surely(lambda *seen: trainer.values(*seen, best)),
    }
    for _ in range(3):
        trainer.learn()
    return {**kept, "next_losses": trainer.losses[-3:]}


def make_sweep(folder: Path, elsewhere: Path) -> dict[str, Any]:
    """A sweep of two settings, the worse of which is stopped early, and what its trainings come to in memory."""
    from drone_env.cluster.sweep.config import Trial, make_config
    from drone_env.cluster.sweep.halving import rungs
    from drone_env.cluster.sweep.settings import settings_of
    from drone_env.cluster.sweep.trial import best_until, network_digest
    from drone_env.evaluation.episodes import episodes_key, run_episodes
    from drone_env.rl.checkpoint import export_network
    from drone_env.rl.trainer import Trainer

    made = elsewhere / "sweep"
    program("sweep", *SWEEP, "--cpus", "1", "--checkpoint-seconds", "0", "--out", str(made))
    for path in sorted(made.rglob("*")):
        if path.name in ("sweep.json", "stopped.json", "trial.json", "parts.jsonl", "report.json", "report.md"):
            target = folder / "sweep" / path.relative_to(made)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        if path.name == "parts.jsonl":
            parts = [json.loads(line) for line in path.read_text().splitlines()]
            target.write_text("".join(f"{json.dumps({**part, 'host': 'localhost'})}\n" for part in parts))

    config = make_config("easy", "fast", settings_of(SWEPT), 1, 1, True, 20)
    trials: list[dict[str, Any]] = []
    for number in range(2):
        trainer = Trainer(config.training(Trial(number, 0)))
        for _ in trainer.train():
            pass
        trials.append({str(rung): best_until(trainer.history, rung) for rung in rungs(config)})
        if number == 0:
            network = elsewhere / "first.npz"
            export_network(trainer.best_network(), network, {"telemetry_size": trainer.task.telemetry_size})
            flights = run_episodes(episodes_key("easy", f"pathqnet:{network}", split_seeds("test", 20), "test"))
            first = {"steps": trainer.steps, "updates": trainer.updates, "validation_score": trainer.best_score}
            first |= {"network": network_digest(network), "test_scores": flights.scores.tolist()}
    return {"command": ["sweep", *SWEEP], "rungs": trials, "first": first}


def make_evaluation(folder: Path) -> dict[str, Any]:
    """The folder of an evaluation, and the figures that its command tells."""
    told = program("evaluate", *EVALUATED, "--out", str(folder / "evaluation"), "--json", "-")
    return {"command": ["evaluate", *EVALUATED], "tasks": json.loads(told)["tasks"]}


def make_records(folder: Path) -> list[dict[str, Any]]:
    """Files of flights: one alone, and all of them line by line."""
    (folder / "records").mkdir()
    for task, seed, agent in RECORDED:
        which = ("fly", "--task", task, "--seed", str(seed), "--agent", agent, "--record")
        program(*which, str(folder / "records" / "flights.jsonl"))
        if task == "skyline_easy":
            program(*which, str(folder / "records" / "flight.json"))
    return [fly(*flight) for flight in RECORDED]


def make_data_set(folder: Path) -> dict[str, Any]:
    """A data set as Parquet, and the flights that it is made of. (Minari's takes 50 KB a flight.)"""
    from drone_env.datasets.columns import columns
    from drone_env.datasets.config import dataset_config
    from drone_env.datasets.trajectories import fly_map

    task, agents = get_task(str(DATA_SET["task"])), DATA_SET["agents"]
    maps, epsilon = int(DATA_SET["maps"]), float(DATA_SET["epsilon"])
    options = ("--task", task.short_name, "--maps", str(maps), "--agents", *agents, "--epsilon", str(epsilon))
    program("dataset", *options, "--formats", "parquet", "--out", str(folder / "dataset"))
    config = dataset_config(task, split_seeds("train", maps), "train", agents, epsilon)
    flights: list[dict[str, Any]] = []
    for seed in config.seeds:
        for flight in fly_map(config, seed):
            episode = Episode(task, config.reward_profile)
            episode.reset(seed)
            for action in flight.actions.tolist():
                episode.step(action)
            exact = {"optimum": float(flight.values[0]), "q_values": flight.q_values.tolist()}
            flights.append({**flight_of(episode, flight.agent), **exact})
    return {"columns": [column.name for column in columns(task)], "flights": flights}


def make(folder: Path) -> None:
    """Make everything in an empty folder."""
    with tempfile.TemporaryDirectory() as elsewhere:
        runs = make_runs(folder)
        manifest = {
            "version": __version__,
            "runs": runs,
            "store": make_store(folder, [flight for run in runs for flight in run["flights"]]),
            "training": make_training(folder, Path(elsewhere)),
            "sweep": make_sweep(folder, Path(elsewhere)),
            "evaluation": make_evaluation(folder),
            "records": make_records(folder),
            "dataset": make_data_set(folder),
        }
    named = [path for path in folder.rglob("*") if path.is_file() and bytes(folder.parent) in path.read_bytes()]
    if named:
        raise SystemExit(f"{named[0]} names a folder of this machine")
    manifest["files"] = digests(folder)
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Make the folder of this version, and say what is in it."""
    parser = argparse.ArgumentParser(description="Make what every later version has to read.")
    parser.add_argument(
        "--again", action="store_true", help="in place of the folder of this version, not handed out yet"
    )
    again = parser.parse_args().again
    target = HERE / __version__
    if target.exists() and not again:
        raise SystemExit(f"{target} is there: later versions have to read it as it is (--again before its release)")
    if target.exists() and json.loads((target / MANIFEST).read_bytes())["version"] != __version__:
        raise SystemExit(f"{target} is of another version: it is never changed")
    # The workers of the sweep find this checkout by it.
    os.environ["PYTHONPATH"] = str(ROOT)
    with tempfile.TemporaryDirectory(prefix=".", suffix=".part", dir=HERE) as temporary:
        folder = Path(temporary) / __version__
        folder.mkdir()
        make(folder)
        if target.exists():
            target.rename(Path(temporary) / "before")
        folder.rename(target)
    sizes: dict[str, int] = {}
    for path in target.rglob("*"):
        if path.is_file():
            part = path.relative_to(target).parts[0]
            sizes[part] = sizes.get(part, 0) + path.stat().st_size
    for part, size in sorted(sizes.items()):
        print(f"{size / 1000:8.1f} KB  {part}")
    print(f"{sum(sizes.values()) / 1000:8.1f} KB  {target.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
