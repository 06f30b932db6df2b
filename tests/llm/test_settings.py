"""Settings of a run of a language model: endpoint, model, token, and what a run is."""

import re
from pathlib import Path

import pytest
from pydantic import SecretStr

from drone_env.errors import InvalidValueError
from drone_env.files import differences
from drone_env.llm.config import InferenceSettings, Sampling, load_settings
from tests.environment import SETTINGS

from .conftest import ROOT
from .stored_run import run_config

HF, OPENAI = "https://router.huggingface.co/v1", "https://api.openai.com/v1"
HF_SPACE, LOCAL = "https://x.hf.space/v1", "http://localhost:1/v1"
QWEN = InferenceSettings.model_fields["model_name"].default


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def settings(**tokens: str) -> InferenceSettings:
    return InferenceSettings.model_validate(tokens)


def test_the_token_is_chosen_by_the_host() -> None:
    both = settings(hf_token="hf_a", openai_api_key="sk-b")
    assert {both.token_for(url) for url in (HF, HF_SPACE)} == {"hf_a"}
    foreign = ("https://huggingface.co.evil.example/v1", "https://nothuggingface.co/v1")
    assert {both.token_for(url) for url in (OPENAI, LOCAL, *foreign)} == {"sk-b"}
    assert settings().token_for("http://127.0.0.1:8000/v1") is None
    assert "hf_a" not in repr(both)


@pytest.mark.parametrize(
    ("tokens", "url", "why"),
    [
        ({"openai_api_key": "sk-b"}, "https://router.huggingface.co./v1", "needs HF_TOKEN"),
        ({}, HF, "needs HF_TOKEN"),
        ({}, OPENAI, "needs OPENAI_API_KEY"),
        ({"hf_token": "hf_two words"}, HF, "HF_TOKEN must be printable ASCII without spaces"),
        ({"hf_token": "hf_\u00e4"}, HF, "HF_TOKEN must be printable ASCII"),
        ({"hf_token": "hf_a"}, "http://x.hf.space/v1", "HF_TOKEN is a key of Hugging Face or OpenAI"),
    ],
)
def test_what_has_no_token_is_named(tokens: dict[str, str], url: str, why: str) -> None:
    with pytest.raises(InvalidValueError, match=why):
        settings(**tokens).token_for(url)


def test_plain_http_reaches_a_server_of_ones_own_with_and_without_a_key() -> None:
    for url in ("http://192.168.1.20:8000/v1", "http://vllm:8000/v1"):
        assert settings(hf_token="hf_a").token_for(url) is None
        assert settings(openai_api_key="EMPTY-no-key").token_for(url) == "EMPTY-no-key"


@pytest.mark.feature("I1")
def test_the_key_of_openai_alone_is_for_openai() -> None:
    def used(url: str | None = None, **written: str) -> tuple[str, str, str | None]:
        Path(".env").write_text("".join(f"{name}={value}\n" for name, value in written.items()))
        found = load_settings(url)
        return found.api_base_url, found.model_name, found.token_for(found.api_base_url)

    openai, both = {"OPENAI_API_KEY": "sk-b"}, {"OPENAI_API_KEY": "sk-b", "HF_TOKEN": "hf_a"}
    assert used(**openai) == used(**openai, HF_TOKEN="") == (OPENAI, "gpt-4o", "sk-b")
    assert used(**openai, API_BASE_URL=LOCAL) == (LOCAL, QWEN, "sk-b")
    assert used(HF_TOKEN="hf_a") == used(**both) == (HF, QWEN, "hf_a")
    assert used(**both, API_BASE_URL=f"{OPENAI}/") == (f"{OPENAI}/", "gpt-4o", "sk-b")
    with pytest.raises(InvalidValueError, match=r"needs HF_TOKEN: set it in the environment or in \.env$"):
        used(**openai, API_BASE_URL=HF)
    with pytest.raises(InvalidValueError, match=r"api\.openai\.com needs OPENAI_API_KEY"):
        used(HF_TOKEN="hf_a", API_BASE_URL=OPENAI)
    # An address on the command line goes before all.
    assert used(OPENAI, **openai, API_BASE_URL=LOCAL) == (OPENAI, "gpt-4o", "sk-b")
    assert used(HF, **both, API_BASE_URL=LOCAL) == (HF, QWEN, "hf_a")


@pytest.mark.feature("I1")
@pytest.mark.parametrize("name", SETTINGS)
def test_settings_of_the_environment_or_env_file(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def value() -> object:
        found = getattr(load_settings(), name.lower())
        return found.get_secret_value() if isinstance(found, SecretStr) else found

    # The example as it is shipped, with one line filled in.
    example = (ROOT / ".env.example").read_text(encoding="utf-8")
    filled, lines = re.subn(rf"(?m)^(# )?{name}=.*$", f"{name}=of-the-file", example)
    assert lines == 1
    Path(".env").write_text(filled)
    assert value() == "of-the-file"
    monkeypatch.setenv(name, "of-the-environment")
    assert value() == "of-the-environment"
    assert {name.upper() for name in InferenceSettings.model_fields} == set(SETTINGS)


def test_an_env_file_that_is_no_text_is_named() -> None:
    Path(".env").write_bytes(b"DRONE_TASK=\xff\xfe")
    with pytest.raises(InvalidValueError, match=r"\.env is not UTF-8 text"):
        load_settings()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"model": "two words"}, "model\n.*match pattern"),
        *(
            ({"base_url": url}, "API_BASE_URL must be")
            for url in ("ftp://x", "https://u:p@x/v1", "x", "https://x?key=1")
        ),
    ],
)
def test_a_run_that_cannot_be_is_refused(change: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        run_config(**change)


def test_what_differs_between_runs_is_named() -> None:
    config = run_config()
    changes: dict[str, object] = {"model": "n", "seeds": (14, 16), "sampling": Sampling(temperature=1.0)}
    for name, value in changes.items():
        changed = differences(dict(config), dict(run_config(**{name: value})))
        assert changed == [f"{name}: {getattr(config, name)!r} is now {value!r}"]
    with pytest.raises(ValueError, match=r"prompt minimal-2 is now .*; the run was made with 0000"):
        run_config(prompt_digest="0" * 16).load_prompt()


@pytest.mark.parametrize("key", ["hf_abcdef", "sk-proj-abcT3BlbkFJdef"])
def test_the_key_of_a_provider_goes_unencrypted_to_no_other_machine(key: str) -> None:
    keyed = settings(openai_api_key=key)
    with pytest.raises(InvalidValueError, match="OpenAI and is not sent unencrypted to vllm"):
        keyed.token_for("http://vllm:8000/v1")
    assert keyed.token_for("http://127.0.0.1:4000/v1") == keyed.token_for("https://gateway.example/v1") == key
