"""Prompts tell all that decides a flight: it is read from them alone, and who sees no more flies the optimum."""

import os
from dataclasses import replace

import pytest

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.rules import score_of
from drone_env.core.seeds import split_seeds
from drone_env.core.tables import interpreted
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.llm.answers import Answer, read_answer
from drone_env.llm.content import with_pictures
from drone_env.llm.prompt import FOLDER, Prompt, first_messages, get_prompt, prompt_ids, read_prompt, untold
from drone_env.planning.optimal import solve, solver_of
from tests.which_tasks import DRAWN, SMALL

from .prompt_reader import NotToldError, Told, read_text

TOLD = [get_prompt(name) for name in prompt_ids() if name != "original-1"] + [
    read_prompt(FOLDER / "tools" / "fly-2.toml")
]
EASY, SKYLINE = TASKS["easy_delivery"], TASKS["skyline_easy"]
ODD = [
    replace(EASY, battery_capacity=25, width=9),
    replace(EASY, efficiency_needs_all=True, deliveries=2),
    replace(EASY, impassable=frozenset({Cell.TREE, Cell.BUILDING})),
    replace(EASY, drain=((Cell.ROAD, 2), (Cell.OBSTACLE, 0), (Cell.TREE, 1))),
    replace(EASY, pads=3, drain=((Cell.PAD, 4),)),
    replace(EASY, pads=3, charge_rate=7),
    replace(SKYLINE, drain=((Cell.DELIVERY, 3), (Cell.PAD, 2)), efficiency_needs_all=False),
]
"""Tasks of one's own, with rules that none of ours has."""
TEXTS = [prompt for prompt in TOLD if not prompt.picture]
SHORT = [prompt.id for prompt in TOLD if prompt.id.startswith("minimal-")]
"""They tell no terrain that decides nothing."""
THOROUGH = int(os.environ.get("DRONE_ENV_LLM_MAPS", "0")) >= 100
UNSEEN = {
    *{"id", "short_name", "grader", "version"},  # names
    *{name for name in EASY.rules() if name.startswith("r_")},  # what learners are paid is no part of the score
    "street_spacing",  # how maps are drawn: the map itself is there to be seen
}
"""What decides no flight over a map that is told."""


def rules_of(task: TaskConfig, terrain: bool) -> dict[str, object]:
    """All numbers and rules of a task that decide its flights, and how much terrain there is that decides none."""
    drain = {kind: units for kind, units in task.drain if units != 1}
    deciding = task.impassable | drain.keys() | ({Cell.PAD} if task.charge_rate else set())
    counts = {
        f"{kind.name.lower()}s": n if terrain or kind in deciding else 0 for kind, n in task.cell_counts().items()
    }
    rules = task.rules() | counts | {"drain": drain}
    return {name: value for name, value in rules.items() if name not in UNSEEN}


def told_by(prompt: Prompt, episode: Episode) -> Told:
    """What is read from a prompt as it is sent."""
    names = {drawn: plain for plain, drawn in prompt.symbols_of(episode.task, episode.seed).names.items()}
    return read_text(with_pictures(first_messages(prompt, episode))[0], names)


@pytest.mark.parametrize("task", [*DRAWN.values(), *ODD], ids=lambda task: task.short_name)
@pytest.mark.parametrize("prompt", TEXTS, ids=lambda prompt: prompt.id)
def test_every_number_and_rule_of_a_task_is_read_from_the_prompt_alone(prompt: Prompt, task: TaskConfig) -> None:
    told = told_by(prompt, Episode(task, seed=3))
    assert rules_of(told.task, True) == rules_of(task, terrain=prompt.id not in SHORT)
    for delivered in range(task.deliveries + 1):
        for battery, steps in (
            (0, task.max_steps),
            (1, 7),
            (task.battery_capacity // 2, 20),
            (task.battery_capacity, 1),
        ):
            score = score_of(interpreted(task), delivered, battery, steps)
            assert told.score(delivered, battery, steps) == pytest.approx(score, abs=1e-12)
    assert untold(prompt, task) == []


def flown_by_reading(prompt: Prompt, task: str, seed: int) -> float:
    """The score of a planner that is told one prompt after another, or a single one that asks for the route."""
    episode = Episode(task, seed=seed)
    words = prompt.symbols_of(episode.task, seed).actions
    while not episode.ended:
        told = told_by(prompt, episode)
        flight, says = told.episode, []
        solver = solver_of(flight)
        while not flight.ended and (prompt.plan or not says):
            action = solver.optimal_actions(flight)[0]
            flight.step(action)
            says.append(told.words[Action(action)])
        for action in read_answer(Answer(text=" ".join(says)), prompt.plan, prompt.marks, words).actions:
            episode.step(action)
    return episode.score


@pytest.mark.parametrize("task", [task.short_name for task in SMALL.values()])
@pytest.mark.parametrize("prompt", TEXTS, ids=lambda prompt: prompt.id)
def test_who_sees_nothing_but_the_text_flies_the_optimum(prompt: Prompt, task: str) -> None:
    for seed in split_seeds("test", 1):
        assert flown_by_reading(prompt, task, seed) == solve(task, seed).score


@pytest.mark.parametrize("task", [task.short_name for task in SMALL.values()])
def test_the_map_can_be_rebuilt_from_its_picture(task: str) -> None:
    seed = split_seeds("test", 1)[0]
    prompt, episode, actions = get_prompt("vision"), Episode(task, seed=seed), solve(task, seed).actions
    assert untold(prompt, episode.task) == []
    for step, action in enumerate(actions):
        if step in (0, len(actions) // 2, len(actions) - 1):
            told = told_by(prompt, episode)
            # Later the drone hides what it flies over; a window shows a part of what there is in all.
            if step == 0 and episode.task.terrain is None:
                assert rules_of(told.task, True) == rules_of(episode.task, True)
            assert told.episode.grid().tolist() == episode.grid().tolist()
        episode.step(action)
    assert episode.success


@pytest.mark.long
@pytest.mark.parametrize("task", [task.short_name for task in DRAWN.values()])
@pytest.mark.parametrize("prompt", TOLD, ids=lambda prompt: prompt.id)
def test_who_sees_nothing_but_the_prompt_flies_the_optimum_of_many_maps(prompt: Prompt, task: str) -> None:
    maps = 100 if prompt.id in SHORT else 4 if prompt.picture else 20
    for seed in split_seeds("test", maps if THOROUGH else maps // 4):
        assert flown_by_reading(prompt, task, seed) == solve(task, seed).score


def test_the_original_prompt_does_not_tell_enough_on_skyline() -> None:
    prompt, episode = get_prompt("original"), Episode("skyline_easy", seed=0)
    assert untold(prompt, episode.task) == [
        *("the score and what ends a flight", "the steps taken", "all parcels"),
        *("buildings", "trees", "obstacles", "charging pads"),
    ]
    with pytest.raises(NotToldError, match="score"):
        told_by(prompt, episode)
