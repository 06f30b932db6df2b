"""What the tests of the features share: a server of each module, and a scripted model."""

from collections.abc import Generator

import pytest

from tests.api.serving import Server, serving
from tests.browser.flights import fill, flown
from tests.llm.conftest import endpoint, scripted_server

__all__ = ["endpoint", "scripted_server"]
AGENTS = ("random", "greedy", "optimal")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Generator[Server, None, None]:
    """A server that knows nine flights over medium maps: of three agents, over maps 0 to 2."""
    data = tmp_path_factory.mktemp("features") / "data"
    fill(data, [flown("medium", seed, agent) for seed in range(3) for agent in AGENTS])
    with serving(data) as running:
        yield running
