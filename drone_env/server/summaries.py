"""Finished episodes as the page lists them."""

from typing import Any

from pydantic import Field

from drone_env.flights.episodes import EpisodeSummary
from drone_env.flights.store import Store
from drone_env.server.pilots import display_name


class ListedEpisode(EpisodeSummary):
    """One row of a list of finished episodes."""

    name: str = Field(description="`agent` for people.")


def listed(store: Store, n: int, *filters: Any, **more: Any) -> list[ListedEpisode]:
    """The last `n` finished episodes, newest first. Arguments and errors as `Store.listed`."""
    return [
        ListedEpisode(**vars(row), name=display_name(store.provenance(row.id)))
        for row in store.listed(n, *filters, **more)
    ]
