"""The command line, as a user runs it."""

import json
import sys
from pathlib import Path
from textwrap import wrap

import numpy as np
import pytest
from PIL import Image

from drone_env.agents import pathqnet
from drone_env.agents.pathqnet import shipped_network
from drone_env.cli import main
from drone_env.commands.arguments import select_maps
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.planning.optimal import solve
from tests.tools import ran
from tests.toy import LOG_OF_MAP_14


def test_fly_to_the_byte_on_a_map_by_hand(capsysbinary: pytest.CaptureFixture[bytes]) -> None:
    assert main(["fly", "--task", "easy", "--agent", "greedy", "--seed", "14"]) == 0
    assert capsysbinary.readouterr().out == LOG_OF_MAP_14.format("greedy").encode()


def test_fly_shows_maps_and_saves_a_picture_beside_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "pictures" / "mission.png"
    assert main(["fly", "--task", "easy", "--seed", "1", "--render", "--picture", str(picture)]) == 0
    captured = capsys.readouterr()
    assert all(line.startswith(("[START]", "[STEP]", "[END]")) for line in captured.out.splitlines())
    assert captured.err.count("🚁") == captured.out.count("[STEP]") + 1
    assert np.asarray(Image.open(picture)).std() > 10


def test_maps_that_are_too_large_to_be_solved_are_flown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{row!r},".replace("'", '"') for row in ["· " * 6] * 4 + ["🔋" + "· " * 5])
    numbers = "deliveries = 16\nmax_steps = 200\nbattery_capacity = 30"
    (tmp_path / "full.toml").write_text(f"format = 1\n[task]\n{numbers}\n[terrain]\nrows = [{rows}]", "utf-8")
    task = ["--task", str(tmp_path / "full.toml")]
    assert main(["solve", *task, "--seed", "7"]) == 2
    assert "GB are allowed" in capsys.readouterr().err
    assert main(["evaluate", *task, "--agents", "greedy", "optimal", "--episodes", "2", "--json"]) == 0
    (figures,) = json.loads(capsys.readouterr().out)["tasks"].values()
    greedy, optimal = figures["agents"]["greedy"], figures["agents"]["optimal"]
    assert greedy["mean_score"] > 0
    assert greedy["mean_optimal_score"] is greedy["mean_regret"] is None
    assert optimal["mean_score"] is None
    assert "GB are allowed" in optimal["unsupported"]


def test_an_agent_that_cannot_fly_a_task_says_why_and_one_must_fly(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    network = f"pathqnet:{shipped_network(get_task('easy'))}"
    evaluate = ["evaluate", "--agents", "greedy", network, "--seeds", "3:4", "--json", "--task"]
    assert main([*evaluate, "skyline_easy", "easy"]) == 0
    tasks = json.loads(capsys.readouterr().out)["tasks"]
    assert "takes 5 values of telemetry" in tasks["skyline_easy"]["agents"][network]["unsupported"]
    assert "unsupported" not in tasks["easy_delivery"]["agents"][network]
    monkeypatch.setattr(pathqnet, "WEIGHTS", tmp_path)
    (tmp_path / "easy_delivery_v1.safetensors").write_text("no network")
    assert main(["evaluate", "--task", "easy", "--agents", "pathqnet", "--seeds", "3:4"]) == 2
    assert "is not an exported network" in " ".join(capsys.readouterr().err.split())


def test_solve_prints_a_flight_that_can_be_flown(capsys: pytest.CaptureFixture[str]) -> None:
    # The battery does not last for all four parcels.
    seed = next(seed for seed in range(1000) if solve("skyline_medium", seed).deliveries == 3)
    assert main(["solve", "--task", "skyline_medium", "--seed", str(seed)]) == 0
    shown = dict(line.split(": ", 1) for line in capsys.readouterr().out.splitlines() if ": " in line)
    episode = Episode("skyline_medium", seed=seed)
    order = [f"{stop}" for stop in (episode.position, *solve("skyline_medium", seed).order)]
    episode.fly(Action[name] for name in shown["Actions"].split())
    assert shown["Best score"] == f"{episode.score:.4f} with 3 of 4 delivered"
    assert (shown["Steps"], shown["Order"]) == (f"{episode.steps}", " -> ".join(order))


def test_the_maps_of_a_command() -> None:
    last = 2**53 - 1
    assert select_maps(f"{last}:{last + 1}", None, None, 200) == ("custom", range(last, last + 1))
    assert select_maps(None, None, None, 200) == ("test", split_seeds("test", 200))
    with pytest.raises(InvalidValueError, match=r"0 <= A < B <= 2\^53"):
        select_maps(f"{last}:{last + 2}", None, None, 200)


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        (["fly", "--task", "esy"], "did you mean 'easy'? allowed: city, city_small, easy, hard, medium, rush_easy"),
        (["evaluate", "--agents", "ace"], "beam, greedy, nearest, optimal, pathqnet, ppo, random"),
        (["evaluate", "--episodes", "0"], "at least 1"),
        (["evaluate", "--seeds", "5:5"], "A < B"),
        (["trian"], "unknown command 'trian'; did you mean 'train'?"),
        (["fly", "--record", "."], "--record"),
        (["fly", "--picture", "flight.gif"], "--picture takes a file that ends in .png, got flight.gif"),
        (["evaluate", "--against", "random", "--seeds", "3:4", "--task", "easy"], "two maps or more, got 1"),
        (["dataset", "--out", "set", "--epsilon", "2"], "0 to 1"),
        (["dataset", "--out", "set", "--agents", "greedy", "greedy"], "each once"),
        (["dataset", "--out", "set", "--prompt", "poem"], "unknown prompt 'poem'"),
        (["train", "--task", "all"], "add --algorithm tournet"),
        (["serve", "--port", "99999"], "--port: Input should be less than or equal to 65535"),
        ([], "name a command, such as fly"),
    ],
)
def test_what_is_not_allowed_exits_2_and_says_what_is(
    arguments: list[str],
    allowed: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DRONE_ENV_PORT", "")  # serve passes its options on by the environment
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert allowed in " ".join(captured.err.split())
    assert len(wrap(captured.err, 80)) <= 3
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["--help"], 0, "solve"),
        (["fly", "--help"], 0, "Example: drone-env"),
        (["solve", "--help"], 0, "(optional)"),
        (["train", "--gamma", "high"], 2, "could not convert string to float: 'high'"),
        (["train", "--algorithm", "tournet", "--preset", "original"], 2, "--preset"),
    ],
)
def test_help_is_a_manual_and_wrong_options_are_named(
    arguments: list[str], status: int, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == status
    assert text in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("output", "said"), [(">/dev/full", "drone-env: standard output: No space left on device\n"), ("| true", "")]
)
def test_an_output_that_cannot_be_written_is_an_error_of_one_line_at_most(output: str, said: str) -> None:
    done = ran("bash", "-c", f"set -o pipefail; {sys.executable} -m drone_env fly --help {output}")
    assert (done.returncode, done.stderr) == (2, said)


def test_what_needs_compiled_code_says_so_without_a_compiler() -> None:
    line = ("-m", "drone_env", "evaluate", "--task", "easy", "--agents", "greedy", "--episodes", "1")
    done = ran(sys.executable, *line, NUMBA_DISABLE_JIT="1")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.endswith("batches and planners need compiled code: unset it\n")


def test_a_terminal_without_emoji_shows_the_flight() -> None:
    line = ("-m", "drone_env", "fly", "--task", "skyline_easy", "--seed", "7", "--render")
    flown = ran(sys.executable, *line, PYTHONIOENCODING="ascii")
    assert "[END] success=" in flown.stdout
    assert flown.stderr.isascii()
