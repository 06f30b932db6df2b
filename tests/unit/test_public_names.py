"""The Python interface: what `import drone_env` offers, and what travels as JSON."""

import pytest
from pydantic import BaseModel

import drone_env
from drone_env.cli import main


def test_everything_promised_is_there_and_nothing_else() -> None:
    assert dir(drone_env) == sorted(drone_env.__all__)
    for name in drone_env.__all__:
        assert getattr(drone_env, name) is not None


@pytest.mark.parametrize("model", [drone_env.DroneAction, drone_env.DroneObservation, drone_env.DroneState])
def test_the_schema_of_what_travels_describes_every_field(model: type[BaseModel]) -> None:
    schema = model.model_json_schema()
    assert schema["additionalProperties"] is False
    assert all("description" in field for field in schema["properties"].values())


def test_the_command_prints_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"drone-env {drone_env.__version__}\n"
