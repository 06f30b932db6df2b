"""The route that flies a step: as programs send it without FastAPI, whose reading takes longer than all the rest."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Annotated, Any

from fastapi import APIRouter, Body, Header, Request, Response
from fastapi.routing import APIRoute
from pydantic import ValidationError

from drone_env.models import DroneObservation
from drone_env.server.observation_json import flat_json, openenv_json
from drone_env.server.problems import answers
from drone_env.server.schemas import STEPS, StepRequest, StepResult, examples
from drone_env.server.security import BODY
from drone_env.server.sessions import Show
from drone_env.server.state import LONGEST_ID, SESSION_ERRORS, Caller, CallerOf, SharedParts

STEP_HEADER = "x-step-count"
LONGEST_COUNT = 9
"""Digits of a count of steps; no task has that many."""


class PlainSteps(APIRoute):
    """Flies steps in which nothing is wrong, and which name their session, in the thread for steps.

    FastAPI reads all others: it says what is wrong with them.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """What answers a request."""
        otherwise = super().get_route_handler()

        async def handle(request: Request) -> Response:
            asked = _read(request)
            if asked is None:
                return await otherwise(request)
            session, body, after = asked
            shared, loop = request.app.state.shared, asyncio.get_running_loop()
            fly = shared.sessions.step
            stepped = await loop.run_in_executor(shared.steps, fly, session, body.chosen, after, None, shown(body))
            return Response(stepped, media_type="application/json")

        return handle


router = APIRouter(tags=["flight"], route_class=PlainSteps)


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


def _read(request: Request) -> tuple[str, StepRequest, int | None] | None:
    """The session, the step, and after which it is to be flown; None where anything about it is unusual."""
    session, after = Caller.of(request).named, request.headers.get(STEP_HEADER)
    if session is None or len(session) > LONGEST_ID:
        return None
    if after is not None and not (after.isascii() and after.isdecimal() and len(after) <= LONGEST_COUNT):
        return None
    try:
        body = StepRequest.model_validate(request.scope.get(BODY))
    except ValidationError:
        return None
    return session, body, None if after is None else int(after)
