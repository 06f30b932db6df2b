"""`drone-env play`: a person flies, in the terminal."""

import os
import re
import sys
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing

from rich.console import Console

from drone_env.commands.arguments import ProfileName, Seed, TaskName
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE
from drone_env.envs.ansi import draw_text
from drone_env.envs.registry import task_argument
from drone_env.planning.optimal import best_of

if sys.platform != "win32":  # where keys come with Enter
    import termios
    import tty

KEYS = {
    **dict.fromkeys(("\x1b[A", "w"), Action.UP),
    **dict.fromkeys(("\x1b[B", "s"), Action.DOWN),
    **dict.fromkeys(("\x1b[C", "d"), Action.RIGHT),
    **dict.fromkeys(("\x1b[D", "a"), Action.LEFT),
    **dict.fromkeys((" ", "."), Action.WAIT),
}
QUIT = {"q", "\x04"}
HELP = "Arrow keys or w a s d fly, space or . waits, q gives up."
KEY = re.compile(r"\x1b\[[0-9;]*[A-Za-z~]|\x1bO.|\x1b[^\[O]|[^\x1b]", re.DOTALL)
"""One key: an escape sequence as a whole, or a character."""


def play(task: TaskName = "easy", seed: Seed = None, reward_profile: ProfileName = DEFAULT_PROFILE) -> None:
    """Fly a map yourself, against the optimum.

    Arrow keys or w a s d fly, space or . waits, q gives up. Keys can also come from a pipe, one character each.

    Example: drone-env play --task hard --seed 7

    Args:
        task: The task, by its short name, id or grader.
        seed: Number of the map, 0 to 2^53 - 1. Without one, a train map is drawn at random.
        reward_profile: What steps pay: a reward profile, or a TOML file with one.
    """
    console = Console(highlight=False)
    episode = Episode(task, reward_profile)
    episode.reset(seed)
    optimum = best_of(episode.task, episode.seed)
    _show(console, episode)
    with closing(_keys()) as keys:
        for pressed in keys:
            if pressed in QUIT:
                break
            if pressed in KEYS:
                episode.step(KEYS[pressed])
                _show(console, episode)
            if episode.ended:
                break
    score = episode.counted_score()
    if not episode.ended:
        console.print(f"Given up after {episode.steps} steps; counted as if you had waited to the end.")
    console.print(f"Your score: {score * 100:.1f} in {episode.steps} steps")
    if optimum is None:
        console.print("The optimum of this task is not known.")
        return
    console.print(f"The optimum: {optimum.score * 100:.1f} in {optimum.steps} steps")
    see = f"See the best flight: drone-env solve --task {task_argument(episode.task)} --seed {episode.seed}"
    regret = (optimum.score - score) * 100
    console.print(f"Regret: {regret:.1f}. {see}" if score < optimum.score else "You flew the optimum!")


def _show(console: Console, episode: Episode) -> None:
    if console.is_terminal:
        console.clear()
    console.print(draw_text(episode), markup=False)
    console.print(HELP)


def _keys() -> Generator[str, None, None]:
    """Keys as they are pressed; the characters of standard input if that is no terminal."""
    if sys.platform == "win32" or not sys.stdin.isatty():
        yield from split_keys(iter(lambda: sys.stdin.read(1), ""))
        return
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    try:
        # TCSADRAIN: keys that were typed before the map was drawn count.
        tty.setcbreak(terminal, termios.TCSADRAIN)
        yield from split_keys(iter(lambda: os.read(terminal, 64).decode(errors="replace"), ""))
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def split_keys(pieces: Iterable[str]) -> Iterator[str]:
    """The keys in a stream of text, whose pieces may end in the middle of an escape sequence."""
    rest = ""
    for piece in pieces:
        rest += piece
        while key := KEY.match(rest):
            rest = rest[key.end() :]
            yield key[0].lower() if len(key[0]) == 1 else key[0].replace("\x1bO", "\x1b[")
