"""The configuration of the server, from the environment. `docs/configuration.md` shows it as a table."""

import os
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

from pydantic import Field, SecretStr, ValidationError, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from drone_env.agents.pathqnet import WEIGHTS
from drone_env.errors import InvalidValueError, text_of

Listed = Annotated[tuple[str, ...], NoDecode]
"""Comma-separated in the environment."""
READ_ELSEWHERE = {"DRONE_ENV_CACHE", "DRONE_ENV_PLUGINS"}
"""Variables that a server heeds and that are no settings of it."""


class Settings(BaseSettings):
    """What can be configured. Each field is read from the variable `DRONE_ENV_` and its name in capitals."""

    model_config = SettingsConfigDict(env_prefix="DRONE_ENV_", env_ignore_empty=True, frozen=True, extra="forbid")

    host: str = Field(default="127.0.0.1", description="Address to listen on; a container needs 0.0.0.0.")
    port: int = Field(default=8000, ge=0, le=65535, description="Port to listen on.")
    workers: int = Field(default=1, ge=1, le=64, description="Processes that serve.")
    data: Path = Field(default=Path("data"), description="Folder of all that is kept: episodes, sessions, logs.")
    weights: Path = Field(
        default=WEIGHTS,
        description="Folder of the networks that are shipped; one trained into the data folder goes before.",
    )
    capacity: int = Field(
        default=256, ge=1, le=100_000, description="Open HTTP sessions in all, and open WebSocket sessions per process."
    )
    idle_seconds: float = Field(default=900, gt=0, description="A session that is not used for so long ends.")
    token: SecretStr | None = Field(
        default=None,
        description="Where set, all but `/health` and the page's files must carry `Authorization: Bearer TOKEN`.",
    )
    allowed_origins: Listed = Field(
        default=(), description="Origins of web pages that may call, beside the server's own; comma-separated."
    )
    allowed_hosts: Listed = Field(
        default=(),
        description="Values of the `Host` header that are answered, without port; comma-separated. A request that "
        "arrives at loopback may always name localhost, 127.0.0.0/8 or [::1]. If empty, requests that arrive at other "
        "addresses, or at a server on 0.0.0.0, may name any host.",
    )
    frame_ancestors: Listed = Field(
        default=("'self'", "https://huggingface.co", "https://*.hf.space"),
        description="Who may show the page in a frame; comma-separated.",
    )
    reward_profiles: Listed = Field(
        default=(),
        description="TOML files of reward profiles that callers may name beside those of the package; comma-separated.",
    )
    maps: int | None = Field(
        default=None,
        ge=0,
        description="Drawn maps that are kept; of more, the one unused for longest is forgotten, and one address keeps "
        "at most a tenth. If empty, 1000 for callers with a token or on this machine alone, and none for others.",
    )
    job_seconds: int = Field(
        default=10, ge=1, description="CPU time that solving a map, drawing a picture and other long work may take."
    )
    job_megabytes: int = Field(
        default=112,
        ge=32,
        description="Memory that it may take; a map of 64 x 64 cells with 8 parcels and 8 pads takes 800 to be solved.",
    )

    @field_validator("allowed_origins", "allowed_hosts", "frame_ancestors", "reward_profiles", mode="before")
    @classmethod
    def _split(cls, value: object) -> object:
        if isinstance(value, str):
            return tuple(part.strip() for part in value.split(",") if part.strip())
        return value

    @field_validator("token")
    @classmethod
    def _usable(cls, value: SecretStr | None) -> SecretStr | None:
        if value is not None and not (value.get_secret_value().isascii() and value.get_secret_value().isprintable()):
            raise ValueError("must be printable ASCII, as a header has to carry it")
        return value


def load_settings() -> Settings:
    """The settings from the environment.

    Raises:
        InvalidValueError: if a variable has a value that it cannot have, or `DRONE_ENV_TOKEN` is empty; the message
            names it and what is allowed.
    """
    if os.environ.get("DRONE_ENV_TOKEN") == "":
        # Anyone who sets it wants a closed server, and would not notice an open one.
        raise InvalidValueError("DRONE_ENV_TOKEN: is empty; give it a value, or unset it for a server without a token")
    try:
        return Settings()
    except ValidationError as error:
        raise InvalidValueError(text_of(error, lambda where: f"DRONE_ENV_{where.upper()}")) from None


def misspelt_variables() -> dict[str, str]:
    """Variables of the environment that look like one of ours and are none, and which one each looks like."""
    known = {f"DRONE_ENV_{name.upper()}" for name in Settings.model_fields} | READ_ELSEWHERE
    found = [name for name in os.environ if name.startswith("DRONE_ENV_") and name not in known]
    close = {name: get_close_matches(name, known, 1, 0.9) for name in found}
    return {name: matches[0] for name, matches in close.items() if matches}
