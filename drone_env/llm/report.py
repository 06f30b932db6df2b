"""The report of a run: scores with the optimum of each map, and what answering them took."""

from pathlib import Path
from typing import Any

from drone_env.errors import DroneEnvError
from drone_env.files import write_json
from drone_env.llm.answers import Unusable
from drone_env.llm.run_folder import Run, read_run, turns_of
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked
from drone_env.results.statistics import Summary, mean_of, normalised


def report(run: Run) -> LeaderboardEntry:
    """Compute the figures of a run; unknown ones are None.

    Means are over maps: flights over the same map are averaged first. Errored flights do not count. `baselines` are
    the mean scores of random and optimal flights over the same maps. `models` counts the answers by the model that the
    endpoint names; "" if it names none. Tokens are sums over the answers that report their tokens; `without_usage`
    counts the others.
    """
    config, budget, counted = run.config, run.budget, run.counted
    random = run_episodes(episodes_key(config.task_config, "random", range(*config.seeds), config.split))
    by_seed = dict(zip(random.seeds.tolist(), random.scores.tolist(), strict=True))
    results = run.results(dict(zip(random.seeds.tolist(), random.optimal_scores.tolist(), strict=True)))
    summary, turns = Summary.of(results), turns_of(run.flights)
    floor, unusable = mean_of([by_seed[seed] for seed in {one.seed for one in counted}]), Unusable.among(turns)
    verdict, reason = run.verdict
    figures: dict[str, Any] = {
        "format": "drone_env/llm-report",
        "config": config.model_dump(mode="json"),
        "models": dict(sorted(budget.models.items())),
        "verdict": verdict,
        "reason": reason,
        "flights": {
            "planned": config.flights,
            "flown": len(run.flights),
            "counted": len(counted),
            "errored": len(run.flights) - len(counted),
            "unfinished": sum(not flight.episode.ended for flight in counted),
        },
        "score": summary.score,
        "score_ci95": summary.score_ci95,
        "success_rate": summary.success_rate,
        "regret": summary.regret,
        "normalised": normalised(summary.score, floor, summary.optimum),
        "baselines": {"random": floor, "optimal": summary.optimum},
        "turns": turns,
        "decisions": Unusable.among(turns_of(counted)).of,
        "steps": sum(flight.episode.steps for flight in counted),
        "unusable": {**unusable._asdict(), "share": unusable.share, "marked": unusable.marked},
        "waits": sum(flight.waits for flight in run.flights),
        "calls": {"answered": budget.answers, "requests": budget.requests, "without_usage": budget.unmetered},
        "tokens": {"prompt": budget.prompt_tokens, "completion": budget.completion_tokens, "total": budget.tokens},
    }
    return LeaderboardEntry(run.path, results, floor, figures)


def run_entry(path: Path) -> LeaderboardEntry | NotRanked:
    """The leaderboard entry of a run, which is flown again first, or why it is not ranked."""
    try:
        run = read_run(path)
    except (DroneEnvError, OSError, ValueError) as error:
        return NotRanked(path, str(error).removeprefix(f"{path}: "))
    verdict, reason = run.verdict
    return report(run) if verdict == "valid" else NotRanked(path, f"{verdict}: {reason}")


def write_report(entry: LeaderboardEntry) -> None:
    """Write `report.json` into the folder of a run, whole or not at all."""
    write_json(entry.path / "report.json", entry.report)
