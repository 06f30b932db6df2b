"""Observations of OpenEnv sessions as text."""

from typing import Any

from drone_env.core.episode import Episode
from drone_env.llm.prompt import Prompt


def full_text(prompt: Prompt, episode: Episode) -> str:
    """Return the text of a prompt: the rules of the task, and the observation."""
    return "\n\n".join(message["content"] for message in prompt.messages(episode))


def openenv_fields(episode: Episode, prompt: Prompt | None, metadata: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a `WireObservation` that no `DroneObservation` has, without `reward`.

    Args:
        episode: The episode.
        prompt: The prompt of the reset.
        metadata: Further fields of `metadata`.
    """
    return {
        "prompt": "" if prompt is None else full_text(prompt, episode),
        "metadata": {"reward_profile": episode.reward_profile.id, **metadata},
    }
