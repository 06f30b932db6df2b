"""Physics and grading of the world through the public interface, with numbers by hand.

Map 14 of easy_delivery: the drone starts at (6, 3), the parcel is at (5, 1), with roads in between.
"""

from pathlib import Path

import numpy as np
import pytest

from drone_env import GRADERS, TASKS, DroneState, Episode, Outcome, generate_city_map, make_agent, solve
from drone_env.models import DroneObservation

CELL_TYPES = {
    "🛣": "road", "🏢": "building", "🌳": "tree", "🚧": "obstacle", "📦": "delivery", "✅": "delivered", "🚁": "drone",
}  # fmt: skip
OBSERVATION = [
    "grid", "cell_types", "grid_width", "grid_height", "drone_x", "drone_y", "cell_below", "battery",
    "battery_steps_remaining", "deliveries_total", "deliveries_done", "current_target", "distance_to_target",
    "step_count", "max_steps", "reward_last", "reward_total", "score", "done", "message", "legend",
]  # fmt: skip


@pytest.mark.feature("P6")
@pytest.mark.parametrize("task", TASKS)
def test_a_mission_from_map_to_grade(task: str) -> None:
    episode, agent = Episode(task), make_agent("optimal", task)
    agent.reset(episode.reset(7))
    city = generate_city_map(task, 7)
    assert np.array_equal(np.where(episode.grid() == 6, 0, episode.grid()), city.grid)
    assert (episode.position, [parcel[:2] for parcel in episode.parcels]) == (city.start, [*city.deliveries])
    while not episode.ended:
        episode.step(agent.act(episode.observation()))
    assert episode.outcome is Outcome.DELIVERED or TASKS[task].family == "rush"  # which has more parcels than steps
    assert GRADERS[task](DroneState.of(episode)) == episode.score == solve(task, 7).score


@pytest.mark.feature("E1")
def test_maps_come_from_a_seeded_torch_generator() -> None:
    import torch  # `uv sync` leaves it out, and all else here does without

    def drawn(seed: int) -> list[list[int]]:
        return generate_city_map("hard_delivery", torch.Generator().manual_seed(seed)).grid.tolist()

    generator = torch.Generator().manual_seed(5)
    before = generator.get_state()
    first = generate_city_map("hard_delivery", generator)
    assert first.grid.tolist() == drawn(5) != drawn(6)
    assert generate_city_map("hard_delivery", generator).seed != first.seed
    generator.set_state(before)
    assert generate_city_map("hard_delivery", generator).grid.tolist() == first.grid.tolist()
    assert generate_city_map("hard_delivery", first.seed).grid.tolist() == first.grid.tolist()
    assert generate_city_map("hard_delivery", first.seed + 1).grid.tolist() != first.grid.tolist()


@pytest.mark.feature("E2")
def test_seven_cell_types_with_emoji_name_and_effect() -> None:
    episode, seen = Episode("medium_delivery", "tiered", 7), set[str]()
    for action in solve("medium_delivery", 7).actions:
        obs = DroneObservation.of(episode)
        for row, names in zip(obs.grid, obs.cell_types, strict=True):
            assert [CELL_TYPES[emoji] for emoji in row] == names
            seen.update(names)
        episode.step(action)
    assert seen == set(CELL_TYPES.values())
    for emoji, name in CELL_TYPES.items():
        label, effect = obs.legend[emoji].split(": ", 1)
        assert (label, bool(effect)) == (name, True)


@pytest.mark.feature("E4")
def test_an_observation_has_typed_fields_that_openapi_documents(tmp_path: Path) -> None:
    from drone_env.server.app import create_app
    from drone_env.server.settings import Settings

    assert list(DroneObservation.model_fields) == OBSERVATION
    documented = create_app(Settings(data=tmp_path)).openapi()["components"]["schemas"]["DroneObservation"]
    assert list(documented["properties"]) == documented["required"] == OBSERVATION
    for field in documented["properties"].values():
        assert "description" in field
        assert field.keys() & {"type", "anyOf"}
