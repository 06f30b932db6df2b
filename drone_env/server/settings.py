"""Server settings from environment variables. `docs/configuration.md` lists them."""

import os
from collections.abc import Collection
from pathlib import Path

from pydantic import Field, SecretStr, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict

from drone_env.agents.pathqnet import WEIGHTS
from drone_env.errors import InvalidValueError, text_of


class Settings(BaseSettings):
    """Settings of the server. The variable of a field is `DRONE_ENV_` and the name of the field in capitals."""

    model_config = SettingsConfigDict(env_prefix="DRONE_ENV_", env_ignore_empty=True, frozen=True, extra="forbid")

    host: str = Field(default="127.0.0.1", description="Address to listen on; a container needs 0.0.0.0.")
    port: int = Field(default=8000, ge=0, le=65535, description="Port to listen on.")
    workers: int = Field(default=1, ge=1, le=64, description="Number of server processes.")
    data: Path = Field(default=Path("data"), description="Data folder: episodes, sessions, logs, trained networks.")
    weights: Path = Field(
        default=WEIGHTS, description="Folder of the shipped networks. Networks in the data folder have priority."
    )
    capacity: int = Field(
        default=256, ge=1, le=100_000, description="Most open HTTP sessions, and most WebSocket sessions per process."
    )
    idle_seconds: float = Field(default=900, gt=0, description="Idle time in seconds after which a session ends.")
    token: SecretStr | None = Field(
        default=None,
        description="If set, requests need `Authorization: Bearer TOKEN`, except for `/health` and the page's files.",
    )
    withhold_hints: bool = Field(
        default=False,
        description="For evaluations: serve only flights and the catalogue, not the page, other flights, values, "
        "solutions and pilots.",
    )
    job_seconds: int = Field(
        default=10, ge=1, description="CPU time in seconds for each long job, such as solving a map."
    )
    job_megabytes: int = Field(
        default=112,
        ge=32,
        description="Memory in MB for each long job. Solving 64 x 64 cells with 8 parcels and 8 pads takes 800.",
    )


def load_settings(options: Collection[str] = ()) -> Settings:
    """Read the settings from the environment.

    Args:
        options: The fields that options of the command line have set; errors name the option.

    Raises:
        InvalidValueError: if a variable has a value that is not allowed, or `DRONE_ENV_TOKEN` is empty.
    """
    if os.environ.get("DRONE_ENV_TOKEN") == "":
        # pydantic-settings ignores empty variables, which would leave the server open.
        raise InvalidValueError("DRONE_ENV_TOKEN: is empty; set a token, or unset it for a server without one")

    def named(where: str) -> str:
        return f"--{where.replace('_', '-')}" if where in options else f"DRONE_ENV_{where.upper()}"

    try:
        return Settings()
    except ValidationError as error:
        raise InvalidValueError(text_of(error, named)) from None
