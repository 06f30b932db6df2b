"""Random commands of pages at random moments leave the server healthy."""

import json
import os
import random
from typing import Any

import websockets.sync.client as websockets_client

from drone_env.core.tasks import TASKS
from tests.api.serving import Server

FRAMES = int(os.environ.get("DRONE_ENV_FRAMES", "500"))
COMMANDS = FRAMES // 4
# Each map is solved in the background, also when its page has gone: seconds for the larger ones.
FLOWN = list(TASKS)[: 4 if FRAMES > 1000 else 1]


OWN_FORK = {"pilot": "human", "undo_used": True, "parent": {"pilot": "greedy", "step": 3}}


def commands(source: random.Random, sessions: list[str]) -> Any:
    """A command that is right, or nearly so."""
    flown = {"direction": source.choice(["UP", "WAIT", "up"]), "flight": source.randrange(-1, 5)}
    pilots = ["pathqnet", "tournet", "greedy", "optimal", "random", "human", "ghost"]
    fork = {
        "actions": source.choices(["UP", "LEFT", "WAIT"], k=source.randrange(80)),
        "step": source.randrange(-1, 9),
        "of": source.choice([*({"pilot": one} for one in ("human", "greedy", "x" * 200, "a\nb")), OWN_FORK, "greedy"]),
    }
    return source.choice(
        [
            {
                "type": "start",
                "task": source.choice([*FLOWN, "nowhere"]),
                "seed": source.choice([None, 7, 2**53 - 1, -1]),
                "pilots": source.choices(pilots, k=source.randrange(6)),
                "fork": source.choice([None, None, fork]),
            },
            {"type": "attach", "sessions": source.choices([*sessions, "nobody"], k=source.randrange(6))},
            {"type": "play", "speed": source.choice([0.5, 6, 60, 61, None, "fast"])},
            {"type": "pause"},
            {"type": "subscribe", "topics": source.choices(["requests", "training", "episodes", "x"], k=2)},
            {"type": "end"},
            source.choice([[], None, 5, "step", {"type": None}, {"type": "step", "more": 1}]),
            *[{"type": "fly", **flown}] * 2,
            {"type": source.choice(["undo", "help"]), "flight": flown["flight"]},
            *[{"type": "step"}] * 3,
        ]
    )


def test_any_command_of_a_page_at_any_time_leaves_the_server_well(server: Server) -> None:
    source = random.Random(7)
    sessions: list[str] = []
    left = COMMANDS
    while left > 0:
        with websockets_client.connect(server.url.replace("http", "ws") + "/live", compression=None) as socket:
            for _ in range(source.randrange(1, 80)):
                left -= 1
                socket.send(json.dumps(commands(source, sessions)))
                try:
                    while True:
                        message = json.loads(socket.recv(timeout=0.002))
                        for shown in message["flights"] if message["type"] == "flights" else ():
                            sessions = [*sessions, shown["opening"]["session"]][-20:]
                except TimeoutError:
                    continue
            if source.random() < 0.5:
                socket.socket.close()  # without a goodbye
    server.assert_well()
