"""Which model is asked, where, and with which token: from the environment or `.env`, the environment first."""

import re
from typing import Any
from urllib.parse import urlsplit

from pydantic import Field, SecretStr, ValidationError, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from drone_env.errors import InvalidValueError, text_of
from drone_env.results.tables import markdown_table

HUGGING_FACE = "https://router.huggingface.co/v1"
OPENAI = "https://api.openai.com/v1"
OPENAI_MODEL = "gpt-4o"
HUGGING_FACE_HOSTS = ("huggingface.co", "hf.co", "hf.space", "endpoints.huggingface.cloud")
LOOPBACK = ("localhost", "127.0.0.1", "::1")

SUPPORTED_MODELS = (
    ("Qwen/Qwen2.5-7B-Instruct", "HF Router", "Free", "Fast, good baseline"),
    ("Qwen/Qwen2.5-72B-Instruct", "HF Router", "Credits", "High capability"),
    ("Qwen/QwQ-32B-Preview", "HF Router", "Credits", "Reasoning-optimized"),
    (OPENAI_MODEL, "OpenAI", "Paid", "Reference performance"),
)
"""Model, provider, tier, notes. Any other model of an OpenAI-compatible endpoint can be named as well."""


class InferenceSettings(BaseSettings):
    """What can be configured. Each field is read from the variable of its name in capitals."""

    model_config = SettingsConfigDict(
        env_file=".env",
        env_file_encoding="utf-8",
        env_ignore_empty=True,
        frozen=True,
        extra="ignore",
        protected_namespaces=(),
    )

    hf_token: SecretStr | None = Field(default=None, description="Token for Hugging Face; sent to its hosts alone.")
    openai_api_key: SecretStr | None = Field(
        default=None, description="Token for any other endpoint; never sent to Hugging Face."
    )
    api_base_url: str = Field(
        default=HUGGING_FACE,
        description=f"The OpenAI-compatible endpoint; `{OPENAI}` where `OPENAI_API_KEY` is set and `HF_TOKEN` is not.",
    )
    model_name: str = Field(
        default="Qwen/Qwen2.5-7B-Instruct", description=f"The model; `{OPENAI_MODEL}` at OpenAI's address."
    )
    drone_task: str = Field(default="easy_delivery", description="The task to fly: id, short name or grader.")
    local_image_name: str = Field(
        default="drone-inference-v1", description="Docker image of the server that `--use-image` starts."
    )

    @model_validator(mode="before")
    @classmethod
    def _openai_alone(cls, given: dict[str, Any]) -> dict[str, Any]:
        """Where the key of OpenAI is the only one, its address and a model that is there are meant."""
        if given.get("openai_api_key") and not given.get("hf_token"):
            given = {"api_base_url": OPENAI, **given}
        if str(given.get("api_base_url")).rstrip("/") == OPENAI:
            given = {"model_name": OPENAI_MODEL, **given}
        return given


def load_settings(api_base_url: str | None = None) -> InferenceSettings:
    """The settings from the environment and `.env` of the working folder.

    Args:
        api_base_url: The endpoint; it goes before both.

    Raises:
        InvalidValueError: if a variable has a value that it cannot have, or `.env` is no text; the message says which.
    """
    try:
        return InferenceSettings() if api_base_url is None else InferenceSettings(api_base_url=api_base_url)
    except UnicodeDecodeError as error:
        raise InvalidValueError(f".env is not UTF-8 text: {error.reason} at byte {error.start}") from None
    except ValidationError as error:
        raise InvalidValueError(text_of(error, str.upper)) from None


def check_url(url: str) -> str:
    """An endpoint's address without a slash at its end.

    Raises:
        InvalidValueError: if it is no http or https address, or holds a user, a password, a query, a fragment or
            anything unprintable.
    """
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0 and "@" not in parts.netloc
    except ValueError:
        usable = False
    # Not quoted: it may hold a password, which would end up in the run folder.
    if not usable or not url.isprintable() or "?" in url or "#" in url:
        raise InvalidValueError(
            "API_BASE_URL must be http(s)://HOST[:PORT][/PATH] without a user, password, query or fragment, and "
            "without anything unprintable"
        )
    return url.rstrip("/")


def token_for(settings: InferenceSettings, url: str) -> str | None:
    """The token that goes to an endpoint: by its host alone. None for a local endpoint where no key is set.

    Raises:
        InvalidValueError: if the token that the host needs is not set or cannot stand in a header, or it would be sent
            unencrypted to another machine.
    """
    parts = urlsplit(check_url(url))
    host = (parts.hostname or "").lower().rstrip(".")
    name, secret = ("OPENAI_API_KEY", settings.openai_api_key)
    if any(host == known or host.endswith(f".{known}") for known in HUGGING_FACE_HOSTS):
        name, secret = ("HF_TOKEN", settings.hf_token)
    if secret is None:
        if host in LOOPBACK:
            return None
        raise InvalidValueError(f"{host} needs {name}: set it in the environment or in .env")
    token = secret.get_secret_value().strip()
    if not re.fullmatch(r"[!#-&(-[\]-~]+", token):
        # Quoted in JSON, quotes and backslashes look different, and would not be found and taken out.
        raise InvalidValueError(
            f"{name} must be printable ASCII without spaces, quotes and backslashes, as a header has to carry it"
        )
    if parts.scheme != "https" and host not in LOOPBACK:
        raise InvalidValueError(f"{name} is not sent unencrypted: API_BASE_URL must begin with https:// for {host}")
    return token


def models_table() -> str:
    """The supported models as a table in Markdown."""
    rows = [(f"`{model}`", *rest) for model, *rest in SUPPORTED_MODELS]
    return markdown_table(("model", "provider", "tier", "notes"), rows)
