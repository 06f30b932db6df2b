"""The routes that look back: finished episodes, what they come to, and the logs."""

import asyncio
from collections import deque
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from pydantic import Field
from sse_starlette import EventSourceResponse

from drone_env.episodes.analysis import Analysis
from drone_env.episodes.store import StoredEpisode
from drone_env.models import Message
from drone_env.server.problems import answers
from drone_env.server.request_log import LoggedRequest, RequestLog
from drone_env.server.schemas import EpisodeSummaries, EpisodeSummary, LogLines
from drone_env.server.state import SharedParts

router = APIRouter(tags=["history"])
SUMMARIES = 5
LINES = 50
TAIL_BYTES = 256 * 1024
TRAIN_LOG = "train.log"
POLL_SECONDS = 0.25


class Requests(Message):
    """The last requests that this process answered, oldest first."""

    requests: Annotated[list[LoggedRequest], Field(description="At most 200.")]


@router.get("/analyse/{task_name}", responses=answers(404, 422, 503))
def analyse(shared: SharedParts, task_name: str) -> Analysis:
    """What the finished episodes of a task come to."""
    return shared.store.analysis(task_name)


@router.get("/memory_logs", responses=answers(503))
def memory_logs(shared: SharedParts) -> EpisodeSummaries:
    """The last 5 finished episodes, newest first."""
    return EpisodeSummaries(episodes=[_summary(episode) for episode in shared.store.latest(SUMMARIES)])


@router.get("/logs")
def logs(shared: SharedParts) -> LogLines:
    """The last 50 lines of the training log, `train.log` in the data folder."""
    return LogLines(file=TRAIN_LOG, lines=tail(shared.settings.data / TRAIN_LOG, LINES))


@router.get(
    "/terminal_logs",
    response_model=Requests,
    responses={200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}}},
)
async def terminal_logs(request: Request, shared: SharedParts) -> Response:
    """The requests that this process answered: as JSON, or live with `Accept: text/event-stream`."""
    if "text/event-stream" in request.headers.get("accept", ""):
        return EventSourceResponse(_live(shared.requests), ping=15)
    return JSONResponse(Requests(requests=shared.requests.since(0)).model_dump())


async def _live(log: RequestLog) -> AsyncGenerator[dict[str, str], None]:
    seen = 0
    while True:
        for entry in log.since(seen):
            seen = entry.number
            yield {"id": str(entry.number), "data": entry.model_dump_json()}
        await asyncio.sleep(POLL_SECONDS)


def tail(path: Path, lines: int) -> list[str]:
    """The last lines of a text file, oldest first; none where there is no file. Reads at most its last 256 KiB."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            start = max(size - TAIL_BYTES, 0)
            file.seek(start)
            text = file.read(TAIL_BYTES).decode("utf-8", "replace")
    except FileNotFoundError:
        return []
    found = text.splitlines()
    return list(deque(found[1:] if start else found, lines))


def _summary(stored: StoredEpisode) -> EpisodeSummary:
    record = stored.record
    return EpisodeSummary(
        id=stored.id,
        finished_at=stored.finished_at.isoformat(),
        task=record.task,
        task_version=record.task_version,
        seed=record.seed,
        agent=record.agent,
        reward_profile=record.reward_profile,
        steps=stored.steps,
        deliveries=record.deliveries,
        deliveries_total=stored.deliveries_total,
        reward_total=stored.reward_total,
        score=record.score,
        success=record.success,
        outcome=stored.outcome,
    )
