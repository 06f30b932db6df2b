"""Pictures of flights, as sites show them beside a link to one: jobs of a worker process."""

from collections.abc import Iterable
from itertools import islice
from typing import NamedTuple

from drone_env.core.episode import Episode, choices
from drone_env.core.tasks import get_task
from drone_env.planning.optimal import best_of
from drone_env.results.record import EpisodeRecord, fly_directions, replay_steps
from drone_env.server.jobs import bench
from drone_env.server.links import Link
from drone_env.server.pilots import PILOTS, Credit, agent_of, called


class Flown(NamedTuple):
    """A flight of a link."""

    pilot: str
    """What people call who flies."""
    episode: Episode


def draw_preview(link: Link, record: EpisodeRecord | None) -> bytes:
    """The picture of a link, 1200 by 630 pixels, as a PNG: the map with the flight up to the step of the link.

    Args:
        link: The link.
        record: The stored episode that it names, if it names one.

    Raises:
        UnknownNameError: if there is no such task, pilot or reward profile.
        InvalidValueError: if the link names no map, too many pilots, or a fork that is none.
        UnsupportedTaskError: if a pilot cannot fly the task.
        CheckpointError: if its network cannot be read.
        TooLargeError: if the map is too large for it.
    """
    from drone_env.envs.rendering import draw_card  # loads Pillow, which the process that serves does without

    flights = list(_flown(link)) if record is None else [_stored(link, record)]
    return draw_card(flights[0].episode, _words(flights))


def _flown(link: Link) -> Iterable[Flown]:
    link.check()
    task, seed, fork, names = get_task(link.task), link.seed, link.forked, link.names
    if fork is not None:
        episode = Episode(task, link.profile, seed)
        for _ in fly_directions(episode, fork.actions[: link.step]):
            pass
        yield Flown(called(link.flown_by(fork)), episode)
        names = names[:-1]
    for name in names:
        episode, agent = Episode(task, link.profile, seed), agent_of(name, task, bench().networks)
        if agent is not None:
            agent.reset(episode.seed)
            episode.fly(islice(choices(episode, agent.act), link.step))
        yield Flown(PILOTS[name].name, episode)
    if not link.names:
        yield Flown("", Episode(task, link.profile, seed))


def _stored(link: Link, record: EpisodeRecord) -> Flown:
    *_, episode = islice(replay_steps(record), None if link.step is None else link.step + 1)
    return Flown(called(record.agent), episode)


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
