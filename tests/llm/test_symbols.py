"""Names that are drawn for each map: which they are, where they stand, and that nothing else is an answer."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.llm.answers import Answer
from drone_env.llm.config import request_bodies
from drone_env.llm.content import PLAIN_LETTERS, draw_symbols
from drone_env.llm.prompt import Prompt, first_texts, get_prompt, prompt_ids, read_prompt, repair_text
from drone_env.planning.optimal import solve

from .conftest import Endpoint
from .kept_run import run_config
from .log_lines import verified

Start = Callable[..., Endpoint]
EASY = get_task("easy")
DRAWN = [get_prompt(name) for name in prompt_ids() if get_prompt(name).symbols]
PLAINLY = r"\b(UP|DOWN|LEFT|RIGHT|WAIT|(?i:parcel|road|building|tree|obstacle|pad)s?)\b"


def test_the_names_of_a_map_are_always_the_same() -> None:
    """Runs are checked and gone on with by them: whoever changes them makes old runs unreadable."""
    symbols = draw_symbols(get_task("skyline_hard"), 7)
    assert " ".join(symbols.names.values()) == "PRULU FLUDO SKOZA PLEMI KLEBA druti stufi zwelu truvo vlafi freza"
    assert "".join(symbols.letters.values()) == "NWAFEMJ?V"


def test_no_two_are_alike() -> None:
    seen: set[tuple[str, ...]] = set()
    for seed in range(200):
        symbols = draw_symbols(EASY, seed)
        names = [name.upper() for name in symbols.names.values()]
        assert len({name[:3] for name in names}) == len(names) == 11
        assert list(symbols.actions) == names[:5]
        letters = [letter for kind, letter in symbols.letters.items() if kind != "unknown"]
        assert len({*letters}) == len(letters) == 8
        assert not {*letters} & {*"".join(PLAIN_LETTERS.values()).upper()}
        seen.add(tuple(names))
    assert len(seen) == 200


@pytest.mark.parametrize("prompt", DRAWN, ids=lambda prompt: prompt.id)
@pytest.mark.parametrize("task", ["easy", "skyline_hard"])
def test_no_plain_name_is_left_in_a_prompt(prompt: Prompt, task: str) -> None:
    episode = Episode(task, seed=7)
    history = [f"1. RIGHT -> (1, 2). {said}" for said in ("Above an obstacle.", "Above a tree.", "On the way.")]
    system, user = first_texts(prompt, episode, history)
    repaired = repair_text(prompt, "the answer is not one action", prompt.symbols_of(episode.task, 7))
    assert not re.findall(PLAINLY, "\n".join((system, user, repaired)))
    names = draw_symbols(episode.task, 7).names
    assert f"1. {names['RIGHT']} -> (1, 2). Above a {names['obstacle']}.\n" in user


def test_answers_are_read_by_drawn_names_alone() -> None:
    up, other = (next(iter(draw_symbols(EASY, seed).actions)) for seed in (14, 15))
    for text in (f" {up.lower()}.\n", f'{{"action": "{up}"}}', f"```{up}```"):
        assert DRAWN[0].read(Answer(text=text), EASY, 14).actions == (Action.UP,)
    for text in ("UP", "right", "TREE", other):
        assert DRAWN[0].read(Answer(text=text), EASY, 14).kind == "illegal"


def test_a_model_flies_by_drawn_names_and_the_run_keeps_them(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    done = scripted.infer("--seeds", "14:16", "--prompt", "minimal-drawn", "--history", "2")
    assert (done.status, set(done.turns)) == (0, {"ok"}), done.err
    for seed, flight in zip((14, 15), done.flights, strict=True):
        assert (flight["score"], flight["names"]) == (solve("easy", seed).score, dict(draw_symbols(EASY, seed).names))
    assert not {call["answer"]["text"] for call in done.calls} & {*Action.__members__}
    verified(done)


def test_who_answers_by_heart_is_asked_again_and_waits(endpoint: Start) -> None:
    done = endpoint(pilot="UP").infer("--seeds", "14:15", "--prompt", "minimal-drawn", "--max-calls", "2")
    assert done.turns == {"illegal": 1, "budget_stop": 1}
    names = draw_symbols(EASY, 14).names
    _, _, said, again = done.calls[1]["messages"]
    assert said == {"role": "assistant", "content": "UP"}
    words = ", ".join(names[action.name] for action in Action).replace(f", {names['WAIT']}", f" or {names['WAIT']}")
    why = "That answer could not be used: 'UP' is not an action. Answer with exactly one word:"
    assert again["content"] == f"{why} {words}."


@pytest.mark.parametrize("form", ["json", "tool"])
def test_no_form_of_answers_names_an_action_plainly(form: str) -> None:
    (body,) = request_bodies(run_config(prompt="minimal-drawn", answers=form))
    assert not re.findall(PLAINLY, json.dumps(body))
    (plain,) = request_bodies(run_config(answers=form))
    assert '["UP", "DOWN", "LEFT", "RIGHT", "WAIT"]' in json.dumps(plain)


def test_a_prompt_of_ones_own_may_draw_its_names(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'format = 1\nplan = true\nsymbols = "drawn"\nsystem = \'Trees! Say {"actions": ["RIGHT", "UP"]}\'\n'
        'user = "An obstacle, {{ buildings }} and a pad; upright, Up."\nrepair = "Say UP: {{ reason }}"'
    )
    prompt, episode = read_prompt(path), Episode("easy", seed=14)
    of = prompt.symbols_of(episode.task, 14).names
    system, user = first_texts(prompt, episode)
    assert system.endswith(f'.\n{of["tree"].capitalize()}s! Say {{"actions": ["{of["RIGHT"]}", "{of["UP"]}"]}}')
    assert user.startswith(f"A {of['obstacle']}, (")
    assert user.endswith(f" and a {of['pad']}; upright, Up.")
