"""One OpenEnv session: an episode, the name that its client gave it, and what the wire carries of it."""

import uuid
from typing import Any

from pydantic import Field

from drone_env.core.episode import Episode
from drone_env.models import DroneObservation, DroneState
from drone_env.server.map_choice import DEFAULT_TASK, start_episode
from drone_env.server.schemas import ResetOptions

ENV_NAME = "drone-env"
DESCRIPTION = (
    "A drone delivers parcels on a generated city grid, on one battery, in as few steps as possible. Maps are solved "
    "exactly, so every score stands beside the optimum of its map."
)


class WireObservation(DroneObservation):
    """An observation with all that OpenEnv adds."""

    reward: float | None = Field(default=None, description="What the step paid; null after a reset.")
    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Empty.")


class Session:
    """One session. Before the first reset `step` and the readers raise `EpisodeError`.

    Args:
        task: The task of a reset that names none.

    Raises:
        UnknownNameError: if there is no such task.
    """

    def __init__(self, task: str = DEFAULT_TASK) -> None:
        self.default_task = task
        self.episode = Episode(task)
        self.episode_id: str | None = None
        self.agent: str | None = None
        self.stored = False
        """Whether the episode, once ended, is in the store."""

    def reset(self, options: ResetOptions) -> None:
        """Start an episode. On an error the running one is left as it was.

        Raises:
            UnknownNameError: if there is no such task, profile or split.
            InvalidValueError: if the split has no such map.
        """
        last = self.episode.seed if self.episode.started else None
        self.episode = start_episode(options, last, self.default_task)
        self.episode_id = options.episode_id if options.episode_id is not None else str(uuid.uuid4())
        self.agent = options.agent
        self.stored = False

    def state(self) -> DroneState:
        """The full state."""
        return DroneState.of(self.episode).model_copy(update={"episode_id": self.episode_id})
