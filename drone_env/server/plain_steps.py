"""Steps as programs send them: flown without FastAPI, whose reading of a request takes longer than all the rest.

Only steps in which nothing is wrong, and which name their session. All others go on to `routes.flight.step`, which the
documentation shows: it tells what is wrong with them, and knows who names none.
"""

import asyncio

from pydantic import ValidationError
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from drone_env.errors import DroneEnvError
from drone_env.server.problems import answer_to
from drone_env.server.routes.flight import shown
from drone_env.server.schemas import StepRequest
from drone_env.server.security import BODY
from drone_env.server.state import LONGEST_ID, STEP_HEADER, Caller, Shared

LONGEST_COUNT = 9
"""Digits of a count of steps; no task has so many."""


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
        asked = None
        if scope["type"] == "http" and scope["path"] == "/step" and scope["method"] == "POST":
            asked = _read(Request(scope))
        if asked is None:
            await self.app(scope, receive, send)
            return
        session, body, after = asked
        loop, show = asyncio.get_running_loop(), shown(body)
        try:
            step = self.shared.sessions.step
            flown = await loop.run_in_executor(self.shared.steps, step, session, body.chosen, after, None, show)
        except DroneEnvError as error:
            await answer_to(error, scope)(scope, receive, send)
            return
        answer = flown.encode()
        headers = [(b"content-type", b"application/json"), (b"content-length", b"%d" % len(answer))]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": answer})


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
