"""The routes for finished episodes, their statistics, and the logs."""

from collections import deque
from datetime import date, datetime, time, timezone
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from pydantic_core import to_json
from sse_starlette import EventSourceResponse
from starlette.types import Receive, Scope, Send

from drone_env.flights.episodes import Analysis, EpisodeSummary
from drone_env.flights.record import EpisodeRecord
from drone_env.models import MAX_SEED, Seed, StrictModel
from drone_env.server import daily
from drone_env.server.exceptions import error_responses
from drone_env.server.logs import LoggedRequest, RequestLog
from drone_env.server.state import AppStateDep

router = APIRouter(tags=["history"])
SUMMARIES = 5
TRAIN_LOG, LINES = "train.log", 50
LISTED = 10


class EpisodePage(StrictModel):
    """A page of finished episodes, newest first."""

    episodes: list[EpisodeSummary]
    next: int | None = Field(description="Value of `before` for the next page; null on the last page.")


class MapOfTheDay(StrictModel):
    """The map of the day, and its list."""

    date: date
    task: str = Field(description="Short name of the task.")
    seed: Seed = Field(description="Number of the map.")
    best: list[EpisodeSummary] = Field(
        description="At most 10 flights by hand of this day, without values, undo and forks; the best of each name."
    )


@router.get("/analyse/{task_name}", responses=error_responses(404, 422, 503))
def analyse(app_state: AppStateDep, task_name: str) -> Analysis:
    """Statistics of the finished episodes of a task."""
    return app_state.store.analysis(task_name)


@router.get("/memory_logs", responses=error_responses(503))
def memory_logs(app_state: AppStateDep) -> dict[str, list[EpisodeSummary]]:
    """The last 5 finished episodes as `episodes`, newest first."""
    return {"episodes": app_state.store.listed(SUMMARIES)}


@router.get("/today", responses=error_responses(503))
def today(app_state: AppStateDep) -> MapOfTheDay:
    """The map of the day (UTC), equal on all servers, and the best flights by hand that ended on this day."""
    day = daily.today()
    task, seed = daily.map_of_the_day(day)
    since = datetime.combine(day, time(), timezone.utc).timestamp()
    return MapOfTheDay(date=day, task=task, seed=seed, best=app_state.store.best(task, seed, since, LISTED))


@router.get("/episodes", responses=error_responses(404, 422, 503))
def episodes(
    app_state: AppStateDep,
    task: Annotated[str | None, Query(max_length=100, description="Id or short name of a task.")] = None,
    agent: Annotated[str | None, Query(max_length=200, description="The agent as in the records.")] = None,
    seed: Annotated[int | None, Query(ge=0, le=MAX_SEED, description="Number of the map.")] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    before: Annotated[int | None, Query(ge=1, le=MAX_SEED, description="`next` of the last page.")] = None,
) -> EpisodePage:
    """Finished episodes, newest first."""
    found = app_state.store.listed(limit + 1, task, agent, before, seed=seed)
    page = found[:limit]
    return EpisodePage(episodes=page, next=page[-1].number if len(found) > limit else None)


@router.get("/episodes/{episode_id}", responses=error_responses(404, 422, 503), response_model_exclude_none=True)
def episode(app_state: AppStateDep, episode_id: str) -> EpisodeRecord:
    """The record of a finished episode, as `drone-env replay` reads it."""
    return app_state.store.episode(episode_id).record


@router.get("/logs", responses=error_responses(503))
def logs(app_state: AppStateDep) -> dict[str, str | list[str]]:
    """The last 50 lines of the training log in the data folder as `lines`, oldest first, and its name as `file`."""
    file = app_state.settings.data / TRAIN_LOG
    if not file.exists():
        return {"file": TRAIN_LOG, "lines": []}
    with file.open(encoding="utf-8", errors="replace") as lines:
        return {"file": TRAIN_LOG, "lines": [line.rstrip("\n") for line in deque(lines, LINES)]}


@router.get(
    "/terminal_logs",
    response_model=dict[str, list[LoggedRequest]],
    responses={200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}}},
)
async def terminal_logs(request: Request, app_state: AppStateDep) -> Response:
    """The last 200 requests to this process as `requests`, or live with `Accept: text/event-stream`."""
    if "text/event-stream" in request.headers.get("accept", ""):
        return _LiveRequests(app_state.requests)
    return Response(to_json({"requests": app_state.requests.since(0)}), media_type="application/json")


class _LiveRequests(EventSourceResponse):
    """The requests as server-sent events."""

    def __init__(self, log: RequestLog) -> None:
        super().__init__(log.follow(), ping=15)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send them until the caller disconnects or the server stops, which the base class leaves unfinished."""
        await super().__call__(scope, receive, send)
        await send({"type": "http.response.body", "body": b"", "more_body": False})
