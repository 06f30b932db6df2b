"""A server that is killed at any moment loses no acknowledged step or episode."""

import json
import os
import random
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from drone_env.client import DroneEnvClient, ServerError
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.planning.optimal import solve
from drone_env.results.record import replay
from drone_env.results.store import Store
from tests.api.serving import Server
from tests.tools import reserved_port

KILLS = int(os.environ.get("DRONE_ENV_KILLS", "2"))


class Pilot(threading.Thread):
    """Flies over HTTP without end, and knows what was acknowledged."""

    def __init__(self, url: str, number: int) -> None:
        super().__init__(daemon=True)
        self.client = DroneEnvClient(url)
        self.random = random.Random(number)
        self.acknowledged = 0
        self.failure: BaseException | None = None
        self.expected: Episode | None = None
        self.best: Sequence[Action] = ()
        self.pending: list[Action] = []
        """Sent, not acknowledged: may have been flown or not."""
        self.finished: list[tuple[int, float]] = []
        """(seed, score) of the episodes whose end was acknowledged."""

    def run(self) -> None:
        try:
            while True:
                self.once()
        except BaseException as error:
            if not isinstance(error, ServerError) or error.status:
                self.failure = error

    def once(self) -> None:
        if self.expected is None or self.expected.ended:
            seed = self.random.randrange(2**40)
            self.expected, self.pending = None, []
            self.client.reset("easy", seed=seed, agent="pilot")
            self.expected = Episode("easy", "tiered")
            self.expected.reset(seed)
            self.best = solve("easy", seed).actions
        flown = self.expected.steps
        action = self.best[flown] if flown < len(self.best) else Action.WAIT
        self.pending = [action]
        observation = self.client.step(action.name)
        self.pending = []
        self.expected.step(action)
        self.acknowledged += 1
        assert observation["step_count"] == self.expected.steps
        if observation["done"]:
            self.finished.append((self.expected.seed, observation["score"]))

    def check(self) -> None:
        """Hold the server's state against what was acknowledged, and go on from there."""
        if self.expected is None:
            return
        state = self.client.state()
        if state["seed"] != self.expected.seed:
            assert self.expected.ended, "an acknowledged episode is gone"
        ahead = state["step_count"] - self.expected.steps
        assert 0 <= ahead <= len(self.pending), "acknowledged steps are gone"
        for action in self.pending[:ahead]:
            self.expected.step(action)
        assert state["reward_total"] == self.expected.reward_total
        self.client.close()


def test_nothing_acknowledged_is_lost_when_the_server_is_killed(
    tmp_path: Path, eventually: Callable[[Callable[[], bool]], None]
) -> None:
    data, port, moments = tmp_path / "data", reserved_port(), random.Random(1)
    finished: list[tuple[int, float]] = []
    server = Server(["drone_env/server/app.py"], data, port, {})
    try:
        for kill in range(KILLS):
            pilots = [Pilot(server.url, 4 * kill + number) for number in range(4)]
            for pilot in pilots:
                pilot.start()
            # Long enough that episodes end, and at another place of a step each time.
            enough = moments.randrange(100, 200)

            def have_flown(pilots: list[Pilot] = pilots, enough: int = enough) -> bool:
                flown = sum(pilot.acknowledged for pilot in pilots)
                return flown >= enough or not any(pilot.is_alive() for pilot in pilots)

            eventually(have_flown)
            server.kill()
            for pilot in pilots:
                pilot.join(60)
                assert not pilot.is_alive()
                assert pilot.failure is None, pilot.failure
            assert json.loads((data / "memory.json").read_text(encoding="utf-8"))["format"] == "drone_env/memory"
            server = Server(["drone_env/server/app.py"], data, port, {})
            for pilot in pilots:
                pilot.check()
                finished += pilot.finished
    finally:
        server.kill()
    assert finished
    with Store(data) as store:
        kept = {(stored.record.seed, stored.record.score): stored.record for stored in store.episodes()}
    for key in finished:
        assert replay(kept[key]).score == key[1]
