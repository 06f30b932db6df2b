"""The routes for flights: replay frame by frame, analysis move by move, and the values of a flight after a step."""

from contextlib import suppress
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np
from fastapi import APIRouter, Body, Request, Response
from pydantic import ConfigDict, Field

from drone_env.agents.base import BatchAgent
from drone_env.core.actions import Action, Outcome
from drone_env.core.cells import CELL_KINDS
from drone_env.core.episode import Episode, rollout
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.core.rules import score
from drone_env.core.tables import interpreted, view
from drone_env.core.tasks import MAX_UNITS, TaskConfig, get_task
from drone_env.errors import CheckpointError, TooLargeError
from drone_env.models import DIRECTIONS, Count, Direction, EventName, Position, Score, Seed, StrictModel
from drone_env.planning.optimal import Solution, solve_episode
from drone_env.results.analysis import FlightAnalysis, Label, Move, analyse_flight
from drone_env.results.record import EpisodeRecord, fly_directions, record_of, replay, replay_steps
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.frames import EpisodeView, FlightHeader, frame_of, plan
from drone_env.server.jobs import job_context
from drone_env.server.json_routes import LARGE_BODY, JsonRoute
from drone_env.server.pilots import WHOLE_MAPS
from drone_env.server.state import AppStateDep

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

router = APIRouter(tags=["replay"], route_class=JsonRoute)
FLIGHT_ERRORS = error_responses(400, 413, 415, 422, 503)
RECORD = record_of(Episode("easy_delivery", ORIGINAL_PROFILE, 7).fly([Action.UP]), "me")


Record = Annotated[EpisodeRecord, Body(openapi_examples={"one step": {"value": RECORD.model_dump()}})]


class AnalysedMove(StrictModel):
    """One move and its regret."""

    step: int = Field(ge=1)
    action: Direction
    position: Position = Field(description="[x, y] after it.")
    event: EventName
    value: Score = Field(description="The best score still possible before it.")
    regret: float = Field(ge=0, description="Score that it lost for good.")
    label: Label
    mark: str = Field(description="Annotation symbol as in chess: `?!`, `?`, `??`, `!!`, or empty.")
    best_actions: list[Direction] = Field(description="All actions without regret.")
    margin: float = Field(ge=0, description="Regret of the next best action.")


class AnalysedFlight(StrictModel):
    """A flight compared with the exact optimum of its map."""

    score: Score
    optimal_score: Score = Field(description="The highest possible score on this map.")
    regret: float = Field(ge=0, description="optimal_score - score.")
    accuracy: float | None = Field(description="Fraction of best moves among moves with a margin.")
    counts: dict[Label, int] = Field(description="Moves by label.")
    moves: list[AnalysedMove]
    worst_step: Count | None = Field(description="The move that lost most, the first of equals; null if none lost.")
    worst_why: str = Field(description="What the best moves there gain: `which saves 2 steps`; empty if none lost.")
    why: str = Field(description="Why it failed, in one sentence; empty if it delivered all parcels.")
    rescue_step: Count | None = Field(
        description="The last step after which all parcels could still be delivered; null if there is none, or if all "
        "were delivered."
    )
    network: str | None = Field(description="Id of the pilot by whose network the map was flown; null without one.")
    network_score: Score | None = Field(description="Its score.")
    optimal_steps: Count = Field(description="Steps of a best flight.")
    optimal_battery: Count = Field(description="Battery units left at its end.")
    optimal_actions: list[Direction] = Field(description="Its actions.")
    optimal_path: list[Position] = Field(description="[x, y] of the drone from the start.")


@router.post("/replay", response_model=EpisodeView, responses=FLIGHT_ERRORS, openapi_extra=LARGE_BODY)
async def replay_record(request: Request, shared: AppStateDep, record: Record) -> Response:
    """Replay a record, check its rewards and score, and return its frames."""
    return await shared.json(request, _replayed, record, task=record.task)


def _replayed(record: EpisodeRecord) -> str:
    steps = replay_steps(record)
    start = next(steps)
    header = FlightHeader.of(start, record.agent)
    network = job_context().networks.shown_network(header.pilot, start.task)
    frames = [frame_of(episode, network) for episode in chain([start], steps)]
    return EpisodeView(opening=header, frames=frames).model_dump_json()


@router.post(
    "/annotate", response_model=AnalysedFlight, responses=FLIGHT_ERRORS | error_responses(409), openapi_extra=LARGE_BODY
)
async def annotate(request: Request, shared: AppStateDep, record: Record) -> Response:
    """The regret of each move of a finished flight, and a best flight over its map. Large maps take seconds."""
    if not record.ended:
        raise RequestError(409, "in_flight", "only a finished flight can be annotated")
    return await shared.json(request, _annotated, record, task=record.task)


def _annotated(record: EpisodeRecord) -> str:
    analysis = analyse_flight(record, lambda start: job_context().solver_of(start.task, start.seed))
    best, path = best_flight(analysis.task, analysis.seed)
    why = why_failed(replay(record))
    worst = max(analysis.moves, key=lambda move: move.regret)
    lost = worst.regret > 0
    network, network_score = network_flight(analysis.task, analysis.seed)
    answer = AnalysedFlight(
        worst_step=worst.step if lost else None,
        worst_why=gain_of_best(analysis, worst) if lost else "",
        why=why,
        network=network,
        network_score=network_score,
        rescue_step=analysis.rescue_step if why else None,
        **{name: getattr(analysis, name) for name in ("score", "regret", "accuracy", "counts")},
        optimal_score=analysis.optimum,
        moves=[AnalysedMove(**move) for move in analysis.to_dict()["moves"]],
        optimal_steps=best.steps,
        optimal_actions=[DIRECTIONS[action] for action in best.actions],
        optimal_battery=Episode(analysis.task, seed=analysis.seed).fly(best.actions).battery_units,
        optimal_path=path,
    )
    return answer.model_dump_json()


def gain_of_best(analysis: FlightAnalysis, move: Move) -> str:
    """What the best actions gain over a move that lost something, if all further moves are best ones."""
    task, solver = analysis.task, job_context().solver_of(analysis.task, analysis.seed)
    before = [one.action for one in analysis.moves[: move.step - 1]]

    def end(action: Action) -> Episode:
        flight = Episode(task, seed=analysis.seed).fly([*before, action])
        return rollout(flight, lambda _: solver.optimal_actions(flight)[0])

    best, flown = end(move.best_actions[0]), end(move.action)
    if best.deliveries_done > flown.deliveries_done:
        reach = f"{best.deliveries_done} of {task.deliveries}"
        return f"which keeps {reach} parcels in reach, not {flown.deliveries_done}"
    steps, units = flown.steps - best.steps, best.battery_units - flown.battery_units
    gains = (("saves", steps, "step"), ("leaves", units, "more battery unit"))
    return f"which {' and '.join(f'{gain} {n} {what}' + 's' * (n > 1) for gain, n, what in gains if n > 0)}"


def why_failed(flown: Episode) -> str:
    """Why an ended flight failed, in one sentence; empty if it delivered all parcels: a job of a worker process."""
    # Loads Numba, which the process that serves does without.
    from drone_env.planning.cell_states import charging_pads

    task, pads = flown.task, charging_pads(flown)
    if flown.outcome is Outcome.OUT_OF_STEPS:
        return f"The steps ran out: a flight has {task.max_steps}."
    if flown.outcome is not Outcome.BATTERY_DEAD:
        return ""
    grid = Episode(task, seed=flown.seed).grid()
    below = {int(grid[step.y, step.x]) for step in flown.path}
    costly = {CELL_KINDS[kind].name: units for kind, units in task.drain if units > 1 and kind in below}
    costs = " and ".join(f"{kind}s cost {units} units" for kind, units in costly.items()) or "each step costs a unit"
    x, y = flown.position
    away = min((abs(x - pad % task.width) + abs(y - pad // task.width) for pad in pads), default=None)
    if away is None:
        return f"{costs.capitalize()}."
    distance = f"a pad was {away} {'cell' if away == 1 else 'cells'} away"
    reached = [(step.x, step.y) for step in flown.path[-2:]].count((x, y)) == 1
    here = "the drone reached a pad with an empty battery" if reached else "the drone was on a pad and did not wait"
    end = distance if away else here
    return f"{costs.capitalize()}; {end}."


def _preferred(task: TaskConfig) -> str | None:
    """The pilot of the preferred network that flies a task, None without one."""
    return next((pilot for pilot in WHOLE_MAPS if job_context().networks.flies(pilot, task)), None)


def network_flight(task: TaskConfig, seed: int) -> tuple[str, Score] | tuple[None, None]:
    """The pilot of the preferred network and its score over a map, if there is one: a job of a worker process."""
    pilot, episode = _preferred(task), Episode(task, seed=seed)
    with suppress(CheckpointError, TooLargeError):
        if pilot is not None:
            plan(episode, pilot, (), 0)
            return pilot, episode.score
    return None, None


def best_flight(task: TaskConfig, seed: int) -> tuple[Solution, list[Position]]:
    """A best flight over a map, and [x, y] of the drone from the start: a job of a worker process.

    Raises:
        TooLargeError: if the map is too large to be solved.
    """
    start = Episode(task, seed=seed)
    # If every step costs the same, the shortest tour needs no solver.
    best = solve_episode(start, None if task.uniform else job_context().solver_of(task, seed))
    return best, [start.position, *((step.x, step.y) for step in start.copy().fly(best.actions).path)]


class FlightSoFar(StrictModel):
    """A flight up to a step: the map, and the actions so far."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"task": "hard", "seed": 7, "actions": ["UP", "LEFT"]}]},
    )

    task: str = Field(max_length=100, description="Id or short name of the task.")
    seed: Seed = Field(description="Number of the map.")
    actions: list[Direction] = Field(
        default=[], max_length=MAX_UNITS, fail_fast=True, description="The actions so far, in order."
    )

    only: Literal["range", "moves"] | None = Field(
        default=None,
        description="`range`: compute only the range of the battery and `pads`; `moves`: only `q_values` and "
        "`best_actions`; null: everything.",
    )

    def episode(self) -> Episode:
        """The episode after these actions.

        Raises:
            UnknownNameError: if the task does not exist.
            InvalidValueError: if there are actions after the end.
        """
        episode = Episode(get_task(self.task), seed=self.seed)
        for _ in fly_directions(episode, self.actions):
            pass
        return episode


Item = TypeVar("Item")
Rows = list[list[Item | None]]
"""[y][x], null at cells without a value."""


class CellNetwork(StrictModel):
    """The network that chose an action for every cell."""

    pilot: str = Field(description="Id of its pilot, as in `/pilots`.")
    file: str = Field(description="Name of its file.")
    digest: str = Field(description="First 16 digits of the SHA-256 of that file.")


class CellValues(StrictModel):
    """Values if the drone were at each cell, [y][x], in an otherwise equal state; null where it cannot be.

    A parcel at the cell counts as delivered. A pad there has not charged the battery yet.
    """

    values: Rows[Score] | None = Field(description="The best score still possible; null if the map is not solved.")
    q_values: Rows[list[Score]] | None = Field(
        description="The best score after UP, DOWN, LEFT, RIGHT and WAIT; null where the flight has ended."
    )
    best_actions: Rows[list[Direction]] | None = Field(description="All actions without regret.")
    network_actions: Rows[Direction] | None = Field(description="The network's action; null without a network.")
    disagree: Rows[bool] | None = Field(description="Whether the network's action has regret.")


class PadRange(StrictModel):
    """The cells in range of a full battery from a pad."""

    position: Position = Field(description="[x, y] of the pad.")
    units: Rows[Count] = Field(description="As `range`.")


class ValuesAnswer(StrictModel):
    """The values of a flight after a step. The fields from `q_values` on are null after the end.

    With `only`, the other fields are null.
    """

    task: str = Field(description="Id of the task.")
    task_version: int = Field(ge=1, description="Version of the task.")
    seed: Count = Field(description="Number of the map.")
    step_count: Count = Field(description="Steps flown.")
    position: Position = Field(description="[x, y] of the drone.")
    battery_units: Count
    deliveries_done: Count
    done: bool = Field(description="Whether the flight has ended.")
    unsolved: str | None = Field(description="Why the exact values are null; null if the map is solved.")
    optimum: Score | None = Field(description="The highest possible score on this map.")
    value: Score | None = Field(description="The best score still possible; after the end, the score.")
    regret: float | None = Field(ge=0, description="optimum - value: the score lost for good.")
    q_values: dict[Direction, float] | None = Field(default=None, description="The best score after each action.")
    best_actions: list[Direction] | None = Field(default=None, description="All actions without regret.")
    network: CellNetwork | None = Field(default=None, description="The network; null if the task has none.")
    cells: CellValues | None = Field(default=None, description="The values at each cell.")
    range: Rows[Count] | None = Field(
        default=None,
        description="[y][x], the most battery units left on arrival at each cell, in the steps left and without "
        "charging; 0 ends the flight there, null is out of range.",
    )
    pads: list[PadRange] | None = Field(default=None, description="The same with a full battery, from each pad.")


def values_json(flight: FlightSoFar) -> str:
    """The JSON of a `ValuesAnswer`: a job of a worker process.

    Raises:
        UnknownNameError, InvalidValueError: as `FlightSoFar.episode`.
        CheckpointError: if the file of the network holds none.
    """
    episode = flight.episode()
    solver = unsolved = optimum = value = None
    try:
        solver = None if flight.only == "range" else job_context().solver_of(episode.task, episode.seed)
    except TooLargeError as error:
        unsolved = str(error)
    if solver is not None:
        optimum, value = solver.value(Episode(episode.task, seed=episode.seed)), solver.value(episode)
    answer = ValuesAnswer(
        task=episode.task.id,
        task_version=episode.task.version,
        seed=episode.seed,
        step_count=episode.steps,
        position=episode.position,
        battery_units=episode.battery_units,
        deliveries_done=episode.deliveries_done,
        done=episode.ended,
        unsolved=unsolved,
        optimum=optimum,
        value=value,
        regret=None if optimum is None or value is None else optimum - value,
        **({} if episode.ended or flight.only == "moves" else _ranges(episode)),
        **({} if episode.ended or solver is None else _moves(episode, solver)),
        **({} if episode.ended or flight.only else _cells(episode, solver)),
    )
    return answer.model_dump_json()


def _moves(episode: Episode, solver: "Solver") -> dict[str, Any]:
    q_values = dict(zip(DIRECTIONS, solver.q_values(episode).tolist(), strict=True))
    best = max(q_values.values())
    return {"q_values": q_values, "best_actions": [name for name, value in q_values.items() if value == best]}


def _cells(episode: Episode, solver: "Solver | None") -> dict[str, Any]:
    task, networks = episode.task, job_context().networks
    pilot, agent, network = _preferred(task), None, None
    if pilot is not None:
        agent = networks.agent(pilot, task)
        assert isinstance(agent, BatchAgent)
        network = CellNetwork(pilot=pilot, file=networks.file(pilot, task).name, digest=str(agent.config["network"]))
    return {"network": network, "cells": _cell_values(episode, solver, agent)}


def _ranges(episode: Episode) -> dict[str, Any]:
    # Loads Numba, which the process that serves does without.
    from drone_env.planning.cell_states import battery_range, charging_pads

    task = episode.task

    def reached(cell: int, units: int) -> Rows[int]:
        most = battery_range(episode, cell, units)
        rows = most.astype(object)
        rows[most < 0] = None
        return rows.reshape(task.height, task.width).tolist()

    return {
        "range": reached(episode.cell, episode.battery_units),
        "pads": [
            PadRange(position=(pad % task.width, pad // task.width), units=reached(pad, task.battery_capacity))
            for pad in charging_pads(episode)
        ],
    }


def _cell_values(episode: Episode, solver: "Solver | None", agent: BatchAgent | None) -> CellValues:
    from drone_env.planning.cell_states import states_in_chunks

    task = episode.task
    shape = (task.height, task.width)
    values, valued, best_actions, network_actions, disagree = np.full((5, task.height * task.width), None, object)
    for places in states_in_chunks(episode):
        is_flying, best = places.flying, None
        flying, over, grids = places.cells[is_flying], places.cells[~is_flying], places.grids[is_flying]
        if solver is not None:
            q_values = solver.q_values_of(grids, places.states[is_flying])
            best = q_values == q_values.max(axis=1, keepdims=True)
            values[flying] = q_values.max(axis=1)
            values[over] = [score(interpreted(task), view(state)) for state in places.states[~is_flying]]
            for cell, row, chosen in zip(flying, q_values.tolist(), best.tolist(), strict=True):
                valued[cell] = row
                best_actions[cell] = [name for name, is_best in zip(DIRECTIONS, chosen, strict=True) if is_best]
            for cell in over:
                best_actions[cell] = []
        if agent is not None:
            actions = agent.act_batch(grids.reshape(-1, *shape), places.telemetry[is_flying])
            network_actions[flying] = np.array(DIRECTIONS, object)[actions]
            if best is not None:
                disagree[flying] = ~best[np.arange(len(flying)), actions]
    return CellValues(
        values=values.reshape(shape).tolist() if solver else None,
        q_values=valued.reshape(shape).tolist() if solver else None,
        best_actions=best_actions.reshape(shape).tolist() if solver else None,
        network_actions=network_actions.reshape(shape).tolist() if agent else None,
        disagree=disagree.reshape(shape).tolist() if solver and agent else None,
    )


@router.post("/values", response_model=ValuesAnswer, responses=FLIGHT_ERRORS, openapi_extra=LARGE_BODY)
async def values(request: Request, shared: AppStateDep, flight: Annotated[FlightSoFar, Body()]) -> Response:
    """The best score still possible after a step of a flight, for each action and from every cell of the map.

    The response also contains the network's action at every cell and the range of the battery. It requires no session.
    If the map is too large to be solved, the exact values are null.
    """
    return await shared.json(request, values_json, flight, task=flight.task)
