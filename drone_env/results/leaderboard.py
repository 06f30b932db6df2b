"""Results side by side, of agents and of language models: those that are whole, over the same maps of a task."""

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from drone_env.errors import DroneEnvError, InvalidValueError, TooLargeError, UnknownNameError
from drone_env.results.evaluate import EpisodeResults, episodes_key, run_episodes, summarise
from drone_env.results.folder import NotWholeError, kept_results


class Refused(NamedTuple):
    """What is not ranked."""

    path: Path
    reason: str
    damaged: bool
    """Whether it is not what it says; else it is only not whole, or invalid, or of a task that is not known here."""


class Judged(NamedTuple):
    """What is ranked: a run of a language model, or an agent on one of the tasks of an evaluation."""

    path: Path
    figures: dict[str, Any]
    """With `config` (`task`, `task_version`, `seeds`, `split`), `score` and `normalised` among them."""


class Board(NamedTuple):
    """All over the same maps of the same task, best first: by (score - random) / (optimal - random), then by score."""

    task: str
    maps: str
    rows: list[dict[str, Any]]


def judge_evaluation(path: Path, task: str | None = None, most: int | None = None) -> list[Judged | Refused]:
    """The figures of each agent and task in the folder of an evaluation, or why it is not ranked.

    Scores are taken as they are kept, since no actions are; they are held to the optima of their maps.

    Args:
        path: The folder.
        task: Look at this one alone.
        most: Look at no evaluation of more maps.
    """
    try:
        return [Judged(path, _figures(agent, repeats)) for agent, repeats in kept_results(path, task, most)]
    except (NotWholeError, TooLargeError, UnknownNameError) as error:
        return [Refused(path, str(error), damaged=False)]
    except (DroneEnvError, OSError) as error:
        return [Refused(path, str(error), damaged=True)]


def _figures(agent: str, repeats: tuple[EpisodeResults, ...]) -> dict[str, Any]:
    key = repeats[0].key
    random = run_episodes(episodes_key(key.task, "random", range(*key.seeds), key.split))
    best = random.optimal_scores  # NaN where they are not known
    for results in repeats:
        known = np.array_equal(results.optimal_scores, best, equal_nan=True)
        if not known or (results.scores > best).any():
            raise InvalidValueError(f"{agent} on {key.task}: these are no scores, or not of these maps")
    figures, floor = summarise(*repeats), fmean(random.scores)
    above = figures["mean_optimal_score"] and figures["mean_optimal_score"] - floor
    return {
        "format": "drone_env/agent-report",
        "agent": agent,
        "config": {
            "task": key.task,
            "task_version": key.version,
            "split": key.split,
            "seeds": list(key.seeds),
            "repeats": len(repeats),
            "config_hash": key.config_hash,
        },
        "score": figures["mean_score"],
        "score_ci95": figures["score_ci95"],
        "normalised": (figures["mean_score"] - floor) / above if above else None,
        "regret": figures["mean_regret"],
        "success_rate": figures["success_rate"],
        "maps": [
            {
                "seed": seed,
                "scores": [float(results.scores[i]) for results in repeats],
                "optimum": None if np.isnan(best[i]) else float(best[i]),
                "success": sum(int(results.success[i]) for results in repeats),
                "steps": [int(results.steps[i]) for results in repeats],
            }
            for i, seed in enumerate(range(*key.seeds))
        ],
    }


def boards_of(judged: Iterable[Judged]) -> list[Board]:
    """All that is ranked, on the board of its maps."""
    boards: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for path, figures in judged:
        config = figures["config"]
        task = f"{config['task']} version {config['task_version']}"
        maps = f"maps {config['seeds'][0]} to {config['seeds'][1] - 1} ({config['split']})"
        boards[task, maps].append({"path": str(path), **figures})
    return [Board(*key, sorted(rows, key=_merit, reverse=True)) for key, rows in sorted(boards.items())]


def _merit(row: dict[str, Any]) -> tuple[float, float]:
    return float("-inf") if row["normalised"] is None else row["normalised"], row["score"]
