"""What a page starts: a session for each flight, and what is flown up to the moment that is asked for."""

from collections.abc import Sequence

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.episodes.record import fly_directions
from drone_env.server.frames import ShownEpisode
from drone_env.server.live.commands import Start
from drone_env.server.live.episodes import LiveEpisode
from drone_env.server.map_choice import start_episode
from drone_env.server.pilots import Credit, agent_of
from drone_env.server.schemas import ResetOptions
from drone_env.server.state import Shared

Opened = list[tuple[LiveEpisode, ShownEpisode]]


def open_flights(command: Start, shared: Shared, last: Episode | None) -> Opened:
    """Open the sessions of all flights, or of none.

    Args:
        command: What to start.
        shared: The parts of the server.
        last: What was flown before: where no map is named, the one after its map follows.

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
    options = ResetOptions(task_name=task.id, seed=command.seed, reward_profile=command.reward_profile)
    start = start_episode(options, last.seed if last is not None and last.task == task else None)
    if fork is not None:
        for _ in fly_directions(start.copy(), fork.actions):
            pass  # says where it ends too early
        agents[-1] = str(Credit.of_fork(agents[-1], fork.step, fork.of))
    opened: Opened = []
    try:
        for agent in agents:
            named = options.model_copy(update={"seed": start.seed, "agent": agent})
            opened.append(LiveEpisode.attach(shared.sessions.reset(None, named)[0], shared))
        alone, steps = (opened, command.step) if fork is None else (opened[:-1], len(fork.actions))
        for live, shown in alone:
            for _ in range(steps):
                if live.automatic:
                    shown.frames.extend(live.step())
        if fork is not None:
            live, shown = opened[-1]
            shown.frames.extend(live.begin_after(fork.actions))
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
