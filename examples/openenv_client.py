"""OpenEnv's client over WebSocket: fly a mission on a server, and compare it with the exact optimum of its map.

    pip install -e '.[server]'
    python examples/openenv_client.py                                  # starts a server of its own
    python examples/openenv_client.py --url http://127.0.0.1:8000      # or flies on one that runs

Measured: map 7 scores 0.9375 in 50 steps (optimum 0.9425 in 46), map 8 0.9550 (0.9575), map 9 0.9475 (0.9525): the
nearest parcel first is not the shortest tour. 10 seconds of CPU time, most of it for starting the server and OpenEnv.

`DroneDeliveryClient` is a subclass of OpenEnv's `EnvClient`: asynchronous as it is, synchronous through `sync()`.
"""

import argparse
import contextlib
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

from drone_env import DroneAction, solve
from drone_env.openenv_client import DroneDeliveryClient

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--url", help="a server that runs; one is started if none is named")
parser.add_argument("--task", default="hard")
parser.add_argument("--seed", type=int, default=7, help="number of the first map (%(default)s)")
parser.add_argument("--maps", type=int, default=3, help="maps to fly (%(default)s)")
args = parser.parse_args()


@contextlib.contextmanager
def own_server():
    """A server for the time of the block, on a free port, with its data in a folder that goes with it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as data:
        command = [sys.executable, "-m", "drone_env.cli", "serve", "--port", str(port), "--data", data]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            url = f"http://127.0.0.1:{port}"
            while process.poll() is None:
                try:
                    urllib.request.urlopen(f"{url}/health", timeout=1).close()
                    break
                except (urllib.error.URLError, TimeoutError):
                    time.sleep(0.1)
            else:
                sys.exit("the server ended by itself")
            yield url
        finally:
            process.terminate()
            process.wait()


def towards_target(observation):
    """Along the row first, then along the column."""
    x, y = observation.current_target
    if x != observation.drone_x:
        return "RIGHT" if x > observation.drone_x else "LEFT"
    return "DOWN" if y > observation.drone_y else "UP"


with contextlib.nullcontext(args.url) if args.url else own_server() as url, DroneDeliveryClient(url).sync() as env:
    for seed in range(args.seed, args.seed + args.maps):
        result = env.reset(task_name=args.task, seed=seed)
        while not result.done:
            result = env.step(DroneAction(direction=towards_target(result.observation)))
        flown, best = result.observation, solve(args.task, seed)
        print(
            f"map {seed}: score {flown.score:.4f} in {flown.step_count} steps, "
            f"optimum {best.score:.4f} in {best.steps} steps"
        )
