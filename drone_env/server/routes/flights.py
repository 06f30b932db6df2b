"""The routes by which the page starts flights, and changes that of a person.

The page shows the map at once, while a worker process flies each agent's flight to its end. It is stored then, and the
page plays it. A person's flight is a session.
"""

import secrets
from hashlib import sha256
from typing import Annotated, Literal

from fastapi import APIRouter, Body, Request, Response
from pydantic import ConfigDict, Field, model_validator
from starlette.concurrency import run_in_threadpool
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import MAX_UNITS
from drone_env.errors import EpisodeError, NoSessionError
from drone_env.flights.flight import new_id
from drone_env.flights.provenance import HUMAN, PersonName, Provenance
from drone_env.flights.record import fly_directions, record_of
from drone_env.flights.sessions import Session
from drone_env.models import Count, Direction, Seed, StrictModel
from drone_env.server.exceptions import error_responses
from drone_env.server.frames import EpisodeView, FlightHeader, Frame, fly_agent, frame_of, frames_of, network_beside
from drone_env.server.routes.flight import CallerDep
from drone_env.server.routes.replay import FLIGHT_ERRORS
from drone_env.server.schemas import ResetOptions
from drone_env.server.state import SESSION_ERRORS, AppState, AppStateDep, caller_address
from drone_env.server.task_api import start_episode

router = APIRouter(tags=["page"])
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


class OnTask(StrictModel):
    """The task of a flight, and who pays."""

    task: str = Field(max_length=100, description="Id or short name of the task.")
    reward_profile: str | None = Field(default=None, max_length=100)

    def start(self, seed: int) -> Episode:
        """The episode of a map at its start."""
        return start_episode(ResetOptions(task_name=self.task, seed=seed, reward_profile=self.reward_profile), None)


class Start(OnTask):
    """One map and one to eight pilots, of which one may be a person.

    With a fork, the person starts after its actions.
    """

    model_config = ConfigDict(json_schema_extra={"examples": [{"task": "hard", "seed": 7, "pilots": ["greedy"]}]})

    pilots: list[PilotName] = Field(min_length=1, max_length=MOST_FLIGHTS, description="Ids as in `/pilots`.")
    seed: Seed | None = Field(default=None, description="Number of the map; null for any.")
    fork: Fork | None = None
    name: PersonName | None = Field(default=None, description="The person's name.")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.fork is not None:
            flies = self.pilots[-1:] if self.fork.step else self.pilots
            if self.seed is None or HUMAN not in flies:
                raise ValueError(f"a fork needs the seed of its map, and as the last pilot {HUMAN!r}")
        if self.pilots.count(HUMAN) > 1:
            raise ValueError("one person flies")
        return self


class StartedFlight(EpisodeView):
    """The beginning of a flight: its start, or the actions of a fork."""

    version: str | None = Field(description="What the next change of a person's flight sends; null without a session.")
    episode: str | None = Field(description="Id of the stored flight; null before the end, and for agents.")


class AgentStart(OnTask):
    """An agent's flight, as `/flights` has begun it."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"task": "hard", "seed": 7, "pilot": "greedy"}]})

    seed: Seed = Field(description="Number of the map.")
    pilot: PilotName


class AgentFlight(StrictModel):
    """An agent's flight."""

    frames: list[Frame] = Field(description="Frame 0 is the reset; then one per step, to the end.")
    episode: str = Field(description="Id of the stored flight.")


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


@router.post("/flights", responses=FLIGHT_ERRORS)
def flights(
    request: Request, app_state: AppStateDep, options: Annotated[Start, Body()]
) -> dict[str, list[StartedFlight]]:
    """Start to fly one map with several pilots, as `flights`.

    A person's flight is a session; `/flights/agent` flies an agent's.
    """
    start, flying = _choose(options, app_state)
    caller = caller_address(request)
    return {"flights": [_begin(app_state, caller, start, *flight) for flight in flying]}


@router.post(
    "/flights/agent",
    response_model=AgentFlight,
    responses=FLIGHT_ERRORS | error_responses(409),
)
async def fly_to_end(request: Request, app_state: AppStateDep, options: Annotated[AgentStart, Body()]) -> Response:
    """Fly an agent's flight to its end, and store it; one that is stored already stays one."""
    start = await run_in_threadpool(options.start, options.seed)
    if options.pilot == HUMAN:
        raise EpisodeError(f"{HUMAN!r} is no agent: fly by /flights/change")
    app_state.networks.require(options.pilot, start.task)
    actions, frames = await app_state.work(request, fly_agent, start, options.pilot, task=start.task.id)
    provenance = Provenance(pilot=options.pilot)
    stored, _ = await run_in_threadpool(_store, app_state, start.copy().fly(actions), provenance)
    return Response(f'{{"frames":{frames},"episode":"{stored}"}}', media_type="application/json")


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
    return ChangedFlight(
        frame=frame_of(episode, network_beside(app_state.networks, by, episode)),
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


def _choose(options: Start, app_state: AppState) -> tuple[Episode, list[tuple[Provenance, list[int]]]]:
    """The episode at its start, and the provenance and the first actions of each flight."""
    fork, pilots = options.fork, options.pilots
    start = options.start(secrets.randbelow(MAPS) if options.seed is None else options.seed)
    for pilot in pilots:
        app_state.networks.require(pilot, start.task)
    flying = [(Provenance(pilot=pilot), list[int]()) for pilot in pilots]
    if HUMAN in pilots:
        by, flown = Provenance(pilot=HUMAN), start
        if fork is not None:
            by = fork.of.forked(fork.step, HUMAN)
            flown = fly_directions(start.copy(), fork.actions)
        # A finished flight is not credited to the visitor who opens its link.
        flying[pilots.index(HUMAN)] = by if flown.ended else by.named(options.name), flown.actions
    return start, flying


def _begin(
    app_state: AppState, caller: str, start: Episode, provenance: Provenance, actions: list[int]
) -> StartedFlight:
    """Begin a flight. A person's flight has a session, or is stored if it has ended."""
    episode, session, version, stored = start.copy().fly(actions), None, None, None
    if provenance.pilot == HUMAN and episode.ended:
        stored, provenance = _store(app_state, episode, provenance)
    elif provenance.pilot == HUMAN:
        flight_id = new_id()
        version = _version(flight_id, 0)
        session = app_state.sessions.open(episode, provenance, owner=caller, flight_id=flight_id)
    opening = FlightHeader.at_start(start, provenance, session)
    frames = frames_of(start, actions, network_beside(app_state.networks, provenance, episode))
    return StartedFlight(opening=opening, frames=frames, version=version, episode=stored)


def _store(app_state: AppState, episode: Episode, provenance: Provenance) -> tuple[str, Provenance]:
    """Store a finished flight unless it is stored; its id and who flew it, because a link knows not all of its help."""
    kept = _without_help(provenance)
    stored = app_state.store.flown_before(episode)
    for flight_id, by in sorted(stored, key=lambda flown: flown[1] != provenance):
        if _without_help(by) == kept:
            return flight_id, by
    # Two pages that open the link at once store it once.
    flight_id = sha256(record_of(episode, provenance).to_json().encode()).hexdigest()[:16]
    return app_state.store.add_episode(episode, provenance, flight_id), provenance


def _without_help(provenance: Provenance) -> Provenance:
    """The pilots of a flight without what only its record says: the person's name, values and undo."""
    return provenance.model_copy(update={"person": None, "values_used": False, "undo_used": False})
