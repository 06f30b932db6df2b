"""`drone-env play`: a person flies, in the terminal."""

import os
import re
import sys
from collections.abc import Iterator

from rich.console import Console

from drone_env.commands.arguments import ProfileName, Seed, TaskName
from drone_env.core.actions import Action
from drone_env.core.state_manager import Episode
from drone_env.envs.ansi import draw_text
from drone_env.planning.optimal import solve

try:
    import termios
    import tty
except ImportError:  # not on Windows: keys then come with Enter
    termios = tty = None

KEYS = {
    "\x1b[A": Action.UP,
    "\x1b[B": Action.DOWN,
    "\x1b[C": Action.RIGHT,
    "\x1b[D": Action.LEFT,
    "w": Action.UP,
    "s": Action.DOWN,
    "a": Action.LEFT,
    "d": Action.RIGHT,
    " ": Action.WAIT,
    ".": Action.WAIT,
}
QUIT = {"q", "\x1b", "\x04"}
ONE_KEY = re.compile(r"\x1b[\[O][A-D]|.", re.DOTALL)
HELP = "Arrow keys or w a s d fly, space or . waits, q gives up."


def play(task: TaskName = "easy", seed: Seed = None, reward_profile: ProfileName = "tiered") -> None:
    """Fly a mission yourself, against the optimum.

    Arrow keys or w a s d fly, space or . waits, q gives up. Keys can also come from a pipe, one character each.

    Example: drone-env play --task hard --seed 7

    Args:
        task: The task, by its short name, id or grader.
        seed: Number of the map, 0 to 2^53 - 1. Without one, a train map is drawn at random.
        reward_profile: What steps pay.
    """
    console = Console(highlight=False)
    episode = Episode(task, reward_profile)
    optimum = solve(task, episode.reset(seed))
    _show(console, episode)
    for pressed in _keys():
        if pressed in QUIT:
            break
        if pressed not in KEYS:
            continue
        episode.step(KEYS[pressed])
        _show(console, episode)
        if episode.ended:
            break
    score = episode.counted_score()
    if not episode.ended:
        console.print(f"Given up after {episode.steps} steps; counted as if you had waited to the end.")
    console.print(f"Your score: {score * 100:.1f} in {episode.steps} steps")
    console.print(f"The optimum: {optimum.score * 100:.1f} in {optimum.steps} steps")
    if score == optimum.score:
        console.print("You flew the optimum!")
    else:
        regret = (optimum.score - score) * 100
        see = f"drone-env solve --task {episode.task.short_name} --seed {episode.seed}"
        console.print(f"Regret: {regret:.1f}. See the best flight: {see}")


def _show(console: Console, episode: Episode) -> None:
    if console.is_terminal:
        console.clear()
    console.print(draw_text(episode), markup=False)
    console.print(HELP)


def _keys() -> Iterator[str]:
    """Keys as they are pressed; characters of standard input where that is no terminal."""
    if termios is None or tty is None or not sys.stdin.isatty():
        while character := sys.stdin.read(1):
            yield character
        return
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    try:
        # Without flushing: what is typed while the map is drawn counts.
        tty.setcbreak(terminal, termios.TCSADRAIN)
        while pressed := os.read(terminal, 64):
            for key in ONE_KEY.findall(pressed.decode(errors="replace")):
                yield key.replace("\x1bO", "\x1b[")
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
