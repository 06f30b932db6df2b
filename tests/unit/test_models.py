"""What travels: complete, documented, and strict about what it takes in."""

import json

import pytest
from pydantic import BaseModel, ValidationError

from drone_env.core.actions import Action
from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.models import DroneAction, DroneObservation, DroneState

OBSERVATION_FIELDS = {
    "grid", "cell_types", "grid_width", "grid_height", "drone_x", "drone_y", "cell_below", "battery",
    "battery_steps_remaining", "deliveries_total", "deliveries_done", "current_target", "distance_to_target",
    "step_count", "max_steps", "reward_last", "reward_total", "score", "done", "message", "legend",
}  # fmt: skip


@pytest.fixture
def episode() -> Episode:
    episode = Episode("medium")
    episode.reset(4)
    for action in (0, 3, 3, 4, 1):
        episode.step(action)
    return episode


def test_an_observation_has_exactly_the_promised_fields() -> None:
    assert set(DroneObservation.model_fields) == OBSERVATION_FIELDS  # test_public_names: each has a description


def test_observation_says_what_the_episode_holds(episode: Episode) -> None:
    seen = DroneObservation.of(episode)
    x, y = episode.position
    assert (seen.drone_x, seen.drone_y) == (x, y)
    assert seen.cell_types[y][x] == "drone"
    assert seen.cell_below == CELL_KINDS[Cell(episode.under)].name
    assert len(seen.grid) == len(seen.cell_types) == seen.grid_height == 14
    assert [len(line) for line in seen.cell_types] == [14] * 14
    names = {kind.emoji: kind.name for kind in CELL_KINDS.values()}
    assert [[names[emoji] for emoji in line] for line in seen.grid] == seen.cell_types
    assert seen.current_target == episode.target
    assert seen.distance_to_target == episode.distance_to_target
    assert (seen.step_count, seen.max_steps, seen.battery_steps_remaining) == (5, 100, 95)
    assert seen.battery == 0.95
    assert (seen.reward_last, seen.reward_total) == (episode.reward_last, episode.reward_total)
    assert (seen.score, seen.done, seen.message) == (episode.score, False, episode.message)
    assert set(seen.legend) == {kind.emoji for cell, kind in CELL_KINDS.items() if cell is not Cell.UNKNOWN}
    assert seen.legend["🚁"].endswith("hides the cell below, which cell_below tells")


def test_target_is_null_when_all_is_delivered() -> None:
    episode = Episode("easy")
    episode.reset(0)
    while not episode.ended:
        dx, dy = (t - p for t, p in zip(episode.target, episode.position, strict=True))
        episode.step(Action.RIGHT if dx > 0 else Action.LEFT if dx else Action.DOWN if dy > 0 else Action.UP)
    seen = json.loads(DroneObservation.of(episode).model_dump_json())
    assert seen["current_target"] is None
    assert seen["distance_to_target"] is None
    assert seen["done"] is True


@pytest.mark.parametrize("model", [DroneObservation, DroneState])
def test_round_trip_through_json_and_dictionaries(model: type[BaseModel], episode: Episode) -> None:
    value = model.of(episode)
    assert model.model_validate_json(value.model_dump_json()) == value
    assert model.model_validate(value.model_dump()) == value


def test_state_holds_the_flight(episode: Episode) -> None:
    state = DroneState.of(episode)
    assert [point.action for point in state.path_history] == ["UP", "RIGHT", "RIGHT", "WAIT", "DOWN"]
    assert [point.step for point in state.path_history] == [1, 2, 3, 4, 5]
    last = state.path_history[-1]
    assert (last.x, last.y) == episode.position == (state.drone_x, state.drone_y)
    assert last.battery_steps_remaining == state.battery_steps_remaining == 95
    assert sum(point.reward for point in state.path_history) == pytest.approx(state.reward_total)
    assert state.grid == episode.grid().tolist()
    assert (state.task_name, state.task_version, state.seed, state.outcome) == ("medium_delivery", 1, 4, "flying")


@pytest.mark.parametrize("value", ["up", 0, ["UP"]])
def test_a_wrong_direction_names_what_is_allowed(value: object) -> None:
    with pytest.raises(ValidationError, match="'UP', 'DOWN', 'LEFT', 'RIGHT' or 'WAIT'"):
        DroneAction.model_validate({"direction": value})


@pytest.mark.parametrize(
    ("model", "field", "value"),
    [
        (DroneObservation, "battery", float("nan")),
        (DroneObservation, "drone_x", 14),
        (DroneObservation, "drone_x", "3"),
        (DroneObservation, "drone_x", 0),
        (DroneObservation, "cell_below", "drone"),
        (DroneObservation, "cell_below", "delivered"),
        (DroneObservation, "score", 1.0),
        (DroneObservation, "deliveries_done", 4),
        (DroneObservation, "step_count", 101),
        (DroneObservation, "grid", ["too short"]),
        (DroneObservation, "cell_types", []),
        (DroneObservation, "cell_types", [["road"] * 13] * 14),
        (DroneObservation, "grid", ["🌳" * 14] * 14),
        (DroneObservation, "current_target", [14, 0]),
        (DroneObservation, "nonsense", 1),
        (DroneState, "battery_steps_remaining", 101),
        (DroneState, "battery", 0.5),
        (DroneState, "deliveries_done", 1),
        (DroneState, "seed", 2**53),
        (DroneState, "parcels", []),
        (DroneState, "outcome", "delivered"),
        (DroneState, "done", True),
        (DroneState, "path_history", [{}]),
    ],
)
def test_a_wrong_field_is_refused_by_name(
    episode: Episode, model: type[DroneObservation] | type[DroneState], field: str, value: object
) -> None:
    fields = model.of(episode).model_dump()
    with pytest.raises(ValidationError, match=field):
        model.model_validate({**fields, field: value})
