"""The route that flies a step, without FastAPI where nothing about the request is unusual."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Annotated, Any

from fastapi import APIRouter, Body, Header, Request, Response
from pydantic import ValidationError

from drone_env.models import DroneObservation
from drone_env.server.incoming import JsonRequest, JsonRoute
from drone_env.server.observation_json import flat_json, openenv_json
from drone_env.server.problems import answers
from drone_env.server.schemas import STEPS, StepRequest, StepResult, examples
from drone_env.server.sessions import Show
from drone_env.server.state import LONGEST_ID, SESSION_ERRORS, Caller, CallerOf, SharedParts

STEP_HEADER = "x-step-count"
LONGEST_COUNT = 9
"""Digits of a count of steps; no task has that many."""


class StepRoute(JsonRoute):
    """Flies a valid step that names its session without FastAPI, whose overhead exceeds the cost of the step.

    FastAPI answers all others: it knows what is wrong with them.
    """

    async def answer(
        self, request: JsonRequest, validated: Callable[[Request], Coroutine[Any, Any, Response]]
    ) -> Response:
        """The answer to a request whose body has been parsed."""
        session, after = Caller.of(request).named, request.headers.get(STEP_HEADER)
        counted = after is None or (after.isascii() and after.isdecimal() and len(after) <= LONGEST_COUNT)
        if session is None or len(session) > LONGEST_ID or not counted:
            return await validated(request)
        try:
            body = StepRequest.model_validate(request.value)
        except ValidationError:
            return await validated(request)
        shared, loop = request.app.state.shared, asyncio.get_running_loop()
        step_count = None if after is None else int(after)
        fly = shared.sessions.step
        stepped = await loop.run_in_executor(shared.steps, fly, session, body.chosen, step_count, None, shown(body))
        return Response(stepped, media_type="application/json")


router = APIRouter(tags=["flight"], route_class=StepRoute)


@router.post("/step", response_model=DroneObservation | StepResult, responses=SESSION_ERRORS | answers(400, 413, 415))
def step(
    shared: SharedParts,
    caller: CallerOf,
    answer: Response,
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
    stepped = shared.sessions.step(caller.session(shared, answer), body.chosen, after, caller.address, shown(body))
    return Response(stepped, headers=dict(answer.headers), media_type="application/json")


def shown(body: StepRequest) -> Show:
    """How a step is answered: as it was asked for."""
    return flat_json if body.action is None else openenv_json
