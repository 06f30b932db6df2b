"""One server for all tests of this folder."""

from collections.abc import Generator

import pytest

from tests.api.serving import Server, serving


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Generator[Server, None, None]:
    with serving(tmp_path_factory.mktemp("server") / "data") as running:
        yield running
