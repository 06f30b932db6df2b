"""What all flights of a run share: its transcript, its cache of answers, and the gate that their requests pass."""

from pathlib import Path
from typing import NoReturn, Protocol
from urllib.parse import urlsplit

from drone_env.errors import DroneEnvError, EndpointError, InvalidValueError
from drone_env.files import read_file, write_text
from drone_env.llm.answers import Answer
from drone_env.llm.config import RunConfig
from drone_env.llm.gate import Gate
from drone_env.llm.transcript import LONGEST_CALL, Call, CallKey, Transcript


class CallFailedError(DroneEnvError):
    """A call brought no answer, after all retries."""


class Watcher(Protocol):
    """Hears what happens."""

    def called(self, call: Call) -> None:
        """A call was made."""
        ...

    def waiting(self, seconds: float, reason: str) -> None:
        """A try failed; the next one comes after this many seconds."""
        ...


class Desk:
    """Where flights ask before they send and report before they go on. It may stand in another process.

    Args:
        config: The run.
        transcript: Every call of it.
        gate: What requests pass.
        watcher: Hears what happens.
    """

    def __init__(self, config: RunConfig, transcript: Transcript, gate: Gate, watcher: Watcher) -> None:
        self._host = urlsplit(config.base_url).netloc
        self._transcript = transcript
        self._gate = gate
        self._cache = None if gate.options.cache is None else AnswerCache(gate.options.cache)
        self._watcher = watcher
        for call in transcript.calls:
            gate.count(call)

    async def known(self, key: CallKey, request: str, cache_key: str) -> tuple[Answer | None, bool]:
        """The answer of a call, where there is one, and whether it is from the cache. The flight does nothing else now.

        Raises:
            StoppedError: if the run is being stopped for the sake of another call.
            InvalidValueError: if the transcript holds another request under this key.
        """
        # A flight that begins again elsewhere, its process having died, has left its place.
        self._gate.leave(key.flight)
        call = self._transcript.answered.get(key)
        if call is not None:
            if call.request_digest != request:
                raise InvalidValueError(f"{self._transcript.path}: call {key} asks something else than this run would")
            return call.answer, False
        self._gate.check_going_on()
        answer = self._cache.get(cache_key) if self._cache else None
        return answer, answer is not None

    async def acquire(self, flight: int) -> float:
        """See `Gate.acquire`."""
        return await self._gate.acquire(flight)

    async def release(self, flight: int, tokens: int | None, overloaded: bool = False, pause: float = 0.0) -> None:
        """See `Gate.release`."""
        self._gate.release(flight, tokens, overloaded, pause)

    async def record(self, call: Call, cache_key: str) -> Answer | None:
        """Put a call into the transcript, where it is before anything is done with it.

        Of two answers to one call, from a process that was believed dead, the first counts, and both are paid: the
        first is returned where there is one, and else nothing.

        Raises:
            OSError: if it cannot be written.
        """
        self._gate.count(call, counted=call.requests)
        first = self._transcript.answered.get(call.key)
        if first is not None:
            return first.answer
        self._transcript.append(call)
        self._watcher.called(call)
        if self._cache and call.answer is not None and not call.cached:
            self._cache.put(cache_key, call.answer)
        return None

    async def failed(self, status: int, reason: str, retried: bool, fatal: bool) -> NoReturn:
        """A call brought no answer after all tries.

        Raises:
            CallFailedError: always, but
            StoppedError: where the run is being stopped.
        """
        self._gate.check_going_on()
        # What the very first call is refused for, such as a parameter that the model does not take, holds for all; and
        # so does where it is sent on to.
        if fatal or (not self._transcript.answered and 300 <= status < 500 and not retried):
            self._gate.fatal = EndpointError(f"{self._host} answers {status}: {reason}")
        raise CallFailedError(f"{status or 'no answer'}: {reason}")

    async def waiting(self, seconds: float, reason: str) -> None:
        """A try failed; the next one comes after this many seconds."""
        self._watcher.waiting(seconds, reason)


class AnswerCache:
    """A folder of answers that were paid for once, shared by runs: one file each, whole or not at all.

    Args:
        folder: Made where it is missing.

    Raises:
        OSError: if it cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def get(self, key: str) -> Answer | None:
        """The answer that is kept under a key.

        Raises:
            InvalidValueError: if the file is no answer.
        """
        path = self._path(key)
        if not path.exists():
            return None
        return Answer.read(read_file(path, LONGEST_CALL), f"remove {path}, which is no answer")

    def put(self, key: str, answer: Answer) -> None:
        """Keep an answer.

        Raises:
            OSError: if it cannot be written.
        """
        path = self._path(key)
        path.parent.mkdir(exist_ok=True)
        write_text(path, answer.model_dump_json())

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key}.json"
