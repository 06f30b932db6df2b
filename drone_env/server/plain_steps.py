"""Steps as programs send them: flown without FastAPI, whose reading of a request takes longer than all the rest.

Only steps in which nothing is wrong, and which name their session. All others go on to `routes.flight.step`, which the
documentation shows: it tells what is wrong with them, and knows who names none.
"""

import asyncio
from typing import NamedTuple

from pydantic import ValidationError
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from drone_env.errors import DroneEnvError
from drone_env.server.problems import told_problem
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


class PlainSteps:
    """Middleware that answers such steps; it stands behind all that checks requests.

    Args:
        app: The application within.
        shared: The parts of the server.
    """

    def __init__(self, app: ASGIApp, shared: Shared) -> None:
        self.app = app
        self.shared = shared

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer such a step, in the thread for steps; pass on all else."""
        step = None
        if scope["type"] == "http" and scope["path"] == "/step" and scope["method"] == "POST":
            step = _plain_step(Request(scope), scope.get(BODY))
        if step is None:
            await self.app(scope, receive, send)
            return
        try:
            flown = await self._fly(step)
        except DroneEnvError as error:
            await told_problem(Request(scope), error)(scope, receive, send)
            return
        headers = [(b"content-type", b"application/json"), (b"content-length", b"%d" % len(flown))]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": flown})

    async def _fly(self, step: PlainStep) -> bytes:
        fly, action, show = self.shared.sessions.step, step.body.chosen, shown(step.body)
        loop = asyncio.get_running_loop()
        answer = await loop.run_in_executor(self.shared.steps, fly, step.session, action, step.after, None, show)
        return answer.encode()


def _plain_step(request: Request, body: object) -> PlainStep | None:
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
