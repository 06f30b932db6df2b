"""An OpenAI-compatible endpoint: send a request, parse the response, classify failures."""

import asyncio
import json
import re
from collections.abc import Iterator, Mapping
from email.utils import parsedate_to_datetime
from time import time
from typing import Any, cast
from urllib.parse import urlsplit

import httpx

from drone_env import __version__
from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer, finish_kind
from drone_env.llm.sender import NO_CHANGES, TryFailedError, changes_for

RETRIED = {408, 409, 429}
REASON_CHARACTERS = 300
MAX_TOKENS = 10**12
"""Larger counts are ignored."""
PARTS = {
    **dict.fromkeys(("text", "output_text"), "text"),
    **dict.fromkeys(("reasoning", "thinking"), "reasoning"),
    "refusal": "refusal",
}
"""The field of the answer for each type of content part. Other types are ignored."""
TEXTS = ("text", "reasoning", "refusal", "tool_arguments")
"""The fields of an answer that contain text from the model."""
HINTS = {
    401: "the token is missing or wrong: check HF_TOKEN (Hugging Face) or OPENAI_API_KEY (elsewhere)",
    402: "the account has no credit left: add credit, then continue the run",
    403: "the token may not use this model or endpoint",
    404: "there is no such model or address: check MODEL_NAME and API_BASE_URL",
}
NO_CREDIT = re.compile(
    r"insufficient[_ ](?:user_)?(?:quota|balance|funds|credit)|credit balance|billing_(?:hard_limit|not_active)"
    r"|exceeded_current_quota_error",
    re.IGNORECASE,
)
"""What errors without the status 402 say of an account without credit."""


class Endpoint:
    """Sends the requests of a run by HTTP.

    Args:
        base_url: Its address.
        token: The API token; None to send none.
        timeout: Maximum duration of a request in seconds.

    Raises:
        InvalidValueError: if the environment names a proxy that cannot be used.
    """

    def __init__(self, base_url: str, token: str | None, timeout: float) -> None:
        self._url, self._host = f"{base_url}/chat/completions", urlsplit(base_url).netloc
        self._token = token
        self._timeout = timeout
        headers = {"user-agent": f"drone-env/{__version__}"}
        if token is not None:
            headers["authorization"] = f"Bearer {token}"
        # A redirect would send the token elsewhere. The run bounds the connections.
        limits = httpx.Limits(max_connections=None, max_keepalive_connections=None)
        try:
            self._client = httpx.AsyncClient(headers=headers, follow_redirects=False, timeout=None, limits=limits)
        except (ImportError, ValueError, httpx.InvalidURL) as error:
            raise InvalidValueError(f"HTTP_PROXY, HTTPS_PROXY or ALL_PROXY cannot be used: {error}") from None

    async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
        """Send one request, given its body. The answer does not contain the token, even if the response quotes it.

        Raises:
            TryFailedError: if there is no answer.
        """
        try:
            # httpx limits each read, so a slow server can take longer.
            answer = await asyncio.wait_for(self._send(request, call_id), self._timeout)
        except asyncio.TimeoutError:
            advice = "a slow server needs a larger --timeout, or a smaller --max-answer-tokens or --concurrency"
            raise TryFailedError(0, f"no answer within {self._timeout:g} s: {advice}", retried=True) from None
        except httpx.ConnectError as error:
            reason = self._clean(f"{self._host} takes no connection ({error}): check API_BASE_URL and the server")
            raise TryFailedError(0, reason, retried=True, fatal=True) from None
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            reason = f"{type(error).__name__}: {error}".rstrip(": ")
            raise TryFailedError(0, self._clean(reason), retried=True) from None
        except (ValueError, AttributeError, LookupError, TypeError, RecursionError) as error:
            # Servers send anything in place of the objects and lists of the protocol.
            raise TryFailedError(200, self._clean(f"not an answer: {error}")) from None
        if finish_kind(answer.finish_reason) == "failed":
            reason = f"the answer was not finished: finish reason {self._clean(str(answer.finish_reason))!r}"
            raise TryFailedError(200, reason, retried=True)
        return answer

    async def close(self) -> None:
        """Close all connections."""
        await self._client.aclose()

    async def _send(self, request: Mapping[str, Any], call_id: str) -> Answer:
        response = await self._client.post(self._url, json=request, headers={"x-client-request-id": call_id})
        if not response.is_success:
            raise self._refusal(response.status_code, _error_text(response.text), response, request)
        if not response.text.strip():
            raise TryFailedError(200, "the response is empty", retried=True)
        completion = _json(response)
        error = _error_of(completion)
        fields = {} if error else _answer(completion)
        if error or not any(fields[name] for name in (*TEXTS, "finish_reason")):
            named = cast(Mapping[str, Any], error if isinstance(error, Mapping) else {})
            codes = (str(named.get(name)) for name in ("code", "status"))
            status = next((int(code) for code in codes if re.fullmatch("[45][0-9][0-9]", code)), 200)
            reason = f"{self._clean(_message_of(error or 'the message is empty'))} (in a 200 response)"
            raise self._refusal(status, reason, response, request)
        texts = {name: self._hidden(value) for name, value in fields.items() if isinstance(value, str)}
        return Answer.model_validate(fields | texts)

    def _refusal(
        self, status: int, reason: str, response: httpx.Response, request: Mapping[str, Any]
    ) -> TryFailedError:
        """The failure for an error, by its status or by what the whole response says."""
        reason = self._clean(reason) or httpx.codes.get_reason_phrase(status)
        if 300 <= status < 400:
            where = self._clean(response.headers.get("location", "elsewhere"))
            reason = f"it redirects to {where}, which is not followed: API_BASE_URL must be the endpoint itself"
        hint = HINTS[402] if NO_CREDIT.search(response.text) else HINTS.get(status)
        if status == 401 and self._token is None:
            hint = "no token was sent: set OPENAI_API_KEY; HF_TOKEN goes to Hugging Face only"
        if hint is not None:
            return TryFailedError(status, f"{hint} ({reason})", fatal=True)
        retried = status in RETRIED or status >= 500 or status == 200
        after = _retry_after(response.headers) if retried else None
        changes = NO_CHANGES if status in RETRIED else changes_for(response.text, request)
        return TryFailedError(status, reason, retried, after, changes=changes)

    def _hidden(self, text: str) -> str:
        """The text without the token and without half characters, which JSON can contain and no file can."""
        text = text.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")
        return text if self._token is None else text.replace(self._token, "***")

    def _clean(self, text: str) -> str:
        """The text on one line, without the token and without unprintable characters."""
        # Shorten last: part of a token would not be found.
        text = " ".join(self._hidden(text).split())[:REASON_CHARACTERS]
        return "".join(letter if letter.isprintable() else "\ufffd" for letter in text)


def _error_of(completion: Any) -> Any:
    """The error in a 200 response; None if it contains an answer."""
    choices: Any = completion.get("choices")
    if completion.get("error") or completion.get("object") == "error" or not choices:
        return completion.get("error") or completion
    choice: Any = choices[0] or {}
    if choice.get("message") is None:
        return "there is no message"
    return choice.get("error")


def _answer(completion: Any) -> dict[str, Any]:
    """The fields of the answer in a completion; many servers omit some."""
    choice: Any = completion["choices"][0]
    message: Any = choice["message"]
    legacy: Any = message.get("function_call")
    calls: list[Any] = message.get("tool_calls") or ([{"function": legacy}] if legacy else [])
    texts: dict[str, list[str]] = {
        "text": [],
        "reasoning": [text for _, text in _parts(message.get("reasoning_content") or message.get("reasoning"))],
        "refusal": [message.get("refusal") or ""],
        # The joined arguments of several calls are not an action.
        "tool_arguments": [_arguments((call.get("function") or {}).get("arguments")) for call in calls],
    }
    for name, part in _parts(message.get("content")):
        texts[name].append(part)
    joined = {name: "".join(found) or None for name, found in texts.items()}
    usage: Any = completion.get("usage") or {}
    prompt, written = _count(usage.get("prompt_tokens")), _count(usage.get("completion_tokens"))
    return {
        **joined,
        # Every prompt has tokens: a server that reports 0 has not counted them.
        "prompt_tokens": prompt or None,
        "completion_tokens": written if prompt or written else None,
        "text": joined["text"] or "",
        "finish_reason": choice.get("finish_reason"),
        "model": completion.get("model"),
    }


def _arguments(arguments: Any) -> str:
    """The arguments of a tool call as text. Some servers send the object itself, others encode it twice."""
    if not isinstance(arguments, str):
        return json.dumps(arguments) if arguments else ""
    try:
        inner: Any = json.loads(arguments) if arguments.lstrip().startswith('"') else None
    except ValueError:
        inner = None
    return inner if isinstance(inner, str) else arguments


def _count(n: Any) -> int | None:
    """A number of tokens; None if it is none, or too large to be true."""
    return int(n) if type(n) in (int, float) and 0 <= n < MAX_TOKENS and n == int(n) else None


def _parts(content: Any) -> Iterator[tuple[str, str]]:
    """Yield (field of the answer, text) for each part of a content: a text or a list of parts."""
    if not isinstance(content, list):
        yield "text", content or ""
        return
    for part in cast(list[Any], content):
        if isinstance(part, str):
            yield "text", part
        elif (kind := part.get("type", "text")) in PARTS:
            inner = part.get("text") or part.get(kind) or part.get("summary")
            yield PARTS[kind], "".join(text for _, text in _parts(inner))


def _json(response: httpx.Response) -> Any:
    try:
        return response.json()
    except ValueError:
        raise ValueError(f"JSON was expected (check API_BASE_URL), got {response.text}") from None


def _error_text(text: str) -> str:
    """The message of an error response, or its whole text."""
    try:
        return _message_of(json.loads(text))
    except (ValueError, RecursionError):
        return text


def _message_of(error: Any) -> str:
    """The innermost message of an error; the whole error if it has none."""
    raw = ""
    while isinstance(error, dict):
        fields = cast(dict[str, Any], error)
        inner = next((fields[name] for name in ("error", "message", "detail") if fields.get(name)), None)
        if inner is None:
            break
        metadata: Any = fields.get("metadata")
        # OpenRouter quotes its provider's error there.
        raw = f": {metadata['raw']}" if isinstance(metadata, dict) and metadata.get("raw") else raw
        error = inner
    return (error if isinstance(error, str) else json.dumps(error)) + raw


def _retry_after(headers: httpx.Headers) -> float | None:
    """Seconds in the header `Retry-After` or `Retry-After-Ms`; None if there is none."""
    after = headers.get("retry-after", "")
    try:
        if "retry-after-ms" in headers:
            return max(0.0, float(headers["retry-after-ms"]) / 1000)
        return max(0.0, float(after) if after[:1].isdecimal() else parsedate_to_datetime(after).timestamp() - time())
    except (TypeError, ValueError):
        return None
