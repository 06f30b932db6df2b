"""An episode flown to its end by whoever chooses its actions."""

from collections.abc import Callable, Iterator
from typing import SupportsIndex

from drone_env.core.episode import Episode

Choose = Callable[[Episode], SupportsIndex]
"""Names the next action of an episode in flight."""


def choices(episode: Episode, choose: Choose) -> Iterator[SupportsIndex]:
    """The actions to the end of an episode: the caller flies each before asking for the next."""
    while not episode.ended:
        yield choose(episode)


def rollout(episode: Episode, choose: Choose) -> Episode:
    """Fly an episode to its end and return it."""
    return episode.fly(choices(episode, choose))
