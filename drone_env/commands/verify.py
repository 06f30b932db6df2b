"""`drone-env verify`: fly submissions to the leaderboard again."""

from pathlib import Path
from typing import Annotated

import tyro

from drone_env.commands.evaluate import print_results
from drone_env.results.statistics import Summary
from drone_env.results.tables import percent

Files = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE...", help_behavior_hint="")]


def verify(files: Files) -> None:
    """Fly submissions to the leaderboard again, and print their entries beside the exact optimum.

    A file passes only if each flight gives its score to the last bit, and each task has its first test maps, each once.
    Otherwise the message names the line. `drone-env submit` writes such files.

    Example: drone-env verify leaderboard/nearest.jsonl

    Args:
        files: One or more submissions.
    """
    from drone_env.results.submission import read_submission  # loads Pydantic

    for file in files:
        head, results = read_submission(file)
        caption = f"verified: {file}, the first {head.maps} test maps of each task, {head.link}"
        if head.prompt is not None:
            caption += f", prompt {head.prompt}, {percent(head.unusable)} of the answers unusable as reported"
        print_results({(task, head.agent): Summary.of(flown) for task, flown in results.items()}, caption)
