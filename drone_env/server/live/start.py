"""What a page starts: a session for each flight, and what each begins with."""

import secrets
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.models import DIRECTIONS, Direction
from drone_env.results.finished import check_agent
from drone_env.server.frames import Opening
from drone_env.server.live.ahead import MapOf, frames_json, plan
from drone_env.server.live.commands import Start
from drone_env.server.live.episodes import LiveEpisode
from drone_env.server.map_choice import is_registered, start_episode
from drone_env.server.pilots import HUMAN, Credit, require_pilot
from drone_env.server.schemas import ResetOptions
from drone_env.server.state import Shared

MAPS = 10_000
"""Where a page names no map, one of so many: people say the numbers to each other."""
Opened = list[tuple[LiveEpisode, str]]
"""The episodes, and each as it is shown: the JSON of a `ShownEpisode`."""


class Beginning(NamedTuple):
    """What a flight begins with."""

    agent: str
    """Who flies, as the session has it."""
    actions: Sequence[int] = ()
    frames: str | None = None
    """Its frames as a JSON array; None if there is only the first."""
    plan: list[int] | None = None
    """All actions of the pilot to the end, if they are known."""


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
    return await run_in_threadpool(_open, shared, caller, map_of, beginnings)


async def attach(session: str, shared: Shared, caller: str) -> tuple[LiveEpisode, str]:
    """The episode of a session, and all of it so far as the JSON of a `ShownEpisode`.

    Raises:
        NoSessionError: if there never was such a session.
        SessionGoneError: if it has ended or expired.
        EpisodeError: if none of our pilots flies it.
        RequestError: if too many requests are waiting for a worker process.
    """
    row = await run_in_threadpool(shared.store.read_session, session)
    live = await run_in_threadpool(LiveEpisode, row, shared, caller)
    quick = is_registered(live.map_of.task.id)
    frames = await shared.workers.run(frames_json, live.map_of, live.by, live.directions, caller=caller, quick=quick)
    return live, await run_in_threadpool(_shown, live, frames)


def end_all(episodes: Sequence[LiveEpisode]) -> None:
    """Give all their sessions back.

    Raises:
        StoreError: if the store could not be written.
    """
    for live in episodes:
        live.end()


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
    credit, quick = Credit.parse(agent), is_registered(map_of.task.id)
    run = partial(shared.workers.run, caller=caller, quick=quick)
    directions, planned = forked or [], None
    if forked is None and credit.pilot != HUMAN and ahead:
        planned = await run(plan, map_of, credit.pilot, (), 0)
        directions = [DIRECTIONS[action] for action in planned[:ahead]]
    if not directions:
        return Beginning(agent, plan=planned)
    actions = [int(Action[direction]) for direction in directions]
    frames = await run(frames_json, map_of, agent, directions)  # says if it goes on after the end
    if forked is not None and credit.pilot != HUMAN:
        planned = await run(plan, map_of, credit.pilot, actions, credit.forked_at or 0, True)
    return Beginning(agent, actions, frames, planned)


def _open(shared: Shared, caller: str, map_of: MapOf, beginnings: Sequence[Beginning]) -> Opened:
    task, seed, profile = map_of
    opened: Opened = []
    try:
        for agent, actions, frames, planned in beginnings:
            options = ResetOptions(task_name=task.id, seed=seed, reward_profile=profile, agent=agent)
            session, _ = shared.sessions.reset(None, options)
            live = LiveEpisode(shared.store.read_session(session), shared, caller)
            opened.append((live, ""))
            live.begin_with(actions, planned)
            opened[-1] = live, _shown(live, frames)
    except BaseException:
        end_all([live for live, _ in opened])
        raise
    return opened


def _shown(live: LiveEpisode, frames: str | None) -> str:
    opening = Opening.of(live.map_of.start(), live.by, live.session).model_dump_json()
    return f'{{"opening":{opening},"frames":{frames or to_json([live.look()]).decode()}}}'
