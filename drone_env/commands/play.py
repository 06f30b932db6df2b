"""`drone-env play`: fly a map yourself in the terminal."""

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

if sys.platform != "win32":  # on Windows, press Enter after each key
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
"""One key: an escape sequence or a character."""


def play(task: TaskName = "easy", seed: Seed = None, reward_profile: ProfileName = DEFAULT_PROFILE) -> None:
    """Fly a map yourself, and compare your score with the optimum.

    Arrow keys or w a s d fly, space or . waits, q gives up. Keys can also come from a pipe.

    Example: drone-env play --task hard --seed 7

    Args:
        task: The task, by its short name, id or grader.
        seed: Number of the map, 0 to 2^53 - 1; by default a random train map.
        reward_profile: A reward profile, or a TOML file with one.
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
    """Yield the keys of standard input in lower case."""
    before = termios.tcgetattr(sys.stdin) if sys.platform != "win32" and sys.stdin.isatty() else None
    buffer = ""
    try:
        if before is not None:
            tty.setcbreak(sys.stdin, termios.TCSADRAIN)  # TCSADRAIN keeps earlier keys
        while chunk := os.read(sys.stdin.fileno(), 64).decode(errors="replace"):
            buffer += chunk
            while key := KEY.match(buffer):
                buffer = buffer[key.end() :]
                yield key[0].lower()
    finally:
        if before is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
