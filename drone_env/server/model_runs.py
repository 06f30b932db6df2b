"""The runs of language models that lie in the data folder: which there are, what they are worth, what was asked.

What flies a model again is imported where it is asked for: most servers have no such run.
"""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from drone_env.errors import DroneEnvError
from drone_env.files import stamp

if TYPE_CHECKING:
    from drone_env.llm.config import RunConfig
    from drone_env.llm.run_folder import PilotedRecord
    from drone_env.llm.transcript import Call
    from drone_env.results.leaderboard import Judged, Refused

MOST_FLIGHTS = 100_000
"""Of one run are looked at: a file may say that there are 2^53."""


class ModelRuns:
    """The runs in a folder, there or not.

    Args:
        folder: The folder of their folders.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._judged: dict[Path, tuple[object, Judged | Refused]] = {}

    def configs(self) -> "dict[Path, RunConfig | None]":
        """What each run is, by its folder; None if that cannot be read."""
        found: dict[Path, RunConfig | None] = {}
        for path in sorted(self._folder.glob("*")):
            from drone_env.llm.run_folder import CONFIG, load_config, runs_in

            for run in runs_in(path):
                if os.path.lexists(run / CONFIG):
                    try:
                        found[run] = load_config(run)
                    except (DroneEnvError, OSError):
                        found[run] = None
        return found

    def models(self) -> set[str]:
        """The models that have flown."""
        return {config.model for config in self.configs().values() if config is not None}

    def judge(self, path: Path) -> "Judged | Refused":
        """What a run is worth, or why it is not ranked: flown again once, as long as its files stay as they are."""
        from drone_env.llm.leaderboard import judge
        from drone_env.llm.run_folder import CONFIG, EPISODES, RESULTS, TRANSCRIPT

        try:
            stamps = [stamp(path / name) for name in (CONFIG, TRANSCRIPT, EPISODES, RESULTS)]
        except OSError as error:
            from drone_env.results.leaderboard import Refused

            return Refused(path, str(error), damaged=True)
        known = self._judged.get(path)
        if known is None or known[0] != stamps:
            known = self._judged[path] = stamps, judge(path)
        return known[1]

    def flights(self, path: Path) -> "list[tuple[str, PilotedRecord]]":
        """The flights of a run that count, each with what a store calls it."""
        from drone_env.llm.run_folder import EpisodeIds, load_results

        ids = EpisodeIds(path)
        return [(ids.of(result.flight), result) for result in load_results(path) if result.status != "errored"]

    def calls(self, episode_id: str) -> "tuple[Path, RunConfig, list[Call]] | None":
        """The calls of a flight of the store, in order, and the run that it is of; None where it is of none.

        Raises:
            OSError: if the transcript cannot be read.
            InvalidValueError: if the transcript of the run is damaged.
        """
        for path, config in self.configs().items():
            from drone_env.llm.run_folder import TRANSCRIPT, EpisodeIds
            from drone_env.llm.transcript import read_calls

            if config is None:
                continue
            try:
                ids = EpisodeIds(path)
            except (DroneEnvError, OSError):  # it has made no call yet, or is damaged
                continue
            for flight in range(min(config.flights, MOST_FLIGHTS)):
                if ids.of(flight) == episode_id:
                    calls = [call for _, call in read_calls(path / TRANSCRIPT) if call.flight == flight]
                    return path, config, sorted(calls, key=lambda call: call.key)
        return None


def newest(flights: "list[tuple[str, PilotedRecord]]", kept: set[str]) -> dict[int, str]:
    """The newest flight of a run over each map of those that a store has, by its id.

    Args:
        flights: With their ids, oldest first.
        kept: The ids that the store has.
    """
    return {result.seed: id_ for id_, result in flights if id_ in kept}
