"""Addresses of the page: which flight one asks for."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from typing import NamedTuple
from urllib.parse import urlencode

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from typing_extensions import Self

from drone_env.core.episode import Episode, choices
from drone_env.core.rewards import ORIGINAL_PROFILE, get_reward_profile
from drone_env.core.tasks import MAX_UNITS, get_task
from drone_env.errors import InvalidValueError, UnknownNameError, text_of
from drone_env.models import DIRECTIONS, Direction, Seed
from drone_env.planning.optimal import best_of
from drone_env.results.finished import check_agent
from drone_env.results.record import EpisodeRecord, fly_directions, replay_steps
from drone_env.server.jobs import bench
from drone_env.server.live.commands import MOST_EPISODES, Fork
from drone_env.server.map_choice import DEFAULT_TASK
from drone_env.server.pilots import HUMAN, PILOTS, Credit, agent_of, called
from drone_env.server.state import LONGEST_ID

LETTERS: dict[str, Direction] = {direction[0]: direction for direction in DIRECTIONS}
"""The actions of a fork, as an address has them."""
MAX_ACTIONS = 8192
"""Actions in an address: the server takes no longer ones."""


class Link(BaseModel):
    """The query of an address. What else stands there is ignored: sites add to links what they like."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    task: str = Field(default=DEFAULT_TASK, max_length=100, description="Id or short name of the task.")
    seed: Seed | None = Field(default=None, description="Number of the map.")
    pilot: str = Field(default="", max_length=100, description="Who flies.")
    pilots: str | None = Field(default=None, max_length=400, description="Who race, up to four, separated by commas.")
    profile: str = Field(default=ORIGINAL_PROFILE, max_length=100, description="What the steps pay.")
    step: int | None = Field(default=None, ge=0, le=MAX_UNITS, description="A moment; the end where it is left out.")
    fork: int | None = Field(default=None, description="The step from which the last of them flies another flight on.")
    actions: str | None = Field(
        default=None,
        max_length=MAX_ACTIONS,
        description=f"What that fork, or without one a person, has flown from the start of the map on, a letter of "
        f"{', '.join(LETTERS)} each.",
    )
    of: str | None = Field(
        default=None,
        max_length=200,
        description="Who flew up to that step; of a person without a fork, as the record says it.",
    )
    episode: str | None = Field(
        default=None, max_length=LONGEST_ID, description="A stored episode, in place of all else."
    )

    @classmethod
    def read(cls, query: Mapping[str, str]) -> Self:
        """The link with this query.

        Raises:
            InvalidValueError: if a value in it is not allowed.
        """
        try:
            return cls.model_validate(dict(query))
        except ValidationError as error:
            raise InvalidValueError(text_of(error)) from None

    @property
    def names(self) -> list[str]:
        """Ids of the pilots, in order; empty where nobody is named."""
        return [name for name in (self.pilot if self.pilots is None else self.pilots).split(",") if name]

    @property
    def forked(self) -> Fork | None:
        """What the last of them flies on from; None for no fork.

        Raises:
            InvalidValueError: if it is no fork.
        """
        # What a person has flown is for himself to go on with: pictures show the map that he flies.
        own = self.fork is None and HUMAN in self.names
        if own or (self.fork is None and self.actions is None and self.of is None):
            return None
        if self.fork is None or self.actions is None or self.of is None or not self.names:
            raise InvalidValueError("a fork needs all of pilot=human&fork=3&actions=UULDW&of=pathqnet in its link")
        unknown = set(self.actions) - LETTERS.keys()
        if unknown:
            raise InvalidValueError(f"actions are letters of {', '.join(LETTERS)}, got {min(unknown)!r}")
        try:
            return Fork(actions=[LETTERS[letter] for letter in self.actions], step=self.fork, of=self.of)
        except ValidationError as error:
            raise InvalidValueError(text_of(error)) from None

    def flown_by(self, fork: Fork) -> str:
        """Who flies its fork, as a record says it.

        Raises:
            InvalidValueError: if that would be too long.
        """
        return check_agent(str(Credit.of_fork(self.names[-1], fork.step, fork.of)))

    def check(self) -> None:
        """See whether it names a map, and pilots that there are.

        Raises:
            UnknownNameError: if there is no such task, pilot or reward profile.
            InvalidValueError: if it names no map, too many pilots, or a fork that is none.
        """
        get_task(self.task)
        get_reward_profile(self.profile)
        if self.seed is None:
            raise InvalidValueError("the link names no map: it has to have task=hard&seed=7, or episode=ID")
        if len(self.names) > MOST_EPISODES:
            raise InvalidValueError(f"at most {MOST_EPISODES} pilots fly on one map, got {len(self.names)}")
        for name in self.names:
            if name not in PILOTS:
                raise UnknownNameError("pilot", name, PILOTS)
        if self.forked is not None:
            self.flown_by(self.forked)

    def query(self) -> str:
        """It as a query again, without what was ignored."""
        return urlencode(self.model_dump(exclude_defaults=True), safe=",")

    def title(self) -> str:
        """What it leads to, in a line, for one that passes `check`."""
        assert self.seed is not None
        fork = self.forked
        if fork is not None:
            return title_of(self.task, self.seed, [called(self.flown_by(fork))], self.step)
        if self.names == [HUMAN]:
            return f"Fly it yourself: {title_of(self.task, self.seed)}"
        return title_of(self.task, self.seed, [PILOTS[name].name for name in self.names], self.step)


HELLO = Link(task="skyline_medium", seed=43, pilot="tournet")
"""The flight that the page of the bare address shows (`static/hello.html`, drawn by `tools/hello.py`)."""


def title_of(task: str, seed: int, who: Sequence[str] = (), step: int | None = None) -> str:
    """A map, and who flies there, in a line."""
    where = f"{get_task(task).short_name.replace('_', ' ').title()}, map {seed}"
    flown = f"{' against '.join(who)}: {where}" if who else where
    return flown if step is None else f"{flown}, step {step}"


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
