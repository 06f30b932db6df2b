"""Language models as pilots: prompts, the endpoint, answers, runs that can be resumed, reports."""

from drone_env.llm.text_episode import TextEpisode

__all__ = ["TextEpisode"]
