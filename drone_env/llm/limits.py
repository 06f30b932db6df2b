"""What a run may spend, and what it has spent."""

from dataclasses import dataclass, field

from drone_env.errors import DroneEnvError, InvalidValueError
from drone_env.llm.clock import Clock
from drone_env.llm.transcript import Call


class LimitReachedError(DroneEnvError):
    """A run has spent what it may."""


@dataclass(frozen=True)
class Prices:
    """US dollars per million tokens."""

    prompt: float
    completion: float

    def __post_init__(self) -> None:
        if not (0 <= self.prompt < float("inf") and 0 <= self.completion < float("inf")):
            raise InvalidValueError("prices must be 0 or more US dollars per million tokens")

    def cost(self, prompt_tokens: int, completion_tokens: int) -> float:
        """What tokens cost, in US dollars."""
        return (prompt_tokens * self.prompt + completion_tokens * self.completion) / 1e6


@dataclass(frozen=True)
class Limits:
    """What a run may spend in all, its earlier parts counted in; None for no limit.

    Requests are counted one by one, retries too. Tokens and money are known only when an answer has come: what is under
    way then is still finished and paid. Seconds are those of this part of the run.
    """

    calls: int | None = None
    tokens: int | None = None
    seconds: float | None = None
    cost: float | None = None

    def __post_init__(self) -> None:
        for name in ("calls", "tokens", "seconds", "cost"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise InvalidValueError(f"--max-{name} must be above 0, got {value}")


@dataclass
class Spending:
    """What a run has spent so far."""

    limits: Limits
    prices: Prices | None
    requests: int = 0
    cached: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0
    unmetered: int = 0
    """Paid answers that did not say how many tokens they took."""
    clock: Clock = field(default_factory=Clock)
    started: float = field(init=False)

    def __post_init__(self) -> None:
        self.started = self.clock.now()

    @property
    def tokens(self) -> int:
        """All tokens."""
        return self.prompt_tokens + self.completion_tokens

    @property
    def cost(self) -> float | None:
        """US dollars; None where no price is known."""
        return None if self.prices is None else self.prices.cost(self.prompt_tokens, self.completion_tokens)

    @property
    def seconds_left(self) -> float:
        """Until the time of the run is over."""
        limit = self.limits.seconds
        return float("inf") if limit is None else max(0.0, limit - (self.clock.now() - self.started))

    def add(self, call: Call, counted: int = 0) -> None:
        """Count a call, `counted` of whose requests have been counted already."""
        self.requests += call.requests - counted
        self.cached += call.cached
        if call.answer is None or call.cached:
            return
        if call.answer.prompt_tokens is None or call.answer.completion_tokens is None:
            self.unmetered += 1
        self.prompt_tokens += call.answer.prompt_tokens or 0
        self.completion_tokens += call.answer.completion_tokens or 0

    def take_request(self) -> None:
        """Count a request that is about to be sent.

        Raises:
            LimitReachedError: if it must not be sent.
        """
        limits, cost = self.limits, self.cost
        if limits.calls is not None and self.requests >= limits.calls:
            raise LimitReachedError(f"all {limits.calls} calls have been made")
        if limits.seconds is not None and self.seconds_left == 0:
            raise LimitReachedError(f"{limits.seconds:g} s have passed")
        if self.unmetered and (limits.tokens is not None or limits.cost is not None):
            raise LimitReachedError("the endpoint does not say how many tokens it used, so they cannot be limited")
        if limits.tokens is not None and self.tokens >= limits.tokens:
            raise LimitReachedError(f"{self.tokens} of {limits.tokens} tokens have been used")
        if limits.cost is not None and cost is not None and cost >= limits.cost:
            raise LimitReachedError(f"{cost:.4f} of {limits.cost:g} US dollars have been spent")
        self.requests += 1
