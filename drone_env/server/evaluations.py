"""The evaluations of agents that lie in the data folder, and what they are worth."""

import os
from pathlib import Path

from drone_env.files import stamp
from drone_env.results.folder import CONFIG, PIECES
from drone_env.results.leaderboard import Judged, Refused, judge_evaluation

MOST_MAPS = 10_000
"""Of one evaluation are looked at: `random` and the optimum are flown over them while somebody waits."""


class Evaluations:
    """The evaluations in a folder, there or not.

    Args:
        folder: The folder of their folders.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._judged: dict[tuple[Path, str], tuple[object, list[Judged | Refused]]] = {}

    def folders(self) -> list[Path]:
        """Those of evaluations, by name."""
        return [path for path in sorted(self._folder.glob("*")) if os.path.lexists(path / CONFIG)]

    def judge(self, path: Path, task: str) -> list[Judged | Refused]:
        """What each agent is worth on a task, or why it is not ranked: once, as long as the files stay as they are."""
        try:
            stamps = [(file, stamp(file)) for file in (path / CONFIG, *sorted((path / PIECES).glob("*.npz")))]
        except OSError as error:
            return [Refused(path, str(error), damaged=True)]
        known = self._judged.get((path, task))
        if known is None or known[0] != stamps:
            known = self._judged[path, task] = stamps, judge_evaluation(path, task, MOST_MAPS)
        return known[1]
