"""Prompts: what the model is told, and files that are none."""

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.llm.content import VALUES
from drone_env.llm.prompt import FOLDER, first_messages, first_texts, get_prompt, prompt_ids, read_prompt, text_of_file
from drone_env.planning.optimal import solve
from tests.tools import missing_tool

from .conftest import ROOT, Endpoint


def test_a_checkout_with_other_ends_of_lines_has_the_same_prompts(tmp_path: Path) -> None:
    for file in [*FOLDER.rglob("*.toml"), *FOLDER.rglob("*.j2")]:
        copy = tmp_path / file.name
        copy.write_bytes(file.read_bytes().replace(b"\n", b"\r\n"))
        assert text_of_file(copy) == text_of_file(file)
    written = ["-c", "core.autocrlf=true", "checkout-index", f"--prefix={tmp_path}/", "README.md"]
    done = subprocess.run(["git", *written], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        missing_tool("a git checkout")
    assert b"\r\n" not in (tmp_path / "README.md").read_bytes()


def test_where_terrain_matters_every_prompt_tells_what_lies_below_the_drone() -> None:
    prompts = [*map(get_prompt, prompt_ids()), *map(read_prompt, sorted(FOLDER.glob("tools/*")))]
    episode, told = Episode("skyline_easy", seed=0), set[str]()
    for action in solve("skyline_easy", 0).actions:
        kind = CELL_KINDS[Cell(episode.under)].name
        below = f"Below the drone: {'charging pad' if kind == 'pad' else kind}"
        for prompt in prompts:
            _, user = first_texts(prompt, episode)
            assert user.splitlines()[-1] == prompt.symbols_of(episode.task, 0).rename(below)
        told.add(below)
        episode.step(action)
    assert len(told) > 1
    assert not any("Below" in first_texts(prompt, Episode("hard", seed=7))[1] for prompt in prompts)


def test_prompts_that_are_none_are_named(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"allowed: FILE\.toml, coordinates"):
        get_prompt("poem")
    path = tmp_path / "mine.toml"
    rest = '\nplan = false\nsystem = ""\nuser = "{{ weather }}"\nrepair = ""'
    for text, why in [
        ("plan = ", "mine.toml: "),
        (
            "plan = 1",
            "mine.toml is not a prompt: format: Field required; plan: Input should be a valid boolean; system: ",
        ),
        ("format = 2" + rest, "format: Input should be 1"),
        (rest, "format: Field required"),
        ("format = 1" + rest, "user: unknown 'weather'; there are battery_percent, battery_steps, "),
        ("format = 1" + rest.replace("}}", ""), "user: unexpected end of template"),
        ('format = 1\nmarks = ["ACTION"]' + rest.replace("weather", "x"), r"marks\.0: String should match pattern"),
        ('format = 1\nsymbols = "names"' + rest, "symbols: Input should be 'drawn'"),
        ("format = 1\npicture = 100" + rest, "picture: Input should be greater than or equal to 256"),
        ('format = 1\nsymbols = "drawn"\npicture = 512' + rest.replace("weather", "x"), "give symbols without picture"),
        ('format = 1\nsymbols = "drawn"' + rest.replace("weather", "grid"), r"\{\{ legend \}\} says what they are"),
        ("format = 1" + rest.replace('system = ""', "system = '{% include \"more.j2\" %}'"), r"unknown 'more\.j2'"),
    ]:
        path.write_text(text)
        with pytest.raises(InvalidValueError, match=why):
            get_prompt(str(path))
    (tmp_path / "grid-2.toml").write_text("format = 1" + rest)
    with pytest.raises(InvalidValueError, match=r"grid-2\.toml: the package has a prompt of this name"):
        read_prompt(tmp_path / "grid-2.toml")


@pytest.mark.parametrize("template", ["{{ task.__class__.__mro__ }}", "{{ 1 // 0 }}", "{{ task.weather }}"])
def test_a_template_that_cannot_be_filled_in_or_reaches_out_is_told(tmp_path: Path, template: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'format = 1\nplan = false\nsystem = ""\nuser = "{template}"\nrepair = ""')
    episode = Episode("easy")
    episode.reset(14)
    with pytest.raises(InvalidValueError, match="prompt mine cannot be filled in: "):
        first_messages(read_prompt(path), episode)


def test_a_template_may_name_every_value_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    told = "; ".join(f"{name}={{{{ {name} }}}}" for name in sorted(VALUES))
    path.write_text(f"format = 1\nplan = false\nsystem = '{told}'\nuser = '{told}'\nrepair = '{{{{ reason }}}}'\n")
    episode = Episode("easy")
    episode.reset(14)
    for text in first_texts(read_prompt(path), episode):
        filled = dict(part.partition("=")[::2] for part in text.split("; "))
        assert filled.keys() == VALUES
        assert (filled["x"], filled["y"], filled["steps_left"], filled["history"]) == ("6", "3", "60", "")
    path.write_text(path.read_text().replace("{{ reason }}", "{{ x }}"))
    with pytest.raises(InvalidValueError, match=r"repair: unknown 'x'; there are .*reason, rules-2.j2"):
        read_prompt(path)


@pytest.mark.feature("I3")
def test_the_prompt_asks_for_one_word(endpoint: Callable[..., Endpoint]) -> None:
    scripted = endpoint(pilot="greedy")
    done = scripted.infer("--task", "easy", "--seeds", "14:15")
    assert done.status == 0
    (system, user), (_, later) = [request["body"]["messages"] for request in scripted.requests()][:2]
    assert (system["role"], user["role"]) == ("system", "user")
    for told in ("delivery drone", "Goal: deliver every parcel", "exactly one", "in uppercase"):
        assert told in system["content"]
    assert re.findall(r"\b[A-Z]{2,}\b", system["content"]) == ["UP", "DOWN", "LEFT", "RIGHT", "WAIT"]
    assert user["content"].split("\n") == [
        "Position: (6, 3)",
        "Battery: 100% (60 units)",
        "Target: (5, 1)",
        "Distance: 3",
        "Step: 0 of 60",
    ]
    assert "does not tell" not in done.err
    assert later["content"].startswith("Position: (5, 3)\nBattery: 98% (59 units)\n")


def test_so_many_of_the_last_steps_are_told(endpoint: Callable[..., Endpoint]) -> None:
    scripted = endpoint(pilot="greedy")
    assert scripted.infer("--seeds", "14:15", "--history", "1").status == 0
    users = [request["body"]["messages"][1]["content"] for request in scripted.requests()]
    assert ["Last steps:" in user for user in users] == [False, True, True]
    assert users[2].endswith("Last steps:\n2. UP -> (5, 2). On the way.")
