"""`drone-env play`: a person flies, in the terminal."""

import os
import re
import sys
from collections.abc import Generator
from contextlib import closing

from rich.console import Console

from drone_env.commands.arguments import ProfileName, Seed, TaskName
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE
from drone_env.envs.ansi import draw_text
from drone_env.planning.optimal import best_of

if sys.platform != "win32":  # where keys come with Enter
    import termios
    import tty

KEYS = {
    **dict.fromkeys(("\x1b[a", "\x1boa", "w"), Action.UP),
    **dict.fromkeys(("\x1b[b", "\x1bob", "s"), Action.DOWN),
    **dict.fromkeys(("\x1b[c", "\x1boc", "d"), Action.RIGHT),
    **dict.fromkeys(("\x1b[d", "\x1bod", "a"), Action.LEFT),
    **dict.fromkeys((" ", "."), Action.WAIT),
}
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
    console = Console(highlight=False, markup=False)
    episode = Episode(task, reward_profile)
    episode.reset(seed)
    optimum = best_of(episode.task, episode.seed)
    console.print(f"{draw_text(episode)}\n{HELP}")
    with closing(_keys()) as keys:
        for key in keys:
            if key in KEYS:
                episode.step(KEYS[key])
                console.clear()
                console.print(f"{draw_text(episode)}\n{HELP}")
            if key in ("q", "\x04") or episode.ended:
                break
    score = episode.counted_score()
    if not episode.ended:
        console.print(f"Given up after {episode.steps} steps; counted as if you had waited to the end.")
    console.print(f"Your score: {score * 100:.1f} in {episode.steps} steps")
    if optimum is not None:
        console.print(f"The optimum: {optimum.score * 100:.1f} in {optimum.steps} steps")
        regret = (optimum.score - score) * 100
        console.print(f"Regret: {regret:.1f}" if regret > 0 else "You flew the optimum!")


def _keys() -> Generator[str, None, None]:
    """Yield keys in lower case as a terminal sends them."""
    before = termios.tcgetattr(sys.stdin) if sys.platform != "win32" and sys.stdin.isatty() else None
    typed = ""
    try:
        if before is not None:
            tty.setcbreak(sys.stdin, termios.TCSADRAIN)  # which keeps the keys that were typed before
        while piece := os.read(sys.stdin.fileno(), 64).decode(errors="replace"):
            typed += piece
            while key := KEY.match(typed):
                typed = typed[key.end() :]
                yield key[0].lower()
    finally:
        if before is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
