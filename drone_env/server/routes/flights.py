"""The routes by which the page starts flights, and changes that of a person.

An agent's flight is flown to its end and stored at once; the page plays it. A person's flight is a session.
"""

import asyncio
import secrets
from collections.abc import Sequence
from contextlib import suppress
from hashlib import sha256
from typing import Annotated, Literal

from fastapi import APIRouter, Body, Request, Response
from pydantic import AfterValidator, ConfigDict, Field, model_validator
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import MAX_UNITS, get_task
from drone_env.errors import EpisodeError, NoSessionError
from drone_env.flights.flight import new_id
from drone_env.flights.provenance import HUMAN, PersonName, Provenance
from drone_env.flights.record import fly_directions, record_of
from drone_env.flights.sessions import Session
from drone_env.models import Count, Direction, Seed, StrictModel
from drone_env.server.exceptions import error_responses
from drone_env.server.frames import EpisodeView, FlightHeader, Frame, fly_frames, frame_of, shows_values
from drone_env.server.json_routes import LARGE_BODY, JsonRoute
from drone_env.server.pilots import check_name
from drone_env.server.routes.flight import CallerDep
from drone_env.server.routes.replay import FLIGHT_ERRORS
from drone_env.server.schemas import ResetOptions
from drone_env.server.state import SESSION_ERRORS, AppState, AppStateDep, caller_address
from drone_env.server.task_api import start_episode

router = APIRouter(tags=["page"], route_class=JsonRoute)
MOST_FLIGHTS = 8
MAPS = 10_000
"""A start that names no map gets one of this many: people say the numbers to each other."""
PilotName = Annotated[str, Field(max_length=100)]
Change = Direction | Literal["UNDO", "VALUES"]


class Fork(StrictModel):
    """A step of a flight, and the actions from there on."""

    actions: list[Direction] = Field(max_length=MAX_UNITS, fail_fast=True, description="All actions from the start.")
    step: Count = Field(description="Number of actions that belong to the first flight; 0 for your own flight.")
    of: Provenance = Field(description="Who flew that flight.")

    @model_validator(mode="after")
    def _step_is_there(self) -> Self:
        if self.step > len(self.actions):
            raise ValueError(f"a fork from step {self.step} requires as many actions, got {len(self.actions)}")
        return self


class Start(StrictModel):
    """One map and one to eight pilots.

    With a fork, the last pilot (or the person, if the fork's step is 0) starts after the fork's actions.
    """

    model_config = ConfigDict(json_schema_extra={"examples": [{"task": "hard", "seed": 7, "pilots": ["greedy"]}]})

    task: str = Field(max_length=100, description="Id or short name of the task.")
    pilots: list[PilotName] = Field(min_length=1, max_length=MOST_FLIGHTS, description="Ids as in `/pilots`.")
    seed: Seed | None = Field(default=None, description="Number of the map; null for any.")
    reward_profile: str | None = Field(default=None, max_length=100)
    fork: Fork | None = None
    name: Annotated[PersonName, AfterValidator(check_name)] | None = Field(
        default=None, description="The person's name."
    )

    @model_validator(mode="after")
    def _fork_has_a_map(self) -> Self:
        if self.fork is not None and self.seed is None:
            raise ValueError("a fork needs the seed of its map")
        return self


class StartedFlight(EpisodeView):
    """A flight of the page: an agent's to its end, a person's so far."""

    version: str | None = Field(description="What the next change of a person's flight sends; null after the end.")
    episode: str | None = Field(description="Id of the stored flight; null before the end.")


class StartedFlights(StrictModel):
    """One flight per pilot."""

    flights: list[StartedFlight]


class FlightChange(StrictModel):
    """A change of a person's flight."""

    version: str = Field(max_length=100, description="As the last response.")
    change: Change = Field(
        description="An action, `UNDO` to take back the last one, or `VALUES` to turn on values; the record notes both."
    )


class ChangedFlight(StrictModel):
    """A person's flight after a change."""

    frame: Frame = Field(description="The newest frame. The frames from its step on are no longer valid.")
    version: str = Field(description="What the next change sends.")
    values_used: bool
    undo_used: bool
    episode: str | None = Field(description="Id of the stored flight; null before the end.")


@router.post(
    "/flights", response_model=StartedFlights, responses=FLIGHT_ERRORS | error_responses(409), openapi_extra=LARGE_BODY
)
async def flights(request: Request, app_state: AppStateDep, options: Annotated[Start, Body()]) -> Response:
    """Fly one map with several pilots. The flights of agents are complete; a person's is a session."""
    start, flying, forking = await run_in_threadpool(_choose, options, app_state)

    async def fly(number: int, provenance: Provenance) -> tuple[list[int], str]:
        forked = None if options.fork is None or number != forking else options.fork.actions
        if not forked and provenance.pilot == HUMAN:
            return [], to_json([frame_of(start)]).decode()
        return await app_state.work(request, fly_frames, start, provenance, forked, task=start.task.id)

    flown = await asyncio.gather(*(fly(number, provenance) for number, provenance in enumerate(flying)))
    views = await run_in_threadpool(_open, app_state, caller_address(request), start, flying, flown)
    return Response(f'{{"flights":[{",".join(views)}]}}', media_type="application/json")


@router.post("/flights/change", responses=SESSION_ERRORS | error_responses(400, 413, 415))
def change_flight(app_state: AppStateDep, caller: CallerDep, body: FlightChange) -> ChangedFlight:
    """Fly an action in the session of a person, take one back, or turn on values. A repeated change is made once."""
    return app_state.sessions.use(caller.session(app_state.sessions), lambda one: _change(app_state, one, body))


def _change(app_state: AppState, session: Session, body: FlightChange) -> ChangedFlight:
    revision, version = session.revision, _version(session.flight_id, session.revision)
    if version == body.version:
        _make(session, body.change)
        version = _version(session.flight_id, revision + 1)
    elif body.version != _version(session.flight_id, revision - 1) or not _is_made(session, body.change):
        raise NoSessionError("another page or client flies this session now: start a new flight")
    episode, by = session.episode, session.provenance
    network = app_state.networks.shown_network(HUMAN, episode.task) if shows_values(by, episode) else None
    return ChangedFlight(
        frame=frame_of(episode, network),
        version=version,
        values_used=by.values_used,
        undo_used=by.undo_used,
        episode=session.episode_id,
    )


def _version(flight_id: str, revision: int) -> str:
    return f"{flight_id}-{revision}"


def _make(session: Session, change: Change) -> None:
    by, episode = session.provenance, session.episode
    if by.pilot != HUMAN:
        raise EpisodeError(f"{by.pilot} flies this session: start one with the pilot {HUMAN!r} to fly yourself")
    if episode.ended:
        raise EpisodeError("this episode has ended: start another")
    if change == "VALUES":
        session.use_values()
    elif change != "UNDO":
        session.fly(Action[change])
    elif episode.steps > (0 if by.parent is None else by.parent.step):
        session.undo()
    else:
        raise EpisodeError("there is no step to take back: you have flown none")


def _is_made(session: Session, change: Change) -> bool:
    """Whether a change may be the last one of a session: then its response was lost."""
    if change in ("UNDO", "VALUES"):
        return session.provenance.undo_used if change == "UNDO" else session.provenance.values_used
    return session.episode.actions[-1:] == [Action[change]]


def _choose(options: Start, app_state: AppState) -> tuple[Episode, list[Provenance], int | None]:
    """The episode at its start, the provenance of each flight, and the index of the flight that continues the fork."""
    task, fork, pilots = get_task(options.task), options.fork, options.pilots
    for pilot in pilots:
        app_state.networks.require(pilot, task)
    seed = secrets.randbelow(MAPS) if options.seed is None else options.seed
    start = start_episode(ResetOptions(task_name=task.id, seed=seed, reward_profile=options.reward_profile), None)
    flying = [Provenance(pilot=pilot) for pilot in pilots]
    forking, is_over = None, False
    if fork is not None:
        # The last pilot flies the fork; a person's own flight may be listed before others.
        own = fork.step == 0 and HUMAN in pilots
        forking = pilots.index(HUMAN) if own else len(pilots) - 1
        flying[forking] = fork.of.forked(fork.step, pilots[forking])
        # All of them, because actions after the end are an error.
        is_over = True in [one.ended for one in fly_directions(start.copy(), fork.actions)]
    for number, one in enumerate(flying):
        # A finished flight is not credited to the visitor who opens its link.
        if one.pilot == HUMAN and not (is_over and number == forking):
            flying[number] = one.named(options.name)
    return start, flying, forking


def _open(
    app_state: AppState,
    caller: str,
    start: Episode,
    flying: Sequence[Provenance],
    flown: Sequence[tuple[list[int], str]],
) -> list[str]:
    """Store the flights that have ended and open sessions for the others, or for none; the JSON of each."""
    opened, views = list[str](), list[str]()
    try:
        for provenance, (actions, frames) in zip(flying, flown, strict=True):
            episode, session, version = start.copy().fly(actions), None, None
            if episode.ended:
                flight_id, provenance = _flown_before(app_state, episode, provenance)
                app_state.store.add_episode(episode, provenance, flight_id)
            else:
                flight_id = new_id()
                version = _version(flight_id, 0)
                session = app_state.sessions.open(episode, provenance, owner=caller, keep=opened, flight_id=flight_id)
                opened.append(session)
            header = FlightHeader.at_start(start, provenance, session).model_dump_json()
            rest = to_json({"version": version, "episode": flight_id if episode.ended else None}).decode()[1:]
            views.append(f'{{"opening":{header},"frames":{frames},{rest}')
    except BaseException:
        for session in opened:
            with suppress(NoSessionError):
                app_state.sessions.end(session)
        raise
    return views


def _flown_before(app_state: AppState, episode: Episode, provenance: Provenance) -> tuple[str, Provenance]:
    """The id of a finished flight that is flown again, and who flew it: a link knows not all of its help."""
    kept = _without_help(provenance)
    stored = app_state.store.flown_before(episode)
    for flight_id, by in sorted(stored, key=lambda flown: flown[1] != provenance):
        if _without_help(by) == kept:
            return flight_id, by
    # Two pages that open the link at once store it once.
    return sha256(record_of(episode, provenance).to_json().encode()).hexdigest()[:16], provenance


def _without_help(provenance: Provenance) -> Provenance:
    """The pilots of a flight without what only its record says: the person's name, values and undo."""
    return provenance.model_copy(update={"person": None, "values_used": False, "undo_used": False})
