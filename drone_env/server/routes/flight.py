"""The routes that fly: reset, step, and the state of the session's episode."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Annotated, Any

from fastapi import APIRouter, Body, Header, Request, Response
from pydantic import ValidationError
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.graders import GRADERS, make_grader
from drone_env.models import DIRECTIONS, DroneObservation, DroneState
from drone_env.server.incoming import LARGE_BODY, JsonRequest, JsonRoute
from drone_env.server.observation_json import flat_json, openenv_json
from drone_env.server.predict import arrays_of
from drone_env.server.problems import RequestError, answers
from drone_env.server.routes.replay import best_flight
from drone_env.server.schemas import (
    RESETS,
    STEPS,
    FlatReset,
    Grade,
    PathHistory,
    Prediction,
    PredictRequest,
    ResetOptions,
    ResetResult,
    SolutionAnswer,
    StepRequest,
    StepResult,
    examples,
)
from drone_env.server.state import (
    COOKIE,
    HEADER,
    LONGEST_ID,
    SESSION_ERRORS,
    Caller,
    CallerOf,
    Shared,
    SharedParts,
)

router = APIRouter(tags=["flight"], route_class=JsonRoute)
STEP_HEADER = "x-step-count"
LONGEST_COUNT = 9
"""Digits of a count of steps; no task has that many."""
IN_SESSION = ("step", "state", "grade", "path_history", "solution", "predict")
OPENED: dict[str, Any] = {
    "headers": {HEADER: {"description": "The session.", "schema": {"type": "string"}}},
    "links": {
        name: {"operationId": name, "parameters": {f"header.{HEADER}": f"$response.header.{HEADER}"}}
        for name in IN_SESSION
    },
}


@router.post(
    "/reset", response_model=FlatReset | ResetResult, responses={200: OPENED, **answers(400, 413, 415, 422, 503)}
)
def reset(
    request: Request,
    shared: SharedParts,
    caller: CallerOf,
    options: Annotated[ResetOptions | None, Body(openapi_examples=examples(RESETS))] = None,
) -> Response:
    """Start an episode: in the session that the request names, or in a new one.

    Callers that name none share the session of their address, unless the server has a token or a proxy.

    An empty body is the same as `{}`. The answer is a `DroneObservation` with the `session_id`; where the body has
    `episode_id`, as OpenEnv's clients send it, it is `{"observation", "reward", "done"}` with the `session_id`.
    """
    options = options or ResetOptions()
    show = flat_json if options.episode_id is None else openenv_json
    session, first = shared.sessions.reset(caller.named, options, show, caller.address)
    # Built from the rules, so it is not validated again; the tests hold it against the documented models.
    response = Response(f'{first[:-1]},"session_id":{to_json(session).decode()}}}', media_type="application/json")
    response.headers[HEADER] = session
    secure = request.url.scheme == "https"
    # A frame of another site needs SameSite=None, which browsers take over https alone.
    response.set_cookie(COOKIE, session, httponly=True, secure=secure, samesite="none" if secure else "lax")
    return response


@router.delete("/session", status_code=204, responses=SESSION_ERRORS)
def end_session(shared: SharedParts, caller: CallerOf, response: Response) -> None:
    """End the session, so that its place is free for others. An episode that has not ended is dropped."""
    shared.sessions.end(caller.session(shared, response))
    response.delete_cookie(COOKIE)


@router.get("/state", responses=SESSION_ERRORS)
def state(shared: SharedParts, caller: CallerOf, answer: Response) -> DroneState:
    """The full state of the session's episode."""
    with shared.sessions.reading(caller.session(shared, answer)) as session:
        return DroneState.of(session.fly()).model_copy(update={"episode_id": session.episode_id})


@router.get("/grade/{task_name}", responses=SESSION_ERRORS | answers(404))
def grade(shared: SharedParts, caller: CallerOf, answer: Response, task_name: str) -> Grade:
    """The graded score of the session's episode, which must be of this task; provisional until it has ended."""
    task = get_task(task_name)
    with shared.sessions.reading(caller.session(shared, answer)) as session:
        episode = session.fly()
        if episode.task.id != task.id:
            raise RequestError(409, "other_task", f"the session flies {episode.task.id!r}, not {task.id!r}")
        score = GRADERS.get(task.id, make_grader(task.id))(DroneState.of(episode))
        return Grade(task=task.id, score=score, done=episode.ended)


@router.get("/path_history", responses=SESSION_ERRORS)
def path_history(shared: SharedParts, caller: CallerOf, answer: Response) -> PathHistory:
    """The flight of the session's episode so far."""
    with shared.sessions.reading(caller.session(shared, answer)) as session:
        flown = DroneState.of(session.fly())
    path = flown.path_history
    return PathHistory(task=flown.task_name, seed=flown.seed, step_count=flown.step_count, path=path, path_history=path)


@router.get("/solution", responses=SESSION_ERRORS)
async def solution(request: Request, shared: SharedParts, caller: CallerOf, answer: Response) -> SolutionAnswer:
    """The best flight over the map of the session's episode, once that has ended."""

    def flown() -> Episode:
        with shared.sessions.reading(caller.session(shared, answer)) as session:
            return session.fly().copy()

    episode = await run_in_threadpool(flown)
    if not episode.ended:
        raise RequestError(409, "in_flight", "the best flight is shown once the episode has ended")
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


@router.post("/predict", responses=SESSION_ERRORS | answers(400, 413, 415), openapi_extra=LARGE_BODY)
def predict(shared: SharedParts, caller: CallerOf, answer: Response, body: PredictRequest | None = None) -> Prediction:
    """What the trained network would do: about the observation in the body, or, without one, about the session's."""
    if body is not None:
        if body.done:
            raise RequestError(422, "ended", "the episode of this observation has ended: there is nothing to fly")
        return shared.networks.predict(*arrays_of(body))
    with shared.sessions.reading(caller.session(shared, answer)) as session:
        episode = session.fly()
        if episode.ended:
            raise RequestError(409, "ended", "the episode has ended: POST /reset starts another")
        task, observation = episode.task, episode.observation()
    return shared.networks.predict(task, observation)


class StepRoute(JsonRoute):
    """Flies a valid step without FastAPI, whose overhead exceeds the cost of the step.

    FastAPI answers all others: it knows what is wrong with them.
    """

    async def answer(
        self, request: JsonRequest, validated: Callable[[Request], Coroutine[Any, Any, Response]]
    ) -> Response:
        """The answer to a request whose body has been parsed."""
        caller, after = Caller.of(request), request.headers.get(STEP_HEADER)
        counted = after is None or (after.isascii() and after.isdecimal() and len(after) <= LONGEST_COUNT)
        if len(caller.named or "") > LONGEST_ID or not counted:
            return await validated(request)
        try:
            body = StepRequest.model_validate(request.value)
        except ValidationError:
            return await validated(request)
        shared: Shared = request.app.state.shared
        step_count = None if after is None else int(after)
        return await asyncio.get_running_loop().run_in_executor(
            shared.steps, _advance, shared, caller, body, step_count
        )


def _advance(shared: Shared, caller: Caller, body: StepRequest, after: int | None) -> Response:
    session, show = caller.session(shared), flat_json if body.action is None else openenv_json
    _, stepped = shared.sessions.advance(session, body.chosen, show, after, caller.address)
    answer = Response(stepped, media_type="application/json")
    if caller.named is None:
        answer.headers[HEADER] = session
    return answer


stepping = APIRouter(tags=["flight"], route_class=StepRoute)
"""Goes before all others: most requests are steps."""


@stepping.post("/step", response_model=DroneObservation | StepResult, responses=SESSION_ERRORS | answers(400, 413, 415))
def step(
    shared: SharedParts,
    caller: CallerOf,
    body: Annotated[StepRequest, Body(openapi_examples=examples(STEPS))],
    after: Annotated[
        int | None,
        Header(
            alias=STEP_HEADER,
            ge=0,
            description="The `step_count` that this action follows: it is then flown once, however often it is sent.",
        ),
    ] = None,
) -> Response:
    """Fly one action.

    `{"direction": "UP"}` is answered with a `DroneObservation`; OpenEnv's `{"action": {"direction": "UP"}}` with
    `{"observation", "reward", "done"}`. After the end of the episode nothing changes, and `message` says so.

    With `X-Step-Count` an action is not flown twice: sent again after a lost answer, it is answered as it was.
    """
    return _advance(shared, caller, body, after)
