"""A flight as log lines, and where its files go: what several subcommands share."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import SupportsIndex

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.envs.ansi import draw_text
from drone_env.errors import InvalidValueError
from drone_env.planning.optimal import best_of
from drone_env.results.log_lines import end_line, start_line, step_line


def log_flight(episode: Episode, agent: str, actions: Iterable[SupportsIndex], render: bool) -> None:
    """Fly actions from the start of an episode.

    Standard output receives the log lines and nothing else; the maps, where they are asked for, and the comparison with
    the optimum go to standard error. A flight that has not ended after its last action counts as if it waited to its
    end.
    """
    if render:
        print(draw_text(episode), file=sys.stderr)
    print(start_line(episode.task, agent))
    for action in actions:
        reward = episode.step(action)
        print(step_line(episode.steps, Action(action), reward, episode.ended), flush=render)
        if render:
            print(draw_text(episode), file=sys.stderr)
    score = episode.counted_score()
    print(end_line(episode.success, score, episode.rewards))
    optimum = best_of(episode.task, episode.seed)
    known = f"the optimum is {optimum.score:.4f} in {optimum.steps}" if optimum else "the optimum is not known"
    steps = (
        f"{episode.steps} steps" if episode.ended else f"{episode.steps} steps, unfinished and counted as waiting on"
    )
    print(f"map {episode.seed}: {agent} scored {score:.4f} in {steps}; {known}", file=sys.stderr)


def prepare_file(option: str, path: Path) -> None:
    """Make the folder of a file that an option names, so that it need not fail after the flight.

    Raises:
        InvalidValueError: if it names a folder.
        OSError: if the folder cannot be made.
    """
    if path.is_dir():
        raise InvalidValueError(f"{option} takes the name of a file, got the folder {path}")
    path.parent.mkdir(parents=True, exist_ok=True)


def prepare_film(path: Path | None) -> None:
    """See that the film that `--video` names can be made, where it names one.

    Raises:
        InvalidValueError, OSError: if its suffix names no film, and as `prepare_file`.
    """
    if path is None:
        return
    from drone_env.envs.film import check_film  # loads Pillow

    check_film(path)
    prepare_file("--video", path)


def film(episode: Episode, path: Path | None) -> None:
    """Write a flight as a film, where `--video` names one, and say so on standard error.

    Raises:
        OSError: if it cannot be written.
    """
    if path is None:
        return
    from drone_env.envs.film import save_film  # loads Pillow

    save_film(episode, path)
    print(f"video: {path}", file=sys.stderr)
