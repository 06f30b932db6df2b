"""Steps as programs send them: flown without FastAPI, whose reading of a request takes longer than all the rest.

Only steps in which nothing is wrong, and which name their session. All others go on to `flight.step`, which the
documentation shows: it tells what is wrong with them, and knows who names none.
"""

import asyncio
from typing import NamedTuple

from pydantic import ValidationError
from starlette.requests import HTTPConnection
from starlette.responses import Response
from starlette.routing import BaseRoute, Match
from starlette.types import Receive, Scope, Send

from drone_env.server.routes.flight import shown
from drone_env.server.schemas import StepRequest
from drone_env.server.security import BODY
from drone_env.server.state import COOKIE, HEADER, LONGEST_ID, NEW, STEP_HEADER, Shared

LONGEST_COUNT = 9
"""Digits of a count of steps; no task has so many."""


class PlainStep(NamedTuple):
    """What such a request asks for."""

    session: str
    body: StepRequest
    after: int | None


class PlainSteps(BaseRoute):
    """The route, to stand before the others.

    Args:
        shared: The parts of the server.
    """

    def __init__(self, shared: Shared) -> None:
        self.shared = shared

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Whether a request is such a step."""
        if scope["type"] == "http" and scope["path"] == "/step" and scope["method"] == "POST":
            step = _plain_step(HTTPConnection(scope), scope.get(BODY))
            if step is not None:
                return Match.FULL, {"plain_step": step}
        return Match.NONE, {}

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Fly it, in the thread for steps, and answer.

        Raises:
            DroneEnvError: as `Sessions.step` does.
        """
        step: PlainStep = scope["plain_step"]
        fly, chosen, show = self.shared.sessions.step, step.body.chosen, shown(step.body)
        loop = asyncio.get_running_loop()
        told = await loop.run_in_executor(self.shared.steps, fly, step.session, chosen, step.after, None, show)
        await Response(told, media_type="application/json")(scope, receive, send)


def _plain_step(request: HTTPConnection, body: object) -> PlainStep | None:
    headers = request.headers
    session, after = headers.get(HEADER) or request.cookies.get(COOKIE), headers.get(STEP_HEADER)
    if not session or session == NEW or len(session) > LONGEST_ID:
        return None
    if after is not None and not (after.isascii() and after.isdecimal() and len(after) <= LONGEST_COUNT):
        return None
    try:
        return PlainStep(session, StepRequest.model_validate(body), None if after is None else int(after))
    except ValidationError:
        return None
