"""What the tests of the features share: a server of each module, a scripted model, and the table of `--features`."""

from collections.abc import Generator

import pytest

from tests.api.serving import Server, serving
from tests.browser.flights import fill, flown
from tests.features.table import TEXT, FeatureTable, feature_of
from tests.llm.conftest import endpoint, scripted_server

__all__ = ["endpoint", "scripted_server"]
AGENTS = ("random", "greedy", "optimal")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--features", action="store_true", help="print the table of features")


def pytest_configure(config: pytest.Config) -> None:
    # The processes of pytest-xdist hand their reports on to the one that prints.
    if config.getoption("--features") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(FeatureTable(), "feature-table")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if feature_of(item.name) and isinstance(item, pytest.Function):
            item.user_properties.append((TEXT, (item.function.__doc__ or "-").splitlines()[0]))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Generator[Server, None, None]:
    """A server that knows nine flights over medium maps: of three agents, over maps 0 to 2."""
    data = tmp_path_factory.mktemp("features") / "data"
    fill(data, [flown("medium", seed, agent) for seed in range(3) for agent in AGENTS])
    with serving(data) as running:
        yield running
