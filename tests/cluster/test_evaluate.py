"""Evaluation on a Ray cluster: the figures of the local run, whatever happens to nodes."""

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drone_env.agents.pathqnet import shipped_network
from drone_env.cli import main
from drone_env.cluster.connect import connect
from drone_env.cluster.nodes import check_node, this_driver
from drone_env.core.tasks import get_task
from drone_env.errors import ClusterError
from tests.llm.conftest import ROOT

from .conftest import MEMORY

TASK = os.environ.get("DRONE_ENV_CLUSTER_TASK", "easy")
MAPS = int(os.environ.get("DRONE_ENV_CLUSTER_MAPS", "3500"))


def contents(folder: Path) -> dict[str, list[np.ndarray]]:
    """Every array that an evaluation brought, by piece."""
    found = {}
    for file in sorted((folder / "pieces").iterdir()):
        with np.load(file) as arrays:
            found[file.name] = [arrays[name] for name in sorted(arrays.files)]
    return found


def arguments(folder: Path, *more: str) -> list[str]:
    maps = ("--task", TASK, "--seeds", f"0:{MAPS}", "--agents", "pathqnet")
    return ["evaluate", *maps, "--out", str(folder / "results"), "--json", str(folder / "figures.json"), *more]


@pytest.mark.timeout(36_000)
def test_a_node_killed_in_the_middle_changes_nothing(cluster: Any, tmp_path: Path) -> None:
    local, on_ray = tmp_path / "local", tmp_path / "ray"
    # The network lies where nodes of another machine would not find it under this name.
    network = tmp_path / "mine.npz"
    shutil.copy(shipped_network(get_task(TASK)), network)
    for folder in (local, on_ray):
        folder.mkdir()
    assert main(arguments(local, "--checkpoint", str(network))) == 0
    killed: list[int] = []

    def kill_a_node() -> None:
        while not list((on_ray / "results").glob("pieces/*.npz")):
            time.sleep(0.01)
        killed.append(len(list((on_ray / "results").glob("pieces/*.npz"))))
        cluster.remove_node(next(iter(cluster.worker_nodes)), allow_graceful=False)

    killer = threading.Thread(target=kill_a_node, daemon=True)
    killer.start()
    status = main(arguments(on_ray, "--checkpoint", str(network), "--engine", "ray", "--address", cluster.address))
    killer.join(60)
    cluster.add_node(num_cpus=1, object_store_memory=MEMORY)
    assert status == 0
    assert killed[0] < len(contents(local / "results"))
    assert (on_ray / "figures.json").read_bytes() == (local / "figures.json").read_bytes()
    flown, expected = contents(on_ray / "results"), contents(local / "results")
    assert flown.keys() == expected.keys()
    for name, arrays in expected.items():
        for ours, theirs in zip(flown[name], arrays, strict=True):
            assert (ours.dtype, ours.tobytes()) == (theirs.dtype, theirs.tobytes())


def test_a_driver_without_the_token_is_refused(cluster: Any) -> None:
    command = [sys.executable, "-m", "drone_env.cli", "evaluate", "--task", "easy", "--episodes", "1"]
    for token in (None, "0" * 64):
        environment = {name: value for name, value in os.environ.items() if name != "RAY_AUTH_TOKEN"}
        environment |= {"PYTHONPATH": str(ROOT), "HOME": "/nonexistent"} | ({"RAY_AUTH_TOKEN": token} if token else {})
        done = subprocess.run(
            [*command, "--engine", "ray", "--address", cluster.address],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=200,
        )
        assert (done.returncode, done.stdout) == (2, "")
        assert "RAY_AUTH_TOKEN" in done.stderr.splitlines()[-1]


def test_where_nobody_listens_and_what_is_no_address(capsys: pytest.CaptureFixture[str]) -> None:
    evaluate = ["evaluate", "--task", "easy", "--episodes", "1"]
    for address, said in (("127.0.0.1:9", "no cluster"), ("here", "HOST:PORT"), ("", "HOST:PORT")):
        assert main([*evaluate, "--engine", "ray", "--address", address]) == 2
        assert said in capsys.readouterr().err
    assert main([*evaluate, "--address", "auto"]) == 2
    assert "--engine ray" in capsys.readouterr().err


def test_a_cluster_that_does_not_start_in_time_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    import ray

    tries: list[str] = []

    def time_out(address: str, **options: object) -> None:
        tries.append(address)
        # This and nothing more is what Ray raises.
        raise Exception("The current node timed out during startup.")

    monkeypatch.setattr(ray, "init", time_out)
    with pytest.raises(ClusterError, match=r"in 3 tries: The current node timed out"), connect(cpus=1):
        pass
    assert tries == ["local"] * 3


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setenv("RAY_AUTH_TOKEN", "none is made")
    assert main(["evaluate", "--task", "easy", "--episodes", "1", "--engine", "ray"]) == 2
    assert "pip install -e '.[cluster]'" in capsys.readouterr().err


def test_a_node_with_another_package_is_refused() -> None:
    driver = this_driver()
    check_node(driver)
    with pytest.raises(ClusterError, match="make them equal"):
        check_node(dataclasses.replace(driver, identity=driver.identity.replace("drone-env", "drone-env 0.0")))


def test_a_task_of_a_plugin_is_flown_on_nodes_that_have_the_plugin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cluster: Any
) -> None:
    task = "replace(get_task('easy'), id='hops', short_name='hops', grader='drone_env.graders:grade_hops')"
    (tmp_path / "cluster_hops.py").write_text(
        "from dataclasses import replace\nfrom drone_env.core.tasks import get_task\n"
        f"from drone_env.registry import register_task\nregister_task({task})\n"
    )
    monkeypatch.setenv("DRONE_ENV_PLUGINS", "cluster_hops")
    command = [sys.executable, "-m", "drone_env.cli", "evaluate", "--task", "hops", "--seeds", "0:40", "--agents",
               "greedy", "--json", "-"]  # fmt: skip
    on_ray = [*command, "--engine", "ray", "--address", cluster.address]

    def run(words: list[str], **options: Any) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(words, capture_output=True, text=True, check=False, **options)

    # The nodes look into the folder that the driver was started in, and were themselves started without this path.
    refused = run(on_ray, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert refused.returncode == 2
    assert "lacks a plugin of the driver's" in refused.stderr
    assert "cluster_hops" in refused.stderr
    local, far = run(command, cwd=tmp_path), run(on_ray, cwd=tmp_path)
    assert (local.returncode, far.returncode) == (0, 0), far.stderr
    assert far.stdout == local.stdout


def test_an_evaluation_goes_on_where_it_was_stopped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, figures = tmp_path / "results", tmp_path / "figures.json"
    command = ["evaluate", "--task", "easy", "--seeds", "0:2500", "--agents", "greedy", "--out", str(folder)]
    assert main([*command, "--json", str(figures)]) == 0
    whole = json.loads(figures.read_text())
    pieces = sorted((folder / "pieces").iterdir())
    assert len(pieces) == 3
    kept = [piece.stat().st_mtime_ns for piece in pieces]
    pieces[1].unlink()
    assert main([*command, "--json", str(figures)]) == 0
    assert json.loads(figures.read_text()) == whole
    now = [piece.stat().st_mtime_ns for piece in pieces]
    assert (now[0], now[2]) == (kept[0], kept[2])
    capsys.readouterr()
    pieces[2].write_bytes(pieces[2].read_bytes()[:-30])
    assert main(command) == 2
    assert "is damaged, remove it" in capsys.readouterr().err
    other = [*command[:4], "0:2600", *command[5:]]
    assert main(other) == 2
    assert "holds another evaluation: seeds: [0, 2500] is now [0, 2600]" in capsys.readouterr().err
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "file").touch()
    assert main([*command[:-1], str(tmp_path / "else")]) == 2
    assert "holds other things" in capsys.readouterr().err
