"""The token goes to its endpoint and nowhere else: not along a redirect, not into a file, not onto the terminal."""

import base64
import itertools
import json
import socket
from collections.abc import Callable

import pytest

from drone_env.llm.endpoint import without_secret
from drone_env.llm.report import report, write_report
from drone_env.llm.verify import verified_run

from .conftest import TOKEN, Endpoint
from .log_lines import verified

Start = Callable[..., Endpoint]


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
    verified(done)


def test_a_short_token_and_a_quoted_one(endpoint: Start) -> None:
    done = endpoint(pilot="greedy").infer("--seeds", "14:15", OPENAI_API_KEY="x")
    assert (done.status, done.turns) == (0, {"ok": 3})
    quoted = endpoint(pilot=f"Your key is {TOKEN}").infer("--seeds", "14:15", "--max-calls", "2")
    assert [call["answer"]["text"] for call in quoted.calls] == ["Your key is ***"] * 2
    # It is not sent on either: the second request quotes the first answer as the transcript has it.
    assert quoted.calls[1]["messages"][2]["content"] == "Your key is ***"
    verified(quoted)


ODD = "aZ9._~+/=|^-(hf)[sk]"
"""A token of all that one may hold, more or less."""


def spellings(token: str) -> dict[str, str]:
    """The token as an endpoint may quote it."""
    codes = [ord(letter) for letter in token]
    return {
        "upper": token.upper(),
        "lower": token.lower(),
        "url": "".join(f"%{code:02X}" for code in codes),
        "url, twice": "".join(f"%25{code:02x}" for code in codes),
        "url, in part": f"{token[:3]}%{codes[3]:02x}{token[4:]}",
        "html": "".join(f"&#{code};" for code in codes),
        "html, hexadecimal": "".join(f"&#x{code:X};" for code in codes),
        "json": "".join(f"\\u{code:04x}" for code in codes),
        "python": "".join(f"\\x{code:02x}" for code in codes),
        "mail": "".join(f"={code:02X}" for code in codes),
        "hexadecimal": token.encode().hex(),
        "hexadecimal, apart": token.encode().hex(":"),
        "backwards": token[::-1],
        "in two": f"{token[:8]} {token[8:]}",
    }


@pytest.mark.parametrize("token", [TOKEN, ODD])
def test_a_token_is_taken_out_however_it_is_written(token: str) -> None:
    for name, written in spellings(token).items():
        assert without_secret(f"a {written} b", token) == "a *** b", name
    for before, after in itertools.product(("", "x", "xy", "Bearer "), ("", "\n", "xy")):
        for spelling in (token, token.upper()):
            text = (before + spelling + after).encode()
            for coded in (base64.b64encode(text), base64.urlsafe_b64encode(text), base64.encodebytes(text * 2)):
                left = without_secret(coded.decode(), token)
                assert len(left) < len(coded) - len(token), (left, coded)
    assert without_secret("nothing to see: RIGHT", token) == "nothing to see: RIGHT"
    assert without_secret("xylophone", "x") == "xylophone"


def test_no_spelling_of_the_token_reaches_a_file_or_the_terminal(endpoint: Start) -> None:
    told = spellings(TOKEN) | {"base64": base64.b64encode(f"Bearer {TOKEN}".encode()).decode()}
    echo = " ".join(told.values())
    faults = [[1, 1, {"status": 400, "message": told["base64"]}], [2, 2, {"status": 400, "message": told["url"]}]]
    done = endpoint(pilot=echo, faults=faults).infer("--seeds", "14:17", "--concurrency", "1", "--max-calls", "4")
    assert [call["outcome"] for call in done.calls] == ["parse_error", "api_error", "api_error", "parse_error"]
    assert done.calls[0]["answer"]["text"].count("***") == len(told)
    assert done.err.count("***") == 2
    write_report(verified_run(done.folder), report(verified_run(done.folder), moves=False))
    seen = done.out + done.err + "".join(path.read_text() for path in done.folder.iterdir())
    assert [name for name, written in told.items() if written in seen] == []


def test_the_token_for_this_machine_passes_no_proxy(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    proxies = dict.fromkeys(("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"), "http://127.0.0.1:9")
    done = scripted.infer("--seeds", "14:15", "--tries", "1", NO_PROXY="", no_proxy="", **proxies)
    assert done.status == 0, done.err


def test_a_redirect_is_not_followed(endpoint: Start) -> None:
    with socket.create_server(("127.0.0.1", 0)) as elsewhere:
        elsewhere.setblocking(False)
        there = f"http://127.0.0.1:{elsewhere.getsockname()[1]}/v1/chat/completions"
        scripted = endpoint(pilot="greedy", faults=[[0, 10**9, {"status": 307, "headers": {"Location": there}}]])
        done = scripted.infer("--seeds", "14:15", "--timeout", "20", "--tries", "1")
        with pytest.raises(BlockingIOError):
            elsewhere.accept()
    assert (done.status, len(scripted.requests())) == (2, 1)
