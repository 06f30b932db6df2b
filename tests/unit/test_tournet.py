"""The tour network: the same in PyTorch and in NumPy, what it sees, and the agent that flies by it."""

from pathlib import Path

import numpy as np
import pytest
import torch

from drone_env.agents.tour_features import FeatureEncoder, Features
from drone_env.agents.tour_network import load_tour_network
from drone_env.agents.tournet import best_options
from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.errors import CheckpointError, InvalidValueError
from drone_env.planning.legs import LegSolver
from drone_env.rl.model import TourNet
from tests.toy import toy_episode
from tests.unit.tour_features import EVERY_TASK, HARD, encoded, features_of, observations


@pytest.fixture(scope="module")
def model(network: Path) -> TourNet:
    """The network in PyTorch."""
    model = TourNet()
    weights = load_tour_network(network).parameters
    model.load_state_dict({name: torch.from_numpy(array) for name, array in weights.items()})
    return model


# The network


@pytest.mark.parametrize("name", ["medium_delivery", "skyline_hard", "16 parcels, 20 pads"])
def test_the_network_without_torch_is_the_same(name: str, model: TourNet, network: Path) -> None:
    features = encoded(FeatureEncoder(EVERY_TASK[name]), *observations(EVERY_TASK[name], 6, 30))
    choices, completions = load_tour_network(network)(features)
    owner = torch.from_numpy(np.repeat(np.arange(len(features.tokens)), np.diff(features.begins)))
    arrays = (torch.from_numpy(array) for array in (features.tokens, features.present, features.edges))
    with torch.no_grad():
        options = owner, torch.from_numpy(features.token).long(), torch.from_numpy(features.options)
        preference, completion = model(*arrays, *options)
        choice = preference + 2 * torch.nn.functional.logsigmoid(completion)
    assert len(choices) > 20
    assert np.abs(choices - choice.numpy()).max() < 1e-5
    assert np.abs(completions - completion.numpy()).max() < 1e-5


# What it sees


def test_the_options_on_a_map_that_is_drawn_by_hand() -> None:
    """Over the building to parcel 0 in 2 steps for 6 units, around it in 4 for 4: both are worth flying."""
    episode = toy_episode(
        ["@B0.", "..PO", "TTT1"], max_steps=50, battery_capacity=12, charge_rate=4,
        drain=((Cell.BUILDING, 5), (Cell.TREE, 2)), impassable=frozenset({Cell.OBSTACLE}),
    )  # fmt: skip
    encoder = FeatureEncoder(episode.task)

    def seen() -> list[tuple[int, ...]]:
        features = features_of(encoder, episode.observation())
        return [
            (int(token), *numbers) for token, numbers in zip(features.token, features.numbers.tolist(), strict=True)
        ]

    down, right = Action.DOWN, Action.RIGHT
    # (token, units, steps, first action); tokens are 1 and 2 for the parcels, 3 for the pad.
    assert seen() == [(1, 6, 2, right), (1, 4, 4, down), (2, 6, 5, down), (3, 3, 3, down)]
    episode.fly([down, right, right])
    assert seen() == [(1, 1, 1, Action.UP), (2, 3, 2, down), (3, -3, 1, Action.WAIT)]
    episode.step(Action.WAIT)
    # Full: no charge. The parcel at the top hides nothing behind it, since it would be delivered there.
    assert seen() == [(1, 1, 1, Action.UP), (2, 3, 2, down)]


def test_a_parcel_that_waits_ends_a_way() -> None:
    """The second parcel lies behind the first: nobody can fly there without delivering that."""
    episode = toy_episode(["@0.1", "OOOO"], max_steps=50, impassable=frozenset({Cell.OBSTACLE}))
    encoder = FeatureEncoder(episode.task)
    assert features_of(encoder, episode.observation()).numbers.tolist() == [[1, 1, Action.RIGHT]]
    episode.step(Action.RIGHT)
    assert features_of(encoder, episode.observation()).numbers.tolist() == [[2, 2, Action.RIGHT]]


@pytest.mark.parametrize("name", ["medium_delivery", "skyline_easy"])
def test_the_optimum_can_be_flown_by_the_options_that_are_offered(name: str) -> None:
    """Whatever the best option is, by the exact value of where its first step leads."""
    task = TASKS[name]
    encoder = FeatureEncoder(task)
    for seed in range(2):
        episode = Episode(task, seed=seed)
        solver = LegSolver(episode)
        optimum = solver.value(episode)
        while not episode.ended:
            values = solver.q_values(episode)
            offered = features_of(encoder, episode.observation()).numbers[:, 2]
            if not len(offered):  # nothing can be won any more
                break
            episode.step(max(offered, key=lambda action: values[action]))
        assert episode.score == optimum


def test_an_observation_of_no_map_of_the_task_is_refused() -> None:
    grids, telemetry = observations(HARD, 2, 1)
    for kind in (Cell.PAD, Cell.DELIVERY):
        with pytest.raises(InvalidValueError, match="more parcels or pads than"):
            encoded(FeatureEncoder(HARD), np.full_like(grids, kind), telemetry)
    for place, amount, why in ((0, 1.5, "outside the grid"), (2, 1.5, "battery or steps")):
        wrong = telemetry.copy()
        wrong[1, place] = amount
        with pytest.raises(InvalidValueError, match=why):
            encoded(FeatureEncoder(HARD), grids, wrong)


# The agent


def test_the_first_of_the_highest_is_chosen() -> None:
    empty = np.zeros(0, np.float32)
    features = Features(empty, empty, empty, np.array([0, 2, 2, 5]), empty, empty, empty)
    assert best_options(features, np.array([1, 2, 3, 3.00001, 1], np.float32)).tolist() == [1, -1, 2]
    assert best_options(features._replace(begins=np.zeros(3, np.int64)), empty).tolist() == [-1, -1]
    with pytest.raises(CheckpointError, match="returned NaN or infinity"):
        best_options(features, np.array([np.nan, 0, 1, 0, 0], np.float32))
