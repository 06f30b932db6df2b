"""The promises of inference: a language model flies, here one that does as it is told."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from drone_env.llm.settings import InferenceSettings, load_settings, models_table, settings_table
from tests.api.serving import ROOT
from tests.llm.conftest import TOKEN, VARIABLES, Endpoint, environment

Start = Callable[..., Endpoint]


@pytest.mark.feature("I1")
def test_i1_settings_of_the_environment_or_env_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """HF_TOKEN, OPENAI_API_KEY, API_BASE_URL, MODEL_NAME, DRONE_TASK, LOCAL_IMAGE_NAME from the environment or .env"""
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    given = load_settings()
    assert (given.hf_token, given.openai_api_key) == (None, None)
    assert (given.api_base_url, given.model_name) == ("https://router.huggingface.co/v1", "Qwen/Qwen2.5-7B-Instruct")
    assert (given.drone_task, given.local_image_name) == ("easy_delivery", "drone-inference-v1")
    example = (ROOT / ".env.example").read_text(encoding="utf-8")
    (tmp_path / ".env").write_text(example.replace("HF_TOKEN=\n", "HF_TOKEN=hf_1\nDRONE_TASK=hard\n", 1))
    monkeypatch.setenv("MODEL_NAME", "gpt-4o")
    given = load_settings()
    assert given.hf_token is not None
    assert (given.hf_token.get_secret_value(), given.model_name) == ("hf_1", "gpt-4o")
    assert settings_table() in (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    assert models_table() in (ROOT / "docs" / "llm.md").read_text(encoding="utf-8")
    assert all(name.upper() in example and name.upper() in VARIABLES for name in InferenceSettings.model_fields)


@pytest.mark.feature("I2")
def test_i2_log_lines_to_the_byte(endpoint: Start, tmp_path: Path) -> None:
    """python inference.py prints [START], [STEP] and [END] lines and nothing else; success is all delivered"""
    variables = {"API_BASE_URL": endpoint(pilot="greedy").url, "MODEL_NAME": "mine", "OPENAI_API_KEY": TOKEN}
    command = [sys.executable, str(ROOT / "inference.py"), "--seeds", "14:15", "--no-report"]
    done = subprocess.run(command, cwd=tmp_path, env=environment(**variables), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == (
        b"[START] task=drone_env.graders:grade_easy env=drone_env_v1 model=mine\n"
        b"[STEP] step=1 action=LEFT reward=0.15 done=false error=null\n"
        b"[STEP] step=2 action=UP reward=0.15 done=false error=null\n"
        b"[STEP] step=3 action=UP reward=0.99 done=true error=null\n"
        b"[END] success=true steps=3 score=0.990 rewards=0.15,0.15,0.99\n"
    )
    waiting = endpoint(pilot="WAIT").infer("--task", "easy", "--seeds", "14:15")
    assert waiting.out.endswith("[END] success=false steps=60 score=0.010 rewards=" + ",".join(["0.10"] * 60) + "\n")


@pytest.mark.feature("I3")
def test_i3_the_prompt_asks_for_one_word(endpoint: Start) -> None:
    """The prompt names role, goal, actions, asks for one uppercase word; tells position, battery, target, distance"""
    scripted = endpoint(pilot="greedy")
    assert scripted.infer("--task", "easy", "--seeds", "14:15").status == 0
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
    ]
    assert later["content"].startswith("Position: (5, 3)\nBattery: 98% (59 units)\n")
