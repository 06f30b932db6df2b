"""What the unit tests share."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from drone_env.agents.weights_file import write_weights
from drone_env.flights.store import Store


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store(tmp_path / "data") as store:
        yield store


@pytest.fixture(scope="session")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a tour network of random weights."""
    import torch  # slow to load

    from drone_env.rl.model import TourNet

    torch.manual_seed(0)
    file = tmp_path_factory.mktemp("network") / "tour.safetensors"
    parameters = {name: tensor.numpy() for name, tensor in TourNet().state_dict().items()}
    write_weights(file, parameters, {"network": "tournet"})
    return file
