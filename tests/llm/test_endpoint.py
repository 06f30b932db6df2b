"""What one response comes to: an answer, or a failure that is retried, passes or stops the run."""

import asyncio
import functools
import gzip
import itertools
import json
from collections.abc import AsyncIterator, Callable
from email.utils import formatdate
from time import time
from typing import Any

import httpx
import pytest

from drone_env.llm import endpoint
from drone_env.llm.answers import Answer
from drone_env.llm.endpoint import Endpoint, TryFailedError

from .conftest import TOKEN
from .kept_run import run_config

Send = Callable[..., Answer | TryFailedError]


@pytest.fixture
def send(monkeypatch: pytest.MonkeyPatch) -> Send:
    """Send one request, to which a response is given: `send(content, status=200, headers={}, stream=False)`."""
    client = httpx.AsyncClient

    def sent(
        content: Any, status: int = 200, headers: Any = None, pieces: Any = (), **change: Any
    ) -> Answer | TryFailedError:
        async def body() -> AsyncIterator[bytes]:
            data = content if isinstance(content, str) else json.dumps(content)
            for piece in pieces or [data.encode()]:
                yield piece

        transport = httpx.MockTransport(lambda _: httpx.Response(status, headers=headers, content=body()))
        monkeypatch.setattr(endpoint.httpx, "AsyncClient", functools.partial(client, transport=transport))
        config = run_config(**change)

        async def ask() -> Answer:
            opened = Endpoint(config, TOKEN, 60)
            try:
                return await opened.send([{"role": "user", "content": "?"}], "0-1-1", 0)
            finally:
                await opened.close()

        try:
            return asyncio.run(ask())
        except TryFailedError as failed:
            return failed

    return sent


def both_forms(part: Any, **more: Any) -> list[tuple[str, bool]]:
    """A choice as a whole response and as a stream, each with whether it is one."""
    choice = {"finish_reason": "stop", **more}
    whole, streamed = ({"choices": [{name: part, **choice}]} for name in ("message", "delta"))
    return [(json.dumps(whole), False), (f"data: {json.dumps(streamed)}\n\ndata: [DONE]\n\n", True)]


@pytest.mark.parametrize(
    ("content", "text", "reasoning", "refusal"),
    [
        ("UP", "UP", None, None),
        ([{"type": "text", "text": "UP"}], "UP", None, None),
        ([{"type": "reasoning", "text": "Up?"}, {"type": "text", "text": "U"}, {"text": "P"}], "UP", "Up?", None),
        ([{"type": "thinking", "thinking": [{"type": "text", "text": "Up?"}]}, "UP"], "UP", "Up?", None),
        ([{"type": "output_audio", "text": "DOWN"}, {"type": "output_text", "text": "UP"}], "UP", None, None),
        ([{"type": "image_url", "image_url": {"url": "data:"}}], "", None, None),
        ([{"type": "refusal", "refusal": "no"}], "", None, "no"),
    ],
)
def test_the_parts_of_a_content(
    send: Send, content: Any, text: str, reasoning: str | None, refusal: str | None
) -> None:
    for data, stream in both_forms({"content": content}):
        answer = send(data, stream=stream)
        assert isinstance(answer, Answer), answer
        assert (answer.text, answer.reasoning, answer.refusal) == (text, reasoning, refusal)


def test_two_tool_calls_are_no_action(send: Send) -> None:
    calls = [{"function": {"name": "fly", "arguments": f'{{"direction":"{to}"}}'}} for to in ("UP", "RIGHT")]
    for data, stream in both_forms({"content": "", "tool_calls": calls}):
        answer = send(data, stream=stream)
        assert isinstance(answer, Answer)
        assert answer.tool_arguments == '{"direction":"UP"}{"direction":"RIGHT"}'


def test_tokens_beyond_counting_are_not_counted(send: Send) -> None:
    usage = {"prompt_tokens": 10**400, "completion_tokens": -1}
    answer = send({"choices": [{"message": {"content": "UP"}}], "usage": usage})
    assert isinstance(answer, Answer)
    assert (answer.prompt_tokens, answer.completion_tokens) == (None, None)


BROKEN_OFF = (
    'data: {"choices": [{"delta": {"content": "UP"}}]}\n\n'
    'data: {"choices": [{"delta": {}, "finish_reason": "error"}]}\n\ndata: [DONE]\n\n'
)
"""A stream whose first piece looks like an answer."""


@pytest.mark.parametrize(
    ("content", "status", "stream"),
    [
        *(("", status, False) for status in (408, 409, 429, 500, 503)),
        ("", 200, False),
        ({"error": {"code": 503}}, 200, False),
        ({"error": "overloaded"}, 200, False),
        ({"object": "error", "message": "busy", "code": 500}, 200, False),
        ({"choices": []}, 200, False),
        ({"choices": [{"message": None, "finish_reason": "stop"}]}, 200, False),
        ({"choices": [{"message": {"content": None}, "finish_reason": None}]}, 200, False),
        ('data: {"error": {"code": 503}}\n\n', 200, True),
        (BROKEN_OFF, 200, True),
        ('data: {"choices": [{"delta": {"content": "UP"}}]}\n\ndata: [DONE]\n\n', 200, True),
        ("<html>busy</html>", 200, True),
    ],
)
def test_failures_that_pass_are_retried(send: Send, content: Any, status: int, stream: bool) -> None:
    failed = send(content, status, stream=stream)
    assert isinstance(failed, TryFailedError)
    assert (failed.retried, failed.fatal) == (True, False)


@pytest.mark.parametrize("stream", [False, True])
@pytest.mark.parametrize(
    "value",
    [
        *([], "UP", None, {"choices": "UP"}, {"choices": ["UP"]}, {"choices": [None]}, {"choices": {"0": 1}}),
        {"choices": [{"message": "UP", "delta": "UP", "finish_reason": "stop"}]},
        {"choices": [{"message": {"tool_calls": ["UP"]}, "delta": {"tool_calls": ["UP"]}, "finish_reason": "stop"}]},
        "data: {\x00\xff not json",
        '{"choices": ' + "[" * 100_000 + "]" * 100_000 + "}",
    ],
    ids=lambda value: str(value)[:20],
)
def test_what_has_not_the_form_of_an_answer_is_a_failure(send: Send, value: Any, stream: bool) -> None:
    text = value if isinstance(value, str) and len(value) > 2 else json.dumps(value)
    assert isinstance(send(f"data: {text}\n\n" if stream else text, stream=stream), TryFailedError)


@pytest.mark.parametrize("stream", [False, True])
@pytest.mark.parametrize(
    ("piece", "headers", "most"),
    [(b" " * 65536, {}, "4,194,304"), (gzip.compress(bytes(1 << 26)), {"Content-Encoding": "gzip"}, "65,536")],
)
def test_an_endless_answer_is_not_read_on(send: Send, piece: bytes, headers: Any, most: str, stream: bool) -> None:
    pieces = itertools.repeat(piece, 3 if headers else 100)
    failed = send("", headers=headers, pieces=pieces, stream=stream)
    assert str(failed) == f"200: not an answer: it takes more than {most} bytes"
    assert isinstance(failed, TryFailedError)
    assert (failed.retried, next(pieces, None)) == (False, piece)


def test_garbage_is_not_retried(send: Send) -> None:
    failed = send("<html>busy</html>")
    assert isinstance(failed, TryFailedError)
    assert (failed.status, failed.retried, failed.fatal) == (200, False, False)
    assert str(failed) == "200: not an answer: JSON was expected, got <html>busy</html>"


@pytest.mark.parametrize(
    ("status", "content", "reason"),
    [
        (401, {"error": {"message": f"bad key {TOKEN}"}}, "the token is missing or wrong: "),
        (403, {}, "the token may not use this model or endpoint"),
        (404, {}, "there is no such model or address"),
        (200, {"error": {"code": 401}}, "the token is missing or wrong: "),
    ],
)
def test_a_refusal_of_every_call_is_fatal(send: Send, status: int, content: Any, reason: str) -> None:
    failed = send(content, status)
    assert isinstance(failed, TryFailedError)
    assert (failed.retried, failed.fatal, failed.reason.startswith(reason)) == (False, True, True)
    assert TOKEN not in failed.reason


MAX_TOKENS = "Unsupported parameter: 'max_tokens' is not supported here. Use 'max_completion_tokens' instead."
FORMAT = "Invalid parameter: 'response_format' of type 'json_schema'."
STREAM = "Unrecognized request argument supplied: stream_options"


@pytest.mark.parametrize(
    ("message", "change", "option"),
    [
        (MAX_TOKENS, {}, """--max-answer-tokens 0 --extra '{"max_completion_tokens": 1024}'"""),
        ("Unsupported value: 'temperature' does not support 0.0 with this model.", {}, "--no-temperature"),
        (
            "This model's maximum context length is 512 tokens.",
            {},
            "another --max-answer-tokens, or with 0 to send none",
        ),
        (STREAM, {"stream": True}, "--no-stream"),
        (STREAM, {}, None),
        (FORMAT, {"answers": "json"}, "--answers text"),
        (FORMAT, {}, None),
        ('"auto" tool choice requires --enable-auto-tool-choice', {"answers": "tool"}, "--answers text"),
    ],
)
def test_a_famous_refusal_names_the_option_that_helps(
    send: Send, message: str, change: Any, option: str | None
) -> None:
    failed = send({"error": {"message": message}}, 400, **change)
    assert str(failed) == f"400: {message}" + (f" (try it with {option})" if option else "")


@pytest.mark.parametrize(
    ("status", "message", "blamed"),
    [
        (400, "Invalid content type. image_url is only supported by certain models.", True),
        (422, "messages[1]: unknown variant `image_url`, expected `text`", True),
        (400, "messages.1.content must be a string", True),
        (404, "No endpoints found that support image input", True),
        (500, "image input is not supported - hint: you may need to provide the mmproj", True),
        (413, "Request Entity Too Large", True),
        (401, "no image for you", False),
        (503, "the image store is not supported", False),
    ],
)
def test_who_takes_no_pictures_is_named_a_prompt_without(send: Send, status: int, message: str, blamed: bool) -> None:
    told = "each call shows a picture"
    failed, plain = (send({"error": message}, status, prompt=prompt) for prompt in ("vision-1", "minimal-2"))
    assert isinstance(failed, TryFailedError)
    assert (told in failed.reason, told in str(plain)) == (blamed, False)
    assert failed.fatal or not blamed


@pytest.mark.parametrize(
    ("status", "headers", "content", "seconds"),
    [
        (429, {"Retry-After": "2"}, {}, 2),
        (503, {"Retry-After": "0.5"}, {}, 0.5),
        (429, {"Retry-After-Ms": "1500", "Retry-After": "9"}, {}, 1.5),
        (200, {}, {"error": {"code": 429, "retry_after": 2}}, 2),
        (200, {}, {"error": {"code": 503, "metadata": {"headers": {"Retry-After": "3"}}}}, 3),
        (429, {"Retry-After": "soon"}, {}, None),
        (503, {"Retry-After": "Sat, 01 Jan 2000 00:00:00 GMT"}, {}, 0),
        (503, {"Retry-After": formatdate(time() + 36_000, usegmt=True)}, {}, 36_000),
    ],
)
def test_the_endpoint_may_ask_to_wait(
    send: Send, status: int, headers: dict[str, str], content: Any, seconds: float | None
) -> None:
    failed = send(content, status, headers)
    assert isinstance(failed, TryFailedError)
    assert failed.retry_after == (seconds and pytest.approx(seconds, rel=0.1))


@pytest.mark.parametrize(
    ("status", "content", "told"),
    [
        (500, {"error": {"message": ""}}, "500: Internal Server Error, without a reason"),
        (500, "y" * 1000, f"500: {'y' * 300}"),
        (500, "\x1b[2Jgone", "500: \ufffd[2Jgone"),
        (200, {"error": {"message": "quota exceeded", "code": 402}}, "402: quota exceeded (in a 200 response)"),
        (200, "x" * 195 + TOKEN, f"200: not an answer: JSON was expected, got {'x' * 195}***"),
        (418, "x" * 295 + TOKEN, f"418: {'x' * 295}***"),
    ],
)
def test_the_reason_is_one_short_line_without_the_token(send: Send, status: int, content: Any, told: str) -> None:
    assert str(send(content, status)) == told


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_a_redirect_is_not_followed(send: Send, status: int) -> None:
    there = f"http://127.0.0.1:9/login?key={TOKEN}"
    told = "http://127.0.0.1:9/login?key=***, which is not followed: API_BASE_URL must be the endpoint itself"
    for stream in (False, True):
        failed = send("", status, {"Location": there}, stream=stream)
        assert isinstance(failed, TryFailedError)
        assert (str(failed), failed.retried, failed.fatal) == (f"{status}: it redirects to {told}", False, False)
