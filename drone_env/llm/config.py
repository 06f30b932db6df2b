"""The configuration of a run: all that decides its calls and its results, so neither limits nor speed."""

import json
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator
from typing_extensions import Self

from drone_env.core.rewards import RewardProfile, get_reward_profile
from drone_env.core.seeds import N_SEEDS
from drone_env.core.tasks import TaskConfig, get_task, own_rules
from drone_env.llm.prompt import Prompt, get_prompt, parse_prompt
from drone_env.llm.settings import check_url
from drone_env.models import DIRECTIONS, Count, Message


class Sampling(Message):
    """What is sent with every request beside the messages. What is null is not sent."""

    temperature: float | None = Field(default=0.0, ge=0, le=2)
    top_p: float | None = Field(default=None, gt=0, le=1)
    max_tokens: int | None = Field(default=1024, ge=1)
    seed: int | None = Field(default=None, ge=0)
    extra: dict[str, Any] = Field(default_factory=dict, description="More of the request's body, as it is.")

    @field_validator("extra")
    @classmethod
    def _only_more(cls, extra: dict[str, Any]) -> dict[str, Any]:
        taken = {"model", "messages", "stream", "stream_options", "temperature", "top_p", "max_tokens", "seed", "n"}
        taken |= {"tools", "tool_choice", "response_format"}
        if taken & extra.keys():
            raise ValueError(f"{sorted(taken & extra.keys())[0]!r} is set by other means than extra")
        json.dumps(extra, allow_nan=False, ensure_ascii=False).encode()
        return extra


class RunConfig(Message):
    """The identity of a run: a run folder is resumed under an equal one only."""

    format: Literal["drone_env/llm-run"] = "drone_env/llm-run"
    format_version: Literal[1] = 1
    model: str = Field(min_length=1, max_length=180, description="The model, without spaces.")
    base_url: str
    task: str
    task_version: int = Field(ge=1)
    rules: dict[str, str] = Field(default={}, description="Digest of the task's rules, where it is not the package's.")
    split: str
    seeds: tuple[Count, Count] = Field(strict=False, description="The maps, [start, stop).")
    repeats: int = Field(ge=1, le=100, description="Flights over each map.")
    reward_profile: str
    rewards: RewardProfile | None = Field(default=None, description="The profile, where it is none of the package's.")
    prompt: str = Field(description="Id of the prompt.")
    prompt_digest: str = Field(description="What its file held.")
    prompt_text: str | None = Field(default=None, description="The file itself, where it is none of the package's.")
    history: Count = Field(description="How many of the last steps the prompt names.")
    answers: Literal["text", "json", "tool"]
    stream: Literal[False] = Field(default=False, description="Answers come whole.")
    sampling: Sampling

    @field_validator("model")
    @classmethod
    def _one_word(cls, model: str) -> str:
        # It stands in log lines, which are split at spaces.
        if any(letter.isspace() or not letter.isprintable() for letter in model):
            raise ValueError(f"a model's name has no spaces and nothing unprintable, got {model!r}")
        return model

    @field_validator("base_url")
    @classmethod
    def _address(cls, url: str) -> str:
        return check_url(url)

    @model_validator(mode="after")
    def _known(self) -> Self:
        if self.rules != own_rules(self.task_config):
            raise ValueError(
                f"the run flew another task of the name {self.task!r} than there is now: name the file as it was; "
                "a city that is changed takes another name"
            )
        if self.profile.id != self.reward_profile:
            raise ValueError(f"rewards are those of {self.profile.id!r}, not of {self.reward_profile!r}")
        if self.history and "history" not in self._prompt().names:
            raise ValueError(f"prompt {self.prompt} tells no last steps: history must be 0")
        start, stop = self.seeds
        if not start < stop <= N_SEEDS:
            raise ValueError(f"seeds {self.seeds} are not [start, stop) within [0, 2^53]")
        return self

    @property
    def task_config(self) -> TaskConfig:
        """The task."""
        return get_task(self.task, self.task_version)

    @property
    def profile(self) -> RewardProfile:
        """What steps pay."""
        return self.rewards or get_reward_profile(self.reward_profile)

    @property
    def flights(self) -> int:
        """How many flights the run has."""
        return (self.seeds[1] - self.seeds[0]) * self.repeats

    def load_prompt(self) -> Prompt:
        """The prompt.

        Raises:
            UnknownNameError: if it is not there.
            ValueError: if it is not what it was when the run began.
        """
        prompt = self._prompt()
        if prompt.digest != self.prompt_digest:
            raise ValueError(f"prompt {self.prompt} is now {prompt.digest}; the run was made with {self.prompt_digest}")
        return prompt

    def _prompt(self) -> Prompt:
        if self.prompt_text is None:
            return get_prompt(self.prompt)
        return parse_prompt(f"{self.prompt}.toml", self.prompt_text, own=True)


def request_bodies(config: RunConfig) -> list[dict[str, Any]]:
    """The body of the requests of each repeat, without the messages."""
    sampling = config.sampling.model_dump(exclude={"extra"}, exclude_none=True)
    body = {"model": config.model, **sampling, **config.sampling.extra, **_answer_form(config)}
    # Equal seeds would make each repeat a copy of the first.
    seed = config.sampling.seed
    return [body if seed is None else {**body, "seed": seed + repeat} for repeat in range(config.repeats)]


def _answer_form(config: RunConfig) -> dict[str, Any]:
    """The fields of the body that ask for answers in the form of the run."""
    prompt = config.load_prompt()
    one = {"type": "string", "enum": DIRECTIONS}
    properties: dict[str, Any] = {"actions": {"type": "array", "items": one}} if prompt.plan else {"direction": one}
    schema = {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }
    name = "fly_route" if prompt.plan else "fly"
    if config.answers == "json":
        return {
            "response_format": {"type": "json_schema", "json_schema": {"name": name, "schema": schema, "strict": True}}
        }
    if config.answers == "tool":
        description = "Fly the whole route." if prompt.plan else "Fly one step."
        function = {"name": name, "description": description, "parameters": schema}
        return {
            "tools": [{"type": "function", "function": function}],
            "tool_choice": {"type": "function", "function": {"name": name}},
        }
    return {}
