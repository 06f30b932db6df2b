"""How a run is made: speed, patience, and what it may spend. None of this changes its results."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from drone_env.errors import InvalidValueError

MOST_CONCURRENCY = 10_000
OPTIONAL = tyro.conf.arg(help_behavior_hint="(optional)")
Number = Annotated[float | None, tyro.conf.arg(metavar="X"), OPTIONAL]
Whole = Annotated[int | None, tyro.conf.arg(metavar="N"), OPTIONAL]


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
class Options:
    """How a run is made. Limits hold for the whole run, its earlier parts counted in.

    Requests are counted one by one. Tokens and money are known only when an answer has come: requests under way when
    a limit is reached are still finished and paid.

    Args:
        concurrency: The most requests at once; fewer when the endpoint is overloaded.
        timeout: Seconds that an answer may take.
        tries: How often a call is tried that meets 408, 409, 429, 5xx or a network failure.
        backoff: Seconds below which the first wait is drawn; the bound doubles each time, up to 30 s.
        requests_per_minute: The most requests a minute, retries counted in, evenly spaced.
        max_calls: Stop after this many requests, retries counted in.
        max_tokens: Stop when this many tokens have been used.
        max_cost: Stop when this many US dollars have been spent.
        price_prompt: US dollars per million prompt tokens.
        price_completion: US dollars per million completion tokens.
        cache: Folder of answers that equal requests of other runs share.
        server: Fly in the server at this address, in the same way.
    """

    concurrency: int = 64
    timeout: float = 120.0
    tries: int = 6
    backoff: float = 1.0
    requests_per_minute: Number = None
    max_calls: Whole = None
    max_tokens: Whole = None
    max_cost: Number = None
    price_prompt: Number = None
    price_completion: Number = None
    cache: Annotated[Path | None, OPTIONAL] = None
    server: Annotated[str | None, OPTIONAL] = None

    def __post_init__(self) -> None:
        for name in ("concurrency", "timeout", "tries", "requests_per_minute", "max_calls", "max_tokens", "max_cost"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise InvalidValueError(f"--{name.replace('_', '-')} must be above 0, got {value}")
        if self.concurrency > MOST_CONCURRENCY or not self.backoff >= 0:
            raise InvalidValueError(f"--concurrency must be at most {MOST_CONCURRENCY}, --backoff 0 s or more")
        if (self.price_prompt is None) != (self.price_completion is None):
            raise InvalidValueError("--price-prompt and --price-completion belong together")
        if self.prices is None and self.max_cost is not None:
            raise InvalidValueError("--max-cost needs prices: give --price-prompt and --price-completion")

    @property
    def prices(self) -> Prices | None:
        """What tokens cost; None where that is not known."""
        if self.price_prompt is None or self.price_completion is None:
            return None
        return Prices(self.price_prompt, self.price_completion)
