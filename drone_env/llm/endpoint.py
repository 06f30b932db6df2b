"""One request to an OpenAI-compatible endpoint: what goes out, what comes back, which failures are worth a retry."""

import asyncio
import itertools
from collections.abc import AsyncIterator, Sequence
from email.utils import parsedate_to_datetime
from time import time
from typing import Any, NoReturn, cast
from urllib.parse import urlsplit

import httpx2
import openai
from openai import AsyncOpenAI, AsyncStream
from openai.types.chat import ChatCompletion, ChatCompletionChunk

from drone_env.core.actions import Action
from drone_env.errors import DroneEnvError
from drone_env.llm.answers import Answer
from drone_env.llm.config import AnswerForm, RunConfig
from drone_env.llm.prompt import ChatMessage
from drone_env.llm.redaction import without_secret
from drone_env.llm.settings import LOOPBACK

RETRIED = {408, 409, 429}
SENT_HEADERS = {
    *("host", "content-type", "content-length", "transfer-encoding", "accept", "accept-encoding", "connection"),
    *("user-agent", "authorization", "x-client-request-id"),
}
REASON_CHARACTERS = 300
MOST_TOKENS = 10**12
"""A count of tokens from here on is none."""
MOST_BYTES = 1 << 22
"""A longer answer is not read on: a million tokens take less, and an endpoint must not fill the memory."""
PACKED = 64
"""How many times less a compressed answer may have. None is asked for, and one may grow a thousandfold."""
POOLS = 8
"""Pools of connections. A pool looks at all of its own for each request, which hundreds in one would make slow."""
DIRECTIONS = [action.name for action in Action]
HINTS = {
    401: "the token is missing or wrong: check HF_TOKEN (Hugging Face) or OPENAI_API_KEY (elsewhere)",
    403: "the token may not use this model or endpoint",
    404: "there is no such model or address: check MODEL_NAME and API_BASE_URL",
}


class TryFailedError(DroneEnvError):
    """A try that brought no answer.

    Attributes:
        status: The HTTP status, 0 where there was none.
        retried: Whether another try may bring one.
        retry_after: Seconds that the endpoint asks to wait; None where it does not say.
        fatal: Whether every other call would be refused as well.
    """

    def __init__(
        self, status: int, reason: str, retried: bool, retry_after: float | None = None, fatal: bool = False
    ) -> None:
        self.status = status
        self.reason = reason
        self.retried = retried
        self.retry_after = retry_after
        self.fatal = fatal
        super().__init__(f"{status or 'no answer'}: {reason}")


class _TooLongError(ValueError):
    """An answer that takes more than is read."""


class _Bounded(httpx2.AsyncByteStream):
    """What comes in, up to a limit."""

    def __init__(self, stream: httpx2.AsyncByteStream, most: int) -> None:
        self._stream = stream
        self._left = most
        self._most = most

    async def __aiter__(self) -> AsyncIterator[bytes]:
        async for chunk in self._stream:
            self._left -= len(chunk)
            if self._left < 0:
                raise _TooLongError(f"it takes more than {self._most:,} bytes")
            yield chunk

    async def aclose(self) -> None:
        await self._stream.aclose()


async def _bound(response: httpx2.Response) -> None:
    stream = cast(httpx2.AsyncByteStream, response.stream)
    response.stream = _Bounded(stream, MOST_BYTES // PACKED if "content-encoding" in response.headers else MOST_BYTES)


class Endpoint:
    """Sends requests. To be closed.

    Args:
        config: Model, address, sampling, form of the answers.
        token: What authorises; None to send none.
        plan: Whether whole routes are asked for.
        timeout: Seconds that an answer may take.
    """

    def __init__(self, config: RunConfig, token: str | None, plan: bool, timeout: float) -> None:
        self._token = token
        self._timeout = timeout
        self._stream = config.stream
        self.body = request_body(config, plan)

        async def keep_to_ourselves(request: httpx2.Request) -> None:
            # The client adds headers from variables of the environment that are meant for one certain host.
            for name in [name for name in request.headers if name.lower() not in SENT_HEADERS]:
                del request.headers[name]
            request.headers["accept-encoding"] = "identity"
            if token is None:
                request.headers.pop("authorization", None)
            else:
                request.headers["authorization"] = f"Bearer {token}"

        def client() -> AsyncOpenAI:
            # A redirect could take the token elsewhere. No limit of connections: the runner limits them.
            # A proxy is another machine: what goes to this one, unencrypted, passes none.
            http = openai.DefaultAsyncHttpxClient(
                trust_env=urlsplit(config.base_url).hostname not in LOOPBACK,
                verify=certificates,
                follow_redirects=False,
                limits=httpx2.Limits(max_connections=None, max_keepalive_connections=None),
                event_hooks={"request": [keep_to_ourselves], "response": [_bound]},
            )
            return AsyncOpenAI(
                api_key=token or "none", base_url=config.base_url, max_retries=0, timeout=timeout, http_client=http
            )

        certificates = httpx2.create_ssl_context()
        self._clients = [client() for _ in range(POOLS)]
        self._next_client = itertools.cycle(self._clients)
        self.host = urlsplit(config.base_url).netloc

    async def ask(self, messages: Sequence[ChatMessage], call_id: str) -> Answer:
        """Send one request.

        Raises:
            TryFailedError: if no answer came.
        """
        try:
            return await asyncio.wait_for(self._ask(messages, call_id), self._timeout)
        except (asyncio.TimeoutError, openai.APITimeoutError, httpx2.TimeoutException):
            raise TryFailedError(0, f"no answer within {self._timeout:g} s", retried=True) from None
        except openai.APIStatusError as error:
            self._status_failed(error)
        except (openai.APIConnectionError, httpx2.TransportError) as error:
            cause = error.__cause__ or error
            if isinstance(cause, _TooLongError):
                raise TryFailedError(200, f"not an answer: {cause}", retried=False) from None
            reason = f"{type(cause).__name__}: {cause}".rstrip(": ")
            raise TryFailedError(0, self._clean(reason), retried=True) from None
        except (openai.APIError, ValueError) as error:
            # An error inside of a stream, or what is no JSON.
            raise TryFailedError(200, self._clean(f"not an answer: {error}"), retried=False) from None
        except (AttributeError, LookupError, TypeError, RecursionError) as error:
            # Foreign servers send anything where the protocol has objects and lists, and nothing checks it before.
            raise TryFailedError(200, self._clean(f"not in the form of an answer: {error}"), retried=False) from None

    async def close(self) -> None:
        """Close all connections."""
        for client in self._clients:
            await client.close()

    async def _ask(self, messages: Sequence[ChatMessage], call_id: str) -> Answer:
        # Not `chat.completions.create`, which takes longer to check each message than all else here takes.
        post: Any = next(self._next_client).post
        body: dict[str, Any] = {"messages": list(messages), **self.body}
        arguments: dict[str, Any] = {
            "options": {"headers": {"X-Client-Request-Id": call_id}},
            "cast_to": ChatCompletion,
        }
        if not self._stream:
            return _read_completion(await post("/chat/completions", body=body, **arguments))
        body |= {"stream": True, "stream_options": {"include_usage": True}}
        chunks = AsyncStream[ChatCompletionChunk]
        return await _read_stream(
            await post("/chat/completions", body=body, stream=True, stream_cls=chunks, **arguments)
        )

    def _status_failed(self, error: openai.APIStatusError) -> NoReturn:
        status = error.status_code
        reason = self._clean(_error_text(error))
        if 300 <= status < 400:
            # Who follows takes the token along.
            where = self._clean(error.response.headers.get("location", "elsewhere"))
            reason = f"it redirects to {where}, which is not followed: API_BASE_URL must be the endpoint itself"
            raise TryFailedError(status, reason, retried=False) from None
        if status in HINTS:
            raise TryFailedError(status, f"{HINTS[status]} ({reason})", retried=False, fatal=True) from None
        retried = status in RETRIED or status >= 500
        raise TryFailedError(
            status, reason, retried, _retry_after(error.response.headers) if retried else None
        ) from None

    def _clean(self, text: str) -> str:
        """The text on one line, without the token, and without what moves a terminal or cannot be written."""
        text = without_secret(text, self._token)
        # Cut last: half of a token would not be found.
        text = " ".join(text.split())[:REASON_CHARACTERS]
        return "".join(letter if letter.isprintable() else "\ufffd" for letter in text)


def request_body(config: RunConfig, plan: bool) -> dict[str, Any]:
    """What is sent beside the messages."""
    sampling = config.sampling.model_dump(exclude={"extra"}, exclude_none=True)
    return {"model": config.model, **sampling, **config.sampling.extra, **_form(config.answers, plan)}


def _form(form: AnswerForm, plan: bool) -> dict[str, Any]:
    one = {"type": "string", "enum": DIRECTIONS}
    properties = {"actions": {"type": "array", "items": one}} if plan else {"direction": one}
    schema = {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }
    name = "fly_route" if plan else "fly"
    if form == "json":
        return {
            "response_format": {"type": "json_schema", "json_schema": {"name": name, "schema": schema, "strict": True}}
        }
    if form == "tool":
        described = "Fly the whole route." if plan else "Fly one step."
        function = {"name": name, "description": described, "parameters": schema}
        return {
            "tools": [{"type": "function", "function": function}],
            "tool_choice": {"type": "function", "function": {"name": name}},
        }
    return {}


def _read_completion(completion: Any) -> Answer:
    """The answer in a completion; foreign servers leave much of it out."""
    choices = getattr(completion, "choices", None)
    if not choices:
        # Some send their errors as 200.
        error = _field(completion, "error") if isinstance(completion, ChatCompletion) else None
        raise ValueError(f"there are no choices, but {error or completion}")
    message = choices[0].message
    if message is None:
        raise ValueError("the choice has no message")
    calls = getattr(message, "tool_calls", None)
    return Answer(
        text=_text(message.content) or "",
        reasoning=_text(_field(message, "reasoning_content") or _field(message, "reasoning")),
        tool_arguments=_arguments(calls) if calls else None,
        refusal=_text(getattr(message, "refusal", None)),
        finish_reason=_text(choices[0].finish_reason),
        model=_text(completion.model),
        **_usage(completion.usage),
    )


async def _read_stream(stream: Any) -> Answer:
    parts: dict[str, list[str]] = {"text": [], "reasoning": [], "refusal": [], "tool": []}
    finish_reason: str | None = None
    model: str | None = None
    usage: dict[str, int | None] = {}
    async with stream:
        async for chunk in stream:
            model = _text(chunk.model) or model
            usage = _usage(chunk.usage) if chunk.usage else usage
            choices: list[Any] = chunk.choices or []
            for choice in choices[:1]:
                finish_reason = _text(choice.finish_reason) or finish_reason
                delta = choice.delta
                if delta is None:
                    continue
                calls = getattr(delta, "tool_calls", None)
                pieces: dict[str, Any] = {
                    "text": delta.content,
                    "reasoning": _field(delta, "reasoning_content") or _field(delta, "reasoning"),
                    "refusal": getattr(delta, "refusal", None),
                    "tool": _arguments(calls) if calls else None,
                }
                for name, piece in pieces.items():
                    if piece:
                        parts[name].append(_text(piece) or "")
    if finish_reason is None:
        raise TryFailedError(0, "the stream ended before the answer did", retried=True)
    joined = {name: "".join(pieces) or None for name, pieces in parts.items()}
    return Answer(
        text=joined["text"] or "",
        reasoning=joined["reasoning"],
        tool_arguments=joined["tool"],
        refusal=joined["refusal"],
        finish_reason=finish_reason,
        model=model,
        **_usage_fields(usage),
    )


def _arguments(calls: Any) -> str | None:
    """The arguments of tool calls. Those of several stand side by side, which makes them no action."""
    pieces = [_text(call.function.arguments) for call in calls if call.function is not None]
    return "".join(piece or "" for piece in pieces) or None


def _field(message: Any, name: str) -> Any:
    """A field that is not part of OpenAI's protocol, but of others'."""
    extra: dict[str, Any] = message.model_extra or {}
    return extra.get(name)


def _text(value: Any) -> str | None:
    if value is None or isinstance(value, str):
        return value
    raise ValueError(f"text was expected, got {value!r}")


def _usage(usage: Any) -> dict[str, int | None]:
    counts = {name: getattr(usage, name, None) for name in ("prompt_tokens", "completion_tokens")}
    return _usage_fields({name: n if type(n) is int and 0 <= n < MOST_TOKENS else None for name, n in counts.items()})


def _usage_fields(usage: dict[str, int | None]) -> dict[str, int | None]:
    return {name: usage.get(name) for name in ("prompt_tokens", "completion_tokens")}


def _error_text(error: openai.APIStatusError) -> str:
    body = error.body
    told = cast(dict[str, Any], body).get("message") if isinstance(body, dict) else None
    return told if isinstance(told, str) else error.message


def _retry_after(headers: httpx2.Headers) -> float | None:
    """Seconds that the endpoint asks to wait, from its headers; None where they do not say."""
    milliseconds, after = headers.get("retry-after-ms"), headers.get("retry-after")
    try:
        if milliseconds is not None:
            return max(0.0, float(milliseconds) / 1000)
        if after is None:
            return None
        if after.strip().replace(".", "", 1).isdecimal():
            return float(after)
        return max(0.0, parsedate_to_datetime(after).timestamp() - time())
    except (TypeError, ValueError):
        return None
