"""`drone-env evaluate` on a Ray cluster on this machine beside the plain run: times, and whether results are equal.

python benchmarks/cluster.py --maps 4000 [--task hard] [--agent pathqnet]
"""

import argparse
import json
import os
import secrets
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

MEMORY = 200 * 2**20


def evaluate(out: Path, options: argparse.Namespace, *more: str) -> float:
    """Seconds of one `drone-env evaluate`, from its start to its end."""
    what = ["--task", options.task, "--agents", options.agent, "--seeds", f"0:{options.maps}", "--out", str(out)]
    command = [sys.executable, "-m", "drone_env.cli", "evaluate", *what, *more]
    # As many threads as a task of Ray has.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
    return time.perf_counter() - began


def equal(left: Path, right: Path) -> bool:
    """Whether two evaluations brought the same bits."""
    names = sorted(file.name for file in (left / "pieces").iterdir())
    if names != sorted(file.name for file in (right / "pieces").iterdir()):
        return False
    for name in names:
        with np.load(left / "pieces" / name) as ours, np.load(right / "pieces" / name) as theirs:
            if any(ours[column].tobytes() != theirs[column].tobytes() for column in ours.files):
                return False
    return True


def kill_in_the_middle(cluster: Any, out: Path, pieces: int) -> None:
    """Kill a node when a third of the pieces are there."""
    while len(list(out.glob("pieces/*.npz"))) < max(1, pieces // 3):
        time.sleep(0.05)
    cluster.remove_node(next(iter(cluster.worker_nodes)), allow_graceful=False)


def main() -> None:
    """Measure, and print one JSON line for each run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=int, default=4000)
    parser.add_argument("--task", default="hard")
    parser.add_argument("--agent", default="pathqnet")
    options = parser.parse_args()
    # Ray's workers are nice by default, the plain run is not: that would be compared on a machine with other work.
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}
    os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    from ray.cluster_utils import Cluster  # reads the environment when it is imported

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cluster: Any = Cluster(
            initialize_head=True,
            head_node_args={"num_cpus": 0, "include_dashboard": False, "object_store_memory": MEMORY},
        )
        on_ray = ("--ray", str(cluster.address))
        plain = folder / "plain"
        seconds = {"plain": evaluate(plain, options)}
        same = {"plain": True}
        for run, nodes, killed in (("one node", 1, False), ("two nodes", 2, False), ("one of two killed", 2, True)):
            while len(cluster.worker_nodes) < nodes:
                cluster.add_node(num_cpus=1, object_store_memory=MEMORY)
            out = folder / run.replace(" ", "-")
            killer = threading.Thread(target=kill_in_the_middle, args=(cluster, out, options.maps // 1000), daemon=True)
            if killed:
                killer.start()
            seconds[run] = evaluate(out, options, *on_ray)
            same[run] = equal(plain, out)
        cluster.shutdown()
    for run, taken in seconds.items():
        row = {"run": run, "maps": options.maps, "seconds": round(taken, 1), "equal": same[run]}
        print(json.dumps({**row, "overhead": round(taken / seconds["plain"] - 1, 3), "load": os.getloadavg()[0]}))
    if not all(same.values()):
        sys.exit("results differ")


if __name__ == "__main__":
    main()
