"""The route that analyses a flight move by move."""

from fastapi import APIRouter, Request, Response
from pydantic import Field

from drone_env.core.actions import Action, Outcome
from drone_env.core.cells import CELL_KINDS
from drone_env.core.episode import Episode, rollout
from drone_env.flights.record import EpisodeRecord, replay
from drone_env.models import DIRECTIONS, Count, Direction, EventName, Position, Score, StrictModel
from drone_env.results.analysis import FlightAnalysis, Label, Move, analyse_flight
from drone_env.server.best_flights import best_flight, network_flight
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.jobs import job_context
from drone_env.server.json_routes import LARGE_BODY, JsonRoute
from drone_env.server.routes.replay import FLIGHT_ERRORS, Record
from drone_env.server.state import AppStateDep

router = APIRouter(tags=["replay"], route_class=JsonRoute)


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


@router.post(
    "/annotate", response_model=AnalysedFlight, responses=FLIGHT_ERRORS | error_responses(409), openapi_extra=LARGE_BODY
)
async def annotate(request: Request, app_state: AppStateDep, record: Record) -> Response:
    """The regret of each move of a finished flight, and a best flight over its map. Large maps take seconds."""
    if not record.ended:
        raise RequestError(409, "in_flight", "only a finished flight can be annotated")
    return await app_state.json(request, _annotated, record, task=record.task)


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
