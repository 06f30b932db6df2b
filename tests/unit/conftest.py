"""What the unit tests share."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from drone_env.results.store import Store
from tests.api.networks import put_tour


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store(tmp_path / "data") as store:
        yield store


@pytest.fixture(scope="session")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a tour network of random weights."""
    return put_tour(tmp_path_factory.mktemp("network") / "tour.safetensors")
