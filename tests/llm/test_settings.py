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

HF, OTHER = "https://router.huggingface.co/v1", "https://api.openai.com/v1"


def test_an_extra_that_cannot_be_sent_is_refused() -> None:
    with pytest.raises(ValueError, match="surrogates not allowed"):
        Sampling(extra={"stop": "\ud800"})
    with pytest.raises(ValueError, match="extra cannot set 'seed'"):
        Sampling(extra={"seed": 1})


def test_the_token_is_chosen_by_the_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    both = InferenceSettings.model_validate({"hf_token": "hf_a", "openai_api_key": "sk-b"})
    assert both.token_for(HF) == both.token_for("https://x.hf.space/v1") == "hf_a"
    foreign = ("https://huggingface.co.evil.example/v1", "https://nothuggingface.co/v1", "http://localhost:1/v1")
    assert {both.token_for(url) for url in (OTHER, *foreign)} == {"sk-b"}
    with pytest.raises(InvalidValueError, match="needs HF_TOKEN"):
        InferenceSettings.model_validate({"openai_api_key": "sk-b"}).token_for("https://router.huggingface.co./v1")
    for wrong, why in (('hf_"quoted', "without spaces, quotes and backslashes"), ("hf_\u00e4", "printable ASCII")):
        with pytest.raises(InvalidValueError, match=f"HF_TOKEN must be .*{why}|{why}"):
            InferenceSettings.model_validate({"hf_token": wrong}).token_for(HF)
    none = InferenceSettings()
    assert none.token_for("http://127.0.0.1:8000/v1") is None
    for url, name in ((HF, "HF_TOKEN"), (OTHER, "OPENAI_API_KEY")):
        with pytest.raises(InvalidValueError, match=f"needs {name}"):
            none.token_for(url)
    for url in ("ftp://x", "https://user:pass@x/v1", "x", "https://x/v1?key=1"):
        with pytest.raises(InvalidValueError, match="API_BASE_URL"):
            both.token_for(url)
    assert "hf_a" not in repr(both)


PRIVATE = (
    *("localhost", "127.0.0.2", "[::1]", "0.0.0.0", "api.localhost", "192.168.1.20", "10.0.0.5", "172.16.3.4"),
    *("169.254.1.1", "100.100.1.2", "[fd00::1]", "[fe80::1]", "[::ffff:192.168.1.20]", "vllm", "my_vllm", "VLLM."),
    *(
        "gpu.local",
        "llm.corp.internal",
        "box.lan",
        "mylocal",
        "nas.home.arpa",
        "vllm.models.svc",
        "host.docker.internal",
    ),
)
PUBLIC = ("example.com", "8.8.8.8", "[2001:4860:4860::8888]", "172.32.0.1", "lan.example", "internal.example.com")


@pytest.mark.parametrize("host", [*PRIVATE, *PUBLIC])
def test_plain_http_reaches_every_host_without_a_token_and_private_ones_with_a_token(
    host: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    url, keyed = f"http://{host}:8000/v1", InferenceSettings.model_validate({"openai_api_key": "EMPTY-no-key"})
    assert InferenceSettings().token_for(url) is None
    assert InferenceSettings.model_validate({"hf_token": "hf_a"}).token_for(url) is None
    assert keyed.token_for(url, allow_plain_http=True) == keyed.token_for(f"https://{host}/v1") == "EMPTY-no-key"
    if host in PUBLIC:
        with pytest.raises(InvalidValueError, match="a public host: use https://, or add --allow-plain-http"):
            keyed.token_for(url)
    else:
        assert keyed.token_for(url) == "EMPTY-no-key"


@pytest.mark.parametrize("key", ["hf_abcdef", "sk-proj-abcT3BlbkFJdef"])
def test_the_key_of_a_provider_goes_unencrypted_to_no_other_machine(
    key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = InferenceSettings.model_validate({"openai_api_key": key})
    with pytest.raises(InvalidValueError, match="OpenAI and is not sent unencrypted to vllm"):
        settings.token_for("http://vllm:8000/v1")
    assert settings.token_for("http://127.0.0.1:4000/v1") == settings.token_for("https://gateway.example/v1") == key
    assert settings.token_for("http://vllm:8000/v1", allow_plain_http=True) == key


@pytest.mark.feature("I1")
def test_the_key_of_openai_alone_is_for_openai(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def asked(**written: str) -> tuple[str, str, str | None]:
        (tmp_path / ".env").write_text("".join(f"{name}={value}\n" for name, value in written.items()))
        settings = load_settings()
        return settings.api_base_url, settings.model_name, settings.token_for(settings.api_base_url)

    qwen = InferenceSettings.model_fields["model_name"].default
    assert asked(OPENAI_API_KEY="sk-b") == asked(OPENAI_API_KEY="sk-b", HF_TOKEN="") == (OTHER, "gpt-4o", "sk-b")
    assert asked(OPENAI_API_KEY="sk-b", API_BASE_URL="https://x/v1") == ("https://x/v1", qwen, "sk-b")
    assert asked(HF_TOKEN="hf_a") == asked(HF_TOKEN="hf_a", OPENAI_API_KEY="sk-b") == (HF, qwen, "hf_a")
    assert asked(HF_TOKEN="hf_a", OPENAI_API_KEY="sk-b", API_BASE_URL=f"{OTHER}/") == (f"{OTHER}/", "gpt-4o", "sk-b")
    for wrong, why in (
        ({"OPENAI_API_KEY": "sk-b", "API_BASE_URL": HF}, r"needs HF_TOKEN: set it in the environment or in \.env$"),
        ({"HF_TOKEN": "hf_a", "API_BASE_URL": OTHER}, "api.openai.com needs OPENAI_API_KEY"),
    ):
        with pytest.raises(InvalidValueError, match=why):
            asked(**wrong)
    # An address on the command line goes before all.
    (tmp_path / ".env").write_text("OPENAI_API_KEY=sk-b\nAPI_BASE_URL=https://x/v1\n")
    assert load_settings(OTHER).model_name == "gpt-4o"
    assert (load_settings(HF).api_base_url, load_settings(HF).model_name) == (HF, qwen)


def test_settings_that_are_wrong_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / ".env").write_bytes(b"DRONE_TASK=\xff\xfe")
    with pytest.raises(InvalidValueError, match=r"\.env is not UTF-8 text"):
        load_settings()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"model": "two words"}, "no spaces"),
        ({"base_url": "ftp://x"}, "API_BASE_URL must be"),
        ({"prompt": "plan", "history": 1}, "shows no last steps"),
        ({"seeds": (3, 3)}, "seeds must be"),
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


@pytest.mark.feature("I1")
def test_settings_of_the_environment_or_env_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    example = (ROOT / ".env.example").read_text(encoding="utf-8")

    def value(name: str) -> object:
        found = getattr(load_settings(), name.lower())
        return found.get_secret_value() if isinstance(found, SecretStr) else found

    for name in SETTINGS:
        # The example as it is shipped, with one line filled in.
        filled, lines = re.subn(rf"(?m)^(# )?{name}=.*$", f"{name}=of-the-file", example)
        assert lines == 1
        (tmp_path / ".env").write_text(filled)
        assert value(name) == "of-the-file"
        monkeypatch.setenv(name, "of-the-environment")
        assert value(name) == "of-the-environment"
        monkeypatch.delenv(name)
    assert {name.upper() for name in InferenceSettings.model_fields} == set(SETTINGS)
