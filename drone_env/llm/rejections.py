"""Parts of a request that some endpoints reject, and what later requests send instead."""

import re
from collections.abc import Mapping
from typing import Any, Literal

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
