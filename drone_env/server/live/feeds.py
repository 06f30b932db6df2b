"""The news of the server beside the episodes of a page: requests, the training log, finished episodes."""

from collections.abc import Iterator
from typing import Any

from drone_env.server.live.commands import Topic
from drone_env.server.state import Shared
from drone_env.server.train_log import TrainLog

EPISODES = 50
LINES = 200


class Feed:
    """The news of some topics, for one page.

    Args:
        shared: The parts of the server.
        topics: Which news the page wants.
    """

    def __init__(self, shared: Shared, topics: list[Topic]) -> None:
        self.topics = topics
        self._shared = shared
        self._request: int | None = None
        self._episode: int | None = None
        self._log = TrainLog(shared.settings.data)

    def news(self) -> Iterator[dict[str, Any]]:
        """The messages that are due; at first what there is, then what is new.

        Raises:
            StoreError: if the store cannot be read.
        """
        if "requests" in self.topics:
            entries = self._shared.requests.since(self._request or 0)
            if entries or self._request is None:
                self._request = entries[-1].number if entries else 0
                yield {"type": "requests", "requests": entries}
        if "training" in self.topics and self._log.has_changed():
            yield {"type": "training", "lines": self._log.tail(LINES), "curve": self._log.curve()}
        if "episodes" in self.topics:
            found = self._shared.store.listed(EPISODES, after=self._episode)
            if found or self._episode is None:
                self._episode = found[0].number if found else 0
                yield {"type": "episodes", "episodes": found}
