"""Evaluation on a Ray cluster: the figures of the local run, whatever happens to nodes."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drone_env.agents.pathqnet import shipped_network
from drone_env.cli import main
from drone_env.core.tasks import get_task
from tests.same import assert_same
from tests.tools import ROOT, eventually, ran
from tests.toy import PLUGIN_OF_HOPS

from .conftest import MEMORY

pytestmark = [pytest.mark.long, pytest.mark.timeout(36_000)]


def contents(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """Every array that an evaluation brought, by piece."""
    return {file.name: dict(np.load(file)) for file in (folder / "pieces").iterdir()}


def arguments(folder: Path, *more: str) -> list[str]:
    maps = ("--task", "easy", "--seeds", "0:2500")
    return ["evaluate", *maps, "--out", str(folder / "results"), *more]


def test_a_node_killed_in_the_middle_changes_nothing(cluster: Any, tmp_path: Path) -> None:
    local, on_ray = tmp_path / "local", tmp_path / "ray"
    network = tmp_path / "mine.safetensors"
    shutil.copy(shipped_network(get_task("easy")), network)
    for folder in (local, on_ray):
        folder.mkdir()
    agent = f"pathqnet:{network}"
    assert main(arguments(local, "--agents", agent)) == 0
    expected = contents(local / "results")

    def kill_a_node() -> int:
        eventually(lambda: [*on_ray.glob("results/pieces/*.npz")])
        cluster.remove_node(next(iter(cluster.worker_nodes)), allow_graceful=False)
        return len([*on_ray.glob("results/pieces/*.npz")])

    with ThreadPoolExecutor() as threads:
        there = threads.submit(kill_a_node)
        assert main(arguments(on_ray, "--agents", agent, "--ray", cluster.address)) == 0
    cluster.add_node(num_cpus=1, object_store_memory=MEMORY)
    assert there.result() < len(expected), "all was done before the node was killed"
    assert_same(contents(on_ray / "results"), expected)


def drone_env(*words: str, cwd: Path = ROOT, **variables: str) -> "subprocess.CompletedProcess[str]":
    return ran(sys.executable, "-m", "drone_env.cli", *words, cwd=cwd, **variables)


def test_a_driver_without_the_token_is_refused(cluster: Any) -> None:
    words = ["evaluate", "--task", "easy", "--episodes", "1", "--ray", cluster.address]
    for token in ("", "0" * 64):
        done = drone_env(*words, HOME="/nonexistent", RAY_AUTH_TOKEN=token)
        assert (done.returncode, done.stdout) == (2, "")
        assert "RAY_AUTH_TOKEN" in done.stderr.splitlines()[-1]


def test_a_task_of_a_plugin_is_flown_on_nodes_that_have_the_plugin(tmp_path: Path, cluster: Any) -> None:
    (tmp_path / "cluster_hops.py").write_text(PLUGIN_OF_HOPS)
    words = ["evaluate", "--task", "hops", "--seeds", "0:40", "--agents", "greedy", "--json"]
    on_ray = [*words, "--ray", cluster.address]
    plugged = {"DRONE_ENV_PLUGINS": "cluster_hops", "PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"}
    # The nodes look into the folder that the driver was started in, and were themselves started without this path.
    refused = drone_env(*on_ray, **plugged)
    assert refused.returncode == 2
    assert "lacks a plugin of the driver" in refused.stderr
    assert "cluster_hops" in refused.stderr
    local, far = (drone_env(*these, cwd=tmp_path, **plugged) for these in (words, on_ray))
    assert (local.returncode, far.returncode) == (0, 0), far.stderr
    assert far.stdout == local.stdout
