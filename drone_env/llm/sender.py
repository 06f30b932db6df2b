"""What a run sends its requests with: `endpoint.Endpoint` or `local.LocalModel`, two classes with the same methods."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from drone_env.errors import DroneEnvError
from drone_env.llm.answers import Answer
from drone_env.llm.rejections import NO_CHANGES, Changes


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
