"""Answers, prompts, settings and limits by themselves."""

import asyncio
import re
from pathlib import Path

import pytest

from drone_env.cli import main
from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TASKS
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.llm.answers import Answer, read_answer
from drone_env.llm.concurrency import AdaptiveGate
from drone_env.llm.config import RunConfig, Sampling
from drone_env.llm.prompt import VALUES, Flown, first_messages, get_prompt, prompt_ids, read_prompt
from drone_env.llm.settings import InferenceSettings, load_settings, token_for
from drone_env.models import DroneObservation


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("UP", "ok"),
        (" up \n", "ok"),
        ("`LEFT`", "ok"),
        ('"WAIT".', "ok"),
        ('{"direction": "DOWN"}', "ok"),
        ("```\nRIGHT\n```", "ok"),
        ("```text\nRIGHT\n```", "ok"),
        ('```json{"action": "UP"}```', "ok"),
        ("```RIGHT```", "ok"),
        ("```", "parse_error"),
        ("```json" + " \n" * 10_000 + "x y```", "parse_error"),
        ("```json" + " \n" * 10_000 + "x", "parse_error"),
        ("reasoned in the prompt's own block</think>\n\nRIGHT", "ok"),
        ("UP UP", "parse_error"),
        ("UP or DOWN", "parse_error"),
        ("Not UP, but DOWN.", "parse_error"),
        ('{"action": "UP", "then": "DOWN"}', "parse_error"),
        ('{"action": ["UP"]}', "parse_error"),
        ('{"action": "UP"', "parse_error"),
        ("[" * 100_000, "parse_error"),
        ("0", "parse_error"),
        ("<think>UP", "truncated"),
        ("<think></think>", "parse_error"),
        ("Upwards", "illegal"),
        ("I can't do that.", "refusal"),
        ("I cannot do that.", "refusal"),
    ],
)
def test_one_action(text: str, kind: str) -> None:
    assert read_answer(Answer(text=text), plan=False).kind == kind


def test_half_a_character_can_be_kept() -> None:
    answer = Answer(text="UP\ud800", reasoning="\ud83d\ude81")
    assert (answer.text, answer.reasoning) == ("UP\ufffd", "\U0001f681")
    assert Answer.model_validate_json(answer.model_dump_json()) == answer


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"actions": ["RIGHT", "up"]}', [Action.RIGHT, Action.UP]),
        ('["RIGHT", "UP"]', [Action.RIGHT, Action.UP]),
        ("RIGHT, UP", [Action.RIGHT, Action.UP]),
        ("right -> up\nDOWN", [Action.RIGHT, Action.UP, Action.DOWN]),
        ("RIGHT", [Action.RIGHT]),
        ("```RIGHT UP```", [Action.RIGHT, Action.UP]),
        ("```plain RIGHT UP```", [Action.RIGHT, Action.UP]),
        ('{"actions": []}', "parse_error"),
        ('{"actions": ["RIGHT", 3]}', "parse_error"),
        ("First RIGHT, then UP!", "parse_error"),
        ('{"actions": ["RIGHT", "FORWARD"]}', "illegal"),
    ],
)
def test_a_route(text: str, expected: object) -> None:
    reading = read_answer(Answer(text=text), plan=True)
    assert (list(reading.actions) or reading.kind) == expected


def test_prompts_tell_what_the_drone_sees() -> None:
    episode = Episode("hard")
    episode.reset(7)
    observation = DroneObservation.of(episode)
    flown = [Flown("UP", 1, 2, "On the way."), Flown("LEFT", 0, 2, "On the way.")]
    x, y = episode.position
    for name in prompt_ids():
        system, user = first_messages(get_prompt(name), episode.task, observation, flown, 1)
        assert all(action.name in system["content"] for action in Action)
        assert f"Position: ({x}, {y})" in user["content"]
        assert not re.search(r"\{\w+\}", system["content"] + user["content"])
    (_, minimal), (_, lists), (_, grid) = (
        first_messages(get_prompt(name), episode.task, observation, flown, 1)
        for name in ("minimal", "coordinates", "grid")
    )
    target = episode.target
    assert target is not None
    for part in (f"Target: ({target[0]}, {target[1]})", f"Distance: {episode.distance_to_target}", "100% (160 units)"):
        assert part in minimal["content"]
    assert minimal["content"].endswith("Last steps:\n2. LEFT -> (0, 2). On the way.")
    parcels = next(line for line in lists["content"].splitlines() if line.startswith("Parcels"))
    assert sorted(re.findall(r"\((\d+), (\d+)\)", parcels)) == sorted((str(a), str(b)) for a, b, _ in episode.parcels)
    letters = "".join(line.replace(" ", "") for line in grid["content"].splitlines()[:18])
    seen = [".BTOPxD?C"[cell] for cell in episode.grid().ravel()]
    assert letters == "".join(seen)
    assert len(Cell) == 9


def test_every_task_can_be_told() -> None:
    for task in TASKS.values():
        episode = Episode(task)
        episode.reset(0)
        system, _ = first_messages(get_prompt("grid"), task, DroneObservation.of(episode), [], 0)
        assert ("charging pad adds" in system["content"]) == bool(task.pads)


def test_prompts_that_are_none_are_named(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="allowed: coordinates"):
        get_prompt("poem")
    path = tmp_path / "mine-1.toml"
    for text, why in [
        ("plan = 1", "a prompt holds"),
        ('plan = false\nsystem = "{weather}"\nuser = ""\nrepair = ""', "unknown 'weather'"),
        ("plan = ", "mine-1.toml"),
    ]:
        path.write_text(text)
        with pytest.raises(InvalidValueError, match=why):
            read_prompt(path)
    assert VALUES


HF, OTHER = "https://router.huggingface.co/v1", "https://api.openai.com/v1"


def test_more_of_the_body_can_be_sent() -> None:
    with pytest.raises(ValueError, match="surrogates not allowed"):
        Sampling(extra={"stop": "\ud800"})
    with pytest.raises(ValueError, match="'seed' is set by other means"):
        Sampling(extra={"seed": 1})


def test_an_extra_that_nests_too_deep_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["infer", "--extra", "[" * 100_000]) == 2
    assert "--extra takes a JSON object" in capsys.readouterr().err


def test_an_openai_key_does_not_go_to_hugging_face_by_another_spelling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HF_TOKEN", raising=False)
    monkeypatch.setenv("OPENAI_API_KEY", "sk-1")
    with pytest.raises(InvalidValueError, match="needs HF_TOKEN"):
        token_for(load_settings(), "https://router.huggingface.co./v1")
    monkeypatch.setenv("HF_TOKEN", 'hf_"quoted')
    with pytest.raises(InvalidValueError, match="without spaces, quotes and backslashes"):
        token_for(load_settings(), HF)


def test_the_token_is_chosen_by_the_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("HF_TOKEN", "OPENAI_API_KEY"):
        monkeypatch.delenv(name, raising=False)
    both = InferenceSettings.model_validate({"hf_token": "hf_a", "openai_api_key": "sk-b"})
    assert token_for(both, HF) == token_for(both, "https://x.hf.space/v1") == "hf_a"
    for url in (
        OTHER,
        "https://huggingface.co.evil.example/v1",
        "https://nothuggingface.co/v1",
        "http://localhost:1/v1",
    ):
        assert token_for(both, url) == "sk-b"
    none = InferenceSettings()
    assert token_for(none, "http://127.0.0.1:8000/v1") is None
    for url, name in ((HF, "HF_TOKEN"), (OTHER, "OPENAI_API_KEY")):
        with pytest.raises(InvalidValueError, match=f"needs {name}"):
            token_for(none, url)
    with pytest.raises(InvalidValueError, match="not sent unencrypted"):
        token_for(both, "http://example.com/v1")
    for url in ("ftp://x", "https://user:pass@x/v1", "x", "https://x/v1?key=1"):
        with pytest.raises(InvalidValueError, match="API_BASE_URL"):
            token_for(both, url)
    assert "hf_a" not in repr(both)


def test_settings_that_are_wrong_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DRONE_TASK", raising=False)
    (tmp_path / ".env").write_text("DRONE_TASK=\nNOT_OURS=1\nno equals sign\n")
    assert load_settings().drone_task == "easy_delivery"
    (tmp_path / ".env").write_bytes(b"DRONE_TASK=\xff\xfe")
    with pytest.raises(InvalidValueError, match=r"\.env is not UTF-8 text"):
        load_settings()
    monkeypatch.setenv("HF_TOKEN", "hf_a\u00e4b")
    (tmp_path / ".env").write_text("")
    with pytest.raises(InvalidValueError, match="HF_TOKEN must be printable ASCII"):
        token_for(load_settings(), HF)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"model": "two words"}, "no spaces"),
        ({"model": "line\u2028break"}, "no spaces"),
        ({"base_url": "ftp://x"}, "API_BASE_URL must be"),
        ({"base_url": "https://x/a\tb"}, "without anything unprintable"),
        ({"prompt": "plan-1", "prompt_digest": get_prompt("plan").digest, "history": 1}, "tells no last steps"),
        ({"seeds": (3, 3)}, "are not"),
    ],
)
def test_a_run_that_cannot_be_is_refused(change: dict[str, object], why: str) -> None:
    fields = {
        "model": "m",
        "base_url": "https://x/v1",
        "task": "easy_delivery",
        "task_version": 1,
        "split": "custom",
        "seeds": (14, 15),
        "repeats": 1,
        "reward_profile": "tiered",
        "prompt": "minimal-1",
        "prompt_digest": get_prompt("minimal").digest,
        "history": 0,
        "answers": "text",
        "stream": False,
        "sampling": Sampling(),
    }
    assert RunConfig.model_validate(fields).flights == 1
    with pytest.raises(ValueError, match=why):
        RunConfig.model_validate(fields | change)


def test_the_gate_grows_with_answers_and_halves_under_load() -> None:
    async def crowd() -> None:
        gate = AdaptiveGate(100)
        assert gate.limit == 8
        for _ in range(8):
            gate.succeeded()
        assert gate.limit == 16
        gate.overloaded(sent_at=1e12)
        assert gate.limit == 8
        gate.overloaded(sent_at=0)  # sent before the last halving
        assert gate.limit == 8
        most = 0

        async def one() -> None:
            nonlocal most
            async with gate.passing():
                most = max(most, gate.active)
                await asyncio.sleep(0.001)

        await asyncio.gather(*(one() for _ in range(50)))
        assert most == 8
        assert gate.active == 0

    asyncio.run(crowd())
