"""Pictures and text."""

import unicodedata
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from drone_env.agents import make_agent
from drone_env.core.cells import CELL_KINDS, TARGET, Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs import rendering
from drone_env.envs.ansi import ROAD, WAY, draw_text, draw_tour
from drone_env.envs.rendering import draw_picture
from tests.toy import toy_episode

EASY = get_task("easy")
HARD = get_task("hard")
SMALLEST = replace(EASY, id="smallest", width=2, height=2, buildings=1, trees=0, obstacles=1)
LARGEST = replace(
    HARD, id="largest", width=64, height=64, buildings=900, trees=500, obstacles=300, deliveries=16, pads=20
)
WIDEST = replace(HARD, id="widest", width=64, height=2)
TALLEST = replace(HARD, id="tallest", width=2, height=64)

Picture = npt.NDArray[np.uint8]


def fly(episode: Episode, steps: int = 1000) -> Episode:
    """Fly towards the target until the end, at most so many steps."""
    agent = make_agent("greedy", episode.task)
    for _ in range(steps):
        if not episode.ended:
            episode.step(agent.act(episode.observation()))
    return episode


def count(picture: Picture, colour: str) -> int:
    """How many pixels have exactly this colour of the palette."""
    return int((picture == np.frombuffer(bytes.fromhex(rendering.PALETTE[colour][1:]), np.uint8)).all(axis=2).sum())


class TestPicture:
    @pytest.mark.parametrize(
        ("task", "size"),
        [(EASY, 241), *((task, 96) for task in (SMALLEST, LARGEST, WIDEST, TALLEST))],
        ids=lambda value: getattr(value, "id", value),
    )
    def test_shape_and_type(self, task: TaskConfig, size: int) -> None:
        picture = draw_picture(Episode(task, seed=7), size)
        height, width, channels = picture.shape
        assert (height, channels) == (size, 3)
        assert width % 2 == 0
        assert picture.dtype == np.uint8
        assert width < 2.6 * size

    def test_target_is_marked_and_only_while_there_is_one(self) -> None:
        episode = Episode(seed=7)
        assert count(draw_picture(episode), "target") > 300
        assert fly(episode).success
        marks = count(draw_picture(episode), "target")
        assert marks < 150, "only the lamps of the drone have this colour"


def columns(text: str) -> int:
    """How many columns a terminal gives to a text."""
    return sum(2 if unicodedata.east_asian_width(letter) in "WF" else 1 for letter in text)


class TestText:
    @pytest.mark.parametrize("steps", [9, 1000])
    def test_rows_hold_what_the_episode_holds(self, steps: int) -> None:
        episode = fly(Episode(LARGEST, seed=7), steps)
        lines = draw_text(episode).split("\n")[:64]
        assert {columns(line) for line in lines} == {2 * 64}
        rows = "".join(lines)
        grid = episode.grid()
        for cell in (Cell.BUILDING, Cell.TREE, Cell.OBSTACLE, Cell.DELIVERED, Cell.PAD, Cell.DRONE):
            assert rows.count(CELL_KINDS[cell].emoji) == (grid == cell).sum(), cell.name
        assert rows.count(ROAD) == (grid == Cell.ROAD).sum()
        targets = int(episode.target is not None)
        assert rows.count(TARGET) == targets
        assert rows.count(CELL_KINDS[Cell.DELIVERY].emoji) == (grid == Cell.DELIVERY).sum() - targets

    def test_a_tour_is_drawn_over_roads_and_its_stops_are_numbered(self) -> None:
        episode = toy_episode(["@.B", "0.1"])
        passed = [(1, 0), (2, 0), (1, 1)]
        assert draw_tour(episode, passed, [(2, 1), (0, 1)]) == f"🚁{WAY}🏢\n2 {WAY}1 "


def test_whose_data_a_city_is_stands_below_it() -> None:
    task = get_task("city")
    assert task.terrain
    said = draw_picture(Episode(task, seed=7), 360)
    unsaid = draw_picture(Episode(replace(task, terrain=replace(task.terrain, attribution="")), seed=7), 360)
    layout = rendering._layout(task, 360)
    rows, _, _ = np.nonzero(said != unsaid)
    assert rows.min() >= layout.top + task.height * layout.cell
    assert rows.max() > rows.min() + 3
