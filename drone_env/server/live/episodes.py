"""One episode that a page flies: its session, its pilot, and the values along its flight."""

import asyncio
import secrets
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from hashlib import sha256
from typing import Any, TypeVar

from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import DroneEnvError, EpisodeError, NoSessionError
from drone_env.models import DIRECTIONS, Direction
from drone_env.results.finished import check_agent
from drone_env.results.record import fly_directions
from drone_env.results.sessions import Session, advance
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
from drone_env.server.map_choice import start_episode
from drone_env.server.pilots import HUMAN, Provenance, all_pilots
from drone_env.server.schemas import ResetOptions
from drone_env.server.state import AppState

Result = TypeVar("Result")


class LeftError(Exception):
    """The page shows another flight now."""


class LiveEpisode:
    """An episode that a page flies. The row of its session in the store is the truth; this is a copy.

    Args:
        row: The session.
        shared: The parts of the server.
        caller: The address of the page.

    Raises:
        EpisodeError: if the agent of the session is not a pilot of the page.
    """

    def __init__(self, row: Session, shared: AppState, caller: str) -> None:
        self.row = row
        self.pilot = self.provenance.pilot
        if self.pilot not in all_pilots():
            raise EpisodeError(f"the agent of this session is {row.agent!r}, not a pilot of the page")
        self.start = Episode(self.episode.task, self.episode.reward_profile, self.episode.seed)
        self.values: list[float] = []
        """The best score still possible at each frame, as far as it is known."""
        self.unsolved = False
        """Whether solving the map failed."""
        self._sessions, self._workers, self._caller = shared.sessions, shared.workers, caller
        self._plan: list[int] | None = None
        self._planning: asyncio.Future[list[int]] | None = None
        self._jobs: set[asyncio.Future[Any]] = set()
        self._network = shared.networks.shown_network(self.pilot, self.start.task)

    @property
    def episode(self) -> Episode:
        """The episode in its current state."""
        return self.row.fly()

    @property
    def provenance(self) -> Provenance:
        """The pilots of its steps."""
        return Provenance.parse(self.row.agent)

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
                self._planning = self._submit(plan, self.start, self.pilot, self.row.actions, self._first)
            self._plan = await _finished(self._planning)
        return self._plan

    async def solve(self) -> None:
        """Compute the values along the flight; for an automatic one to its end.

        Raises:
            LeftError: if the page has left the flight.
            DroneEnvError: as `Workers.run` and `values_along`.
        """
        actions = tuple(await self.planned()) if self.automatic else self.row.actions
        try:
            values = await _finished(self._submit(values_along, self.start, actions))
        except DroneEnvError:
            self.unsolved = True
            raise
        if self.automatic or self.row.actions[: len(actions)] == actions:
            self.values = values

    def leave(self) -> None:
        """Cancel its jobs: the page shows another flight."""
        for job in self._jobs:
            job.cancel()

    def begin_with(self, actions: Sequence[int], planned: list[int] | None) -> None:
        """Fly the first actions of a new flight and store them.

        Args:
            actions: The actions of a fork, or the pilot's own up to a step.
            planned: What `planned` returns, None if that is unknown.
        """
        self._plan = planned
        if not actions:
            return
        with self._changing() as row:
            for action in actions:
                advance(row, action)
            if row.finished:
                self._store_once(row)

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
        with self._changing() as row:
            row.actions, row.episode = row.actions[:-1], None
            row.agent = check_agent(str(self.provenance._replace(undo=True)))
        del self.values[self.episode.steps + 1 :]

    def help(self) -> Frame:
        """Turn on the values for a person in flight; the provenance shows it. Returns the current frame with values.

        Raises:
            EpisodeError: if an agent flies this episode, or it has ended.
        """
        self._check_by_hand()
        with self._changing() as row:
            row.agent = check_agent(str(self.provenance._replace(values=True)))
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
        header = FlightHeader.of(self.start, self.row.agent, self.row.id).model_dump_json()
        return f'{{"opening":{header},"frames":{frames or to_json([self.frame()]).decode()}}}'

    def _fly(self, action: int) -> Frame:
        with self._changing() as row:
            advance(row, action)
        return self.frame()

    @contextmanager
    def _changing(self) -> Generator[Session, None, None]:
        """Context manager of the session to change.

        Raises:
            NoSessionError: if somebody else has changed it.
        """
        with self._sessions.changing(self.row.id) as row:
            if (row.flight, row.agent, row.actions) != (self.row.flight, self.row.agent, self.row.actions):
                raise NoSessionError("another page or client flies this session now: start a new flight")
            yield row
        self.row = row

    def _store_once(self, row: Session) -> None:
        """Replace a finished flight that a link flew again by the stored one: the link knows not all of its agent."""
        (flown,) = row.finished
        record, kept = flown.record, _without_help(row.agent)
        before = self._sessions.store.flown_before(record)
        for stored in sorted(before, key=lambda stored: stored.agent != row.agent):
            if _without_help(stored.agent) == kept:
                row.finished, row.episode_id, row.agent = [], stored.id, stored.agent
                return
        # Two pages that open the link at once store it once.
        row.episode_id = sha256(record.to_json().encode()).hexdigest()[:16]
        row.finished = [flown.model_copy(update={"id": row.episode_id})]

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
        return self.provenance.forked_at or 0

    @property
    def _shown(self) -> bool:
        return shows_values(self.provenance, self.episode)


def _without_help(agent: str) -> Provenance:
    """The pilots of a flight without what only its record says: the person's name, values and undo."""
    return Provenance.parse(agent)._replace(name=None, values=False, undo=False)


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


async def open_flights(command: Start, shared: AppState, caller: str, last: Episode | None) -> Opened:
    """Open the sessions of all flights; of none if one fails.

    Args:
        command: The flights to start.
        shared: The parts of the server.
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
    start, agents, forking = await run_in_threadpool(_choose, command, shared, last)
    fork = command.fork
    steps = max(command.step, 0 if fork is None else len(fork.actions))
    beginnings: list[Beginning | None] = []
    for number, agent in enumerate(agents):
        forked = None if fork is None or number != forking else fork.actions
        if forked or (steps and forked is None and Provenance.parse(agent).pilot != HUMAN):
            job = shared.workers.run(begin, start, agent, forked, steps, caller=caller, task=start.task.id)
            beginnings.append(await job)
        else:
            beginnings.append(None)
    return await run_in_threadpool(_open, shared, caller, start, agents, beginnings)


async def attach(session: str, shared: AppState, caller: str) -> tuple[LiveEpisode, str]:
    """The episode of a session, and the JSON of its `EpisodeView`.

    Raises:
        NoSessionError: if there is no such session.
        EpisodeError: if the agent of the session is not a pilot of the page.
        RequestError: if too many requests are waiting for a worker process.
    """
    live = await run_in_threadpool(lambda: LiveEpisode(shared.sessions.read(session), shared, caller))
    run = partial(shared.workers.run, caller=caller, task=live.start.task.id)
    frames = await run(frames_json, live.start, live.row.agent, [DIRECTIONS[action] for action in live.row.actions])
    return live, await run_in_threadpool(live.view_json, frames)


def end_all(episodes: Sequence[LiveEpisode], shared: AppState) -> None:
    """End the sessions of these episodes.

    Raises:
        StoreError: if the store could not be written.
    """
    for live in episodes:
        with suppress(NoSessionError):  # it may have expired
            shared.store.end_session(live.row.id)


def _choose(command: Start, shared: AppState, last: Episode | None) -> tuple[Episode, list[str], int | None]:
    """The episode at its start, the agents, and the index of the one that flies the fork."""
    task, fork, agents = get_task(command.task), command.fork, list(command.pilots)
    for pilot in agents:
        shared.networks.require(pilot, task)
    seed = command.seed
    while seed is None or (command.seed is None and last is not None and seed == last.seed):
        seed = secrets.randbelow(MAPS)
    start = start_episode(ResetOptions(task_name=task.id, seed=seed, reward_profile=command.reward_profile), None)
    forking = None
    if fork is not None:
        # The last pilot flies the fork; a person's own flight may be listed before others.
        own = fork.step == 0 and HUMAN in agents
        forking = agents.index(HUMAN) if own else len(agents) - 1
        agents[forking] = str(Provenance.of_fork(agents[forking], fork.step, fork.of))
    # A finished flight is not credited to the visitor who opens its link.
    over = fork is not None and any(one.ended for one in fly_directions(start.copy(), fork.actions))
    flying = [Provenance.parse(agent) for agent in agents]
    for number, one in enumerate(flying):
        if one.pilot == HUMAN and not (over and number == forking):
            flying[number] = one._replace(name=command.name)
    return start, [check_agent(str(one)) for one in flying], forking


def _open(
    shared: AppState, caller: str, start: Episode, agents: Sequence[str], beginnings: Sequence[Beginning | None]
) -> Opened:
    task, profile = start.task.id, start.reward_profile.id
    opened: list[LiveEpisode] = []
    views: list[str] = []
    try:
        for agent, beginning in zip(agents, beginnings, strict=True):
            options = ResetOptions(task_name=task, seed=start.seed, reward_profile=profile, agent=agent)
            own = [live.row.id for live in opened]
            session, _ = shared.sessions.reset(None, options, owner=caller, keep=own)
            live = LiveEpisode(shared.sessions.read(session), shared, caller)
            opened.append(live)
            actions, frames, planned = beginning or ((), None, None)
            live.begin_with(actions, planned)
            views.append(live.view_json(frames))
    except BaseException:
        end_all(opened, shared)
        raise
    return list(zip(opened, views, strict=True))
