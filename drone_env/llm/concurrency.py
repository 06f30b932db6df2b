"""The search for the number of requests at once that an endpoint can use.

A limit on latency alone would not do. Answers differ in length by a factor of ten, and the first answer of a local
server waits for its model to load. So the search compares neighbours, per token, again and again.
"""

import math
from collections import Counter
from dataclasses import dataclass

SMALL, LARGE = 4, 16
"""Fewest and most requests that measure a number of requests at once."""
LATE = 0.25
"""Share of them that need not have an answer: a few answers take many times longer than the others."""
MAX_FAILED = 0.1
"""Share of failed requests that counts as an overload."""
MIN_GAIN = 1.2
"""Throughput that twice as many requests at once must bring."""
MAX_REST = 16
"""Most rounds until a number that was no better is tried again."""
PROMPT_TOKENS = 32
"""Tokens of an answer that take about as long as its request and its prompt."""


@dataclass(eq=False)
class Round:
    """Requests that were all sent under one limit, and the time that their answers took.

    Attributes:
        early: Number of requests to leave out, until the endpoint has as many as the limit allows.
        unsent: Number of requests still to send.
        late: Number of its requests that may be open at its end.
        open: Number of its open requests.
        failed: Number of failed requests under its limit, in this round or not.
        peak: Largest number of requests at once.
        seconds: Seconds of its answers.
        tokens: Tokens of its answers.
    """

    early: int
    unsent: int
    late: int
    open: int = 0
    failed: int = 0
    peak: int = 0
    seconds: float = 0.0
    tokens: float = 0.0


class ConcurrencySearch:
    """Searches the smallest number of requests at once that brings the most answers.

    A server that answers one request at a time takes twice as long for two; a server that batches does not. A round
    measures the seconds per token under one limit. Twice as many requests must raise the throughput by `MIN_GAIN`, else
    half as many are enough. An overload is no gain. A limit that was no better is tried again after 4, 8 and then every
    16 rounds, since one round can mislead, and endpoints change.

    Args:
        first: The first limit.
        most: The highest one.

    Attributes:
        limit: Maximum number of open requests.
    """

    def __init__(self, first: int, most: int) -> None:
        self._most = most
        self._seconds: dict[int, float] = {}
        """Seconds per token by limit; infinite if it overloads the endpoint."""
        self._expiry: dict[int, int] = {}
        """The round from which the seconds of a limit are out of date."""
        self._rejected: Counter[int] = Counter()
        self._rounds = 0
        self._begin(min(first, most), early=min(first, most))

    def _begin(self, limit: int, early: int = 0) -> None:
        self.limit = limit
        size = min(max(limit, SMALL), LARGE)
        self._round = Round(early, size, late=int(LATE * size))

    def sent(self, active: int) -> Round:
        """The round of a request, the last of `active` open requests; one of its own if it is not measured."""
        now = self._round
        now.peak = max(now.peak, active)
        if now.early or not now.unsent:
            now.early -= now.early > 0
            return Round(0, 0, 0)
        now.unsent -= 1
        now.open += 1
        return now

    def closed(self, of: Round) -> None:
        """Count a request that is no longer open; decide after the last one of a round."""
        of.open -= 1
        if of is not self._round or of.open > of.late or of.unsent:
            return
        if of.peak < self.limit or not of.tokens:
            # Too few flights or answers to judge this limit.
            self._begin(self.limit)
            return
        self._rounds += 1
        self._choose(of.seconds / of.tokens)

    def _choose(self, seconds: float) -> None:
        """Choose the next limit, after a round with these seconds per token."""
        lower, limit, upper = self._lower(), self.limit, min(2 * self.limit, self._most)
        last = self._seconds.get(limit, math.inf)
        self._seconds[limit] = seconds if last == math.inf else (seconds + last) / 2
        for other in {lower, upper} - {limit}:
            if self._expiry.get(other, 0) <= self._rounds:
                self._seconds.pop(other, None)
        known = self._seconds
        if lower in known and not self._pays(lower, limit):
            self._move(lower)
        elif upper != limit and (upper not in known or self._pays(limit, upper)):
            self._move(upper)
        elif lower not in known:
            self._move(lower)
        else:
            self._rejected[limit] = 0
            self._begin(limit)

    def failed(self, overload: bool) -> None:
        """Halve the limit if a request failed by an overload, or too many failed."""
        self._round.failed += 1
        if not overload and self._round.failed <= MAX_FAILED * self.limit:
            return
        if self.limit == 1:
            self._begin(1)
            return
        self._seconds[self.limit] = math.inf
        self._move(self._lower())

    def _lower(self) -> int:
        """The power of two below the limit; 1 if it is 1."""
        return 1 << max(0, (self.limit - 1).bit_length() - 1)

    def _pays(self, few: int, many: int) -> bool:
        gain = MIN_GAIN ** math.log2(many / few)
        return many * self._seconds[few] >= few * self._seconds[many] * gain

    def _move(self, limit: int) -> None:
        left, rest = self.limit, MAX_REST
        if limit < left:
            self._rejected[left] += 1
            rest = min(MAX_REST, 2 << self._rejected[left])
        self._expiry[left] = self._rounds + rest
        self._begin(limit, early=max(0, limit - left))
