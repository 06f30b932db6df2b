"""Settings from the environment (model, endpoint, token), and the configuration that identifies a run."""

import re
from typing import Any, Literal
from urllib.parse import urlsplit

from pydantic import Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict
from typing_extensions import Self

from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.core.tasks import TaskConfig, custom_task_rules, get_task
from drone_env.errors import InvalidValueError
from drone_env.llm.prompt import Prompt, get_prompt, parse_prompt
from drone_env.llm.text_episode import EpisodeRun
from drone_env.models import DIRECTIONS, Count, StrictModel

HUGGING_FACE = "https://router.huggingface.co/v1"
OPENAI = "https://api.openai.com/v1"
OPENAI_MODEL = "gpt-4o"
HUGGING_FACE_HOSTS = ("huggingface.co", "hf.co", "hf.space", "endpoints.huggingface.cloud")
LOOPBACK = ("localhost", "127.0.0.1", "::1")
LOCAL = r"local:(bfloat16|float32):[0-9a-f]{16}"
"""In place of an endpoint's address: the type of a local model's numbers, and the digest of its files."""
PROVIDERS_KEY = re.compile(r"\Ahf_|\Ask-.*T3BlbkFJ")
"""Beginning of a key of Hugging Face, and a part of every key of OpenAI."""


class InferenceSettings(BaseSettings):
    """Settings from the environment or `.env`. The environment takes precedence; names are in capitals there."""

    model_config = SettingsConfigDict(
        env_file=".env", env_file_encoding="utf-8", env_ignore_empty=True, extra="ignore", protected_namespaces=()
    )

    hf_token: SecretStr | None = Field(default=None, description="Token for Hugging Face; sent to its hosts alone.")
    openai_api_key: SecretStr | None = Field(
        default=None, description="Token for any other endpoint; never sent to Hugging Face."
    )
    api_base_url: str = Field(
        default=HUGGING_FACE,
        description=f"The OpenAI-compatible endpoint; `{OPENAI}` if `OPENAI_API_KEY` is set and `HF_TOKEN` is not.",
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
    def _openai_defaults(cls, values: dict[str, Any]) -> dict[str, Any]:
        """If OpenAI's key is the only one, default to its address and to a model that it has."""
        if values.get("openai_api_key") and not values.get("hf_token"):
            values = {"api_base_url": OPENAI, **values}
        if str(values.get("api_base_url")).rstrip("/") == OPENAI:
            values = {"model_name": OPENAI_MODEL, **values}
        return values

    def token_for(self, url: str) -> str | None:
        """The token for an endpoint, chosen by its host; None if no key is set and the endpoint may need none.

        Raises:
            InvalidValueError: if the token for the host is not set or cannot be in a header, or would reach another
                machine unencrypted, as a key of Hugging Face or OpenAI.
        """
        parts = urlsplit(url)
        host = (parts.hostname or "").rstrip(".")
        hugging_face = any(f".{host}".endswith(f".{known}") for known in HUGGING_FACE_HOSTS)
        name, secret = ("HF_TOKEN", self.hf_token) if hugging_face else ("OPENAI_API_KEY", self.openai_api_key)
        if secret is None:
            if host in (urlsplit(HUGGING_FACE).hostname, urlsplit(OPENAI).hostname):
                raise InvalidValueError(f"{host} needs {name}: set it in the environment or in .env")
            return None
        token = secret.get_secret_value().strip()
        if not re.fullmatch("[!-~]+", token):
            raise InvalidValueError(f"{name} must be printable ASCII without spaces")
        if parts.scheme == "http" and host not in LOOPBACK and PROVIDERS_KEY.search(token):
            raise InvalidValueError(
                f"{name} is a key of Hugging Face or OpenAI and is not sent unencrypted to {host}: set it to the key "
                "of this endpoint (any word if it has none), or use https://"
            )
        return token


def load_settings(api_base_url: str | None = None) -> InferenceSettings:
    """The settings from the environment and from `.env` in the working folder.

    Args:
        api_base_url: The endpoint; overrides both.

    Raises:
        InvalidValueError: if `.env` is not text.
    """
    try:
        return InferenceSettings() if api_base_url is None else InferenceSettings(api_base_url=api_base_url)
    except UnicodeDecodeError as error:
        raise InvalidValueError(f".env is not UTF-8 text: {error.reason} at byte {error.start}") from None


class Sampling(StrictModel):
    """Parameters of every request. Null values are not sent."""

    temperature: float | None = Field(default=0.0, ge=0, le=2)
    max_tokens: int | None = Field(default=1024, ge=1)
    max_completion_tokens: int | None = Field(default=None, ge=1)
    reasoning_effort: str | None = None
    seed: int | None = Field(default=None, ge=0)
    extra: dict[str, Any] = Field(default_factory=dict, description="More fields of the body; they replace others.")


class RunConfig(StrictModel):
    """The identity of a run: all that decides its calls and results. A run folder resumes only with an equal one."""

    format: Literal["drone_env/llm-run"] = "drone_env/llm-run"
    format_version: Literal[1] = 1
    # Readers split log lines at spaces.
    model: str = Field(pattern=r"^\S{1,180}$", description="The model, without spaces.")
    base_url: str
    task: str
    task_version: int = Field(ge=1)
    rules: dict[str, str] = Field(default={}, description="Digest of the rules of a task from outside the package.")
    split: str
    seeds: tuple[Count, Count] = Field(strict=False, description="The maps, [start, stop).")
    repeats: int = Field(ge=1, le=100, description="Flights over each map.")
    prompt: str = Field(description="Id of the prompt.")
    prompt_digest: str = Field(description="Digest of its file.")
    prompt_text: str | None = Field(default=None, description="Its text, if it is from outside the package.")
    answers: Literal["text", "json", "tool"]
    sampling: Sampling

    @field_validator("base_url")
    @classmethod
    def _check_url(cls, url: str) -> str:
        if re.fullmatch(LOCAL, url):
            return url
        parts = urlsplit(url)
        plain = "@" not in parts.netloc and not parts.query and not parts.fragment
        if parts.scheme not in ("http", "https") or not parts.hostname or not plain:
            # The message does not quote the address: it can contain a password.
            raise ValueError("API_BASE_URL must be http(s)://HOST[:PORT][/PATH] without a user, password or query")
        return url.rstrip("/")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.rules != custom_task_rules(self.task_config):
            raise ValueError(f"the task {self.task!r} has changed since the run: name the file as it was")
        return self

    @property
    def task_config(self) -> TaskConfig:
        """The task."""
        return get_task(self.task, self.task_version)

    @property
    def flights(self) -> int:
        """Number of flights."""
        return (self.seeds[1] - self.seeds[0]) * self.repeats

    def episode_run(self, index: int, prompt: Prompt) -> EpisodeRun:
        """A flight at its start, by its number: all maps once, then all again."""
        repeat, offset = divmod(index, self.seeds[1] - self.seeds[0])
        run = EpisodeRun(self.task_config, self.seeds[0] + offset, prompt, ORIGINAL_PROFILE)
        run.index, run.repeat, run.parameters = index, repeat, self._parameters(repeat, prompt)
        return run

    def load_prompt(self) -> Prompt:
        """The prompt.

        Raises:
            UnknownNameError: if it does not exist.
            ValueError: if it has changed since the run began.
        """
        if self.prompt_text is None:
            prompt = get_prompt(self.prompt)
        else:
            prompt = parse_prompt(f"{self.prompt}.toml", self.prompt_text, own=True)
        if prompt.digest != self.prompt_digest:
            raise ValueError(f"prompt {self.prompt} is now {prompt.digest}; the run was made with {self.prompt_digest}")
        return prompt

    def _parameters(self, repeat: int, prompt: Prompt) -> dict[str, Any]:
        """The fields of the requests of a repeat besides the messages."""
        sampling = self.sampling.model_dump(exclude={"extra"}, exclude_none=True)
        if "seed" in sampling:  # equal seeds would make each repeat a copy of the first
            sampling["seed"] += repeat
        return {"model": self.model, **sampling, **_answer_form(self.answers, prompt), **self.sampling.extra}


def _answer_form(answers: Literal["text", "json", "tool"], prompt: Prompt) -> dict[str, Any]:
    """The fields of the body that request a form of answers: an action, a stop, or a whole route."""
    if answers == "text":
        return {}
    one = {"type": "string", "enum": DIRECTIONS}
    if prompt.stop:
        name, properties, about = "goto", {"stop": {"type": "string"}}, "Fly to a stop."
    elif prompt.plan:
        name, properties, about = "fly_route", {"actions": {"type": "array", "items": one}}, "Fly the whole route."
    else:
        name, properties, about = "fly", {"direction": one}, "Fly one step."
    fixed = {"required": list(properties), "additionalProperties": False}
    schema = {"type": "object", "properties": properties, **fixed}
    if answers == "json":
        form = {"name": name, "schema": schema, "strict": True}
        return {"response_format": {"type": "json_schema", "json_schema": form}}
    function = {"name": name, "description": about, "parameters": schema}
    return {
        "tools": [{"type": "function", "function": function}],
        "tool_choice": {"type": "function", "function": {"name": name}},
    }
