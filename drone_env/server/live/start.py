"""What a page starts: a session for each flight, and where there is a fork, what was flown up to there."""

import secrets
from collections.abc import Sequence

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.episodes.record import fly_directions
from drone_env.server.frames import ShownEpisode
from drone_env.server.live.commands import Start
from drone_env.server.live.episodes import LiveEpisode
from drone_env.server.map_choice import start_episode
from drone_env.server.pilots import HUMAN, Credit, agent_of
from drone_env.server.schemas import ResetOptions
from drone_env.server.state import Shared

MAPS = 10_000
"""Where a page names no map, one of so many: people say the numbers to each other."""
Opened = list[tuple[LiveEpisode, ShownEpisode]]


def open_flights(command: Start, shared: Shared, last: Episode | None) -> Opened:
    """Open the sessions of all flights, or of none.

    Args:
        command: What to start.
        shared: The parts of the server.
        last: What was flown before: where no map is named, it is another.

    Raises:
        UnknownNameError: if there is no such task, pilot or reward profile.
        UnsupportedTaskError: if there is no network that a pilot needs.
        CheckpointError: if that cannot be read.
        InvalidValueError: if a fork goes on after the end of its flight, or is of so many that they cannot be named.
        EpisodeError: if an agent is said to have flown in a fork what it would not fly.
        CapacityError: if there is no room.
    """
    task, fork = get_task(command.task), command.fork
    agents = list(command.pilots)
    for pilot in agents:
        agent_of(pilot, task, shared.networks)  # says why it cannot fly before anything is opened
    seed = command.seed
    while seed is None or (command.seed is None and last is not None and seed == last.seed):
        seed = secrets.randbelow(MAPS)
    options = ResetOptions(task_name=task.id, seed=seed, reward_profile=command.reward_profile)
    start = start_episode(options, None)
    # A fork is the last one's; a person who goes on with a flight of his own may have others behind him.
    own = fork is not None and fork.step == 0 and HUMAN in agents
    forking = agents.index(HUMAN) if own else len(agents) - 1
    if fork is not None:
        for _ in fly_directions(start.copy(), fork.actions):
            pass  # says where it ends too early
        agents[forking] = str(Credit.of_fork(agents[forking], fork.step, fork.of))
    opened: Opened = []
    try:
        for agent in agents:
            named = options.model_copy(update={"agent": agent})
            opened.append(LiveEpisode.attach(shared.sessions.reset(None, named)[0], shared))
        ahead = command.step if fork is None else len(fork.actions)
        for i, (live, shown) in enumerate(opened):
            if fork is not None and i == forking:
                shown.frames.extend(live.begin_after(fork.actions))
            else:
                shown.frames.extend(live.begin_at(ahead))
    except BaseException:
        end_all([live for live, _ in opened])
        raise
    return opened


def end_all(episodes: Sequence[LiveEpisode]) -> None:
    """Give all their sessions back.

    Raises:
        StoreError: if the store could not be written.
    """
    for live in episodes:
        live.end()
