"""What goes wrong, as callers read it: one JSON model, and the status of every exception."""

import logging
from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import Field
from starlette.exceptions import HTTPException
from starlette.types import Scope

from drone_env.errors import (
    CapacityError,
    CheckpointError,
    DroneEnvError,
    EpisodeError,
    InvalidValueError,
    NoSessionError,
    SessionGoneError,
    StoreError,
    TooLargeError,
    UnknownNameError,
    UnsupportedTaskError,
    text_of,
    wrong_parts,
)
from drone_env.models import Message

log = logging.getLogger(__name__)

FAILED = "the server failed; its log says why"
WHAT_TO_DO = "POST /reset opens a session; send the header X-Session-Id: SESSION_ID, as it answers, or keep the cookie"


class FieldProblem(Message):
    """What is wrong with one part of a request."""

    where: str = Field(description="The part, such as `body.direction`.")
    message: str = Field(description="What is wrong with it.")


class Problem(Message):
    """Why a request was not answered."""

    code: str = Field(description="What went wrong, for programs.")
    detail: str = Field(description="What went wrong and what is allowed, for people.")
    errors: list[FieldProblem] = Field(default_factory=list[FieldProblem], description="The parts that are wrong.")


class RequestError(DroneEnvError):
    """A request that is answered with a `Problem`.

    Args:
        status: The HTTP status.
        code: What went wrong, for programs.
        detail: What went wrong, for people.
        headers: More headers of the answer.
    """

    def __init__(self, status: int, code: str, detail: str, headers: dict[str, str] | None = None) -> None:
        self.status = status
        self.code = code
        self.headers = headers
        super().__init__(detail)


STATUSES: list[tuple[type[DroneEnvError], int, str]] = [
    (NoSessionError, 410, "session_gone"),
    (SessionGoneError, 410, "session_gone"),
    (CapacityError, 503, "no_room"),
    (StoreError, 503, "store"),
    (CheckpointError, 503, "no_network"),
    (UnsupportedTaskError, 422, "unsupported"),
    (TooLargeError, 422, "too_large"),
    (InvalidValueError, 422, "invalid_request"),
    (EpisodeError, 409, "wrong_moment"),
]
"""The first that fits holds."""

_MEANINGS = {
    400: "The body is not JSON; in the task API also an index that the split does not have.",
    401: "The token is missing or wrong.",
    403: "A host, or a web page of an origin, that is not allowed; or something that this server has turned off.",
    404: "There is no such thing; `detail` lists what there is.",
    409: "No session was named, or the episode is not at the right point.",
    410: "The session is gone.",
    413: "The body is too large.",
    415: "The body is not declared as JSON.",
    422: "A value that is not allowed.",
    503: "No room, no network, the server is busy, or its store is busy or gone.",
}


def answers(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The error answers of a route, for its documentation."""
    return {status: {"model": Problem, "description": _MEANINGS[status]} for status in statuses}


def status_of(error: Exception, method: str) -> tuple[int, str]:
    """HTTP status and code of an error; an unknown name is 404 in a path (GET) and 422 in a body."""
    if isinstance(error, RequestError):
        return error.status, error.code
    if isinstance(error, UnknownNameError):
        return (404 if method in ("GET", "HEAD") else 422), "unknown_name"
    return next(((status, code) for kind, status, code in STATUSES if isinstance(error, kind)), (500, "internal"))


def answer_to(error: Exception, scope: Scope) -> JSONResponse:
    """The answer that says what went wrong with a request."""
    status, code, detail = 500, "internal", FAILED
    headers: Mapping[str, str] | None = None
    errors: list[FieldProblem] = []
    if isinstance(error, RequestValidationError):
        status, code, detail = 422, "invalid_request", text_of(error)
        errors = [FieldProblem(where=where, message=why) for where, why, _ in wrong_parts(error)]
    elif isinstance(error, HTTPException):
        status, code, detail, headers = error.status_code, "http", str(error.detail), error.headers
    elif isinstance(error, DroneEnvError):
        status, code = status_of(error, scope["method"])
        if status == 500:
            log.error("%s %s", scope["method"], scope["path"], exc_info=error)
        else:
            detail = f"{error}: {WHAT_TO_DO}" if status == 410 else str(error)
        if isinstance(error, RequestError):
            headers = error.headers
        if status == 503 and code not in ("no_network", "not_started"):  # where waiting helps
            headers = {"Retry-After": "5"}
    problem = Problem(code=code, detail=detail, errors=errors)
    return JSONResponse(problem.model_dump(), status, headers)


async def _answer(request: Request, error: Exception) -> JSONResponse:
    return answer_to(error, request.scope)


def install(app: FastAPI) -> None:
    """Tell all problems of an application in this way. The trace of an unforeseen one is the server's to log."""
    for kind in (DroneEnvError, RequestValidationError, HTTPException, Exception):
        app.add_exception_handler(kind, _answer)
