"""The routes for finished episodes, their statistics, and the logs."""

from datetime import date, datetime, time, timezone
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from pydantic_core import to_json
from sse_starlette import EventSourceResponse
from starlette.types import Receive, Scope, Send

from drone_env.flights.episodes import Analysis, EpisodeSummary
from drone_env.flights.provenance import Provenance
from drone_env.flights.record import EpisodeRecord
from drone_env.flights.store import Store
from drone_env.models import MAX_SEED, Count, Score, Seed, StrictModel
from drone_env.server import daily
from drone_env.server.exceptions import RequestError, answer_to, error_responses
from drone_env.server.logs import LoggedRequest, RequestLog
from drone_env.server.state import AppStateDep
from drone_env.server.train_log import FILE_NAME, TrainLog

router = APIRouter(tags=["history"])
SUMMARIES = 5
LINES = 50
FOLLOWERS = 32
LISTED = 10


class ListedEpisode(EpisodeSummary):
    """One row of a list of finished episodes."""

    by: Provenance = Field(description="`agent` as fields.")


def listed(store: Store, n: int, *filters: Any, **more: Any) -> list[ListedEpisode]:
    """The last `n` finished episodes, newest first. Arguments and errors as `Store.listed`."""
    return [ListedEpisode(**vars(row), by=store.provenance(row.id)) for row in store.listed(n, *filters, **more)]


class EpisodeSummaries(StrictModel):
    """Finished episodes, newest first."""

    episodes: list[ListedEpisode]


class EpisodePage(EpisodeSummaries):
    """A page of finished episodes, newest first."""

    next: int | None = Field(description="Value of `before` for the next page; null on the last page.")


class FlightByHand(StrictModel):
    """A flight of a person without values, undo and forks."""

    id: str = Field(description="Id of the stored flight.")
    name: str | None = Field(description="The name that the person chose; null for all without one.")
    score: Score
    steps: Count


class MapOfTheDay(StrictModel):
    """The map of the day, and its list."""

    date: date
    task: str = Field(description="Short name of the task.")
    seed: Seed = Field(description="Number of the map.")
    best: list[FlightByHand] = Field(description="At most 10 flights by hand of this day, the best of each name.")


class LogLines(StrictModel):
    """The end of a log file."""

    file: str = Field(description="Name of the file.")
    lines: list[str] = Field(description="Its last lines, oldest first; empty if there is no file.")


@router.get("/analyse/{task_name}", responses=error_responses(404, 422, 503))
def analyse(app_state: AppStateDep, task_name: str) -> Analysis:
    """Statistics of the finished episodes of a task."""
    return app_state.store.analysis(task_name)


@router.get("/memory_logs", responses=error_responses(503))
def memory_logs(app_state: AppStateDep) -> EpisodeSummaries:
    """The last 5 finished episodes, newest first."""
    return EpisodeSummaries(episodes=listed(app_state.store, SUMMARIES))


@router.get("/today", responses=error_responses(503))
def today(app_state: AppStateDep) -> MapOfTheDay:
    """The map of the day (UTC), equal on all servers, and the best flights by hand that ended on this day."""
    day = daily.today()
    task, seed = daily.map_of_the_day(day)
    since = datetime.combine(day, time(), timezone.utc).timestamp()
    flights = [
        FlightByHand(id=row.id, name=row.person, score=row.score, steps=row.steps)
        for row in app_state.store.best(task, seed, since, LISTED)
    ]
    return MapOfTheDay(date=day, task=task, seed=seed, best=flights)


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
    found = listed(app_state.store, limit + 1, task, agent, before, seed=seed)
    page = found[:limit]
    return EpisodePage(episodes=page, next=page[-1].number if len(found) > limit else None)


@router.get("/episodes/{episode_id}", responses=error_responses(404, 422, 503), response_model_exclude_none=True)
def episode(app_state: AppStateDep, episode_id: str) -> EpisodeRecord:
    """The record of a finished episode, as `drone-env replay` reads it."""
    return app_state.store.episode(episode_id).record


@router.get("/logs", responses=error_responses(503))
def logs(app_state: AppStateDep) -> LogLines:
    """The last 50 lines of the training log, `train.log` in the data folder."""
    return LogLines(file=FILE_NAME, lines=TrainLog(app_state.settings.data).tail(LINES))


@router.get("/logs/curve", responses=error_responses(503))
def curve(app_state: AppStateDep) -> dict[str, list[float | None]]:
    """The metrics of the training log by name, of at most 400 of its lines; empty without a log."""
    return TrainLog(app_state.settings.data).curve()


@router.get(
    "/terminal_logs",
    response_model=dict[str, list[LoggedRequest]],
    responses=error_responses(503) | {200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}}},
)
async def terminal_logs(request: Request, app_state: AppStateDep) -> Response:
    """The last 200 requests to this process as `requests`, or live with `Accept: text/event-stream`."""
    if "text/event-stream" in request.headers.get("accept", ""):
        return _LiveRequests(app_state.requests)
    return Response(to_json({"requests": app_state.requests.since(0)}), media_type="application/json")


class _LiveRequests(EventSourceResponse):
    """The requests as server-sent events, for a bounded number of callers."""

    def __init__(self, log: RequestLog) -> None:
        super().__init__(log.follow(), ping=15)
        self._log = log

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send them until the caller disconnects."""
        if self._log.followers >= FOLLOWERS:
            error = RequestError(503, "no_room", f"{FOLLOWERS} callers follow the requests, the maximum: try later")
            await answer_to(error, scope)(scope, receive, send)
            return
        self._log.followers += 1
        try:
            await super().__call__(scope, receive, send)
            # The server stops, or the caller has disconnected.
            await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            self._log.followers -= 1
