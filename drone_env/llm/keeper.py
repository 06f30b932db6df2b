"""Flights of a run in the store, where the server and its page find them."""

import hashlib
from pathlib import Path

from drone_env.episodes.store import Store
from drone_env.errors import StoreError
from drone_env.llm.pilot import Flight


class Keeper:
    """Keeps the flights of a run that were flown to their end: each once, however often the run is gone on with.

    Args:
        store: The store.
        transcript: The transcript of the run.
        agent: Who flies, as records say it.
    """

    def __init__(self, store: Store, transcript: Path, agent: str) -> None:
        self.problems: list[str] = []
        """Why flights are missing in the store, one text for each."""
        self._store = store
        self._transcript = transcript
        self._agent = agent

    def keep(self, flight: Flight) -> None:
        """Keep a flight whose calls are in the transcript, unless it is there already.

        What the store refuses is noted: the flight has been paid, and the run goes on without the store.
        """
        if not flight.episode.ended:
            return
        with self._transcript.open("rb") as file:
            # It tells the time of the run's first call, and is the same for all parts of the run.
            run = file.readline()
        episode_id = hashlib.sha256(b"%d %s" % (flight.index, run)).hexdigest()[:16]
        try:
            self._store.add_episode(flight.episode, self._agent, episode_id)
        except StoreError as error:
            self.problems.append(str(error))
