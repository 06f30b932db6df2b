"""Flights as the page starts and changes them, and as the agents fly them, for tests."""

from typing import Any

from starlette.testclient import TestClient

from drone_env.agents import make_agent
from drone_env.core.episode import Episode, rollout
from drone_env.flights.provenance import Provenance
from drone_env.models import DIRECTIONS, Direction

Message = dict[str, Any]


def start(client: TestClient, *pilots: str, task: str = "easy", seed: int | None = 7, **fields: Any) -> list[Message]:
    """The flights of pilots over a map, those of agents to their ends."""
    body = {"task": task, "seed": seed, "pilots": pilots, **fields}
    flights = client.post("/flights", json=body).raise_for_status().json()["flights"]
    for shown in flights:
        if shown["opening"]["pilot"] != "human":
            shown.update(client.post("/flights/agent", json=agent_start(shown)).raise_for_status().json())
    return flights


def agent_start(shown: Message) -> Message:
    """The request for an agent's flight that has begun."""
    opening = shown["opening"]
    fields = {name: opening[name] for name in ("task", "seed", "reward_profile")}
    return {**fields, "pilot": opening["pilot"]}


def label(shown: Message) -> str:
    """The label of a flight's pilot."""
    return Provenance.model_validate({name: shown["opening"][name] for name in Provenance.model_fields}).label


class ByHand:
    """A person's flight, which remembers its version as the page does."""

    def __init__(self, client: TestClient, flight: Message) -> None:
        self.client = client
        self.version = flight["version"]
        self.header = {"X-Session-Id": flight["opening"]["session"]}

    def change(self, *changes: str) -> Message:
        """What the server answers to the last of these changes."""
        answer: Message = {}
        for change in changes:
            body = {"version": self.version, "change": change}
            answer = self.client.post("/flights/change", json=body, headers=self.header).json()
            self.version = answer.get("version", self.version)
        return answer


def flown(
    task: str,
    agent: str,
    steps: int | None = None,
    seed: int = 7,
    profile: str = "tiered",
    start: Episode | None = None,
) -> Episode:
    """An agent's flight up to a step, from where `start` stands."""
    pilot, first = make_agent(agent, task), Episode(task, profile, seed)
    pilot.reset(seed)
    return first.copy().fly(rollout((start or first).copy(), pilot.act).actions[:steps])


def directions(episode: Episode) -> list[Direction]:
    return [DIRECTIONS[action] for action in episode.actions]
