"""The report of a run: scores with the optimum of each map and the scores of other agents on the same maps."""

import math
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from statistics import fmean, median_high
from typing import TYPE_CHECKING, Any

import numpy as np

from drone_env.core.episode import Episode
from drone_env.errors import CheckpointError, DroneEnvError, TooLargeError, UnsupportedTaskError
from drone_env.files import write_json
from drone_env.llm.answers import Unusable
from drone_env.llm.budget import Budget, Options
from drone_env.llm.rejections import described
from drone_env.llm.run_folder import RESULTS, load_config, results_of, turns_of
from drone_env.llm.runner import verdict_of
from drone_env.llm.verify import VerifiedRun, verified_run
from drone_env.results.analysis import LABELS, Label, Move, analyse_actions
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, map_rows
from drone_env.results.statistics import Summary, mean_of, normalised

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

NO_PRICES = Options()
BASELINES = ("random", "greedy", "nearest", "beam", "pathqnet", "tournet", "optimal")


def report(run: VerifiedRun, options: Options = NO_PRICES, moves: bool = True) -> LeaderboardEntry:
    """Compute the figures of a run; unknown ones are None.

    Means are over maps: flights over the same map are averaged first. Errored flights do not count. `baselines` are
    the mean scores of other agents over the same maps, `pass_hat_k` the chance that k flights over one map all deliver
    everything. `models` counts the answers by the model that the endpoint names; "" if it names none. Tokens and cost
    are sums over the answers that report their tokens; `without_usage` counts the others.

    Args:
        run: The run.
        options: Contain the prices of tokens.
        moves: Whether to analyse every move, which takes time.
    """
    config, flown = run.config, run.results
    counted = [result for result in flown if result.status != "errored"]
    waits: Counter[int] = Counter()
    for result in counted:
        waits[result.seed] += result.waits
    seeds = sorted(waits)
    scores = _baselines(run, seeds)
    baselines = {name: None if found is None else mean_of(found) for name, found in scores.items()}
    results = results_of(config, flown, dict(zip(seeds, scores["optimal"] or (), strict=False)))
    summary, maps, turns = Summary.of(results), map_rows(results), turns_of(flown)
    verdict, reason = verdict_of(config.flights, [str(result.status) for result in flown])
    answered = [call for call in run.calls if call.answer is not None]
    budget, unusable, named = Budget(options), Unusable.among(turns), ("seed", "repeat", "status", "error")
    budget.resume(run.calls)
    figures: dict[str, Any] = {
        "format": "drone_env/llm-report",
        "config": config.model_dump(mode="json"),
        "models": dict(sorted(Counter(call.answer.model or "" for call in answered if call.answer).items())),
        "changes": dict(Counter(text for call in answered for text in described(call.changes))),
        "verdict": verdict,
        "reason": reason,
        "flights": {
            "planned": config.flights,
            "flown": len(flown),
            "counted": len(counted),
            "errored": len(flown) - len(counted),
            "unfinished": sum(not result.ended for result in counted),
        },
        "not_finished": [
            {name: getattr(result, name) for name in named} for result in flown if result.status != "finished"
        ],
        "score": summary.score,
        "score_ci95": summary.score_ci95,
        "success_rate": summary.success_rate,
        "pass_hat_k": _pass_hat_k([(row["success"], len(row["scores"])) for row in maps]),
        "regret": summary.regret,
        "normalised": normalised(summary.score, baselines["random"], baselines["optimal"]),
        "baselines": baselines,
        "turns": turns,
        "unusable": {**unusable._asdict(), "share": unusable.share, "marked": unusable.marked},
        "waits": sum(result.waits for result in flown),
        "moves": _moves(run) if moves else None,
        "calls": {"answered": budget.answers, "requests": budget.requests, "without_usage": budget.unmetered},
        "tokens": {"prompt": budget.prompt_tokens, "completion": budget.completion_tokens, "total": budget.tokens},
        "cost_usd": budget.cost,
        "latency_median": median_high(call.latency for call in answered) if answered else None,
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
    entry = report(run, moves=False)
    if entry.report["verdict"] != "valid":
        return NotRanked(path, f"{entry.report['verdict']}: {entry.report['reason']}", damaged=False)
    return entry


def _baselines(run: VerifiedRun, seeds: Sequence[int]) -> dict[str, list[float] | None]:
    """The scores of other agents on the same maps; None for an agent that does not support the task."""
    config = run.config
    rows = np.array(seeds, np.int64) - config.seeds[0]
    found: dict[str, list[float] | None] = {}
    for agent in BASELINES:
        try:
            flown = run_episodes(episodes_key(config.task_config, agent, range(*config.seeds), config.split))
        except (CheckpointError, FileNotFoundError, TooLargeError, UnsupportedTaskError):
            found[agent] = None
        else:
            found[agent] = flown.scores[rows].tolist()
    return found


def _pass_hat_k(counts: Sequence[tuple[int, int]]) -> dict[str, float]:
    """For each k, the chance that k flights over one map, drawn without replacement, all deliver everything.

    The unbiased estimate C(successes, k) / C(flights, k), averaged over the maps (Yao et al., tau-bench, 2024).
    """
    repeats = min((flights for _, flights in counts), default=0)
    return {
        str(k): fmean(math.comb(successes, k) / math.comb(flights, k) for successes, flights in counts)
        for k in range(1, repeats + 1)
    }


def _moves(run: VerifiedRun) -> dict[str, Any] | None:
    """The model's moves by label, decisive ones, and the share of best ones among these; None on too large maps.

    A WAIT in place of an unusable answer is no move of the model.
    """
    from drone_env.planning.optimal import solver_of  # loads Numba

    labels: Counter[Label] = Counter(dict.fromkeys(LABELS, 0))
    decisive: list[Move] = []

    @lru_cache(maxsize=1)
    def solver(seed: int) -> "Solver":
        return solver_of(Episode(run.config.task_config, seed=seed))

    # Sorted by map, since its solver takes the time.
    for flight in sorted(run.flights, key=lambda flight: flight.episode.seed):
        if flight.status == "errored":
            continue
        start = Episode(flight.episode.task, "score", flight.episode.seed)
        try:
            analysis = analyse_actions(
                start, flight.episode.actions, run.config.model, lambda start: solver(start.seed)
            )
        except TooLargeError:
            return None
        moves = [move for move, error in zip(analysis.moves, flight.step_errors, strict=True) if error is None]
        labels.update(move.label for move in moves)
        decisive += (move for move in moves if move.margin > 0)
    best = sum(move.regret == 0 for move in decisive)
    accuracy = best / len(decisive) if decisive else None
    return {"labels": dict(labels), "decisive": len(decisive), "accuracy": accuracy}


def write_report(entry: LeaderboardEntry) -> None:
    """Write `report.json` into the folder of a run, whole or not at all."""
    write_json(entry.path / "report.json", entry.report)
