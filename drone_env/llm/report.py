"""The report of a run: scores with the optimum of each map, and what answering them took."""

from collections import Counter
from pathlib import Path
from typing import Any

from drone_env.errors import DroneEnvError
from drone_env.files import write_json
from drone_env.llm.answers import Unusable
from drone_env.llm.budget import Budget, Options
from drone_env.llm.run_folder import RESULTS, load_config, results_of, turns_of
from drone_env.llm.runner import verdict_of
from drone_env.llm.verify import VerifiedRun, verified_run
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, map_rows
from drone_env.results.statistics import Summary, mean_of, normalised


def report(run: VerifiedRun) -> LeaderboardEntry:
    """Compute the figures of a run; unknown ones are None.

    Means are over maps: flights over the same map are averaged first. Errored flights do not count. `baselines` are
    the mean scores of random and optimal flights over the same maps. `models` counts the answers by the model that the
    endpoint names; "" if it names none. Tokens are sums over the answers that report their tokens; `without_usage`
    counts the others.
    """
    config, flown = run.config, run.results
    counted = [result for result in flown if result.status != "errored"]
    waits: Counter[int] = Counter()
    for result in counted:
        waits[result.seed] += result.waits
    random = run_episodes(episodes_key(config.task_config, "random", range(*config.seeds), config.split))
    by_seed = dict(zip(random.seeds.tolist(), random.scores.tolist(), strict=True))
    optima = dict(zip(random.seeds.tolist(), random.optimal_scores.tolist(), strict=True))
    results = results_of(config, flown, optima)
    summary, maps, turns = Summary.of(results), map_rows(results), turns_of(flown)
    floor = mean_of([by_seed[row["seed"]] for row in maps])
    verdict, reason = verdict_of(config.flights, [str(result.status) for result in flown])
    budget, unusable = Budget(Options()), Unusable.among(turns)
    budget.resume(run.calls)
    models = Counter(call.answer.model or "" for call in run.calls if call.answer is not None)
    figures: dict[str, Any] = {
        "format": "drone_env/llm-report",
        "config": config.model_dump(mode="json"),
        "models": dict(sorted(models.items())),
        "verdict": verdict,
        "reason": reason,
        "flights": {
            "planned": config.flights,
            "flown": len(flown),
            "counted": len(counted),
            "errored": len(flown) - len(counted),
            "unfinished": sum(not result.ended for result in counted),
        },
        "score": summary.score,
        "score_ci95": summary.score_ci95,
        "success_rate": summary.success_rate,
        "regret": summary.regret,
        "normalised": normalised(summary.score, floor, summary.optimum),
        "baselines": {"random": floor, "optimal": summary.optimum},
        "turns": turns,
        "decisions": Unusable.among(turns_of(counted)).of,
        "steps": sum(result.steps for result in counted),
        "unusable": {**unusable._asdict(), "share": unusable.share, "marked": unusable.marked},
        "waits": sum(result.waits for result in flown),
        "calls": {"answered": budget.answers, "requests": budget.requests, "without_usage": budget.unmetered},
        "tokens": {"prompt": budget.prompt_tokens, "completion": budget.completion_tokens, "total": budget.tokens},
        "maps": [{**row, "waits": waits[row["seed"]]} for row in maps],
    }
    return LeaderboardEntry(run.path, figures, results)


def run_entry(path: Path) -> LeaderboardEntry | NotRanked:
    """The leaderboard entry of a run, which is verified first, or why it is not ranked."""
    try:
        load_config(path)
        if not (path / RESULTS).exists():
            # The results are written at the end.
            return NotRanked(path, "no flights yet: it is running, or was killed (continue: --resume)", damaged=False)
        run = verified_run(path)
    except (DroneEnvError, OSError, ValueError) as error:
        return NotRanked(path, str(error).removeprefix(f"{path}: "), damaged=True)
    entry = report(run)
    if entry.report["verdict"] != "valid":
        return NotRanked(path, f"{entry.report['verdict']}: {entry.report['reason']}", damaged=False)
    return entry


def write_report(entry: LeaderboardEntry) -> None:
    """Write `report.json` into the folder of a run, whole or not at all."""
    write_json(entry.path / "report.json", entry.report)
