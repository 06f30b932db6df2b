"""The promises of the environment."""

import json
from importlib import import_module

import httpx
import pytest
import torch
from pydantic import BaseModel, ValidationError

from drone_env import GRADERS, TASKS, Action, DroneState, Episode, generate_city_map, solve
from drone_env.core import tasks
from drone_env.models import DroneAction, DroneObservation
from tests.api.serving import Server

CELL_TYPES = {
    "🛣": "road", "🏢": "building", "🌳": "tree", "🚧": "obstacle", "📦": "delivery", "✅": "delivered", "🚁": "drone",
}  # fmt: skip
OBSERVATION = [
    "grid", "cell_types", "grid_width", "grid_height", "drone_x", "drone_y", "battery", "battery_steps_remaining",
    "deliveries_total", "deliveries_done", "current_target", "distance_to_target", "step_count", "max_steps",
    "reward_last", "reward_total", "score", "done", "message", "legend",
]  # fmt: skip
TIERED = {  # parcels, size, terrain, steps, pay of a delivery and of all else
    "easy_delivery": (1, 10, (4, 4, 3), 60, 0.95, 0.10),
    "medium_delivery": (3, 14, (8, 6, 6), 100, 0.90, 0.15),
    "hard_delivery": (5, 18, (12, 10, 10), 160, 0.85, 0.25),
}


def started(task: str, seed: int, profile: str = "tiered") -> Episode:
    episode = Episode(task, profile)
    episode.reset(seed)
    return episode


@pytest.mark.feature("E1")
def test_e1_maps_come_from_a_seeded_generator() -> None:
    """Maps are generated from a seed or a PyTorch generator: the same one gives the same map"""

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
def test_e2_seven_cell_types_with_emoji_name_and_effect() -> None:
    """A city of seven cell types; each has an emoji, a name and an effect, and the legend tells them"""
    episode, seen = started("medium_delivery", 7), set[str]()
    for action in solve("medium_delivery", 7).actions:
        observation = DroneObservation.of(episode)
        for row, names in zip(observation.grid, observation.cell_types, strict=True):
            assert [CELL_TYPES[emoji] for emoji in row] == names
            seen.update(names)
        episode.step(action)
    assert seen == set(CELL_TYPES.values())
    for emoji, name in CELL_TYPES.items():
        told, effect = observation.legend[emoji].split(": ", 1)
        assert (told, bool(effect)) == (name, True)


@pytest.mark.feature("E3")
def test_e3_five_actions_and_walls_that_hold() -> None:
    """UP, DOWN, LEFT, RIGHT and WAIT; a move off the grid is penalised and the drone stays"""
    for action, (dx, dy) in {"UP": (0, -1), "DOWN": (0, 1), "LEFT": (-1, 0), "RIGHT": (1, 0), "WAIT": (0, 0)}.items():
        episode = started("easy_delivery", 14)  # starts at (6, 3), the parcel at (5, 1)
        episode.step(Action[action])
        assert episode.position == (6 + dx, 3 + dy)
    for _ in range(3):
        episode.step(Action.RIGHT)
    assert episode.position == (9, 3)
    assert episode.step(Action.RIGHT) == 0.10
    assert (episode.position, episode.event.name, episode.steps) == ((9, 3), "WALL", 5)


@pytest.mark.feature("E4")
def test_e4_an_observation_has_all_fields(server: Server) -> None:
    """A DroneObservation has 20 typed fields, from the emoji grid to the legend, documented in OpenAPI"""
    assert list(DroneObservation.model_fields) == OBSERVATION
    documented = httpx.get(f"{server.url}/openapi.json").json()["components"]["schemas"]["DroneObservation"]
    assert list(documented["properties"]) == documented["required"] == OBSERVATION
    assert all(
        "description" in field and field.keys() & {"type", "anyOf"} for field in documented["properties"].values()
    )
    answer = httpx.post(f"{server.url}/reset", json={"task_name": "hard_delivery", "seed": 7}).json()
    assert answer.pop("session_id")
    assert list(answer) == OBSERVATION
    assert DroneObservation.model_validate_json(json.dumps(answer)) == DroneObservation.of(started("hard", 7))


@pytest.mark.feature("E5")
def test_e5_actions_observations_and_states_are_models() -> None:
    """DroneAction, DroneObservation and DroneState are Pydantic models; a state has the path_history"""
    episode = started("easy_delivery", 14)
    action = DroneAction(direction="LEFT")
    episode.step(action.action)
    state = DroneState.of(episode)
    (point,) = state.path_history
    assert (point.action, point.x, point.y, point.reward) == ("LEFT", 5, 3, 0.15)
    for message in (action, state, DroneObservation.of(episode)):
        assert isinstance(message, BaseModel)
        assert type(message).model_validate_json(message.model_dump_json()) == message
    with pytest.raises(ValidationError, match="direction"):
        DroneAction.model_validate({"direction": "SIDEWAYS"})


@pytest.mark.feature("E6")
@pytest.mark.parametrize("name", TIERED)
def test_e6_three_tasks_with_their_numbers(name: str) -> None:
    """Three tasks, easy_delivery, medium_delivery and hard_delivery, with the numbers of the specification"""
    task = TASKS[name]
    deliveries, side, terrain, steps, r_delivery, r_other = TIERED[name]
    assert tasks.TASKS is TASKS
    assert (task.width, task.height, task.deliveries) == (side, side, deliveries)
    assert (task.buildings, task.trees, task.obstacles) == terrain
    assert (task.max_steps, task.battery_capacity, task.r_delivery) == (steps, steps, r_delivery)
    others = {task.r_step, task.r_wait, task.r_building, task.r_tree, task.r_obstacle}
    assert others | {task.r_battery_dead, task.r_wall, task.r_blocked} == {r_other}


@pytest.mark.feature("E7")
def test_e7_rewards_add_up_and_are_clamped() -> None:
    """A step pays base + 0.05 per cell nearer to the target, between 0.01 and 0.99; profiles tiered and composite"""
    # Map 14: the drone at (6, 3), the parcel at (5, 1), roads in between.
    paid = {
        "tiered": {"LEFT": 0.15, "RIGHT": 0.05, "WAIT": 0.10, "UP LEFT UP": 0.99},  # 0.95 + 0.05 is clamped
        "composite": {"LEFT": 0.10, "RIGHT": 0.01, "WAIT": 0.01, "UP LEFT UP": 0.99},  # so is 0.05 - 0.05
    }
    for profile, flights in paid.items():
        for flight, reward in flights.items():
            episode = started("easy_delivery", 14, profile)
            assert [episode.step(Action[name]) for name in flight.split()][-1] == reward, (profile, flight)
    medium = started("medium_delivery", 14)
    rewards = [medium.step(action) for action in solve("medium_delivery", 14).actions]
    assert rewards.count(0.95) == 3  # 0.90 + 0.05 for each parcel
    assert medium.reward_total == pytest.approx(sum(rewards))


@pytest.mark.feature("E8")
def test_e8_the_battery_drains_and_collisions_are_seen() -> None:
    """Each step drains the battery and an empty one ends the flight; buildings, trees and obstacles are noticed"""
    episode = started("easy_delivery", 14)
    for flown in range(1, 61):
        episode.step(Action.WAIT)
        assert (episode.battery_units, episode.battery) == (60 - flown, (60 - flown) / 60)
    assert (episode.outcome.name, episode.score) == ("BATTERY_DEAD", 0.01)
    city = generate_city_map("hard_delivery", 7)
    for kind, name in ((1, "BUILDING"), (2, "TREE"), (3, "OBSTACLE")):
        y, x = (city.grid == kind).nonzero()[0][0], (city.grid == kind).nonzero()[1][0]
        episode = started("hard_delivery", 7)
        right, down = int(x) - city.start[0], int(y) - city.start[1]
        moves = [Action.RIGHT if right > 0 else Action.LEFT] * abs(right)
        for move in moves + [Action.DOWN if down > 0 else Action.UP] * abs(down):
            episode.step(move)
        assert (episode.position, episode.event.name) == ((x, y), name)


@pytest.mark.feature("E9")
def test_e9_graders_score_a_state() -> None:
    """Graders easy, medium and hard score a DroneState or its dictionary, from 0.01 to 0.99, by one formula"""
    for level in ("easy", "medium", "hard"):
        task = TASKS[f"{level}_delivery"]
        grader = getattr(import_module(f"drone_env.graders.{level}"), f"grade_{level}")
        module, _, name = task.grader.partition(":")
        assert getattr(import_module(module), name) is grader is GRADERS[task.id]
        episode = started(task.id, 14)
        assert grader(DroneState.of(episode)) == 0.20  # nothing delivered: 0.2 * (0.5 * 1 + 0.5 * 1)
        for action in solve(task.id, 14).actions:
            episode.step(action)
        state = DroneState.of(episode)
        assert grader(state) == grader(state.model_dump(mode="json")) == solve(task.id, 14).score
    best, worst = started("easy_delivery", 14), started("easy_delivery", 14)
    for action in (Action.LEFT, Action.UP, Action.UP):
        best.step(action)
    for _ in range(60):
        worst.step(Action.WAIT)
    # 0.8 + 0.2 * 57 / 60 = 0.99, and 0 is clamped.
    assert [GRADERS["easy_delivery"](DroneState.of(flight)) for flight in (best, worst)] == [0.99, 0.01]


@pytest.mark.feature("E10")
def test_e10_openenvs_client_drives_it(server: Server) -> None:
    """DroneDeliveryEnvironment is an OpenEnv Environment, and OpenEnv's own client flies it"""
    from openenv.core.env_server.interfaces import Environment
    from openenv.core.generic_client import GenericEnvClient

    from drone_env.server.grid_world_environment import DroneDeliveryEnvironment

    assert issubclass(DroneDeliveryEnvironment, Environment)
    with GenericEnvClient(server.url).sync() as env:
        first = env.reset(task_name="easy_delivery", seed=14)
        assert (first.observation["drone_x"], first.observation["drone_y"], first.done) == (6, 3, False)
        results = [env.step({"direction": name}) for name in ("LEFT", "UP", "UP")]
    assert [(result.reward, result.done) for result in results] == [(0.15, False), (0.15, False), (0.99, True)]
    assert results[-1].observation["score"] == 0.99
