"""Actions, observations and states as Pydantic models.

Unknown fields, wrong types and numbers out of range are validation errors that name the field. All models are
immutable. Positions are `[x, y]` in JSON.
"""

from functools import lru_cache
from typing import Annotated, Any, Literal, cast

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError, WithJsonSchema
from pydantic_core import to_json
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.core.seeds import N_SEEDS
from drone_env.errors import InvalidValueError, text_of

Direction = Literal["UP", "DOWN", "LEFT", "RIGHT", "WAIT"]
Count = Annotated[int, Field(ge=0)]
MAX_SEED = N_SEEDS - 1
Seed = Annotated[int, Field(ge=0, le=MAX_SEED)]
CellName = Literal["road", "building", "tree", "obstacle", "delivery", "delivered", "drone", "unknown", "pad"]
GroundName = Literal["road", "building", "tree", "obstacle", "delivery", "delivered", "pad"]
"""Names of the cells that can be below the drone, as `tasks.TERRAIN`."""
EventName = Literal["delivery", "battery_dead", "wall", "blocked", "obstacle", "building", "tree", "wait", "step"]
OutcomeName = Literal["flying", "delivered", "battery_dead", "out_of_steps"]
Score = Annotated[float, Field(ge=0.01, le=0.99)]
PAIR = {"type": "array", "items": {"type": "integer", "minimum": 0}, "minItems": 2, "maxItems": 2}
"""The JSON schema of a position. Some readers of schemas misread `prefixItems`, which Pydantic writes for a tuple."""
Position = Annotated[tuple[Count, Count], Field(strict=False), WithJsonSchema(PAIR)]

LEGEND: dict[str, str] = {
    kind.emoji: f"{kind.name}: {kind.effect}" for cell, kind in CELL_KINDS.items() if cell is not Cell.UNKNOWN
}
LEGEND[CELL_KINDS[Cell.DRONE].emoji] += ", which cell_below tells"
EMOJI = [CELL_KINDS[cell].emoji for cell in Cell]
NAMES = [CELL_KINDS[cell].name for cell in Cell]
DIRECTIONS: list[Direction] = [action.name for action in Action]
"""The names of the actions, by number."""


class StrictModel(BaseModel):
    """Base of all models: immutable, strict, without unknown fields, NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @classmethod
    def read(cls, text: str | bytes, wrong: str) -> Self:
        """Parse JSON.

        Args:
            text: The JSON.
            wrong: Start of the error message, such as `line 3 is not a call`; the reason follows.
        """
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            raise InvalidValueError(f"{wrong}: {text_of(error)}") from None


class DroneAction(StrictModel):
    """One action."""

    direction: Direction = Field(description="Where to fly: UP is y - 1, DOWN y + 1, LEFT x - 1, RIGHT x + 1.")


class DroneObservation(StrictModel):
    """The observation after a reset or a step."""

    grid: list[str] = Field(description="The map as one row of emoji per line, top row first.")
    cell_types: list[list[CellName]] = Field(description="Names of the cell kinds, cell_types[y][x].")
    grid_width: int = Field(ge=2, description="Columns of the grid.")
    grid_height: int = Field(ge=2, description="Rows of the grid.")
    drone_x: Count = Field(description="Column of the drone, 0 at the left.")
    drone_y: Count = Field(description="Row of the drone, 0 at the top.")
    cell_below: GroundName = Field(description="Kind of the cell below the drone, which the map hides; `pad` charges.")
    battery: float = Field(ge=0, le=1, description="Share of the battery left.")
    battery_steps_remaining: Count = Field(description="Battery units left; in the standard tasks each step costs one.")
    deliveries_total: int = Field(ge=1, description="Parcels to deliver.")
    deliveries_done: Count = Field(description="Parcels delivered.")
    current_target: Position | None = Field(description="[x, y] of the next parcel; null when all are delivered.")
    distance_to_target: float | None = Field(ge=0, description="Manhattan distance to the current target in cells.")
    step_count: Count = Field(description="Steps taken.")
    max_steps: int = Field(ge=1, description="Steps after which the episode ends.")
    reward_last: float = Field(description="Reward of the last step.")
    reward_total: float = Field(description="Sum of all rewards.")
    score: Score = Field(description="The graded score as the episode stands; provisional until `done`.")
    done: bool = Field(description="Whether the episode has ended.")
    message: str = Field(description="What happened last, in words.")
    legend: dict[str, str] = Field(description="What each emoji means.")

    @classmethod
    def of(cls, episode: Episode) -> Self:
        """Return the current observation of an episode."""
        return cls(**observation_fields(episode))


def observation_fields(episode: Episode) -> dict[str, Any]:
    """Return the fields of `DroneObservation.of(episode)` without validation, which takes a third of a step's time."""
    rows = [row_as_emoji(row) for row in _rows(episode.grid())]
    return {
        "grid": [emoji for emoji, _ in rows],
        "cell_types": [list(names) for _, names in rows],
        **observation_numbers(episode),
        "legend": LEGEND,
    }


def observation_numbers(episode: Episode) -> dict[str, Any]:
    """Return the fields of `DroneObservation.of(episode)` except for map and legend."""
    x, y = episode.position
    distance = episode.distance_to_target
    return {
        "grid_width": episode.task.width,
        "grid_height": episode.task.height,
        "drone_x": x,
        "drone_y": y,
        "cell_below": NAMES[episode.under],
        "battery": episode.battery,
        "battery_steps_remaining": episode.battery_units,
        "deliveries_total": episode.task.deliveries,
        "deliveries_done": episode.deliveries_done,
        "current_target": episode.target,
        "distance_to_target": None if distance is None else float(distance),
        "step_count": episode.steps,
        "max_steps": episode.task.max_steps,
        "reward_last": episode.reward_last,
        "reward_total": episode.reward_total,
        "score": episode.score,
        "done": episode.ended,
        "message": episode.message,
    }


def flat_json(episode: Episode) -> bytes:
    """Return the JSON of `DroneObservation.of(episode)`."""
    numbers = observation_numbers(episode)
    return _with_map(episode.grid(), {**numbers, "legend": LEGEND})


def openenv_json(episode: Episode, reward: float | None, **more: object) -> bytes:
    """Return the observation in OpenEnv's format, with `reward` and `done` outside.

    Args:
        episode: The episode.
        reward: The reward of the last step, None after a reset.
        more: Further fields of the observation. OpenEnv repeats `metadata` outside of it, unless it is empty.
    """
    numbers = observation_numbers(episode)
    outside = {"reward": reward, "done": numbers.pop("done")}
    if more.get("metadata"):
        outside["metadata"] = more["metadata"]
    observation = _with_map(episode.grid(), {**numbers, "legend": LEGEND, "metadata": {}, **more})
    return b"".join((b'{"observation":', observation, b",", to_json(outside)[1:]))


def _rows(grid: npt.NDArray[np.uint8]) -> list[bytes]:
    width, cells = grid.shape[1], grid.tobytes()
    return [cells[start : start + width] for start in range(0, len(cells), width)]


def _with_map(grid: npt.NDArray[np.uint8], fields: dict[str, Any]) -> bytes:
    """Return JSON of the map and of further fields."""
    emoji, names = zip(*map(_row_as_json, _rows(grid)), strict=True)
    rows = b'{"grid":[', b",".join(emoji), b'],"cell_types":[', b",".join(names), b"],"
    return b"".join((*rows, to_json(fields)[1:]))


@lru_cache(maxsize=4096)
def row_as_emoji(row: bytes) -> tuple[str, tuple[str, ...]]:
    """Return a row of cell ids as emoji and as names. Cached: a step changes one or two rows of a map."""
    return "".join([EMOJI[cell] for cell in row]), tuple([NAMES[cell] for cell in row])


@lru_cache(maxsize=4096)
def _row_as_json(row: bytes) -> tuple[bytes, bytes]:
    emoji, names = row_as_emoji(row)
    return to_json(emoji), to_json(names)


class PathPoint(StrictModel):
    """One step of a flight: the action and its effect."""

    step: int = Field(ge=1, description="Number of the step, from 1.")
    action: Direction
    x: Count = Field(description="Column of the drone after the step.")
    y: Count = Field(description="Row of the drone after the step.")
    event: EventName = Field(description="What happened in the step, such as `step`, `delivery`, `wall`.")
    reward: float
    battery_steps_remaining: Count = Field(description="Battery units left after the step.")


class ParcelState(StrictModel):
    """One parcel."""

    x: Count
    y: Count
    delivered: bool


class DroneState(StrictModel):
    """The full state of an episode, including its steps."""

    episode_id: str | None = Field(
        default=None,
        description="Over `/ws` the id from the reset; over HTTP the id in the store, once the episode has ended.",
    )
    task_name: str = Field(description="Id of the task.")
    task_version: int = Field(ge=1, description="Version of the task.")
    seed: Seed = Field(description="Number of the map.")
    reward_profile: str = Field(description="Id of the reward profile.")
    grid: list[list[Annotated[int, Field(ge=0, lt=len(Cell))]]] = Field(description="Cell ids, grid[y][x].")
    drone_x: Count = Field(description="Column of the drone.")
    drone_y: Count = Field(description="Row of the drone.")
    battery: float = Field(ge=0, le=1, description="Share of the battery left.")
    battery_steps_remaining: Count = Field(description="Battery units left.")
    battery_capacity: int = Field(ge=1, description="Battery units at the start.")
    deliveries_total: int = Field(ge=1, description="Parcels to deliver.")
    deliveries_done: Count = Field(description="Parcels delivered.")
    parcels: list[ParcelState] = Field(description="All parcels, by their index.")
    current_target: Position | None = Field(description="[x, y] of the current target, null when none is left.")
    step_count: Count = Field(description="Steps taken.")
    max_steps: int = Field(ge=1, description="Steps after which the episode ends.")
    reward_total: float = Field(description="Sum of all rewards.")
    score: Score = Field(description="The graded score as the episode stands.")
    done: bool = Field(description="Whether the episode has ended.")
    outcome: OutcomeName = Field(description="Outcome of the episode; `flying` until it ends.")
    path_history: list[PathPoint] = Field(description="All steps flown, in order; may be left empty.")

    @classmethod
    def of(cls, episode: Episode, episode_id: str | None = None) -> Self:
        """Return the full state of an episode."""
        return cls(
            **{name: value for name, value in observation_numbers(episode).items() if name in cls.model_fields},
            episode_id=episode_id,
            task_name=episode.task.id,
            task_version=episode.task.version,
            seed=episode.seed,
            reward_profile=episode.reward_profile.id,
            grid=episode.grid().tolist(),
            battery_capacity=episode.task.battery_capacity,
            parcels=[ParcelState(x=px, y=py, delivered=delivered) for px, py, delivered in episode.parcels],
            outcome=cast(OutcomeName, episode.outcome.name.lower()),
            path_history=[
                PathPoint(
                    step=i,
                    action=point.action.name,
                    x=point.x,
                    y=point.y,
                    event=cast(EventName, point.event.name.lower()),
                    reward=point.reward,
                    battery_steps_remaining=point.battery,
                )
                for i, point in enumerate(episode.path, start=1)
            ],
        )
