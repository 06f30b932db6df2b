"""The route that replays a flight frame by frame."""

import json
from itertools import chain
from typing import Annotated

from fastapi import APIRouter, Body, Request, Response

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.flights.record import EpisodeRecord, record_of, replay_steps
from drone_env.server.exceptions import error_responses
from drone_env.server.frames import EpisodeView, FlightHeader, frame_of
from drone_env.server.jobs import job_context
from drone_env.server.json_routes import LARGE_BODY, JsonRoute
from drone_env.server.state import AppStateDep

router = APIRouter(tags=["replay"], route_class=JsonRoute)
FLIGHT_ERRORS = error_responses(400, 413, 415, 422, 503)
RECORD = record_of(Episode("easy_delivery", ORIGINAL_PROFILE, 7).fly([Action.UP]), "me")
Record = Annotated[EpisodeRecord, Body(openapi_examples={"one step": {"value": json.loads(RECORD.to_json())}})]


@router.post("/replay", response_model=EpisodeView, responses=FLIGHT_ERRORS, openapi_extra=LARGE_BODY)
async def replay_record(request: Request, app_state: AppStateDep, record: Record) -> Response:
    """Replay a record, check its rewards and score, and return its frames."""
    return await app_state.json(request, _replayed, record, task=record.task)


def _replayed(record: EpisodeRecord) -> str:
    steps = replay_steps(record)
    start = next(steps)
    header = FlightHeader.at_start(start, record.provenance)
    network = job_context().networks.shown_network(header.pilot, start.task)
    frames = [frame_of(episode, network) for episode in chain([start], steps)]
    return EpisodeView(opening=header, frames=frames).model_dump_json()
