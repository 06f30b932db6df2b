"""One episode that a page flies: a session, its pilot, and what is known of its flight ahead of time."""

import asyncio
import secrets
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from hashlib import sha256
from typing import Any, TypeVar

from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import DroneEnvError, EpisodeError, NoSessionError, SessionGoneError
from drone_env.models import DIRECTIONS, Direction
from drone_env.results.finished import check_agent
from drone_env.results.sessions import Session, advance
from drone_env.server.frames import Frame, MapOf, Opening, frame_of, frames_json, plan, shows_values, values_along
from drone_env.server.live.commands import Start
from drone_env.server.map_choice import start_episode
from drone_env.server.observation_json import flat_json
from drone_env.server.pilots import HUMAN, PILOTS, Credit, require_pilot
from drone_env.server.schemas import ResetOptions
from drone_env.server.sessions import OtherStepError
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

    def __init__(self, row: Session, shared: Shared, caller: str) -> None:
        self.row = replace(row, episode=row.fly().copy())
        """The session as it was last seen, with an episode of its own."""
        self.credit = Credit.parse(row.agent)
        self.pilot = self.credit.pilot
        if self.pilot not in PILOTS:
            raise EpisodeError(f"this session is flown by {row.agent!r}, not from the page")
        self.map_of = MapOf.of(self.episode)
        self.values: list[float] = []
        """The best score that can still be reached at the frames of the flight, as far as it is known."""
        self.unsolved = False
        """Whether the map could not be solved."""
        self._sessions, self._workers, self._caller = shared.sessions, shared.workers, caller
        self._plan: list[int] | None = None
        self._planning: asyncio.Future[list[int]] | None = None
        self._jobs: set[asyncio.Future[Any]] = set()
        self._network = shared.networks.beside(self.pilot, self.episode.task)

    @property
    def episode(self) -> Episode:
        """The episode as it stands."""
        return self.row.fly()

    @property
    def automatic(self) -> bool:
        """Whether it flies by itself, and has not ended."""
        return self.pilot != HUMAN and not self.episode.ended

    @property
    def lacks_values(self) -> bool:
        """Whether values are to be shown that are not known yet."""
        return len(self.values) <= self.episode.steps and self._shown and not self.unsolved

    async def planned(self) -> list[int]:
        """All actions of an automatic episode to its end: its agent flies in a worker process, once.

        Raises:
            LeftError: if the page has left it meanwhile.
            DroneEnvError: as `Workers.run` and `ahead.plan`.
        """
        if self._plan is None:
            if self._planning is None or self._planning.done():
                self._planning = self._submit(plan, self.map_of, self.pilot, self.row.actions, self._first)
            self._plan = await _ended(self._planning)
        return self._plan

    async def solve(self) -> None:
        """Find out what can still be reached along the flight, of an automatic one to its end.

        Raises:
            LeftError: if the page has left it meanwhile.
            DroneEnvError: as `Workers.run` and `ahead.values_along`.
        """
        actions = tuple(await self.planned()) if self.automatic else self.row.actions
        first = min(len(self.values), len(actions))
        try:
            values = await _ended(self._submit(values_along, self.map_of, actions, first))
        except DroneEnvError:
            self.unsolved = True
            raise
        flown = self.row.actions
        if len(self.values) >= first and flown[: len(actions)] == actions[: len(flown)]:
            self.values[first:] = values

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
        with self._sessions.changing(self.row.id) as row:
            for action in actions:
                advance(row, action)
            if row.finished:
                # Named by what it is: however often a link to it is opened, it is kept once.
                record = row.finished[0].record.to_json()
                row.episode_id = sha256(record.encode()).hexdigest()[:16]
                row.finished[0] = row.finished[0].model_copy(update={"id": row.episode_id})
        self._see(row)

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
        if self.episode.steps <= self._first:
            raise EpisodeError("there is nothing to take back: you have flown no step yet")
        known = self.row
        with self._sessions.changing(known.id) as row:
            self._recognise(row)
            alone = len(row.actions) == len(known.actions)
            if alone:
                row.actions, row.episode = row.actions[:-1], None
                row.agent = check_agent(str(self.credit._replace(undo=True)))
        if not alone:
            return self._follow(row)
        self._see(row)
        del self.values[self.episode.steps + 1 :]
        return []

    def help(self) -> Frame:
        """Show a person in flight what the actions are worth from now on, and say so of who flew; the frame with that.

        Raises:
            EpisodeError: if an agent flies this episode, or it has ended.
        """
        self._check_by_hand()
        with self._sessions.changing(self.row.id) as row:
            self._recognise(row)
            row.agent = check_agent(str(self.credit._replace(values=True)))
        self.row.agent, self.credit = row.agent, Credit.parse(row.agent)
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
            self._sessions.end(self.row.id)

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
        steps = len(self.row.actions)
        try:
            row, episode = self._sessions.advance(
                self.row.id, action, lambda episode, _: episode.copy(), after=steps, check=self._recognise
            )
        except OtherStepError:  # another page has gone on with the same session
            return self._follow(self._sessions.store.read_session(self.row.id))
        self.row = replace(row, episode=episode)
        return [self.look()]

    def _see(self, row: Session) -> None:
        """Note how the session stands."""
        self.row, self.credit = replace(row, episode=row.fly().copy()), Credit.parse(row.agent)

    def _recognise(self, row: Session) -> None:
        """See whether the session still flies this episode. Another page may have asked for help with it meanwhile."""
        credit = self.credit if row.agent == self.row.agent else Credit.parse(row.agent)
        if self.credit._replace(values=credit.values, undo=credit.undo) != credit or not row.follows(self.row):
            raise SessionGoneError("this session flies another episode by now: start a new one")
        self.credit = credit

    def _check_by_hand(self) -> None:
        if self.pilot != HUMAN:
            raise EpisodeError(f"{self.pilot} flies this episode: start one with the pilot {HUMAN!r} to fly yourself")
        if self.episode.ended:
            raise EpisodeError("this episode has ended: start another")

    def _follow(self, row: Session) -> list[Frame]:
        """Fly what another page has flown, and return the frames."""
        self._recognise(row)
        episode, missed = self.episode.copy(), row.actions[self.episode.steps :]
        if self.pilot == HUMAN:
            del self.values[episode.steps + 1 :]
        self.row = replace(row, episode=episode)
        frames: list[Frame] = []
        for action in missed:
            episode.step(action)
            frames.append(self.look())
        if self._plan is not None and tuple(self._plan[: episode.steps]) != row.actions:
            self._plan = None  # its agent chooses differently each time
        return frames

    def _submit(self, function: Callable[..., Result], *arguments: object) -> "asyncio.Future[Result]":
        run = self._workers.run(function, *arguments, caller=self._caller, task=self.map_of.task.id)
        job = asyncio.ensure_future(run)
        self._jobs.add(job)
        job.add_done_callback(self._jobs.discard)
        return job

    @property
    def _first(self) -> int:
        """The steps that others have flown, before the pilot began."""
        return self.credit.forked_at or 0

    @property
    def _shown(self) -> bool:
        return shows_values(self.credit, self.episode)


async def _ended(job: "asyncio.Future[Result]") -> Result:
    """The result of a job. It goes on if this is cancelled, since others may wait for it."""
    await asyncio.wait((job,))
    if job.cancelled():
        raise LeftError
    return job.result()


MAPS = 10_000
"""Where a page names no map, one of so many: people say the numbers to each other."""
Opened = list[tuple[LiveEpisode, str]]
"""The episodes, and each as it is shown: the JSON of a `ShownEpisode`."""
Beginning = tuple[Sequence[int], str | None, list[int] | None]
"""The actions that a flight begins with, its frames as a JSON array, and all actions of its pilot; None if unknown."""


async def open_flights(command: Start, shared: Shared, caller: str, last: Episode | None) -> Opened:
    """Open the sessions of all flights, or of none.

    Args:
        command: What to start.
        shared: The parts of the server.
        caller: The address of the page.
        last: What was flown before: where no map is named, it is another.

    Raises:
        UnknownNameError: if there is no such task, pilot or reward profile.
        UnsupportedTaskError: if there is no network that a pilot needs.
        CheckpointError: if that cannot be read.
        InvalidValueError: if a fork goes on after the end of its flight, or is of so many that they cannot be named.
        EpisodeError: if an agent is said to have flown in a fork what it would not fly.
        CapacityError: if there is no room.
        RequestError: if too many requests are waiting for a worker process.
    """
    start, agents, forking = await run_in_threadpool(_chosen, command, shared, last)
    fork, map_of = command.fork, MapOf.of(start)
    ahead = command.step if fork is None else len(fork.actions)
    begin = partial(_begin, shared, caller, map_of)
    beginnings = [
        await begin(agent, fork.actions if fork is not None and number == forking else None, ahead)
        for number, agent in enumerate(agents)
    ]
    return await run_in_threadpool(_open, shared, caller, map_of, zip(agents, beginnings, strict=True))


async def attach(session: str, shared: Shared, caller: str) -> tuple[LiveEpisode, str]:
    """The episode of a session, and all of it so far as the JSON of a `ShownEpisode`.

    Raises:
        NoSessionError: if there never was such a session.
        SessionGoneError: if it has ended or expired.
        EpisodeError: if none of our pilots flies it.
        RequestError: if too many requests are waiting for a worker process.
    """
    live = await run_in_threadpool(_attached, session, shared, caller)
    run = partial(shared.workers.run, caller=caller, task=live.map_of.task.id)
    frames = await run(frames_json, live.map_of, live.row.agent, [DIRECTIONS[action] for action in live.row.actions])
    return live, await run_in_threadpool(_shown, live, frames)


def end_all(episodes: Sequence[LiveEpisode]) -> None:
    """Give all their sessions back.

    Raises:
        StoreError: if the store could not be written.
    """
    for live in episodes:
        live.end()


def _attached(session: str, shared: Shared, caller: str) -> LiveEpisode:
    with shared.sessions.reading(session) as row:
        return LiveEpisode(row, shared, caller)


def _chosen(command: Start, shared: Shared, last: Episode | None) -> tuple[Episode, list[str], int | None]:
    """The flight at its start, who flies, and the number of the one that goes on from the fork."""
    task, fork, agents = get_task(command.task), command.fork, list(command.pilots)
    for pilot in agents:
        require_pilot(pilot, task, shared.networks)
    seed = command.seed
    while seed is None or (command.seed is None and last is not None and seed == last.seed):
        seed = secrets.randbelow(MAPS)
    start = start_episode(ResetOptions(task_name=task.id, seed=seed, reward_profile=command.reward_profile), None)
    if fork is None:
        return start, agents, None
    # A fork is the last one's; a person who goes on with a flight of his own may have others behind him.
    own = fork.step == 0 and HUMAN in agents
    forking = agents.index(HUMAN) if own else len(agents) - 1
    agents[forking] = check_agent(str(Credit.of_fork(agents[forking], fork.step, fork.of)))
    return start, agents, forking


async def _begin(
    shared: Shared, caller: str, map_of: MapOf, agent: str, forked: list[Direction] | None, ahead: int
) -> Beginning:
    """What a flight begins with: `forked` if that is given, else, of a pilot, its own first `ahead` steps."""
    credit = Credit.parse(agent)
    run = partial(shared.workers.run, caller=caller, task=map_of.task.id)
    directions, planned = forked or [], None
    if forked is None and credit.pilot != HUMAN and ahead:
        planned = await run(plan, map_of, credit.pilot, (), 0)
        directions = [DIRECTIONS[action] for action in planned[:ahead]]
    if not directions:
        return (), None, planned
    actions = [int(Action[direction]) for direction in directions]
    frames = await run(frames_json, map_of, agent, directions)  # says if it goes on after the end
    if forked is not None and credit.pilot != HUMAN:
        planned = await run(plan, map_of, credit.pilot, actions, credit.forked_at or 0, True)
    return actions, frames, planned


def _open(shared: Shared, caller: str, map_of: MapOf, flights: Iterable[tuple[str, Beginning]]) -> Opened:
    task, seed, profile = map_of
    opened: Opened = []
    try:
        for agent, (actions, frames, planned) in flights:
            options = ResetOptions(task_name=task.id, seed=seed, reward_profile=profile, agent=agent)
            session, _ = shared.sessions.reset(None, options, flat_json)
            live = _attached(session, shared, caller)
            opened.append((live, ""))
            live.begin_with(actions, planned)
            opened[-1] = live, _shown(live, frames)
    except BaseException:
        end_all([live for live, _ in opened])
        raise
    return opened


def _shown(live: LiveEpisode, frames: str | None) -> str:
    opening = Opening.of(live.map_of.start(), live.row.agent, live.row.id).model_dump_json()
    return f'{{"opening":{opening},"frames":{frames or to_json([live.look()]).decode()}}}'
