"""Prompts: what the model is told, and files that are none."""

import hashlib
import json
import re
from pathlib import Path

import pytest

from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.llm import prompt as prompt_module
from drone_env.llm.prompt import FOLDER, get_prompt, parse_prompt, prompt_ids, read_prompt

from .conftest import Start, verified
from .test_prompts_suffice import ODD, texts_of

SHOWN = [*TASKS.values(), *ODD]
"""The tasks of the package, and some with rules that none of those has."""
GOLDEN = {
    "compass-1": "351b3949c4bb4583",
    "coordinates-2": "355c58b4cd474617",
    "grid-2": "a5e5d97e7ff9896f",
    "minimal-2": "111f4be1ee1584f5",
    "plan-2": "458cb8ee7f1beb94",
    "think-1": "6a1e217719c26e36",
    "think-plan-1": "d7e663d4b716d17a",
    "short-1": "611d67f55862e59a",
    "stops-1": "d49a0e5c7466c2ba",
    "fly-4": "52214653476f80a4",
    "route-2": "00c4acc4f33536f5",
}


OWN = """
format = 1
plan = false
marks = ["MOVE:"]
system = '{% include "rules-2.j2" %}'
user = '{% include "drone-2.j2" %}'
repair = "{{ reason }}"
"""


def test_published_prompts_stay_as_they_were_to_the_byte() -> None:
    """A planner that read nothing else flew the optimum by them; a changed prompt is a new version."""
    shown: dict[str, str] = {}
    for prompt in [*map(get_prompt, prompt_ids()), *map(read_prompt, sorted(FOLDER.glob("tools/*")))]:
        texts: list[str] = []
        for task in SHOWN:
            episode = Episode(task, seed=7)
            texts += texts_of(prompt, episode)
            episode.fly([3, 1, 1, 2])
            texts += texts_of(prompt, episode)
        shown[prompt.id] = hashlib.sha256("\n\n".join(texts).encode()).hexdigest()[:16]
    assert shown == GOLDEN


def test_the_digest_covers_the_parts_that_a_prompt_includes_and_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = {"a.j2": '{% include "b.j2" %}', "b.j2": "{{ x }}", "c.j2": "{{ y }}"}
    text = "format = 1\nplan = false\nuser = '{% include \"a.j2\" %}'\nrepair = ''"

    def digest(**changed: str) -> str:
        now = {**parts, **{f"{name}.j2": part for name, part in changed.items()}}
        monkeypatch.setattr(prompt_module, "_parts", lambda: now)
        return parse_prompt.__wrapped__("mine.toml", text, own=False).digest

    assert digest(c="{{ step }}", d="{{ x }}") == digest()
    assert len({digest(), digest(a='{% include "b.j2" %}.'), digest(b="{{ y }}")}) == 3


def test_prompts_that_are_none_are_named(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"allowed: FILE\.toml, compass"):
        get_prompt("poem")
    path = tmp_path / "mine.toml"
    rest = '\nplan = false\nsystem = ""\nuser = "{{ weather }}"\nrepair = ""'
    for text, why in [
        ("plan = ", "mine.toml: "),
        ("plan = 1", "mine.toml is not a prompt: format: Field required; plan: Input should be a valid boolean"),
        ("format = 2" + rest, "format: Input should be 1"),
        ("format = 1" + rest, "prompt mine cannot be rendered: 'weather' is undefined; values: x, y, battery_percent"),
        ("format = 1" + rest.replace("}}", ""), "unexpected end of template"),
        ('format = 1\nmarks = ["ACTION"]' + rest.replace("weather", "x"), r"marks\.0: String should match pattern"),
        (
            "format = 1" + rest.replace("weather", "x").replace('system = ""', "system = '{% include \"more.j2\" %}'"),
            r"cannot be rendered: more\.j2;",
        ),
        ("format = 1" + rest.replace("weather", "x").replace('""', '"{{ x }}"'), "'x' is undefined; values: reason"),
    ]:
        path.write_text(text)
        with pytest.raises(InvalidValueError, match=why):
            get_prompt(str(path))


@pytest.mark.parametrize("template", ["{{ task.__class__.__mro__ }}", "{{ 1 // 0 }}"])
def test_a_template_that_cannot_be_filled_in_or_reaches_out_is_told(tmp_path: Path, template: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'format = 1\nplan = false\nsystem = ""\nuser = "{template}"\nrepair = ""')
    with pytest.raises(InvalidValueError, match="prompt mine cannot be rendered: "):
        read_prompt(path)


def test_without_a_system_text_there_is_no_system_message(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("format = 1\r\nplan = false\r\nuser = '{{ x }} {{ steps_left }}'\r\nrepair = '{{ reason }}'\r\n")
    assert read_prompt(path).messages(Episode("easy", seed=14)) == [{"role": "user", "content": "6 60"}]


@pytest.mark.feature("I3")
def test_the_prompt_asks_for_one_word_and_tells_the_state() -> None:
    system, user = (message["content"] for message in get_prompt("minimal").messages(Episode("easy", seed=14)))
    for told in ("delivery drone", "Goal: deliver as many parcels as you can", "exactly one", "in uppercase"):
        assert told in system
    assert re.findall(r"\b[A-Z]{2,}\b", system) == ["UP", "DOWN", "LEFT", "RIGHT", "WAIT"]
    assert user.startswith("Position: (6, 3)\nBattery: 100% (60 units)\nTarget: (5, 1)\n")


def test_a_prompt_of_ones_own_goes_into_the_run(endpoint: Start) -> None:
    scripted = endpoint(pilot="MOVE: LEFT")
    mine = scripted.folder / "mine.toml"
    mine.write_text(OWN)
    first = scripted.infer("--seeds", "14:15", "--prompt", str(mine), "--max-calls", "2")
    assert (first.turns, first.status) == ({"ok": 2, "budget_stop": 1}, 3), first.err
    config = json.loads((first.folder / "run.json").read_text())
    assert (config["prompt"], config["prompt_text"]) == ("mine", OWN)
    assert scripted.requests()[0]["body"]["messages"][0]["content"].startswith("The grid is 10 x 10:")
    # Another text is another run.
    mine.write_text(OWN.replace("{{ reason }}", "Again!"))
    again = ("--seeds", "14:15", "--resume", "--max-calls", "5")
    refused = scripted.infer(*again, "--prompt", str(mine), folder=first.folder)
    assert (refused.status, "prompt_digest: " in refused.err) == (2, True)
    mine.write_text(OWN)
    resumed = scripted.infer(*again, "--prompt", str(mine), folder=first.folder)
    assert resumed.turns == {"ok": 5, "budget_stop": 1}
    verified(resumed)
