"""The figures of a run: every score beside the exact optimum of its map, and beside other agents on the same maps."""

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

from drone_env.core.episode import Episode
from drone_env.errors import CheckpointError, DroneEnvError, TooLargeError, UnsupportedTaskError
from drone_env.llm.answers import TURN_KINDS, TurnKind, Unusable
from drone_env.llm.options import Prices
from drone_env.llm.run_folder import RESULTS, PilotedRecord, load_config, results_of
from drone_env.llm.runner import verdict_of
from drone_env.llm.verify import VerifiedRun, verified_run
from drone_env.results.analysis import analyse_flight
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked
from drone_env.results.statistics import Summary, mean_of, normalised

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

BASELINES = ("random", "greedy", "pathqnet", "tournet", "optimal")


def report(run: VerifiedRun, prices: Prices | None = None, moves: bool = True) -> dict[str, Any]:
    """The figures of a run, as JSON values; what is not known is null.

    Flights over one map are averaged first, then the maps, so that each map counts as much as for the other agents.
    `score_ci95` (`results.statistics`) is null for one map. `normalised` is (score - random) / (optimal - random) of
    the means over the same maps. `unusable` counts the answers that no repair made usable; the run is marked if they
    are more than 5 %. `models` counts the answers by the model that the endpoint names in them; "" if it names none.

    Args:
        run: The run.
        prices: What tokens cost.
        moves: Whether to analyse every move, which takes some time for each flight.
    """
    config = run.config
    counted = [result for result in run.results if result.status != "errored"]
    verdict, reason = verdict_of(config.flights, [str(result.status) for result in run.results])
    by_map: dict[int, list[PilotedRecord]] = defaultdict(list)
    for result in sorted(counted, key=lambda result: result.seed):
        by_map[result.seed].append(result)
    baselines = _baselines(run, list(by_map))
    best = baselines["optimal"]
    optimum: dict[int, float] = {} if best is None else dict(zip(by_map, best, strict=True))
    summary = Summary.of(results_of(config, run.results, optimum))
    means = {name: None if scores is None else mean_of(scores) for name, scores in baselines.items()}
    turns: dict[TurnKind, int] = {name: sum(one.turns.get(name, 0) for one in run.results) for name in TURN_KINDS}
    return {
        "format": "drone_env/llm-report",
        "config": config.model_dump(mode="json"),
        "models": dict(sorted(Counter(call.answer.model or "" for call in run.calls if call.answer).items())),
        "verdict": verdict,
        "reason": reason,
        "flights": {
            "planned": config.flights,
            "flown": len(run.results),
            "counted": len(counted),
            "errored": len(run.results) - len(counted),
            "unfinished": sum(not result.ended for result in counted),
        },
        "not_finished": [
            {"seed": r.seed, "repeat": r.repeat, "status": r.status, "error": r.error}
            for r in run.results
            if r.status != "finished"
        ],
        "score": summary.score,
        "score_ci95": summary.score_ci95,
        "success_rate": summary.success_rate,
        "pass_hat_k": _pass_hat_k(list(by_map.values())),
        "regret": summary.regret,
        "normalised": normalised(summary.score, means["random"], means["optimal"]),
        "baselines": means,
        "turns": turns,
        "unusable": Unusable.among(turns).to_dict(),
        "waits": sum(result.waits for result in run.results),
        "moves": _moves(run) if moves else None,
        **_spending(run, prices),
        "maps": [
            {
                "seed": seed,
                "scores": [result.score for result in flights],
                "optimum": optimum.get(seed),
                "success": sum(result.success for result in flights),
                "steps": [result.steps for result in flights],
                "waits": sum(result.waits for result in flights),
            }
            for seed, flights in by_map.items()
        ],
    }


def run_entry(path: Path) -> LeaderboardEntry | NotRanked:
    """The leaderboard entry of a run, which is checked first, or why it is not ranked."""
    try:
        load_config(path)
        if not (path / RESULTS).exists():
            # Written at the end of each part of a run.
            under_way = "no flights yet: it is under way, or was killed and can be gone on with (--resume)"
            return NotRanked(path, under_way, damaged=False)
        run = verified_run(path)
    except (DroneEnvError, OSError, ValueError) as error:
        return NotRanked(path, str(error).removeprefix(f"{path}: "), damaged=True)
    figures = report(run, moves=False)
    if figures["verdict"] != "valid":
        return NotRanked(path, f"{figures['verdict']}: {figures['reason']}", damaged=False)
    return LeaderboardEntry(path, figures)


def unusable_of(figures: dict[str, Any]) -> Unusable:
    """The unusable answers of a run, from the figures of its report."""
    return Unusable(figures["unusable"]["answers"], figures["unusable"]["of"])


def _baselines(run: VerifiedRun, seeds: Sequence[int]) -> dict[str, list[float] | None]:
    """The scores of other agents on maps of the run; None for an agent that cannot fly this task."""
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


def _pass_hat_k(maps: Sequence[Sequence[PilotedRecord]]) -> dict[str, float]:
    """For each k, the chance that k flights over one map, drawn without replacement, all deliver everything.

    The unbiased estimate C(successes, k) / C(flights, k), averaged over the maps (Yao et al., tau-bench, 2024).
    """
    counts = [(sum(result.success for result in flights), len(flights)) for flights in maps]
    repeats = min((flights for _, flights in counts), default=0)
    return {
        str(k): fmean(math.comb(successes, k) / math.comb(flights, k) for successes, flights in counts)
        for k in range(1, repeats + 1)
    }


def _moves(run: VerifiedRun) -> dict[str, Any] | None:
    """How many moves have which label; None where the maps are too large for exact values."""
    from drone_env.planning.optimal import solver_of  # loads Numba

    counts: Counter[str] = Counter()
    best = decisive = 0

    @lru_cache(maxsize=1)
    def solver(seed: int) -> "Solver":
        return solver_of(Episode(run.config.task_config, seed=seed))

    # All flights over a map, one after another: what takes time is its solver.
    for result, record in sorted(zip(run.results, run.records, strict=True), key=lambda pair: pair[1].seed):
        if result.status == "errored":
            continue
        try:
            analysis = analyse_flight(record, lambda start: solver(start.seed))
        except TooLargeError:
            return None
        counts.update(analysis.counts)
        decisive += analysis.decisive
        best += analysis.decisive_best
    return {"labels": dict(counts), "decisive": decisive, "accuracy": best / decisive if decisive else None}


def _spending(run: VerifiedRun, prices: Prices | None) -> dict[str, Any]:
    paid = [call.answer for call in run.calls if call.answer is not None and not call.cached]
    prompt = sum(answer.prompt_tokens or 0 for answer in paid)
    completion = sum(answer.completion_tokens or 0 for answer in paid)
    latencies = sorted(call.latency for call in run.calls if call.answer is not None and not call.cached)
    return {
        "calls": {
            "answered": len(paid),
            "cached": sum(call.cached for call in run.calls),
            "requests": sum(call.requests for call in run.calls),
            "without_usage": sum(a.prompt_tokens is None or a.completion_tokens is None for a in paid),
        },
        "tokens": {"prompt": prompt, "completion": completion},
        "cost_usd": None if prices is None else prices.cost(prompt, completion),
        "latency_median": latencies[len(latencies) // 2] if latencies else None,
    }


def write_report(run: VerifiedRun, figures: dict[str, Any]) -> None:
    """Write `report.json`, `report.md` and `report.html` into the run's folder, each whole or not at all.

    Raises:
        OSError: if they cannot be written.
    """
    from drone_env.llm.report_plots import plots
    from drone_env.llm.report_tables import page_values
    from drone_env.results.pages import render, write_pages

    values = page_values(figures)
    page = render("llm.html", **values, plots=plots(figures))
    write_pages(run.path, figures, {"report.md": render("llm.md", **values), "report.html": page})
