"""What travels: complete, documented, and strict about what it takes in."""

import pytest
from pydantic import ValidationError

from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.models import DroneObservation, DroneState


@pytest.fixture
def episode() -> Episode:
    return Episode("medium", seed=4).fly((0, 3, 3, 4, 1))


def test_observation_says_what_the_episode_holds(episode: Episode) -> None:
    seen = DroneObservation.of(episode)
    x, y = episode.position
    assert (seen.drone_x, seen.drone_y) == (x, y)
    assert seen.cell_below == CELL_KINDS[Cell(episode.under)].name
    assert (seen.grid_width, seen.grid_height) == (14, 14)
    assert seen.current_target == episode.target
    assert seen.distance_to_target == episode.distance_to_target
    assert (seen.step_count, seen.max_steps, seen.battery_steps_remaining) == (5, 100, 95)
    assert (seen.battery, seen.deliveries_total, seen.deliveries_done) == (0.95, 3, episode.deliveries_done)
    assert (seen.reward_last, seen.reward_total) == (episode.reward_last, episode.reward_total)
    assert (seen.score, seen.done, seen.message) == (episode.score, False, episode.message)
    assert set(seen.legend) == {kind.emoji for cell, kind in CELL_KINDS.items() if cell is not Cell.UNKNOWN}
    assert seen.legend["🚁"].endswith("hides the cell below, which cell_below tells")


@pytest.mark.parametrize(
    ("model", "field", "value"),
    [
        (DroneObservation, "battery", float("nan")),
        (DroneObservation, "drone_x", "3"),
        (DroneObservation, "nonsense", 1),
        (DroneState, "path_history", [{}]),
    ],
)
def test_a_wrong_field_is_refused_by_name(
    episode: Episode, model: type[DroneObservation] | type[DroneState], field: str, value: object
) -> None:
    fields = model.of(episode).model_dump()
    with pytest.raises(ValidationError, match=field):
        model.model_validate({**fields, field: value})
