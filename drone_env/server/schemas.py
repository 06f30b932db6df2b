"""Requests and responses of the HTTP routes, as Pydantic models."""

from dataclasses import fields
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, JsonValue, create_model, model_validator
from typing_extensions import Self

from drone_env.core.actions import Action, Event
from drone_env.core.cells import CELL_KINDS
from drone_env.core.rewards import ORIGINAL_PROFILE, REWARD_PROFILES, RewardProfile, tabulate_rewards
from drone_env.core.tasks import TaskConfig
from drone_env.models import (
    MAX_SEED,
    Count,
    Direction,
    DroneAction,
    DroneObservation,
    GroundName,
    Message,
    PathPoint,
    Position,
    Score,
    Seed,
)
from drone_env.results.finished import Analysis, EpisodeSummary, check_agent

RESETS: list[JsonValue] = [{"task_name": "easy_delivery", "seed": 7}, {}, {"episode_id": "run-1", "seed": 7}]
STAYING = (Event.WALL, Event.BLOCKED, Event.WAIT)
"""Events that do not change the distance to the target."""
ENV_NAME = "drone-env"
DESCRIPTION = (
    "A drone delivers parcels on a generated city grid, on one battery, in as few steps as possible. Maps are solved "
    "exactly, so every score can be compared with the optimum of its map."
)
STEPS: list[JsonValue] = [{"direction": "UP"}, {"action": {"direction": "UP"}}]


def examples(values: list[JsonValue]) -> Any:
    """Return the OpenAPI examples of a body."""
    return {str(value): {"value": value} for value in values}


# Checked here, because the store checks it again when the episode has ended.
AgentName = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(check_agent)]


class ResetOptions(Message):
    """Options of a reset."""

    model_config = ConfigDict(json_schema_extra={"examples": RESETS})

    task_name: str | None = Field(default=None, max_length=100, description="Id, short name or grader of the task.")
    seed: Seed | None = Field(
        default=None,
        description="Number of the map. Default: the next on a fixed walk; in a new session, a random one.",
    )
    reward_profile: str | None = Field(
        default=None,
        max_length=100,
        description=f"Reward profile: {', '.join(REWARD_PROFILES)}. Default: `{ORIGINAL_PROFILE}`.",
    )
    agent: AgentName | None = Field(default=None, description="Name of the agent in the records: one printable line.")
    episode_id: str | None = Field(default=None, max_length=255, description="Id of the episode in OpenEnv's state.")
    split: str | None = Field(
        default=None,
        max_length=100,
        description="Split of a task, such as `easy_delivery/test`; replaces task_name and seed.",
    )
    index: int | None = Field(default=None, ge=0, le=MAX_SEED, description="Number of the map within the split.")

    @model_validator(mode="after")
    def _check_split(self) -> Self:
        if (self.split is None) != (self.index is None):
            raise ValueError("split and index go together")
        if self.split is not None and (self.task_name is not None or self.seed is not None):
            raise ValueError("split and index choose a map; leave out task_name and seed")
        return self


class WireAction(DroneAction):
    """One action in OpenEnv's format."""

    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Ignored.")


class WireObservation(DroneObservation):
    """An observation with OpenEnv's fields."""

    reward: float | None = Field(default=None, description="Reward of the step; null after a reset.")
    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Empty.")


class StepRequest(Message):
    """One action: either flat (`direction`) or in OpenEnv's format (`action`)."""

    model_config = ConfigDict(json_schema_extra={"examples": STEPS})

    direction: Direction | None = Field(default=None, description="The action; returns a `DroneObservation`.")
    action: WireAction | None = Field(default=None, description="The action in OpenEnv's format; returns `StepResult`.")
    timeout_s: float | None = Field(default=None, gt=0, description="Ignored; OpenEnv's clients send it.")
    request_id: str | None = Field(default=None, max_length=255, description="Ignored; OpenEnv's clients send it.")

    @model_validator(mode="after")
    def _check_format(self) -> Self:
        if (self.direction is None) == (self.action is None):
            raise ValueError('send either {"direction": ...} or {"action": {"direction": ...}}')
        return self

    @property
    def chosen(self) -> Action:
        """The action."""
        return Action[str(self.direction)] if self.action is None else self.action.action


class StepResult(Message):
    """An observation in OpenEnv's format, with reward and done outside."""

    observation: dict[str, Any] = Field(description="The fields of `DroneObservation` without `done`, and `metadata`.")
    reward: float | None = Field(description="Reward of the step; null after a reset.")
    done: bool = Field(description="Whether the episode has ended.")


SessionId = Annotated[str, Field(description="The session id. Send it as the header X-Session-Id with every request.")]


class FlatReset(DroneObservation):
    """The first observation of an episode, and the session id."""

    session_id: SessionId


class ResetResult(StepResult):
    """The first observation in OpenEnv's format, and the session id."""

    session_id: SessionId


class AnalysisAnswer(Analysis):
    """Statistics of the finished episodes of a task."""

    status: Literal["Success", "No data"] = Field(description="Whether there are any episodes.")


class Grade(Message):
    """The graded score of the session's episode."""

    task: str = Field(description="Id of the task.")
    score: Score = Field(description="The graded score; provisional until `done`.")
    done: bool = Field(description="Whether the episode has ended.")


class PathHistory(Message):
    """The steps of a session's episode."""

    task: str = Field(description="Id of the task.")
    seed: Seed = Field(description="Number of the map.")
    step_count: Count = Field(description="Steps flown.")
    path: list[PathPoint] = Field(description="All steps, in order.")
    path_history: list[PathPoint] = Field(description="Same as `path`.")


class SolutionAnswer(Message):
    """An optimal flight on the map of an episode that has ended."""

    task: str = Field(description="Id of the task.")
    seed: Seed = Field(description="Number of the map.")
    score: Score = Field(description="Score of the session's episode.")
    optimal_score: Score = Field(description="Highest possible score on this map.")
    regret: float = Field(ge=0, description="optimal_score - score.")
    steps: Count = Field(description="Steps of the optimal flight.")
    deliveries: Count = Field(description="Parcels that it delivers.")
    actions: list[Direction] = Field(description="Its actions, in order.")
    path: list[Position] = Field(description="Its positions [x, y], including the start.")


_CONVERTED = ("drain", "impassable", "terrain")
_PLAIN: dict[str, Any] = {n.name: (n.type, ...) for n in fields(TaskConfig) if n.name not in _CONVERTED}


class TaskInfo(create_model("TaskNumbers", __base__=Message, **_PLAIN)):
    """One task: the fields of its `TaskConfig`, except for the terrain."""

    name: str = Field(description="Same as `id`.")
    drain: dict[str, int] = Field(description="Battery units per step by kind of cell below the drone; default 1.")
    impassable: list[str] = Field(description="Kinds of cells that the drone cannot enter.")
    charge_rate: int = Field(description="Battery units that waiting on a pad adds.")
    rewards: dict[str, dict[str, list[float]]] = Field(
        description="Reward of each event, by reward profile; empty if the profile does not reward events. Three "
        "numbers if the drone moves: distance to the target grows, stays equal, shrinks. Otherwise one number."
    )
    published: bool = Field(description="Whether it is one of the three tasks of the OpenEnv manifest.")
    attribution: str = Field(description="Attribution of its terrain data, to be shown with it; empty for none.")

    @classmethod
    def of(cls, task: TaskConfig, published: bool) -> Self:
        """Describe a task."""
        return cls(
            **{name: getattr(task, name) for name in _PLAIN},
            name=task.id,
            drain={CELL_KINDS[cell].name: units for cell, units in task.drain},
            impassable=sorted(CELL_KINDS[cell].name for cell in task.impassable),
            rewards={profile.id: _event_rewards(task, profile) for profile in REWARD_PROFILES.values()},
            published=published,
            attribution=task.attribution,
        )


def _event_rewards(task: TaskConfig, profile: RewardProfile) -> dict[str, list[float]]:
    table = np.reshape(np.asarray(tabulate_rewards(task, profile).events), (-1, 3))
    events = [event for event in Event if event is not Event.NONE and table.any()]
    return {event.name.lower(): (table[event, 1:2] if event in STAYING else table[event]).tolist() for event in events}


class ProfileInfo(Message):
    """The terms of a reward profile that are equal for all tasks. `TaskInfo.rewards` contains the others."""

    id: str
    summary: str = Field(description="One-line summary.")
    shaping: float = Field(description="Reward per cell by which the distance to the target shrinks.")
    clamp: tuple[float, float] | None = Field(description="Bounds of the sum of event reward and shaping.")
    shaping_gamma: float | None = Field(description="Discount of potential-based shaping; null for none.")
    pays_score: bool = Field(description="Whether the last step pays the graded score.")

    @classmethod
    def of(cls, profile: RewardProfile) -> Self:
        """Describe a profile."""
        return cls.model_validate(profile, from_attributes=True, strict=False)


class TaskList(Message):
    """All tasks and reward profiles."""

    tasks: list[TaskInfo]
    reward_profiles: list[ProfileInfo]


class OneTask(Message):
    """One task and its pilots."""

    task: TaskInfo
    pilots: list[str] = Field(description="Ids of the pilots that can fly it, as in `/pilots`.")


class GraderInfo(Message):
    """One grader."""

    id: str = Field(description="`module:function`.")
    task: str = Field(description="Id of its task.")


class GraderList(Message):
    """All graders."""

    graders: list[GraderInfo]
    ids: list[str] = Field(description="The ids in the same order.")


class KindInfo(Message):
    """One kind of cell."""

    id: Count = Field(description="Its number in grids.")
    name: str
    emoji: str
    effect: str


class KindList(Message):
    """All kinds of cells."""

    kinds: list[KindInfo]


class PilotInfo(Message):
    """One pilot of the page."""

    id: str
    name: str
    summary: str
    colour: int = Field(ge=1, description="Number of its colour on the page.")
    automatic: bool = Field(description="False for a human pilot.")
    tasks: list[str] = Field(description="Ids of the tasks that it can fly.")


class PilotList(Message):
    """All pilots of the page."""

    pilots: list[PilotInfo]
    most: Count = Field(description="Most pilots in a race.")


class ModelInfo(Message):
    """The network behind a prediction."""

    name: Literal["pathqnet"] = "pathqnet"
    file: str = Field(description="Name of its file.")
    digest: str = Field(description="First 16 digits of the SHA-256 of that file.")


class PredictRequest(DroneObservation):
    """An observation from `/step` or `/reset`."""

    # Networks need it only for tasks with pads.
    cell_below: GroundName | None = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        default=None, description="Kind of the cell below the drone; optional for tasks without pads."
    )
    session_id: str | None = Field(default=None, max_length=255, description="Ignored.")


class Prediction(Message):
    """The next action by the network."""

    action: Direction = Field(description="The action with the highest value.")
    q_values: dict[Direction, float] = Field(description="Value of each action.")
    model: ModelInfo


class Health(Message):
    """Status of the server."""

    status: Literal["healthy"] = "healthy"
    version: str = Field(description="Version of the package.")


class EpisodeSummaries(Message):
    """Finished episodes, newest first."""

    episodes: list[EpisodeSummary]


class EpisodePage(EpisodeSummaries):
    """A page of finished episodes, newest first."""

    next: int | None = Field(description="Value of `before` for the next page; null on the last page.")


class History(EpisodeSummaries):
    """The last finished episodes of a task, oldest first."""

    task: str = Field(description="Id of the task.")
    rolling_success: list[float] = Field(description="Success rate over 20 episodes up to each episode.")


class LogLines(Message):
    """The end of a log file."""

    file: str = Field(description="Name of the file.")
    lines: list[str] = Field(description="Its last lines, oldest first; empty if there is no file.")
