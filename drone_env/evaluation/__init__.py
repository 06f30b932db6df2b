"""Episodes on splits, their results and figures, and the analysis of a flight."""

from drone_env.evaluation.episodes import (
    EpisodeResults,
    EpisodesKey,
    concatenate,
    episodes_key,
    run_episodes,
    summarise,
)

__all__ = ["EpisodeResults", "EpisodesKey", "concatenate", "episodes_key", "run_episodes", "summarise"]
