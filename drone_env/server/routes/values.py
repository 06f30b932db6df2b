"""The route that says what can still be reached from a moment of a flight."""

from typing import Annotated

from fastapi import APIRouter, Body, Request, Response
from pydantic import ConfigDict, Field

from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE
from drone_env.core.tasks import MAX_UNITS, get_task
from drone_env.models import Direction, Message, Seed
from drone_env.results.record import fly_directions
from drone_env.server.incoming import LARGE_BODY, JsonRoute
from drone_env.server.map_choice import is_registered
from drone_env.server.map_values import ValuesAnswer, values_json
from drone_env.server.problems import answers
from drone_env.server.state import SharedParts

router = APIRouter(tags=["replay"], route_class=JsonRoute)


class FlightSoFar(Message):
    """The moment of a flight: the head of its record, and the actions flown up to then."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"task": "hard", "seed": 7, "actions": ["UP", "LEFT"]}]},
    )

    task: str = Field(max_length=100, description="Id or short name of the task.")
    task_version: int | None = Field(default=None, ge=1, description="Version of the task; the current one without.")
    seed: Seed = Field(description="Number of the map.")
    reward_profile: str | None = Field(
        default=None, max_length=100, description="As in a record; no value depends on it."
    )
    actions: list[Direction] = Field(
        default_factory=list[Direction],
        max_length=MAX_UNITS,
        fail_fast=True,
        description="The actions so far, in order.",
    )

    def episode(self) -> Episode:
        """The episode that has flown so far.

        Raises:
            UnknownNameError: if there is no such task, version or reward profile.
            InvalidValueError: if there are actions after the end.
        """
        episode = Episode(get_task(self.task, self.task_version), self.reward_profile or DEFAULT_PROFILE, self.seed)
        for _ in fly_directions(episode, self.actions):
            pass
        return episode


@router.post(
    "/values", response_model=ValuesAnswer, responses=answers(400, 413, 415, 422, 503), openapi_extra=LARGE_BODY
)
async def values(request: Request, shared: SharedParts, flight: Annotated[FlightSoFar, Body()]) -> Response:
    """The best score still possible from a moment of a flight: by each action, and from every cell of the map.

    Beside it stands what the network would do at every cell, and how far the battery reaches. No session is needed. Of
    a task whose maps are too large to be solved the exact values are null.
    """
    found = await shared.work(request, _values, flight, quick=is_registered(flight.task))
    return Response(found, media_type="application/json")


def _values(flight: FlightSoFar) -> str:
    return values_json(flight.episode())
