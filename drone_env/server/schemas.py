"""What travels beside actions, observations and states: requests and answers of the server."""

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
"""Events after which the drone is as far from its target as before."""
ENV_NAME = "drone-env"
DESCRIPTION = (
    "A drone delivers parcels on a generated city grid, on one battery, in as few steps as possible. Maps are solved "
    "exactly, so every score stands beside the optimum of its map."
)
STEPS: list[JsonValue] = [{"direction": "UP"}, {"action": {"direction": "UP"}}]


def examples(values: list[JsonValue]) -> Any:
    """Examples of a body, as its documentation shows them."""
    return {str(value): {"value": value} for value in values}


# What the store takes: an episode must not fail to be kept when it has been flown.
AgentName = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(check_agent)]


class ResetOptions(Message):
    """What to fly. All of it may be left out."""

    model_config = ConfigDict(json_schema_extra={"examples": RESETS})

    task_name: str | None = Field(default=None, max_length=100, description="Id, short name or grader of the task.")
    seed: Seed | None = Field(
        default=None,
        description="Number of the map; without one, the next on a fixed walk; drawn at random in a new session.",
    )
    reward_profile: str | None = Field(
        default=None,
        max_length=100,
        description=f"What steps pay: {', '.join(REWARD_PROFILES)}; `{ORIGINAL_PROFILE}` without one.",
    )
    agent: AgentName | None = Field(default=None, description="Who flies, for the records: one printable line.")
    episode_id: str | None = Field(default=None, max_length=255, description="Names the episode in OpenEnv's state.")
    split: str | None = Field(
        default=None,
        max_length=100,
        description="Split of a task, such as `easy_delivery/test`; instead of task_name and seed.",
    )
    index: int | None = Field(default=None, ge=0, le=MAX_SEED, description="Number of the map within the split.")

    @model_validator(mode="after")
    def _one_way_to_name_a_map(self) -> Self:
        if (self.split is None) != (self.index is None):
            raise ValueError("split and index go together")
        if self.split is not None and (self.task_name is not None or self.seed is not None):
            raise ValueError("split and index name a map; leave out task_name and seed")
        return self


class WireAction(DroneAction):
    """One action, as OpenEnv sends it."""

    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Ignored.")


class WireObservation(DroneObservation):
    """An observation with all that OpenEnv adds."""

    reward: float | None = Field(default=None, description="What the step paid; null after a reset.")
    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Empty.")


class StepRequest(Message):
    """One action: flat (`direction`), or as OpenEnv sends it (`action`). Exactly one of them."""

    model_config = ConfigDict(json_schema_extra={"examples": STEPS})

    direction: Direction | None = Field(default=None, description="Where to fly; the answer is a `DroneObservation`.")
    action: WireAction | None = Field(default=None, description="The same for OpenEnv; the answer is a `StepResult`.")
    timeout_s: float | None = Field(default=None, gt=0, description="OpenEnv's; a step takes microseconds.")
    request_id: str | None = Field(default=None, max_length=255, description="OpenEnv's; ignored.")

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.direction is None) == (self.action is None):
            raise ValueError('give either {"direction": ...} or {"action": {"direction": ...}}')
        return self

    @property
    def chosen(self) -> Action:
        """The action."""
        return Action[str(self.direction)] if self.action is None else self.action.action


class StepResult(Message):
    """An observation as OpenEnv has it: reward and done stand beside it."""

    observation: dict[str, Any] = Field(description="The fields of `DroneObservation` without `done`, and `metadata`.")
    reward: float | None = Field(description="What the step paid; null after a reset.")
    done: bool = Field(description="Whether the episode has ended.")


class FlatReset(DroneObservation):
    """The first observation of an episode, and the session that it is flown in."""

    session_id: str = Field(description="Send it as the header X-Session-Id with what follows.")


class ResetResult(StepResult):
    """The same as OpenEnv has it."""

    session_id: str = Field(description="Send it as the header X-Session-Id with what follows.")


class AnalysisAnswer(Analysis):
    """Figures of the finished episodes of a task."""

    status: Literal["Success", "No data"] = Field(description="Whether there are any, in the words of older clients.")


class Grade(Message):
    """The graded score of the session's episode."""

    task: str = Field(description="Id of the task.")
    score: Score = Field(description="The graded score; provisional until `done`.")
    done: bool = Field(description="Whether the episode has ended.")


class PathHistory(Message):
    """The flight of a session so far."""

    task: str = Field(description="Id of the task.")
    seed: Seed = Field(description="Number of the map.")
    step_count: Count = Field(description="Steps flown.")
    path: list[PathPoint] = Field(description="All steps, in order.")
    path_history: list[PathPoint] = Field(description="The same, as older clients call it.")


class SolutionAnswer(Message):
    """The best flight over the map of an episode that has ended."""

    task: str = Field(description="Id of the task.")
    seed: Seed = Field(description="Number of the map.")
    score: Score = Field(description="What the session's flight scored.")
    optimal_score: Score = Field(description="The highest score that any flight over this map can reach.")
    regret: float = Field(ge=0, description="optimal_score - score.")
    steps: Count = Field(description="Steps of the best flight.")
    deliveries: Count = Field(description="Parcels that it delivers.")
    actions: list[Direction] = Field(description="Its actions, in order.")
    path: list[Position] = Field(description="[x, y] of the drone, from its start on.")


LAID_OUT = ("drain", "impassable", "terrain")
"""What is no plain number: the kinds of cells go by their names, and terrain is seen on every map."""
_PLAIN: dict[str, Any] = {n.name: (n.type, ...) for n in fields(TaskConfig) if n.name not in LAID_OUT}


class TaskInfo(create_model("TaskNumbers", __base__=Message, **_PLAIN)):
    """One task: every number of its `TaskConfig`."""

    name: str = Field(description="The id, as older clients call it.")
    drain: dict[str, int] = Field(description="Battery units per step above a kind of cell; 1 where not named.")
    impassable: list[str] = Field(description="Kinds of cells that the drone cannot enter.")
    charge_rate: int = Field(description="Battery units that waiting on a pad adds.")
    rewards: dict[str, dict[str, list[float]]] = Field(
        description="What a step with each event pays, by reward profile; none where it pays for no events. Where the "
        "drone moves: farther from its target, as far, and closer; where it stays, one number."
    )
    published: bool = Field(description="Whether it is one of the three tasks of the OpenEnv manifest.")
    attribution: str = Field(description="Whose data its terrain is, to be said where it is shown; empty for nobody's.")

    @classmethod
    def of(cls, task: TaskConfig, published: bool) -> Self:
        """The numbers of a task."""
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
    paid = [event for event in Event if event is not Event.NONE and table.any()]
    return {event.name.lower(): (table[event, 1:2] if event in STAYING else table[event]).tolist() for event in paid}


class ProfileInfo(Message):
    """One reward profile: what it pays on every task. What single events pay stands at the tasks."""

    id: str
    summary: str = Field(description="What it pays, in a line.")
    shaping: float = Field(description="Paid per cell that a step came closer to its target, less for farther.")
    clamp: tuple[float, float] | None = Field(description="Bounds of what an event and that pay together.")
    shaping_gamma: float | None = Field(description="Discount of its potential-based shaping; null for none.")
    pays_score: bool = Field(description="Whether the end of the episode pays the graded score.")

    @classmethod
    def of(cls, profile: RewardProfile) -> Self:
        """The numbers of a profile."""
        return cls(
            id=profile.id,
            summary=profile.summary,
            shaping=float(profile.shaping),
            clamp=None if profile.clamp is None else (float(profile.clamp[0]), float(profile.clamp[1])),
            shaping_gamma=None if profile.shaping_gamma is None else float(profile.shaping_gamma),
            pays_score=profile.pays_score,
        )


class TaskList(Message):
    """All tasks and reward profiles."""

    tasks: list[TaskInfo]
    reward_profiles: list[ProfileInfo]


class OneTask(Message):
    """One task, and who flies it."""

    task: TaskInfo
    pilots: list[str] = Field(description="Ids of those who can fly it, as in `/pilots`.")


class GraderInfo(Message):
    """One grader."""

    id: str = Field(description="`module:function`.")
    task: str = Field(description="Id of the task that it grades.")


class GraderList(Message):
    """All graders."""

    graders: list[GraderInfo]
    ids: list[str] = Field(description="The ids alone, in the same order.")


class KindInfo(Message):
    """What can stand in a cell."""

    id: Count = Field(description="The number that stands in grids.")
    name: str
    emoji: str
    effect: str


class KindList(Message):
    """All kinds of cells."""

    kinds: list[KindInfo]


class PilotInfo(Message):
    """One who flies on the page."""

    id: str
    name: str
    summary: str
    colour: int = Field(ge=1, description="Number of its colour on the page, always the same.")
    automatic: bool = Field(description="Whether it flies by itself.")
    tasks: list[str] = Field(description="Ids of the tasks that it can fly.")


class PilotList(Message):
    """All who fly on the page."""

    pilots: list[PilotInfo]
    most: Count = Field(description="How many can race on a map.")


class ModelInfo(Message):
    """The network that was asked."""

    name: Literal["pathqnet"] = "pathqnet"
    file: str = Field(description="Name of its file.")
    digest: str = Field(description="First 16 digits of the SHA-256 of that file.")


class PredictRequest(DroneObservation):
    """An observation, as `/step` or `/reset` answered it."""

    # What earlier servers answered lacks it, and only in tasks with pads is a network given it.
    cell_below: GroundName | None = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        default=None, description="Kind of the cell below the drone; it may be left out in tasks without pads."
    )
    session_id: str | None = Field(default=None, max_length=255, description="Of a reset's answer; ignored.")


class Prediction(Message):
    """What the trained network would do."""

    action: Direction = Field(description="The action of the highest value.")
    q_values: dict[Direction, float] = Field(description="The network's value of each action.")
    model: ModelInfo


class Health(Message):
    """Whether the server is well."""

    status: Literal["healthy"] = "healthy"
    version: str = Field(description="Version of the package.")


class EpisodeSummaries(Message):
    """Finished episodes, newest first."""

    episodes: list[EpisodeSummary]


class EpisodePage(EpisodeSummaries):
    """A page of finished episodes, newest first."""

    next: int | None = Field(description="Send it as `before` for the page that follows; null on the last.")


class History(EpisodeSummaries):
    """The last finished episodes of a task, oldest first."""

    task: str = Field(description="Id of the task.")
    rolling_success: list[float] = Field(description="For each episode, the success rate of the last 20 up to it.")


class LogLines(Message):
    """The end of a log file."""

    file: str = Field(description="Name of the file.")
    lines: list[str] = Field(description="Its last lines, oldest first; empty where there is no file.")
