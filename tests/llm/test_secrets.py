"""The token goes to its endpoint and nowhere else: not along a redirect, not into a file, not onto the terminal."""

import json
from contextlib import nullcontext
from urllib.parse import quote

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.endpoint import Endpoint, without_secret

from .conftest import TOKEN, Start, verified


def test_only_what_is_needed_is_sent(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    foreign = {"HF_TOKEN": "hf_secret", "OPENAI_ORG_ID": "org-secret", "OPENAI_CUSTOM_HEADERS": "X-Secret: secret"}
    done = scripted.infer("--seeds", "14:15", "--extra", '{"reasoning_effort": "low"}', "--top-p", "0.5", **foreign)
    assert done.status == 0, done.err
    for request in scripted.requests():
        assert request["headers"]["authorization"] == f"Bearer {TOKEN}"
        assert "secret" not in json.dumps(request)
        assert request["body"]["reasoning_effort"] == "low"
        assert (request["body"]["top_p"], request["body"]["temperature"]) == (0.5, 0.0)


def test_a_quoted_token_reaches_no_file_no_request_and_no_terminal(endpoint: Start) -> None:
    faults = [[2, 2, {"status": 400, "message": f"bad key {TOKEN}"}]]
    done = endpoint(pilot=f"Your key is {TOKEN}", faults=faults).infer("--seeds", "14:15", "--max-calls", "3")
    assert [call["answer"] and call["answer"]["text"] for call in done.calls] == ["Your key is ***"] * 2 + [None]
    # The second request quotes the first answer as the transcript has it.
    assert done.calls[1]["messages"][2]["content"] == "Your key is ***"
    assert "400: bad key ***" in done.err
    verified(done)


@pytest.mark.parametrize("token", [TOKEN, "aZ9._~+/=|^-(hf)[sk]"])
def test_a_token_is_taken_out_however_it_is_written(token: str) -> None:
    for written in (token, token.upper(), token.lower(), quote(token, safe="")):
        assert without_secret(f"a {written} b", token) == "a *** b"
    assert without_secret("xylophone", "x") == "xylophone", "short tokens are parts of words"


@pytest.mark.parametrize(("url", "proxies"), [("http://192.168.1.20", 0), ("http://vllm", 0), ("https://x.org", 1)])
def test_only_public_hosts_are_reached_by_a_proxy(url: str, proxies: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("http_proxy", "https_proxy", "all_proxy", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.upper(), raising=False)
    monkeypatch.setenv("ALL_PROXY", "http://127.0.0.1:9")
    assert len(Endpoint(url, None, 1)._client._mounts) == proxies
    monkeypatch.setenv("ALL_PROXY", "gopher://127.0.0.1:9")
    with pytest.raises(InvalidValueError, match="ALL_PROXY cannot be used: ") if proxies else nullcontext():
        Endpoint(url, None, 1)


def test_the_token_for_this_machine_passes_no_proxy(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    proxies = dict.fromkeys(("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"), "http://127.0.0.1:9")
    done = scripted.infer("--seeds", "14:15", "--tries", "1", NO_PROXY="", no_proxy="", **proxies)
    assert done.status == 0, done.err
