"""The oracle: fly the probe of `runtime.json` by the exact solution, and the canaries, on a running server.

    python validation/solve.py                                 # http://127.0.0.1:8000
    python validation/solve.py --url http://127.0.0.1:9000

Prints the sum of the rewards of each flight. Exit status 1 if the oracle misses the optimum, or a canary's pay differs
from `canaries.json`.
"""

import argparse
import json
import sys
import urllib.request
from pathlib import Path
from typing import Any

from drone_env import Action, solve

HERE = Path(__file__).parent


def fly(url: str, options: dict[str, Any], route: list[str]) -> float:
    """Fly a route in a session of its own, and return the sum of the rewards."""

    def call(method: str, **params: Any) -> dict[str, Any]:
        body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode()
        request = urllib.request.Request(f"{url}/mcp", body, {"Content-Type": "application/json"})
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)["result"]

    session = call("openenv/session/create")["session_id"]
    call("tools/call", name="reset", arguments=options, session_id=session)
    flown = call("tools/call", name="fly", arguments={"route": " ".join(route)}, session_id=session)
    call("openenv/session/close", session_id=session)
    return flown["data"]["reward"]


def main() -> int:
    """Fly, print, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="the server (%(default)s)")
    url = parser.parse_args().url
    probe = json.loads((HERE / "runtime.json").read_text())["reset"]
    options = {"seed": probe["seed"], **probe["options"]}
    best = solve(options["task_name"], options["seed"])
    flights = [("oracle", options, [Action(action).name for action in best.actions], best.score)]
    for canary in json.loads((HERE / "canaries.json").read_text())["canaries"]:
        route = [name for action in canary["actions"] for name in action["direction"].split()]
        flights.append((canary["name"], canary["reset"], route, canary["reward"]))
    wrong = 0
    for name, reset, route, expected in flights:
        reward = fly(url, reset, route)
        wrong += reward != expected
        note = "" if reward == expected else f", expected {expected}"
        print(f"{name:9} {reset['task_name']:15} map {reset['seed']}: {reward:.4f}{note}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
