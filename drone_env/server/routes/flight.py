"""The routes that fly: reset, step, the state of the session's episode; and which session a request flies."""

from functools import partial
from typing import Annotated, Literal, NamedTuple

import numpy as np
from fastapi import APIRouter, Body, Depends, Header, Request, Response
from pydantic import Field, TypeAdapter, ValidationError
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from typing_extensions import Self

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.actions import Action
from drone_env.core.tasks import get_task
from drone_env.errors import DroneEnvError
from drone_env.flights.sessions import Session, Sessions
from drone_env.graders import GRADERS, make_grader
from drone_env.models import (
    DIRECTIONS,
    Count,
    Direction,
    DroneAction,
    DroneObservation,
    DroneState,
    PathPoint,
    Score,
    Seed,
    StrictModel,
    flat_json,
)
from drone_env.server.addresses import shared_address
from drone_env.server.exceptions import WHAT_TO_DO, RequestError, answer_to, error_responses
from drone_env.server.json_bodies import JsonRequest
from drone_env.server.schemas import ResetOptions
from drone_env.server.state import LONGEST_ID, SESSION_ERRORS, AppState, AppStateDep, caller_address
from drone_env.server.task_api import start_episode

router = APIRouter(tags=["flight"])
COOKIE = "drone_env_session"
HEADER = "X-Session-Id"
NEW = "new"
"""As `X-Session-Id` of a reset, this opens a private session."""
STEP_HEADER = "x-step-count"
STEP_COUNT: TypeAdapter[int | None] = TypeAdapter(Annotated[int | None, Field(ge=0)])


class Caller(NamedTuple):
    """The session id of a request, or the `address` whose callers share a session."""

    named: str | None
    address: str | None

    @classmethod
    def of(cls, request: Request) -> Self:
        """Read the header or the cookie. Empty ones count as missing."""
        named = request.headers.get(HEADER) or request.cookies.get(COOKIE)
        if named or request.app.state.shared.settings.token is not None:
            return cls(None if named in ("", NEW) else named, None)
        return cls(None, shared_address(request.scope))

    def session(self, sessions: Sessions, answer: Response | None = None) -> str:
        """Return the session id. The header of `answer` contains the id of a shared session.

        Raises:
            RequestError: if there is no session.
        """
        if self.named is not None:
            return self.named
        session = None if self.address is None else sessions.unnamed(self.address)
        if session is None:
            raise RequestError(409, "no_session", f"this request names no session: {WHAT_TO_DO}")
        if answer is not None:
            answer.headers[HEADER] = session
        return session


async def get_caller(
    request: Request,
    _: Annotated[
        str | None,
        Header(
            alias=HEADER,
            max_length=LONGEST_ID,
            description="The session id from `/reset`; overrides the cookie. With `new`, a reset opens a session.",
        ),
    ] = None,
) -> Caller:
    """The caller of a request."""
    return Caller.of(request)


CallerDep = Annotated[Caller, Depends(get_caller)]


class FlatReset(DroneObservation):
    """The first observation of an episode, and the session id."""

    session_id: str = Field(description="The session id. Send it as the header X-Session-Id with every request.")


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


class ModelInfo(StrictModel):
    """The network behind a prediction."""

    name: Literal["pathqnet"] = "pathqnet"
    file: str = Field(description="Name of its file.")
    digest: str = Field(description="First 16 digits of the SHA-256 of that file.")


class Prediction(StrictModel):
    """The next action by the network."""

    action: Direction = Field(description="The action with the highest value.")
    q_values: dict[Direction, float] = Field(description="Value of each action.")
    model: ModelInfo


def read_session(app_state: AppStateDep, caller: CallerDep, answer: Response) -> Session:
    """The caller's session."""
    return app_state.sessions.read(caller.session(app_state.sessions, answer))


SessionDep = Annotated[Session, Depends(read_session)]


@router.post("/reset", response_model=FlatReset, responses=error_responses(400, 413, 415, 422, 503))
def reset(
    request: Request,
    app_state: AppStateDep,
    caller: CallerDep,
    options: Annotated[ResetOptions | None, Body()] = None,
) -> Response:
    """Start an episode: in the session that the request names, or in a new one.

    Callers that name none share the session of their address, unless the server has a token or a proxy.

    An empty body equals `{}`. The response is a `DroneObservation` with the `session_id`.
    """
    options = options or ResetOptions()
    start = partial(start_episode, options)
    owner = caller_address(request)
    session, episode = app_state.sessions.reset(caller.named, start, options.agent, caller.address, owner)
    # Not validated again, for speed; tests compare it with the documented model.
    named = b"%b,%b" % (flat_json(episode)[:-1], to_json({"session_id": session})[1:])
    response = Response(named, media_type="application/json")
    response.headers[HEADER] = session
    secure = request.url.scheme == "https"
    # A frame in another site requires SameSite=None, which browsers accept over https only.
    response.set_cookie(COOKIE, session, httponly=True, secure=secure, samesite="none" if secure else "lax")
    return response


@router.delete("/session", status_code=204, responses=SESSION_ERRORS)
def end_session(app_state: AppStateDep, caller: CallerDep, response: Response) -> None:
    """End the session and free its place. An unfinished episode is dropped."""
    app_state.sessions.end(caller.session(app_state.sessions, response))
    response.delete_cookie(COOKIE)


@router.get("/state", responses=SESSION_ERRORS)
def state(session: SessionDep) -> DroneState:
    """The full state of the session's episode."""
    return DroneState.of(session.episode, session.episode_id)


@router.get("/grade/{task_name}", responses=SESSION_ERRORS | error_responses(404))
def grade(session: SessionDep, task_name: str) -> Grade:
    """The graded score of the session's episode, which must be of this task; provisional until it has ended."""
    task, episode = get_task(task_name), session.episode
    if episode.task.id != task.id:
        raise RequestError(409, "other_task", f"the session flies {episode.task.id!r}, not {task.id!r}")
    score = GRADERS.get(task.id, make_grader(task.id))(DroneState.of(episode))
    return Grade(task=task.id, score=score, done=episode.ended)


@router.get("/path_history", responses=SESSION_ERRORS)
def path_history(session: SessionDep) -> PathHistory:
    """The flight of the session's episode so far."""
    flown = DroneState.of(session.episode)
    return PathHistory(task=flown.task_name, seed=flown.seed, step_count=flown.step_count, path=flown.path_history)


@router.post("/predict", responses=SESSION_ERRORS)
def predict(app_state: AppStateDep, session: SessionDep) -> Prediction:
    """The action of the trained network for the session's episode."""
    episode, networks = session.episode, app_state.networks
    if episode.ended:
        raise RequestError(409, "ended", "the episode has ended: start another with POST /reset")
    task = episode.task
    pilot = networks.preferred(task)
    if pilot is None:
        detail = f"there is no network for {task.id!r}; train one: drone-env train --task {task.short_name}"
        raise RequestError(503, "no_network", detail)
    agent = networks.network(pilot, task)
    assert isinstance(agent, PathQNetAgent)
    values = agent.q_values(episode.observation())
    return Prediction(
        action=DIRECTIONS[int(np.argmax(values))],
        q_values=dict(zip(DIRECTIONS, values.tolist(), strict=True)),
        model=ModelInfo(file=networks.file(pilot, task).name, digest=str(agent.config["network"])),
    )


async def answer_step(app_state: AppState, request: JsonRequest) -> Response | None:
    """Answer a step without FastAPI, whose overhead exceeds the cost of the step.

    Returns None for other requests, and for invalid steps, whose errors FastAPI explains.
    """
    if request.scope["path"] != "/step":
        return None
    try:
        caller, count = Caller.of(request), request.headers.get(STEP_HEADER)
        if len(caller.named or "") > LONGEST_ID:
            return None
        body, after = DroneAction.model_validate(request.value), STEP_COUNT.validate_python(count)
        return await _fly(app_state, caller, body, after)
    except ValidationError:
        return None
    except DroneEnvError as error:
        return answer_to(error, request.scope)


async def _fly(app_state: AppState, caller: Caller, body: DroneAction, after: int | None) -> Response:
    sessions = app_state.sessions
    session = caller.named or await run_in_threadpool(caller.session, sessions)

    def fly(flown: Session) -> bytes:
        flown.fly(Action[body.direction], after)
        return flat_json(flown.episode)

    stepped = await app_state.write(sessions.use, session, fly, caller.address)
    response = Response(stepped, media_type="application/json")
    if caller.named is None:
        response.headers[HEADER] = session
    return response


@router.post("/step", response_model=DroneObservation, responses=SESSION_ERRORS | error_responses(400, 413, 415))
async def step(
    app_state: AppStateDep,
    caller: CallerDep,
    body: Annotated[DroneAction, Body(examples=[{"direction": "UP"}])],
    after: Annotated[
        int | None,
        Header(
            alias=STEP_HEADER,
            ge=0,
            description="The `step_count` before this action; a repeated request is then flown once.",
        ),
    ] = None,
) -> Response:
    """Fly one action. After the end of the episode nothing changes, and `message` explains it.

    With `X-Step-Count` the server flies a repeated request once and returns the same response.
    """
    return await _fly(app_state, caller, body, after)
