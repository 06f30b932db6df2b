"""Reward profiles: data that defines the reward of a step. A new profile is a new entry in `REWARD_PROFILES`."""

from dataclasses import dataclass, replace
from decimal import Decimal
from functools import lru_cache
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np

from drone_env.core.actions import N_EVENTS, Event
from drone_env.core.tables import FloatBuffer, as_views, read_only
from drone_env.core.tasks import MAX_SIDE, TaskConfig
from drone_env.errors import InvalidTaskError, UnknownNameError

DEFAULT_PROFILE = "aligned"
"""The default of `Episode`, Gymnasium, training, datasets, `audit`, Inspect and TRL."""
ORIGINAL_PROFILE = "tiered"
"""The default of flat HTTP, the page, `fly`, `infer` and `inference.py`, as in the original project."""

STRIDE = 2 * MAX_SIDE
"""Entries of a potential table per number of deliveries. Distances are smaller."""
MAX_REWARD = 1_000_000


@dataclass(frozen=True)
class RewardProfile:
    """The reward of a step: the sum of all enabled parts. Immutable and hashable.

    Attributes:
        id: Unique name.
        summary: One line of description.
        task_events: Whether the reward of an event is the task's `r_...` number; otherwise it is 0.
        events: Rewards of single events that replace those.
        shaping: Reward per cell by which the distance to the current target decreased.
        clamp: Bounds of the event reward plus its shaping, or None.
        shaping_gamma: Discount of potential-based shaping gamma * phi(s') - phi(s) with
            phi = 0.2 + 0.8/D * (k + 1 - d/(W + H)), and phi = 0 at the end (Ng, Harada, Russell, "Policy invariance
            under reward transformations", ICML 1999); k of D parcels delivered, d to the current target. None for none.
        pays_score: Whether the graded score is added at the end of the episode.
    """

    id: str
    summary: str
    task_events: bool = False
    events: tuple[tuple[Event, Decimal], ...] = ()
    shaping: Decimal = Decimal(0)
    clamp: tuple[Decimal, Decimal] | None = None
    shaping_gamma: Decimal | None = None
    pays_score: bool = False

    def __post_init__(self) -> None:
        numbers: tuple[Any, ...] = (
            self.shaping,
            self.shaping_gamma or Decimal(0),
            *(self.clamp or ()),
            *(v for _, v in self.events),
        )
        if not all(isinstance(n, Decimal) and n.is_finite() and abs(n) <= MAX_REWARD for n in numbers):
            allowed = f"Decimals from -{MAX_REWARD} to {MAX_REWARD}, such as Decimal('0.05')"
            raise InvalidTaskError(f"reward profile {self.id!r}: numbers must be {allowed}")
        if self.clamp is not None and self.clamp[0] > self.clamp[1]:
            bounds = f"{self.clamp[0]} to {self.clamp[1]}"
            raise InvalidTaskError(f"reward profile {self.id!r}: the lower bound of clamp is above the upper: {bounds}")
        if self.shaping_gamma is not None and not 0 <= self.shaping_gamma <= 1:
            raise InvalidTaskError(f"reward profile {self.id!r}: shaping_gamma must be in [0, 1]")

    @property
    def digest(self) -> str:
        """A hash of all fields that affect rewards, 16 hex digits."""
        rules = replace(self, summary="", events=tuple(sorted(self.events)))
        return sha256(repr(rules).encode()).hexdigest()[:16]


_CLAMP = (Decimal("0.01"), Decimal("0.99"))
_TERRAIN_AND_BUMPS = (Event.OBSTACLE, Event.BUILDING, Event.TREE, Event.WALL, Event.BLOCKED)

REWARD_PROFILES: dict[str, RewardProfile] = {
    profile.id: profile
    for profile in (
        RewardProfile(
            id="tiered",
            summary="the task's own reward for each event, plus 0.05 per cell closer, clamped to [0.01, 0.99]",
            task_events=True,
            shaping=Decimal("0.05"),
            clamp=_CLAMP,
        ),
        RewardProfile(
            id="composite",
            summary="step 0.05, wait 0.01, terrain and bumps 0.02, delivery and dead battery as in tiered",
            task_events=True,
            events=(
                (Event.STEP, Decimal("0.05")),
                (Event.WAIT, Decimal("0.01")),
                *((event, Decimal("0.02")) for event in _TERRAIN_AND_BUMPS),
            ),
            shaping=Decimal("0.05"),
            clamp=_CLAMP,
        ),
        RewardProfile(
            id="aligned",
            summary="the graded score at the end, plus potential-based shaping: the profile to train on",
            shaping_gamma=Decimal("0.99"),
            pays_score=True,
        ),
        RewardProfile(id="score", summary="the graded score at the end, nothing else", pays_score=True),
    )
}
"""All known profiles, by id."""
PACKAGE_PROFILES = frozenset(REWARD_PROFILES)
"""The ids of the profiles in this package."""


def get_reward_profile(name: str | RewardProfile) -> RewardProfile:
    """The reward profile with this name; a `RewardProfile` is returned unchanged.

    Raises:
        UnknownNameError: if there is no such profile; the message lists the valid names.
    """
    if isinstance(name, RewardProfile):
        return name
    if name not in list(REWARD_PROFILES):
        raise UnknownNameError("reward profile", name, REWARD_PROFILES)
    return REWARD_PROFILES[name]


def own_profile(name: str) -> RewardProfile | None:
    """The reward profile with this name, or None if it is one of the package. A run must store other profiles."""
    profile = get_reward_profile(name)
    return None if profile.id in PACKAGE_PROFILES else profile


def profile_for_discount(profile: RewardProfile, gamma: float) -> RewardProfile:
    """The profile for a learner with this discount: potential-based shaping uses the same discount."""
    return profile if profile.shaping_gamma is None else replace(profile, shaping_gamma=Decimal(str(gamma)))


class Rewards(NamedTuple):
    """A profile's tables for one task: arrays for compiled code, memory views for interpreted code."""

    events: FloatBuffer
    """float64[events * 3], at event * 3 + delta; delta is 2 if the distance decreased, 1 if it is equal, else 0."""
    potential: FloatBuffer
    """phi(s): float64, at deliveries * STRIDE + distance."""
    discounted: FloatBuffer
    """gamma * phi(s), in the same layout."""
    pays_score: int
    """1 if the score is added at the end."""


@lru_cache(maxsize=64)
def tabulate_rewards(task: TaskConfig, profile: RewardProfile) -> Rewards:
    """The profile's tables for a task as read-only NumPy arrays, for compiled code.

    Every entry is computed exactly and rounded once, so 0.10 + 0.05 is 0.15.
    """
    events = np.zeros(N_EVENTS * 3)
    for event in Event:
        if event is Event.NONE:
            continue
        own = Decimal(str(getattr(task, f"r_{event.name.lower()}"))) if profile.task_events else Decimal(0)
        for delta in (-1, 0, 1):
            value = dict(profile.events).get(event, own) + profile.shaping * delta
            if profile.clamp is not None:
                value = min(max(value, profile.clamp[0]), profile.clamp[1])
            events[event * 3 + delta + 1] = float(value)

    potential = discounted = np.zeros((task.deliveries + 1) * STRIDE)
    if profile.shaping_gamma is not None:
        # phi with a common denominator: division of large integers is correctly rounded, and faster than Fraction.
        span = task.width + task.height
        denominator = 10 * task.deliveries * span
        phi = [
            2 * task.deliveries * span + 8 * ((done + 1) * span - distance)
            for done in range(task.deliveries + 1)
            for distance in range(STRIDE)
        ]
        p, q = profile.shaping_gamma.as_integer_ratio()
        potential = np.array([value / denominator for value in phi])
        discounted = np.array([p * value / (q * denominator) for value in phi])
    tables: Any = (events, potential, discounted, int(profile.pays_score))
    return read_only(Rewards(*tables))


@lru_cache(maxsize=64)
def interpreted_rewards(task: TaskConfig, profile: RewardProfile) -> Rewards:
    """The same tables as memory views, for interpreted code."""
    return as_views(tabulate_rewards(task, profile))
