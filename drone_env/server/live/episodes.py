"""One episode that a page flies: its session, its pilot, and the values along its flight."""

import asyncio
import secrets
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from hashlib import sha256
from typing import Any, TypeVar

from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import DroneEnvError, EpisodeError, NoSessionError
from drone_env.flights.provenance import HUMAN, Provenance
from drone_env.flights.record import fly_directions, record_of
from drone_env.flights.sessions import Session
from drone_env.models import DIRECTIONS, Direction
from drone_env.server.frames import (
    Beginning,
    FlightHeader,
    Frame,
    begin,
    frame_of,
    frames_json,
    plan,
    shows_values,
    values_along,
)
from drone_env.server.live.commands import Start
from drone_env.server.pilots import all_pilots
from drone_env.server.schemas import ResetOptions
from drone_env.server.state import AppState
from drone_env.server.task_api import start_episode

Result = TypeVar("Result")


class LeftError(Exception):
    """The page shows another flight now."""


class LiveEpisode:
    """An episode that a page flies.

    Args:
        session: The session in memory.
        app_state: The parts of the server.
        caller: The address of the page.
        planned: What `planned` returns; None if that is unknown.

    Raises:
        EpisodeError: if a flight of this provenance is not one of the page.
    """

    def __init__(self, session: Session, app_state: AppState, caller: str, planned: list[int] | None = None) -> None:
        self.session = session
        self._revision = session.revision
        self.pilot = self.provenance.pilot
        if self.pilot not in all_pilots():
            raise EpisodeError(f"the agent of this session is {self.provenance.label!r}, not a pilot of the page")
        self.start = Episode(self.episode.task, self.episode.reward_profile, self.episode.seed)
        self.values: list[float] = []
        """The best score still possible at each frame, as far as it is known."""
        self.unsolved = False
        """Whether solving the map failed."""
        self._sessions, self._workers, self._caller = app_state.sessions, app_state.workers, caller
        self._plan = planned
        self._planning: asyncio.Future[list[int]] | None = None
        self._jobs: set[asyncio.Future[Any]] = set()
        self._network = app_state.networks.shown_network(self.pilot, self.start.task)

    @classmethod
    def of(cls, session_id: str, app_state: AppState, caller: str, planned: list[int] | None = None) -> Self:
        """The episode of a session.

        Raises:
            NoSessionError: if there is no such session.
            EpisodeError: if a flight of this provenance is not one of the page.
        """
        return cls(app_state.sessions.use(session_id, lambda session: session), app_state, caller, planned)

    @property
    def episode(self) -> Episode:
        """The episode in its current state."""
        return self.session.episode

    @property
    def provenance(self) -> Provenance:
        """Who flies."""
        return self.session.provenance

    @property
    def flown_by(self) -> dict[str, Any]:
        """What may change of who flies, for the page."""
        by = self.provenance
        return {"by": by.label, "values_used": by.values_used, "undo_used": by.undo_used}

    @property
    def automatic(self) -> bool:
        """Whether an agent flies it, and it has not ended."""
        return self.pilot != HUMAN and not self.episode.ended

    @property
    def lacks_values(self) -> bool:
        """Whether values are shown that are not known yet."""
        return len(self.values) <= self.episode.steps and self._shown and not self.unsolved

    async def planned(self) -> list[int]:
        """All actions of an automatic episode to its end, computed once in a worker process.

        Raises:
            LeftError: if the page has left the flight.
            DroneEnvError: as `Workers.run` and `plan`.
        """
        if self._plan is None:
            if self._planning is None or self._planning.done():
                self._planning = self._submit(plan, self.start, self.pilot, self.episode.actions, self._first)
            self._plan = await _finished(self._planning)
        return self._plan

    async def solve(self) -> None:
        """Compute the values along the flight; for an automatic one to its end.

        Raises:
            LeftError: if the page has left the flight.
            DroneEnvError: as `Workers.run` and `values_along`.
        """
        actions = await self.planned() if self.automatic else self.episode.actions
        try:
            values = await _finished(self._submit(values_along, self.start, actions))
        except DroneEnvError:
            self.unsolved = True
            raise
        if self.automatic or self.episode.actions[: len(actions)] == actions:
            self.values = values

    def leave(self) -> None:
        """Cancel its jobs: the page shows another flight."""
        for job in self._jobs:
            job.cancel()

    def step(self) -> Frame:
        """Fly one step of an automatic episode whose actions are `planned`."""
        assert self._plan is not None
        return self._fly(self._plan[self.episode.steps])

    def fly(self, direction: Direction) -> Frame:
        """Fly one step by hand.

        Raises:
            EpisodeError: if an agent flies this episode, or it has ended.
        """
        self._check_by_hand()
        return self._fly(Action[direction])

    def undo(self) -> None:
        """Take back the last step flown by hand; the provenance shows it.

        Raises:
            EpisodeError: if an agent flies this episode, it has ended, or the person has flown no step.
        """
        self._check_by_hand()
        if self.episode.steps <= self._first:
            raise EpisodeError("there is no step to take back: you have flown none")
        self._change(lambda session: session.undo())
        del self.values[self.episode.steps + 1 :]

    def help(self) -> Frame:
        """Turn on the values for a person in flight; the provenance shows it. Returns the current frame with values.

        Raises:
            EpisodeError: if an agent flies this episode, or it has ended.
        """
        self._check_by_hand()
        self._change(lambda session: session.use_values())
        return self.frame()

    def shown_values(self) -> list[float] | None:
        """The best score still possible at each frame so far; None if it is unknown or hidden."""
        known = self._shown and len(self.values) > self.episode.steps
        return self.values[: self.episode.steps + 1] if known else None

    def frame(self) -> Frame:
        """The frame of the episode in its current state."""
        step, network = self.episode.steps, self._network if self._shown else None
        if self._shown and step < len(self.values):
            return frame_of(self.episode, network, self.values[step], self.values[0])
        return frame_of(self.episode, network)

    def view_json(self, frames: str | None) -> str:
        """The JSON of its `EpisodeView`, with these frames as a JSON array; None for the current frame alone."""
        header = FlightHeader.at_start(self.start, self.provenance, self.session.id).model_dump_json()
        return f'{{"opening":{header},"frames":{frames or to_json([self.frame()]).decode()}}}'

    def _fly(self, action: int) -> Frame:
        self._change(lambda session: session.fly(action))
        return self.frame()

    def _change(self, change: Callable[[Session], object]) -> None:
        """Change the session.

        Raises:
            NoSessionError: if somebody else has changed it.
        """
        seen = self.session.flight_id, self._revision

        def unless_changed(session: Session) -> Session:
            if (session.flight_id, session.revision) != seen:
                raise NoSessionError("another page or client flies this session now: start a new flight")
            change(session)
            return session

        self.session = self._sessions.use(self.session.id, unless_changed)
        self._revision = self.session.revision

    def _check_by_hand(self) -> None:
        if self.pilot != HUMAN:
            raise EpisodeError(f"{self.pilot} flies this episode: start one with the pilot {HUMAN!r} to fly yourself")
        if self.episode.ended:
            raise EpisodeError("this episode has ended: start another")

    def _submit(self, function: Callable[..., Result], *arguments: object) -> "asyncio.Future[Result]":
        run = self._workers.run(function, *arguments, caller=self._caller, task=self.start.task.id)
        job = asyncio.ensure_future(run)
        self._jobs.add(job)
        job.add_done_callback(self._jobs.discard)
        return job

    @property
    def _first(self) -> int:
        """The number of steps that another pilot flew."""
        return 0 if self.provenance.parent is None else self.provenance.parent.step

    @property
    def _shown(self) -> bool:
        return shows_values(self.provenance, self.episode)


def _without_help(provenance: Provenance) -> Provenance:
    """The pilots of a flight without what only its record says: the person's name, values and undo."""
    return provenance.model_copy(update={"person": None, "values_used": False, "undo_used": False})


async def _finished(job: "asyncio.Future[Result]") -> Result:
    """The result of a job. The job continues if this is cancelled, since others may wait for it."""
    await asyncio.wait((job,))
    if job.cancelled():
        raise LeftError
    return job.result()


MAPS = 10_000
"""A page that names no map gets one of this many: people say the numbers to each other."""
Opened = list[tuple[LiveEpisode, str]]
"""Episodes, and the JSON of the `EpisodeView` of each."""


async def open_flights(command: Start, app_state: AppState, caller: str, last: Episode | None) -> Opened:
    """Open the sessions of all flights; of none if one fails.

    Args:
        command: The flights to start.
        app_state: The parts of the server.
        caller: The address of the page.
        last: The last episode of the page: a map that is not named is another one.

    Raises:
        UnknownNameError: if the task, a pilot or the reward profile does not exist.
        UnsupportedTaskError: if there is no network that a pilot needs.
        CheckpointError: if the network cannot be read.
        InvalidValueError: if a fork has actions after the end, or its provenance is too long.
        EpisodeError: if the moves of an agent in a fork are not those of that agent.
        CapacityError: if there is no room.
        RequestError: if too many requests are waiting for a worker process.
    """
    start, agents, forking = await run_in_threadpool(_choose, command, app_state, last)
    fork = command.fork
    steps = max(command.step, 0 if fork is None else len(fork.actions))
    beginnings: list[Beginning | None] = []
    for number, agent in enumerate(agents):
        forked = None if fork is None or number != forking else fork.actions
        if forked or (steps and forked is None and agent.pilot != HUMAN):
            job = app_state.workers.run(begin, start, agent, forked, steps, caller=caller, task=start.task.id)
            beginnings.append(await job)
        else:
            beginnings.append(None)
    return await run_in_threadpool(_open, app_state, caller, start, agents, beginnings)


async def attach(session: str, app_state: AppState, caller: str) -> tuple[LiveEpisode, str]:
    """The episode of a session, and the JSON of its `EpisodeView`.

    Raises:
        NoSessionError: if there is no such session.
        EpisodeError: if the agent of the session is not a pilot of the page.
        RequestError: if too many requests are waiting for a worker process.
    """
    live = await run_in_threadpool(LiveEpisode.of, session, app_state, caller)
    run = partial(app_state.workers.run, caller=caller, task=live.start.task.id)
    frames = await run(frames_json, live.start, live.provenance, [DIRECTIONS[one] for one in live.episode.actions])
    return live, await run_in_threadpool(live.view_json, frames)


def end_all(episodes: Sequence[LiveEpisode], app_state: AppState) -> None:
    """End the sessions of these episodes.

    Raises:
        StoreError: if the store could not be written.
    """
    for live in episodes:
        with suppress(NoSessionError):  # it may have expired
            app_state.sessions.end(live.session.id)


def _choose(command: Start, app_state: AppState, last: Episode | None) -> tuple[Episode, list[Provenance], int | None]:
    """The episode at its start, the provenance of each flight, and the index of the flight that continues the fork."""
    task, fork, pilots = get_task(command.task), command.fork, command.pilots
    for pilot in pilots:
        app_state.networks.require(pilot, task)
    seed = command.seed
    while seed is None or (command.seed is None and last is not None and seed == last.seed):
        seed = secrets.randbelow(MAPS)
    start = start_episode(ResetOptions(task_name=task.id, seed=seed, reward_profile=command.reward_profile), None)
    flying = [Provenance(pilot=pilot) for pilot in pilots]
    forking, is_over = None, False
    if fork is not None:
        # The last pilot flies the fork; a person's own flight may be listed before others.
        own = fork.step == 0 and HUMAN in pilots
        forking = pilots.index(HUMAN) if own else len(pilots) - 1
        flying[forking] = fork.of.forked(fork.step, pilots[forking])
        is_over = any(one.ended for one in fly_directions(start.copy(), fork.actions))
    for number, one in enumerate(flying):
        # A finished flight is not credited to the visitor who opens its link.
        if one.pilot == HUMAN and not (is_over and number == forking):
            flying[number] = one.named(command.name)
    return start, flying, forking


def _open(
    app_state: AppState,
    caller: str,
    start: Episode,
    flying: Sequence[Provenance],
    beginnings: Sequence[Beginning | None],
) -> Opened:
    opened: list[LiveEpisode] = []
    views: list[str] = []
    try:
        for provenance, beginning in zip(flying, beginnings, strict=True):
            actions, frames, planned = beginning or ([], None, None)
            episode, flight_id = start.copy().fly(actions), None
            if episode.ended:
                flight_id, provenance = _flown_before(app_state, episode, provenance)
            own = [live.session.id for live in opened]
            session = app_state.sessions.open(episode, provenance, owner=caller, keep=own, flight_id=flight_id)
            live = LiveEpisode.of(session, app_state, caller, planned)
            opened.append(live)
            views.append(live.view_json(frames))
    except BaseException:
        end_all(opened, app_state)
        raise
    return list(zip(opened, views, strict=True))


def _flown_before(app_state: AppState, episode: Episode, provenance: Provenance) -> tuple[str, Provenance]:
    """The id of a finished flight that a link flies again, and who flew it: the link knows not all of its help."""
    kept = _without_help(provenance)
    stored = app_state.store.flown_before(episode)
    for flight_id, by in sorted(stored, key=lambda flown: flown[1] != provenance):
        if _without_help(by) == kept:
            return flight_id, by
    # Two pages that open the link at once store it once.
    return sha256(record_of(episode, provenance).to_json().encode()).hexdigest()[:16], provenance
