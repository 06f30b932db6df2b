"""What a run sends its requests with, and what it changes in those that are rejected.

A sender is `endpoint.Endpoint` or `local.LocalModel`, two classes with the same methods. Some endpoints reject parts of
a request, so later requests send something else instead.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from drone_env.errors import DroneEnvError
from drone_env.llm.answers import Answer

Part = Literal["system", "max_tokens", "max_completion_tokens", "temperature", "seed", "tool_choice"]
Changes = Mapping[Part, str | None]
"""The new name of each changed field of a request; None for a field that is not sent. `system` becomes `merge`."""
NO_CHANGES: Changes = {}
PARAMETERS: tuple[Part, ...] = ("max_tokens", "max_completion_tokens", "temperature", "seed", "tool_choice")
UNSUPPORTED = (
    r"unsupported|(?:not|n't) (?:currently )?(?:support|permit|allow|available|compatible)|incompatible|forbidden"
    r"|unexpected|unknown|unrecogni[sz]ed|deprecated|can(?:not|'t) both"
)
OUT_OF_RANGE = r"positive|must be|should be|has to be|greater|between|range|invalid"
SYSTEM_ROLE = re.compile(
    r"roles? must alternate|developer instruction|messages\W{0,3}0\W{0,3}role"
    r"|only [^.]{0,60}roles? (?:is|are) supported"
    r"|system['\"`]? (?:role|message|prompt|instruction)s?\b[^.]{0,40}(?:not|n't|un)[ -]?(?:support|allow|permit)"
    r"|(?:(?:not|n't) (?:support|allow)|unsupported|unexpected|invalid|unknown)[^.]{0,60}"
    r"(?:\bsystem['\"`]? (?:role|message|prompt|instruction)|\brole\W{1,5}system)",
    re.IGNORECASE,
)


def changes_for(reason: str, request: Mapping[str, Any]) -> Changes:
    """What to change in a request that was refused; empty if the reason names no part that can change.

    An explicit limit or form of the answer that is out of range, such as a `max_tokens` above the model's, stays.
    """
    if request.get("messages") and request["messages"][0]["role"] == "system" and SYSTEM_ROLE.search(reason):
        return {"system": "merge"}
    for name in PARAMETERS:
        # The program chose the temperature 0, which is no valid value for some servers.
        why = f"{UNSUPPORTED}|{OUT_OF_RANGE}" if name == "temperature" and request.get(name) == 0 else UNSUPPORTED
        near = rf"(?is)\b{name}\b.{{,120}}(?:{why})|(?:{why}).{{,120}}\b{name}\b"
        if name in request and re.search(near, reason):
            other = name == "max_tokens" and "max_completion_tokens" in reason
            return {name: "max_completion_tokens" if other else None}
    return NO_CHANGES


def changed(request: Mapping[str, Any], changes: Changes) -> dict[str, Any]:
    """The body of a request after changes."""
    sent = dict(request)
    for name, other in changes.items():
        if name == "system" and sent["messages"][0]["role"] == "system":
            system, user, *later = sent["messages"]
            sent["messages"] = [{"role": "user", "content": f"{system['content']}\n\n{user['content']}"}, *later]
        elif name in sent:
            value = sent.pop(name)
            if other is not None:
                sent[other] = value
    return sent


def described(changes: Changes) -> str:
    """The changes in words."""
    return "; ".join(
        "the system text is sent in the first user message"
        if name == "system"
        else f"{name} is {'not sent' if other is None else f'sent as {other}'}"
        for name, other in changes.items()
    )


@dataclass(eq=False)
class TryFailedError(DroneEnvError):
    """A try without an answer.

    Attributes:
        status: The HTTP status, or that of an error in a 200 response; 0 if there is none.
        reason: What went wrong.
        retried: Whether another try can succeed.
        retry_after: Seconds to wait, as the endpoint requests; None if it does not.
        fatal: Whether every other call would fail too, once no try is left.
        changes: What to change in the request, if the endpoint rejects a part that can change.
    """

    status: int
    reason: str
    retried: bool = False
    retry_after: float | None = None
    fatal: bool = False
    changes: Changes = field(default_factory=lambda: NO_CHANGES)

    def __str__(self) -> str:
        return f"{self.status or 'no answer'}: {self.reason}"


class Sender(Protocol):
    """Sends the requests of a run, many at once."""

    async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
        """Send one request, given its body in OpenAI's form.

        Args:
            request: The body.
            call_id: Identifies the call in logs.

        Raises:
            TryFailedError: if there is no answer.
        """
        ...

    async def close(self) -> None:
        """Release what it holds."""
        ...
