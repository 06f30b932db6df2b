"""A finished episode as the store gives it."""

from datetime import datetime, timezone
from typing import cast

from pydantic import Field, TypeAdapter, ValidationError
from typing_extensions import Self

from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.core.tasks import get_task
from drone_env.episodes.record import AgentLabel, EpisodeRecord, record_of
from drone_env.errors import EpisodeError, InvalidValueError
from drone_env.models import Count, Message, OutcomeName

AGENT_LABEL: TypeAdapter[str] = TypeAdapter(AgentLabel)


class StoredEpisode(Message):
    """One finished episode."""

    id: str = Field(description="Names the episode in its store.")
    finished_at: datetime = Field(description="When it was stored, UTC.")
    steps: Count = Field(description="Steps flown.")
    deliveries_total: int = Field(ge=1, description="Parcels to deliver.")
    reward_total: float = Field(description="Sum of all rewards.")
    outcome: OutcomeName = Field(description="How it ended.")
    record: EpisodeRecord = Field(description="The flight: task, seed, agent, actions, rewards, score.")

    @classmethod
    def of(cls, episode_id: str, episode: Episode, agent: str) -> Self:
        """The stored form of an episode that has just ended.

        Raises:
            EpisodeError: if it has not ended.
            InvalidValueError: if the agent's name is not one printable line, or the task or the reward profile are not
                those that are known by their names.
            UnknownNameError: if they are not known at all.
        """
        if not episode.started or not episode.ended:
            raise EpisodeError("the episode has not ended: only finished ones are stored")
        task, profile = episode.task, episode.reward_profile
        if get_task(task.id, task.version) != task or get_reward_profile(profile.id) != profile:
            raise InvalidValueError(
                f"task {task.id!r} or reward profile {profile.id!r} are not the registered ones of that name, "
                "so nobody could fly the episode again"
            )
        return cls(
            id=episode_id,
            finished_at=datetime.now(timezone.utc),
            steps=episode.steps,
            deliveries_total=episode.task.deliveries,
            reward_total=episode.reward_total,
            outcome=cast(OutcomeName, episode.outcome.name.lower()),
            record=record_of(episode, check_agent(agent)),
        )


def check_agent(agent: str) -> str:
    """The name of an agent, as records take it.

    Raises:
        InvalidValueError: if it is not one printable line of 1 to 200 characters.
    """
    try:
        return AGENT_LABEL.validate_python(agent, strict=True)
    except ValidationError:
        raise InvalidValueError(
            f"an agent's name is one printable line of 1 to 200 characters, got {agent!r}"
        ) from None
