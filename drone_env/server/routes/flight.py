"""The routes that fly: reset, step, the state of the session's episode, and the network's next action."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Body, Depends, Header, Request, Response
from pydantic import ConfigDict, Field, JsonValue, TypeAdapter, ValidationError, model_validator
from pydantic_core import to_json
from typing_extensions import Self

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Observation
from drone_env.core.rules import telemetry_of
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.graders import GRADERS, make_grader
from drone_env.models import (
    DIRECTIONS,
    NAMES,
    Count,
    Direction,
    DroneObservation,
    DroneState,
    GroundName,
    PathPoint,
    Position,
    Score,
    Seed,
    StrictModel,
    flat_json,
    openenv_json,
)
from drone_env.results.sessions import Session
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.json_routes import LARGE_BODY, JsonRequest, JsonRoute
from drone_env.server.routes.replay import best_flight
from drone_env.server.schemas import RESETS, ResetOptions, WireAction, examples
from drone_env.server.sessions import COOKIE, HEADER, LONGEST_ID, Caller
from drone_env.server.state import SESSION_ERRORS, AppState, AppStateDep, CallerDep, caller_address

router = APIRouter(tags=["flight"], route_class=JsonRoute)
STEP_HEADER = "x-step-count"
STEP_COUNT: TypeAdapter[int | None] = TypeAdapter(Annotated[int | None, Field(ge=0)])
STEPS: list[JsonValue] = [{"direction": "UP"}, {"action": {"direction": "UP"}}]
IN_SESSION = ("step", "state", "grade", "path_history", "solution", "predict")
OPENED: dict[str, Any] = {
    "headers": {HEADER: {"description": "The session.", "schema": {"type": "string"}}},
    "links": {
        name: {"operationId": name, "parameters": {f"header.{HEADER}": f"$response.header.{HEADER}"}}
        for name in IN_SESSION
    },
}


class StepRequest(StrictModel):
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


class StepResult(StrictModel):
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


class Grade(StrictModel):
    """The graded score of the session's episode."""

    task: str = Field(description="Id of the task.")
    score: Score = Field(description="The graded score; provisional until `done`.")
    done: bool = Field(description="Whether the episode has ended.")


class PathHistory(StrictModel):
    """The steps of a session's episode."""

    task: str = Field(description="Id of the task.")
    seed: Seed = Field(description="Number of the map.")
    step_count: Count = Field(description="Steps flown.")
    path: list[PathPoint] = Field(description="All steps, in order.")
    path_history: list[PathPoint] = Field(description="Same as `path`.")


class SolutionAnswer(StrictModel):
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


def read_session(shared: AppStateDep, caller: CallerDep, answer: Response) -> Session:
    """The caller's session."""
    return shared.sessions.read(caller.session(shared.sessions, answer))


SessionDep = Annotated[Session, Depends(read_session)]


@router.post(
    "/reset",
    response_model=FlatReset | ResetResult,
    responses={200: OPENED, **error_responses(400, 413, 415, 422, 503)},
)
def reset(
    request: Request,
    shared: AppStateDep,
    caller: CallerDep,
    options: Annotated[ResetOptions | None, Body(openapi_examples=examples(RESETS))] = None,
) -> Response:
    """Start an episode: in the session that the request names, or in a new one.

    Callers that name none share the session of their address, unless the server has a token or a proxy.

    An empty body equals `{}`. The response is a `DroneObservation` with the `session_id`. If the body contains
    `episode_id`, as from OpenEnv's clients, it is `{"observation", "reward", "done"}` with the `session_id`.
    """
    options = options or ResetOptions()
    session, episode = shared.sessions.reset(caller.named, options, caller.address, caller_address(request))
    first = flat_json(episode) if options.episode_id is None else openenv_json(episode, None)
    # Not validated again, for speed; tests compare it with the documented models.
    response = Response(f'{first[:-1]},"session_id":{to_json(session).decode()}}}', media_type="application/json")
    response.headers[HEADER] = session
    secure = request.url.scheme == "https"
    # A frame in another site requires SameSite=None, which browsers accept over https only.
    response.set_cookie(COOKIE, session, httponly=True, secure=secure, samesite="none" if secure else "lax")
    return response


@router.delete("/session", status_code=204, responses=SESSION_ERRORS)
def end_session(shared: AppStateDep, caller: CallerDep, response: Response) -> None:
    """End the session and free its place. An unfinished episode is dropped."""
    shared.store.end_session(caller.session(shared.sessions, response))
    response.delete_cookie(COOKIE)


@router.get("/state", responses=SESSION_ERRORS)
def state(session: SessionDep) -> DroneState:
    """The full state of the session's episode."""
    return DroneState.of(session.fly(), session.episode_id)


@router.get("/grade/{task_name}", responses=SESSION_ERRORS | error_responses(404))
def grade(session: SessionDep, task_name: str) -> Grade:
    """The graded score of the session's episode, which must be of this task; provisional until it has ended."""
    task, episode = get_task(task_name), session.fly()
    if episode.task.id != task.id:
        raise RequestError(409, "other_task", f"the session flies {episode.task.id!r}, not {task.id!r}")
    score = GRADERS.get(task.id, make_grader(task.id))(DroneState.of(episode))
    return Grade(task=task.id, score=score, done=episode.ended)


@router.get("/path_history", responses=SESSION_ERRORS)
def path_history(session: SessionDep) -> PathHistory:
    """The flight of the session's episode so far."""
    flown = DroneState.of(session.fly())
    path = flown.path_history
    return PathHistory(task=flown.task_name, seed=flown.seed, step_count=flown.step_count, path=path, path_history=path)


@router.get("/solution", responses=SESSION_ERRORS)
async def solution(request: Request, shared: AppStateDep, session: SessionDep) -> SolutionAnswer:
    """The best flight over the map of the session's episode, once that has ended."""
    episode = session.fly()
    if not episode.ended:
        raise RequestError(409, "in_flight", "the best flight is available when the episode has ended")
    best, path = await shared.work(request, best_flight, episode.task, episode.seed, task=episode.task.id)
    return SolutionAnswer(
        task=episode.task.id,
        seed=episode.seed,
        score=episode.score,
        optimal_score=best.score,
        regret=best.score - episode.score,
        steps=best.steps,
        deliveries=best.deliveries,
        actions=[DIRECTIONS[action] for action in best.actions],
        path=path,
    )


@router.post("/predict", responses=SESSION_ERRORS | error_responses(400, 413, 415), openapi_extra=LARGE_BODY)
def predict(shared: AppStateDep, caller: CallerDep, answer: Response, body: PredictRequest | None = None) -> Prediction:
    """The action of the trained network for the observation in the body, or without one for the session's."""
    if body is not None:
        if body.done:
            raise RequestError(422, "ended", "the episode of this observation has ended: there is no next action")
        return _predicted(shared, *arrays_of(body))
    episode = read_session(shared, caller, answer).fly()
    if episode.ended:
        raise RequestError(409, "ended", "the episode has ended: start another with POST /reset")
    return _predicted(shared, episode.task, episode.observation())


def _predicted(shared: AppState, task: TaskConfig, observation: Observation) -> Prediction:
    pilot = shared.networks.preferred(task)
    if pilot is None:
        detail = f"there is no network for {task.id!r}; train one: drone-env train --task {task.short_name}"
        raise RequestError(503, "no_network", detail)
    agent = shared.networks.network(pilot, task)
    assert isinstance(agent, PathQNetAgent)
    values = agent.q_values(observation)
    return Prediction(
        action=DIRECTIONS[int(np.argmax(values))],
        q_values=dict(zip(DIRECTIONS, values.tolist(), strict=True)),
        model=ModelInfo(file=shared.networks.file(pilot, task).name, digest=str(agent.config["network"])),
    )


def arrays_of(observation: DroneObservation | PredictRequest) -> tuple[TaskConfig, Observation]:
    """Return the task and the arrays of an observation, as agents need them.

    Raises:
        InvalidValueError: if no task matches, the battery exceeds the task's capacity, or `cell_below` is missing in a
            task with pads.
    """
    shape = (observation.grid_width, observation.grid_height, observation.deliveries_total, observation.max_steps)
    shapes = {(task.width, task.height, task.deliveries, task.max_steps): task for task in TASKS.values()}
    task = shapes.get(shape)
    if task is None:
        known = "; ".join(f"{task.id} {shape}" for shape, task in shapes.items())
        raise InvalidValueError(
            f"no task has (grid_width, grid_height, deliveries_total, max_steps) = {shape}; there are: {known}"
        )
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


class StepRoute(JsonRoute):
    """Flies a valid step without FastAPI, whose overhead exceeds the cost of the step.

    Invalid ones go to FastAPI, which explains the error.
    """

    async def answer(
        self, request: JsonRequest, validated: Callable[[Request], Coroutine[Any, Any, Response]]
    ) -> Response:
        """The response to a request with a parsed body."""
        caller = Caller.of(request)
        if len(caller.named or "") > LONGEST_ID:
            return await validated(request)
        try:
            body = StepRequest.model_validate(request.value)
            after = STEP_COUNT.validate_python(request.headers.get(STEP_HEADER))
        except ValidationError:
            return await validated(request)
        shared: AppState = request.app.state.shared
        return await asyncio.get_running_loop().run_in_executor(shared.steps, _advance, shared, caller, body, after)


def _advance(shared: AppState, caller: Caller, body: StepRequest, after: int | None) -> Response:
    session = caller.session(shared.sessions)
    episode, reward = shared.sessions.advance(session, body.chosen, after, caller.address)
    stepped = flat_json(episode) if body.action is None else openenv_json(episode, reward)
    response = Response(stepped, media_type="application/json")
    if caller.named is None:
        response.headers[HEADER] = session
    return response


stepping = APIRouter(tags=["flight"], route_class=StepRoute)
"""Matched first, because most requests are steps."""


@stepping.post(
    "/step", response_model=DroneObservation | StepResult, responses=SESSION_ERRORS | error_responses(400, 413, 415)
)
def step(
    shared: AppStateDep,
    caller: CallerDep,
    body: Annotated[StepRequest, Body(openapi_examples=examples(STEPS))],
    after: Annotated[
        int | None,
        Header(
            alias=STEP_HEADER,
            ge=0,
            description="The `step_count` before this action; a repeated request is then flown once.",
        ),
    ] = None,
) -> Response:
    """Fly one action.

    `{"direction": "UP"}` returns a `DroneObservation`; OpenEnv's `{"action": {"direction": "UP"}}` returns
    `{"observation", "reward", "done"}`. After the end of the episode nothing changes, and `message` explains it.

    With `X-Step-Count` the server flies a repeated request once and returns the same response.
    """
    return _advance(shared, caller, body, after)
