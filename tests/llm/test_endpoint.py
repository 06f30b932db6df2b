"""What one response comes to: an answer, or a failure that is retried, passes or stops the run."""

import asyncio
import functools
import json
from collections.abc import Callable
from email.utils import formatdate
from time import time
from typing import Any

import httpx
import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm import endpoint
from drone_env.llm.answers import Answer
from drone_env.llm.endpoint import Endpoint
from drone_env.llm.sender import TryFailedError

from .conftest import ENDPOINTS, TOKEN

Send = Callable[..., Answer | TryFailedError]


@pytest.fixture
def send(monkeypatch: pytest.MonkeyPatch) -> Send:
    """Send one request, to which a response is given: `send(content, status=200, headers={})`."""
    client = httpx.AsyncClient

    def sent(content: Any, status: int = 200, headers: Any = None) -> Answer | TryFailedError:
        data = content if isinstance(content, str) else json.dumps(content)
        transport = httpx.MockTransport(lambda _: httpx.Response(status, headers=headers, content=data.encode()))
        monkeypatch.setattr(endpoint.httpx, "AsyncClient", functools.partial(client, transport=transport))

        async def ask() -> Answer:
            opened = Endpoint("http://localhost:1/v1", TOKEN, 60)
            try:
                return await opened.send({"model": "m", "messages": [], "max_tokens": 9, "top_k": 0}, "0-1-1")
            finally:
                await opened.close()

        try:
            return asyncio.run(ask())
        except TryFailedError as failed:
            return failed

    return sent


def completion(message: Any, **more: Any) -> dict[str, Any]:
    return {"choices": [{"message": message, "finish_reason": "stop"}], **more}


def failed(response: Answer | TryFailedError) -> TryFailedError:
    assert isinstance(response, TryFailedError)
    return response


@pytest.mark.parametrize(("message", "answer"), ENDPOINTS["answers"])
def test_the_parts_of_an_answer(send: Send, message: Any, answer: dict[str, Any]) -> None:
    assert send(completion(message)) == Answer(**answer, finish_reason="stop")


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("arguments", "read"), ENDPOINTS["tool arguments"])
def test_the_arguments_of_a_tool_call_in_each_form(send: Send, arguments: Any, read: str | None, legacy: bool) -> None:
    call = {"name": "fly", "arguments": arguments}
    message = {"content": None, "function_call": call} if legacy else {"tool_calls": [{"function": call}]}
    assert send(completion(message)) == Answer(text="", tool_arguments=read, finish_reason="stop")


@pytest.mark.parametrize(("usage", "counted"), ENDPOINTS["usage"])
def test_tokens_that_are_not_counted_are_unknown(send: Send, usage: Any, counted: object) -> None:
    answer = send(completion({"content": "UP"}, usage=usage))
    assert isinstance(answer, Answer)
    assert [answer.prompt_tokens, answer.completion_tokens] == counted


@pytest.mark.parametrize(("content", "status"), ENDPOINTS["retried"])
def test_failures_that_pass_are_retried(send: Send, content: Any, status: int) -> None:
    failure = failed(send(content, status))
    assert (failure.retried, failure.fatal) == (True, False)


DEEP = '{"choices": ' + "[" * 100_000 + "]" * 100_000 + "}"


@pytest.mark.parametrize("value", [*ENDPOINTS["no answers"], DEEP], ids=lambda value: str(value)[:20])
def test_what_has_not_the_form_of_an_answer_is_a_failure(send: Send, value: Any) -> None:
    failed(send(value if isinstance(value, str) and len(value) > 2 else json.dumps(value)))


@pytest.mark.parametrize(
    ("status", "headers", "seconds"),
    [
        (429, {"Retry-After": "2"}, 2),
        (503, {"Retry-After": "0.5"}, 0.5),
        (429, {"Retry-After": "soon"}, None),
        (429, {"Retry-After": "2", "Retry-After-Ms": "150"}, 0.15),
        (503, {"Retry-After": "Sat, 01 Jan 2000 00:00:00 GMT"}, 0),
        (503, {"Retry-After": formatdate(time() + 36_000, usegmt=True)}, 36_000),
        (503, {}, None),
    ],
)
def test_the_endpoint_may_ask_to_wait(send: Send, status: int, headers: dict[str, str], seconds: float | None) -> None:
    assert failed(send({}, status, headers)).retry_after == (seconds and pytest.approx(seconds, rel=0.1))


NOT_JSON = "200: not an answer: JSON was expected (check API_BASE_URL), got "
LONG = [
    (500, "y" * 1000, f"500: {'y' * 300}", False),
    (200, "x" * 195 + TOKEN, f"{NOT_JSON}{'x' * 195}***", False),
    (418, "x" * 295 + TOKEN, f"418: {'x' * 295}***", False),
]


@pytest.mark.parametrize(("status", "content", "told", "fatal"), [*ENDPOINTS["refusals"], *LONG])
def test_the_reason_is_one_short_line_without_the_token(
    send: Send, status: int, content: Any, told: str, fatal: bool
) -> None:
    content = json.loads(json.dumps(content).replace("TOKEN", TOKEN))
    failure = failed(send(content, status, {"Location": f"http://127.0.0.1:9/login?key={TOKEN}"}))
    assert (str(failure).startswith(told), failure.fatal) == (True, fatal), failure
    assert len(failure.reason) < 500
    assert "sk-test" not in failure.reason


def test_a_proxy_that_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ALL_PROXY", "gopher://127.0.0.1:9")
    with pytest.raises(InvalidValueError, match="ALL_PROXY cannot be used: "):
        Endpoint("https://x.org", None, 1)
