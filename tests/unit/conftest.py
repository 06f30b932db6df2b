"""What the unit tests share."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from drone_env.episodes.store import Store


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store(tmp_path / "data") as store:
        yield store
