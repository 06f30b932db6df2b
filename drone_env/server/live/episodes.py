"""One episode that a page flies: a session, its pilot, and what is known of its flight ahead of time."""

import asyncio
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from hashlib import sha256
from typing import Any, TypeVar

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.errors import DroneEnvError, EpisodeError, NoSessionError, SessionGoneError
from drone_env.models import DIRECTIONS, Direction
from drone_env.results.finished import check_agent
from drone_env.results.record import record_of
from drone_env.results.sessions import SessionRow
from drone_env.server.frames import Frame, frame_of, shows_values
from drone_env.server.live.ahead import MapOf, plan, values_along
from drone_env.server.map_choice import is_registered
from drone_env.server.pilots import HUMAN, PILOTS, Credit
from drone_env.server.state import Shared

Result = TypeVar("Result")


class LeftError(Exception):
    """The page shows another flight by now."""


class LiveEpisode:
    """An episode that a page flies. The row of its session is the truth; this follows it.

    Args:
        row: The session as it stands.
        shared: The parts of the server.
        caller: The address of the page: its jobs take turns with those of others.

    Raises:
        EpisodeError: if none of our pilots flies it.
    """

    def __init__(self, row: SessionRow, shared: Shared, caller: str) -> None:
        self.by, self.credit = row.agent, Credit.parse(row.agent)
        self.pilot = self.credit.pilot
        if self.pilot not in PILOTS:
            raise EpisodeError(f"this session is flown by {row.agent!r}, not from the page")
        self.session = row.id
        self.episode_id = row.episode_id
        self.episode: Episode = row.fly()
        self.map_of = MapOf.of(self.episode)
        self.values: list[float] = []
        """The best score that can still be reached at the frames of the flight, as far as it is known."""
        self._ahead: list[float] | None = None
        """The same after each action, of a person's flight."""
        self.unsolved = False
        """Whether the map could not be solved."""
        self._shared, self._caller = shared, caller
        self._plan: list[int] | None = None
        self._planning: asyncio.Future[list[int]] | None = None
        self._jobs: set[asyncio.Future[Any]] = set()
        self._network = shared.networks.beside(self.pilot, self.episode.task)

    @property
    def automatic(self) -> bool:
        """Whether it flies by itself, and has not ended."""
        return self.pilot != HUMAN and not self.episode.ended

    @property
    def first(self) -> int:
        """The steps that others have flown, before the pilot began."""
        return self.credit.forked_at or 0

    @property
    def directions(self) -> list[Direction]:
        """What has been flown."""
        return [DIRECTIONS[action] for action in self.episode.actions]

    @property
    def lacks_values(self) -> bool:
        """Whether values are to be shown, now or after the next step, that are not known yet."""
        missing = len(self.values) <= self.episode.steps
        if self.pilot == HUMAN and not self.episode.ended:
            missing = missing or self._ahead is None
        return missing and self._shown and not self.unsolved

    async def planned(self) -> list[int]:
        """All actions of an automatic episode to its end: its agent flies in a worker process, once.

        Raises:
            LeftError: if the page has left it meanwhile.
            DroneEnvError: as `Workers.run` and `ahead.plan`.
        """
        if self._plan is None:
            if self._planning is None or self._planning.done():
                self._planning = self._submit(plan, self.map_of, self.pilot, self._flown, self.first)
            self._plan = await _ended(self._planning)
        return self._plan

    async def solve(self) -> None:
        """Find out what can still be reached along the flight: of an automatic one to its end, else to one step ahead.

        Raises:
            LeftError: if the page has left it meanwhile.
            DroneEnvError: as `Workers.run` and `ahead.values_along`.
        """
        actions = await self.planned() if self.automatic else self._flown
        first = min(len(self.values), len(actions))
        try:
            values, ahead = await _ended(self._submit(values_along, self.map_of, actions, first))
        except DroneEnvError:
            self.unsolved = True
            raise
        flown = self._flown
        if len(self.values) >= first and flown[: len(actions)] == actions[: len(flown)]:
            self.values[first:] = values
            self._ahead = ahead if flown == actions else None

    def leave(self) -> None:
        """Drop its jobs: the page shows another."""
        for job in self._jobs:
            job.cancel()

    def step(self) -> list[Frame]:
        """Let the pilot of an automatic episode, which is `planned`, fly one step; the frames that follow from it."""
        assert self._plan is not None
        return self._fly(self._plan[self.episode.steps])

    def begin_with(self, actions: Sequence[int], planned: list[int] | None) -> None:
        """Fly and keep what the flight begins with when it is started: a fork, or the steps up to a moment.

        Args:
            actions: These steps.
            planned: What `planned` is to return, if that is known.
        """
        self._plan = planned
        if not actions:
            return
        self.episode.fly(actions)
        with self._shared.store.session(self.session) as row:
            for action in self.episode.actions:
                row.append(action)
            if self.episode.ended:
                # Named by what it is: however often a link to it is opened, it is kept once.
                record = record_of(self.episode, row.agent).to_json()
                self.episode_id = row.finish(self.episode, sha256(record.encode()).hexdigest()[:16])

    def fly(self, direction: Direction) -> list[Frame]:
        """Fly one step by hand.

        Raises:
            EpisodeError: if an agent flies this episode, or it has ended.
        """
        self._check_by_hand()
        return self._fly(Action[direction])

    def undo(self) -> list[Frame]:
        """Take back the last step flown by hand, and say so of who flew.

        Returns:
            None but where another page has flown on meanwhile: the frames of that, with nothing taken back.

        Raises:
            EpisodeError: if an agent flies this episode, it has ended, or the person has flown nothing yet.
        """
        self._check_by_hand()
        if self.episode.steps <= self.first:
            since = f"since step {self.first}, where the fork begins" if self.first else "yet"
            raise EpisodeError(f"there is nothing to take back: you have not flown {since}")
        before = self.map_of.start().fly(self.episode.actions[:-1])
        with self._shared.store.session(self.session) as row:
            self._recognise(row, self.episode)
            alone = len(row.actions) == self.episode.steps
            if alone:
                row.undo()
                row.agent = check_agent(str(self.credit._replace(undo=True)))
        self.by, self.credit = row.agent, Credit.parse(row.agent)
        if not alone:
            return self._follow(row.actions[self.episode.steps :])
        self.episode = before
        del self.values[before.steps + 1 :]
        self._ahead = None
        return []

    def help(self) -> Frame:
        """Show a person in flight what the actions are worth from now on, and say so of who flew; the frame with that.

        Raises:
            EpisodeError: if an agent flies this episode, or it has ended.
        """
        self._check_by_hand()
        with self._shared.store.session(self.session) as row:
            self._recognise(row, self.episode)
            row.agent = check_agent(str(self.credit._replace(values=True)))
        self.by, self.credit = row.agent, Credit.parse(row.agent)
        return self.look()

    def reachable(self) -> list[float] | None:
        """The best score that could still be reached at each frame so far; None if it is unknown or hidden."""
        known = self._shown and len(self.values) > self.episode.steps
        return self.values[: self.episode.steps + 1] if known else None

    def end(self) -> None:
        """Give the session back.

        Raises:
            StoreError: if the store could not be written.
        """
        with suppress(NoSessionError, SessionGoneError):  # it may have been idle for too long
            self._shared.sessions.end(self.session)

    def look(self) -> Frame:
        """The frame of the episode as it stands: its map is drawn once, and a network asked once."""
        shown, step = self._shown, self.episode.steps
        known = shown and step < len(self.values)
        return frame_of(
            self.episode,
            self.episode.observation(),
            self._network if shown else None,
            self.values[step] if known else None,
            self.values[0] if known else None,
        )

    def _fly(self, action: int) -> list[Frame]:
        flown = self.episode.copy()  # where the step cannot be kept, nothing has changed here
        with self._shared.store.session(self.session) as row:
            self._recognise(row, flown)
            # Another page may have gone on with the same session: then this one catches up.
            alone = len(row.actions) == flown.steps
            if alone:
                row.step(flown, action)
        self.episode_id = row.episode_id
        if not alone:
            return self._follow(row.actions[self.episode.steps :])
        self.episode = flown
        if self._ahead is not None and len(self.values) == flown.steps:
            self.values.append(self._ahead[action])  # V* after an action is its Q*, to the last bit
        self._ahead = None
        return [self.look()]

    def _recognise(self, row: SessionRow, flown: Episode) -> None:
        """See whether the session still flies this episode. Another page may have asked for help with it meanwhile."""
        credit = self.credit if row.agent == self.by else Credit.parse(row.agent)
        same = self.credit._replace(values=credit.values, undo=credit.undo)
        if credit != same or not row.follows(flown):
            raise SessionGoneError("this session flies another episode by now: start a new one")
        self.by, self.credit = row.agent, credit

    def _check_by_hand(self) -> None:
        if self.pilot != HUMAN:
            raise EpisodeError(f"{self.pilot} flies this episode: start one with the pilot {HUMAN!r} to fly yourself")
        if self.episode.ended:
            raise EpisodeError("this episode has ended: start another")

    def _follow(self, actions: Iterable[int]) -> list[Frame]:
        """Fly what another page has flown, and return the frames."""
        frames: list[Frame] = []
        if self.pilot == HUMAN:
            del self.values[self.episode.steps + 1 :]
            self._ahead = None
        for action in actions:
            self.episode.step(action)
            frames.append(self.look())
        if self._plan is not None and self._plan[: self.episode.steps] != self._flown:
            self._plan = None  # its agent chooses differently each time
        return frames

    def _submit(self, function: Callable[..., Result], *arguments: object) -> "asyncio.Future[Result]":
        quick = is_registered(self.map_of.task.id)
        job = asyncio.ensure_future(self._shared.workers.run(function, *arguments, caller=self._caller, quick=quick))
        self._jobs.add(job)
        job.add_done_callback(self._jobs.discard)
        return job

    @property
    def _flown(self) -> list[int]:
        return [int(action) for action in self.episode.actions]

    @property
    def _shown(self) -> bool:
        return shows_values(self.credit, self.episode)


async def _ended(job: "asyncio.Future[Result]") -> Result:
    """The result of a job. It goes on if this is cancelled, since others may wait for it."""
    await asyncio.wait((job,))
    if job.cancelled():
        raise LeftError
    return job.result()
