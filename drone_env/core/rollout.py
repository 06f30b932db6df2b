"""An episode flown to its end by a function that chooses each action."""

from collections.abc import Callable, Iterator
from typing import SupportsIndex

from drone_env.core.episode import Episode
from drone_env.core.observation import Observation

Act = Callable[[Observation], SupportsIndex]
"""Chooses an action, as `act` of an agent does."""


def choices(episode: Episode, act: Act) -> Iterator[SupportsIndex]:
    """The actions to the end of an episode: the caller flies each before asking for the next."""
    while not episode.ended:
        yield act(episode.observation())


def rollout(episode: Episode, act: Act) -> Episode:
    """Fly an episode to its end and return it."""
    return episode.fly(choices(episode, act))
