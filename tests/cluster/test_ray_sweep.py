"""Sweeps on a Ray cluster: nothing is lost or done twice, whatever is killed."""

import json
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drone_env.agents.pathqnet import load_network
from drone_env.cli import main
from drone_env.cluster.sweep.config import Trial
from drone_env.cluster.sweep.driver import is_done
from drone_env.cluster.sweep.folder import SweepFolder
from drone_env.cluster.sweep.trial import network_digest
from tests.llm.conftest import ROOT, wait_until, whole_lines

from .test_sweep import SMALL

pytestmark = [pytest.mark.long, pytest.mark.timeout(1200)]


def command(out: Path, address: str, *more: str) -> list[str]:
    sets = [word for text in (*SMALL, "episodes=80", "lr=1e-3,1e-6") for word in ("--set", text)]
    return ["sweep", "--task", "easy", "--seeds", "1", *sets, "--no-early-stopping", "--test-maps", "20",
            "--checkpoint-seconds", "0.1", "--address", address, "--out", str(out), *more]  # fmt: skip


def drive(out: Path, address: str, *more: str) -> "subprocess.Popen[bytes]":
    """A driver in a process of its own."""
    words = [sys.executable, "-m", "drone_env.cli", *command(out, address, *more)]
    with (out.parent / "driver.log").open("ab") as log:
        return subprocess.Popen(words, stdout=log, stderr=log, env={**os.environ, "PYTHONPATH": str(ROOT)})


def test_trials_that_no_node_has_the_cpus_for_are_refused(
    tmp_path: Path, cluster: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command(tmp_path / "sweep", cluster.address, "--cpus-per-trial", "2")) == 2
    assert "no node of the cluster offers 2 CPUs at once: the most that one has are 1" in capsys.readouterr().err


def test_killed_drivers_and_workers_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cluster: Any
) -> None:
    """A worker is killed, then the driver; the same command ends the sweep with the networks of uninterrupted runs."""
    out = tmp_path / "sweep"
    folder = SweepFolder(out)
    driver = drive(out, cluster.address)
    try:
        log, checkpoint = (folder.folder(Trial(0, 0)) / name for name in ("train.log", "easy.pth"))
        wait_until(lambda: any(line.startswith("episode=10 ") for line in whole_lines(log)), driver)
        logged = log.stat().st_mtime
        wait_until(lambda: checkpoint.exists() and checkpoint.stat().st_mtime > logged, driver)
        os.kill(folder.parts(Trial(0, 0))[-1]["pid"], signal.SIGKILL)
        wait_until(lambda: len(folder.parts(Trial(0, 0))) == 2, driver)
    finally:
        driver.kill()
        driver.wait()
    config = folder.config()
    assert not is_done(folder, config)
    before = {trial: folder.state(trial) for trial in config.trials()}
    driver = drive(out, cluster.address)
    try:
        assert driver.wait(540) == 0, (tmp_path / "driver.log").read_text()
    finally:
        driver.kill()
        driver.wait()
    figures = json.loads((out / "report.json").read_text())
    assert figures["trials_by_status"] == {"finished": 2, "stopped": 0, "failed": 0, "unfinished": 0}
    for trial, state in before.items():
        assert state.status == "unfinished" or folder.state(trial) == state
        # Each episode is on the log once, and no part began before what an earlier one had kept.
        lines = [line.split()[0] for line in whole_lines(folder.folder(trial) / "train.log")]
        assert lines == [f"episode={n}" for n in range(5, 81, 5)]
        begun = [part["episodes"] for part in folder.parts(trial)]
        assert begun == sorted(begun)
        assert begun[0] == 0
    assert folder.parts(Trial(0, 0))[1]["episodes"] >= 10
    assert figures["trials"][0]["parts"] >= 3
    for name in ("report.md", "curves.png", "scores.png"):
        assert (out / name).stat().st_size > 500
    assert not list(out.glob("tune-*"))

    # The command of the report trains the same network alone.
    monkeypatch.chdir(tmp_path)
    words = shlex.split(figures["trials"][0]["command"])
    assert words[:2] == ["python", "train.py"]
    assert main(["train", *words[2:]]) == 0
    alone, own = Path("alone/setting0-seed0/easy.safetensors"), folder.folder(Trial(0, 0)) / "easy.safetensors"
    assert network_digest(alone) == network_digest(own) == figures["trials"][0]["network"]
    assert load_network(alone).metadata["updates"] == figures["trials"][0]["updates"]

    # A finished sweep is only told again: nothing is trained, and no cluster is asked for.
    parts = {trial: folder.parts(trial) for trial in config.trials()}
    assert main(command(out, "127.0.0.1:1")) == 0
    assert {trial: folder.parts(trial) for trial in config.trials()} == parts
    assert json.loads((out / "report.json").read_text()) == figures
