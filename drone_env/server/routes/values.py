"""The route for the values of a flight after a step, and at each cell."""

from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np
from fastapi import APIRouter, Body, Request, Response
from pydantic import ConfigDict, Field

from drone_env.agents.base import BatchAgent
from drone_env.core.episode import Episode
from drone_env.core.rules import score
from drone_env.core.tables import interpreted, view
from drone_env.core.tasks import MAX_UNITS, get_task
from drone_env.errors import TooLargeError
from drone_env.flights.record import fly_directions
from drone_env.models import DIRECTIONS, Count, Direction, Position, Score, Seed, StrictModel
from drone_env.server.jobs import job_context
from drone_env.server.json_routes import LARGE_BODY, JsonRoute
from drone_env.server.state import AppStateDep

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

from drone_env.server.best_flights import planner_of
from drone_env.server.routes.replay import FLIGHT_ERRORS

router = APIRouter(tags=["replay"], route_class=JsonRoute)


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

    only: Literal["range", "moves", "along"] | None = Field(
        default=None,
        description="`range`: compute only the range of the battery and `pads`; `moves`: only `q_values` and "
        "`best_actions`; `along`: only `along`; null: everything but `along`.",
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

    position: Position = Field(description="[x, y] of the drone.")
    done: bool = Field(description="Whether the flight has ended.")
    unsolved: str | None = Field(description="Why the exact values are null; null if the map is solved.")
    optimum: Score | None = Field(description="The highest possible score on this map.")
    value: Score | None = Field(description="The best score still possible; after the end, the score.")
    regret: float | None = Field(ge=0, description="optimum - value: the score lost for good.")
    q_values: dict[Direction, float] | None = Field(default=None, description="The best score after each action.")
    best_actions: list[Direction] | None = Field(default=None, description="All actions without regret.")
    network: CellNetwork | None = Field(default=None, description="The network; null if the task has none.")
    cells: CellValues | None = Field(default=None, description="The values at each cell.")
    along: list[Score] | None = Field(default=None, description="`value` before each action and at the end.")
    range: Rows[Count] | None = Field(
        default=None,
        description="[y][x], the most battery units left on arrival at each cell, without charging; 0 ends the flight "
        "there, null is out of range.",
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
        position=episode.position,
        done=episode.ended,
        unsolved=unsolved,
        optimum=optimum,
        value=value,
        regret=None if optimum is None or value is None else optimum - value,
        **(_ranges(episode) if not episode.ended and flight.only in (None, "range") else {}),
        **(_moves(episode, solver) if not episode.ended and flight.only in (None, "moves") and solver else {}),
        **(_cells(episode, solver) if not episode.ended and flight.only is None else {}),
        along=_along(flight, solver) if flight.only == "along" and solver else None,
    )
    return answer.model_dump_json()


def _along(flight: FlightSoFar, solver: "Solver") -> list[float]:
    start = Episode(get_task(flight.task), seed=flight.seed)
    return [solver.value(start), *(solver.value(episode) for episode in fly_directions(start, flight.actions))]


def _moves(episode: Episode, solver: "Solver") -> dict[str, Any]:
    q_values = dict(zip(DIRECTIONS, solver.q_values(episode).tolist(), strict=True))
    best = max(q_values.values())
    return {"q_values": q_values, "best_actions": [name for name, value in q_values.items() if value == best]}


def _cells(episode: Episode, solver: "Solver | None") -> dict[str, Any]:
    task, networks = episode.task, job_context().networks
    pilot, agent, network = planner_of(task), None, None
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
async def values(request: Request, app_state: AppStateDep, flight: Annotated[FlightSoFar, Body()]) -> Response:
    """The best score still possible after a step of a flight, for each action and from every cell of the map.

    The response also contains the network's action at every cell and the range of the battery. It requires no session.
    If the map is too large to be solved, the exact values are null.
    """
    return await app_state.json(request, values_json, flight, task=flight.task)
