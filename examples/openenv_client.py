"""OpenEnv's client over WebSocket: fly a mission on a server, and compare it with the exact optimum of its map.

    pip install -e '.[server]'
    drone-env serve                       # in another terminal
    python examples/openenv_client.py

Measured: map 7 scores 0.9375 in 50 steps (optimum 0.9425 in 46), map 8 0.9550 (0.9575), map 9 0.9475 (0.9525): the
nearest parcel first is not the shortest tour.

`DroneDeliveryClient` is a subclass of OpenEnv's `EnvClient`: asynchronous as it is, synchronous through `sync()`.
"""

import argparse

from drone_env import DroneAction, solve
from drone_env.openenv_client import DroneDeliveryClient

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--url", default="http://127.0.0.1:8000", help="of the server (%(default)s)")
parser.add_argument("--task", default="hard")
parser.add_argument("--seed", type=int, default=7, help="number of the first map (%(default)s)")
parser.add_argument("--maps", type=int, default=3, help="maps to fly (%(default)s)")
args = parser.parse_args()


def towards_target(observation):
    """Along the row first, then along the column."""
    x, y = observation.current_target
    if x != observation.drone_x:
        return "RIGHT" if x > observation.drone_x else "LEFT"
    return "DOWN" if y > observation.drone_y else "UP"


with DroneDeliveryClient(args.url).sync() as env:
    for seed in range(args.seed, args.seed + args.maps):
        result = env.reset(task_name=args.task, seed=seed)
        while not result.done:
            result = env.step(DroneAction(direction=towards_target(result.observation)))
        flown, best = result.observation, solve(args.task, seed)
        print(
            f"map {seed}: score {flown.score:.4f} in {flown.step_count} steps, "
            f"optimum {best.score:.4f} in {best.steps} steps"
        )
