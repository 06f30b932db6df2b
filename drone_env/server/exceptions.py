"""Error responses: one JSON model, the HTTP status of each exception, the exception handlers."""

import logging
from collections.abc import Mapping
from http import HTTPStatus
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
    StoreError,
    TooLargeError,
    UnknownNameError,
    UnsupportedTaskError,
    text_of,
)
from drone_env.models import StrictModel

log = logging.getLogger(__name__)

FAILED = "the server failed; its log says why"
WHAT_TO_DO = "POST /reset opens a session; send the header X-Session-Id: SESSION_ID, as it answers, or keep the cookie"


class Problem(StrictModel):
    """An error response."""

    code: str = Field(description="Error code for programs.")
    detail: str = Field(description="What is wrong and what is allowed, for people.")


class RequestError(DroneEnvError):
    """An error with its own HTTP status.

    Args:
        status: The HTTP status.
        code: The error code for programs.
        detail: The message for people.
        headers: Headers of the response.
    """

    def __init__(self, status: int, code: str, detail: str, headers: dict[str, str] | None = None) -> None:
        self.status = status
        self.code = code
        self.headers = headers
        super().__init__(detail)


STATUSES: list[tuple[type[DroneEnvError], int, str]] = [
    (NoSessionError, 410, "session_gone"),
    (CapacityError, 503, "no_room"),
    (StoreError, 503, "store"),
    (CheckpointError, 503, "no_network"),
    (UnsupportedTaskError, 422, "unsupported"),
    (TooLargeError, 422, "too_large"),
    (InvalidValueError, 422, "invalid_request"),
    (EpisodeError, 409, "wrong_moment"),
]
"""The first class that matches decides."""


def error_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the `responses` of a route for these errors."""
    return {status: {"model": Problem, "description": HTTPStatus(status).phrase} for status in statuses}


def answer_to(error: Exception, scope: Scope) -> JSONResponse:
    """Return the error response of a request."""
    status, code, detail = 500, "internal", FAILED
    headers: Mapping[str, str] | None = None
    if isinstance(error, RequestValidationError):
        status, code, detail = 422, "invalid_request", text_of(error)
    elif isinstance(error, HTTPException):
        status, code, headers = error.status_code, "http", error.headers
        detail = str(error.detail)
        if status == 404:
            detail = f"there is nothing at {scope['path'][:100]}; /openapi.json lists all calls"
    elif isinstance(error, DroneEnvError):
        status, code = next(((status, code) for kind, status, code in STATUSES if isinstance(error, kind)), (500, code))
        if isinstance(error, UnknownNameError):  # in a path or in a body
            status, code = (404 if scope["method"] in ("GET", "HEAD") else 422), "unknown_name"
        if isinstance(error, RequestError):
            status, code, headers = error.status, error.code, error.headers
        if status == 500:
            log.error("%s %s", scope["method"], scope["path"], exc_info=error)
        else:
            detail = f"{error}: {WHAT_TO_DO}" if status == 410 else str(error)
        if status == 503 and code not in ("no_network", "not_started"):  # a retry cannot help these
            headers = {"Retry-After": "5"}
    problem = Problem(code=code, detail=detail)
    return JSONResponse(problem.model_dump(), status, headers)


async def _answer(request: Request, error: Exception) -> JSONResponse:
    return answer_to(error, request.scope)


def install(app: FastAPI) -> None:
    """Add the exception handlers. uvicorn logs the trace of an unexpected exception."""
    for kind in (DroneEnvError, RequestValidationError, HTTPException, Exception):
        app.add_exception_handler(kind, _answer)
