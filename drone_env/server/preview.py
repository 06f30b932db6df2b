"""Pictures of flights, as sites show them beside a link to one."""

import threading
from collections import OrderedDict
from collections.abc import Iterable
from itertools import islice
from typing import NamedTuple

from drone_env.core.episode import Episode
from drone_env.core.rollout import choices
from drone_env.core.tasks import get_task
from drone_env.episodes.record import fly_directions, replay_steps
from drone_env.planning.optimal import best_of
from drone_env.server.links import Link
from drone_env.server.pilots import PILOTS, Credit, agent_of, called
from drone_env.server.predict import SOURCES
from drone_env.server.state import Shared

MAX_BYTES = 16 << 20
"""Memory that the pictures may take together; one takes 100 to 200 KB."""


class Flown(NamedTuple):
    """A flight of a link."""

    pilot: str
    """What people call who flies."""
    episode: Episode


class Previews:
    """Draws the pictures, and keeps those that were asked for last; safe to share between threads.

    Args:
        shared: The parts of the server.
    """

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self._kept: OrderedDict[tuple[object, ...], bytes] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, link: Link) -> bytes | None:
        """The picture of a link if it is kept.

        Raises:
            DroneEnvError: as `draw`.
        """
        key = self._key(link)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def draw(self, link: Link) -> bytes:
        """The picture of a link, 1200 by 630 pixels, as a PNG: the map with the flight up to the step of the link.

        Raises:
            UnknownNameError: if there is no such task, pilot, reward profile or stored episode.
            InvalidValueError: if the link names no map, too many pilots, or a fork that is none.
            UnsupportedTaskError: if a pilot cannot fly the task.
            CheckpointError: if its network cannot be read.
            TooLargeError: if the map is too large for it.
        """
        from drone_env.envs.rendering import draw_card  # loads Pillow, which no server needs that only flies

        key = self._key(link)
        flights = list(self._stored(link) if link.episode else self._flown(link))
        picture = draw_card(flights[0].episode, _words(flights))
        with self._lock:
            self._kept[key] = picture
            while len(self._kept) > 1 and sum(map(len, self._kept.values())) > MAX_BYTES:
                self._kept.popitem(last=False)
        return picture

    def _key(self, link: Link) -> tuple[object, ...]:
        """What a picture depends on: a network may be trained further, an episode never changes."""
        if link.episode:
            return link.episode, link.step
        link.check()
        task, networks = get_task(link.task), self._shared.networks
        files = [networks.stamp_of(name, task) for name in link.names if name in SOURCES]
        return task, link.seed, *link.names, link.step, link.fork, link.actions, link.of, *files

    def _flown(self, link: Link) -> Iterable[Flown]:
        task, seed, fork, names = get_task(link.task), link.seed, link.forked, link.names
        if fork is not None:
            episode = Episode(task, link.profile, seed)
            for _ in fly_directions(episode, fork.actions[: link.step]):
                pass
            yield Flown(called(link.flown_by(fork)), episode)
            names = names[:-1]
        for name in names:
            episode, agent = Episode(task, link.profile, seed), agent_of(name, task, self._shared.networks)
            if agent is not None:
                agent.reset(episode.seed)
                episode.fly(islice(choices(episode, agent.act), link.step))
            yield Flown(PILOTS[name].name, episode)
        if not link.names:
            yield Flown("", Episode(task, link.profile, seed))

    def _stored(self, link: Link) -> Iterable[Flown]:
        record = self._shared.store.episode(str(link.episode)).record
        *_, episode = islice(replay_steps(record), None if link.step is None else link.step + 1)
        yield Flown(called(record.agent), episode)


def _words(flights: list[Flown]) -> list[tuple[str, bool]]:
    """Who flies and what came of it; the optimum is told once a flight over the map has ended."""
    lines: list[tuple[str, bool]] = []
    for pilot, episode in flights:
        if pilot:
            so_far = f"step {episode.steps}" if episode.steps else "at the start"
            credit = Credit.parse(pilot)
            lines += [(credit.pilot, True), *((said, False) for said in credit.additions)]
            lines += [(f"score {100 * episode.score:.1f}" if episode.ended else so_far, False)]
    ended = next((episode for _, episode in flights if episode.ended), None)
    best = None if ended is None else best_of(ended.task, ended.seed)
    return lines if best is None else [*lines, ("", False), (f"optimum {100 * best.score:.1f}", False)]
