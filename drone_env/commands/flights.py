"""Log lines and files of a flight, for several commands."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import SupportsIndex

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.envs.ansi import draw_text, end_line, start_line, step_line
from drone_env.errors import InvalidValueError
from drone_env.planning.optimal import best_of
from drone_env.results.tables import plural


def log_flight(episode: Episode, agent: str, actions: Iterable[SupportsIndex], render: bool) -> None:
    """Fly actions from the start of an episode and print its log lines.

    The maps (`render`) and the comparison with the optimum go to standard error. An unfinished flight counts as if it
    waited to the end.
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
    unfinished = "" if episode.ended else ", unfinished and counted as waiting to the end"
    flown = f"{score:.4f} in {plural(episode.steps, 'step')}{unfinished}"
    print(f"map {episode.seed}: {agent} scored {flown}; {known}", file=sys.stderr)


def prepare_file(option: str, path: Path) -> None:
    """Create the folder of a file before the flight."""
    if path.is_dir():
        raise InvalidValueError(f"{option} takes the name of a file, got the folder {path}")
    path.parent.mkdir(parents=True, exist_ok=True)
