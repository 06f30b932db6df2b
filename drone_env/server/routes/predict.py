"""The route of the network's next action."""

from typing import Literal

import numpy as np
from fastapi import APIRouter, Response
from pydantic import Field

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.cells import Cell
from drone_env.core.episode import Observation
from drone_env.core.rules import telemetry_of
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.models import DIRECTIONS, NAMES, Direction, DroneObservation, GroundName, StrictModel
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.json_routes import LARGE_BODY, JsonRoute
from drone_env.server.routes.flight import CallerDep, read_session
from drone_env.server.state import SESSION_ERRORS, AppState, AppStateDep

router = APIRouter(tags=["flight"], route_class=JsonRoute)


class ModelInfo(StrictModel):
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


class Prediction(StrictModel):
    """The next action by the network."""

    action: Direction = Field(description="The action with the highest value.")
    q_values: dict[Direction, float] = Field(description="Value of each action.")
    model: ModelInfo


@router.post("/predict", responses=SESSION_ERRORS | error_responses(400, 413, 415), openapi_extra=LARGE_BODY)
def predict(
    app_state: AppStateDep, caller: CallerDep, answer: Response, body: PredictRequest | None = None
) -> Prediction:
    """The action of the trained network for the observation in the body, or without one for the session's."""
    if body is not None:
        if body.done:
            raise RequestError(422, "ended", "the episode of this observation has ended: there is no next action")
        return _predicted(app_state, *arrays_of(body))
    episode = read_session(app_state, caller, answer).episode
    if episode.ended:
        raise RequestError(409, "ended", "the episode has ended: start another with POST /reset")
    return _predicted(app_state, episode.task, episode.observation())


def _predicted(app_state: AppState, task: TaskConfig, observation: Observation) -> Prediction:
    pilot = app_state.networks.preferred(task)
    if pilot is None:
        detail = f"there is no network for {task.id!r}; train one: drone-env train --task {task.short_name}"
        raise RequestError(503, "no_network", detail)
    agent = app_state.networks.network(pilot, task)
    assert isinstance(agent, PathQNetAgent)
    values = agent.q_values(observation)
    return Prediction(
        action=DIRECTIONS[int(np.argmax(values))],
        q_values=dict(zip(DIRECTIONS, values.tolist(), strict=True)),
        model=ModelInfo(file=app_state.networks.file(pilot, task).name, digest=str(agent.config["network"])),
    )


def arrays_of(observation: DroneObservation | PredictRequest) -> tuple[TaskConfig, Observation]:
    """Return the task and the arrays of an observation, as agents need them.

    Raises:
        InvalidValueError: if no task matches, `cell_types` has another shape, the drone or its target is outside of it,
            the battery exceeds the task's capacity, or `cell_below` is missing in a task with pads.
    """
    shape = (observation.grid_width, observation.grid_height, observation.deliveries_total, observation.max_steps)
    shapes = {(task.width, task.height, task.deliveries, task.max_steps): task for task in TASKS.values()}
    task = shapes.get(shape)
    if task is None:
        known = "; ".join(f"{task.id} {shape}" for shape, task in shapes.items())
        raise InvalidValueError(
            f"no task has (grid_width, grid_height, deliveries_total, max_steps) = {shape}; there are: {known}"
        )
    if [len(row) for row in observation.cell_types] != [task.width] * task.height:
        raise InvalidValueError(f"cell_types must have {task.height} rows of {task.width} names in {task.id!r}")
    for x, y in ((observation.drone_x, observation.drone_y), observation.current_target or (0, 0)):
        if x >= task.width or y >= task.height:
            raise InvalidValueError(f"drone and current_target must be inside of the map, got ({x}, {y})")
    if observation.battery_steps_remaining > task.battery_capacity:
        raise InvalidValueError(f"battery_steps_remaining must be at most {task.battery_capacity} in {task.id!r}")
    below = observation.cell_below
    placed = [kind for kind, count in task.cell_counts().items() if count and kind not in task.impassable]
    possible = [NAMES[kind] for kind in (Cell.ROAD, Cell.DELIVERED, *placed)]
    if below not in possible and (below is not None or task.pads):
        raise InvalidValueError(
            f"cell_below {'is missing' if below is None else f'cannot be {below}'}: in {task.id!r} one of "
            f"{', '.join(possible)} is below the drone; /reset and /step return it"
        )
    target = observation.current_target
    telemetry = telemetry_of(
        task,
        cell=observation.drone_y * task.width + observation.drone_x,
        under=0 if below is None else NAMES.index(below),
        battery=observation.battery_steps_remaining,
        steps=observation.step_count,
        target=None if target is None else target[1] * task.width + target[0],
    )
    grid = np.array([[NAMES.index(name) for name in line] for line in observation.cell_types], np.uint8)
    return task, {"grid": grid, "telemetry": telemetry}
