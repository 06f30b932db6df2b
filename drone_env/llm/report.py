"""The figures of a run: every score beside the exact optimum of its map, and beside other agents on the same maps."""

import math
from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from statistics import fmean
from typing import TYPE_CHECKING, Any

from drone_env.core.episode import Episode
from drone_env.errors import CheckpointError, TooLargeError, UnsupportedTaskError
from drone_env.llm.answers import TURN_KINDS, TurnKind, Unusable
from drone_env.llm.options import Prices
from drone_env.llm.run_folder import PilotedRecord
from drone_env.llm.runner import mean_over_maps, verdict_of
from drone_env.llm.verify import VerifiedRun
from drone_env.results.analysis import analyse_flight
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.interval import SCORES, ci95

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

BASELINES = ("random", "greedy", "pathqnet", "tournet", "optimal")


def report(run: VerifiedRun, prices: Prices | None = None, moves: bool = True) -> dict[str, Any]:
    """The figures of a run, as JSON values; what is not known is null.

    Flights over one map are averaged first, then the maps, so that each map counts as much as for the other agents.
    `score_ci95` (`results.interval`) is null for one map. `normalised` is (score - random) / (optimal - random) of
    the means over the same maps. `unusable` counts the answers that no repair made usable; the run is marked if they
    are more than 5 %.

    Args:
        run: The run.
        prices: What tokens cost.
        moves: Whether to analyse every move, which takes some time for each flight.
    """
    config = run.config
    counted = [result for result in run.results if result.status != "errored"]
    statuses = [result.status for result in run.results]
    verdict, reason = verdict_of(config.flights, [str(status) for status in statuses])
    by_map: dict[int, list[PilotedRecord]] = defaultdict(list)
    for result in counted:
        by_map[result.seed].append(result)
    baselines = _baselines(run, sorted(by_map))
    optima = baselines["optimal"]
    score = mean_over_maps([(result.seed, result.score) for result in counted])
    random = _mean_of(baselines["random"])
    best = _mean_of(optima)
    turns: dict[TurnKind, int] = {name: sum(one.turns.get(name, 0) for one in run.results) for name in TURN_KINDS}
    return {
        "format": "drone_env/llm-report",
        "config": config.model_dump(mode="json"),
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
        "score": score,
        "score_ci95": ci95([fmean(r.score for r in results) for results in by_map.values()], SCORES),
        "success_rate": mean_over_maps([(result.seed, result.success) for result in counted]),
        "pass_hat_k": _pass_hat_k(list(by_map.values())),
        "regret": None
        if optima is None
        else mean_over_maps([(result.seed, optima[result.seed] - result.score) for result in counted]),
        "normalised": None
        if score is None or random is None or best is None or best == random
        else (score - random) / (best - random),
        "baselines": {name: _mean_of(scores) for name, scores in baselines.items()},
        "turns": turns,
        "unusable": Unusable.among(turns).to_dict(),
        "waits": sum(result.waits for result in run.results),
        "moves": _moves(run) if moves else None,
        **_spending(run, prices),
        "maps": [
            {
                "seed": seed,
                "scores": [result.score for result in results],
                "optimum": None if optima is None else optima[seed],
                "success": sum(result.success for result in results),
                "steps": [result.steps for result in results],
                "waits": sum(result.waits for result in results),
            }
            for seed, results in sorted(by_map.items())
        ],
    }


def _baselines(run: VerifiedRun, seeds: Sequence[int]) -> dict[str, dict[int, float] | None]:
    """The scores of other agents by map; None for an agent that cannot fly this task."""
    config = run.config
    found: dict[str, dict[int, float] | None] = {}
    for agent in BASELINES:
        try:
            flown = run_episodes(episodes_key(config.task_config, agent, range(*config.seeds), config.split))
        except (CheckpointError, FileNotFoundError, TooLargeError, UnsupportedTaskError):
            found[agent] = None
            continue
        found[agent] = {seed: float(flown.scores[seed - config.seeds[0]]) for seed in seeds}
    return found


def _mean_of(scores: dict[int, float] | None) -> float | None:
    return fmean(scores.values()) if scores else None


def _pass_hat_k(maps: Sequence[Sequence[PilotedRecord]]) -> dict[str, float]:
    """For each k, the chance that k flights over one map, drawn without replacement, all deliver everything.

    The unbiased estimate C(successes, k) / C(flights, k), averaged over the maps (Yao et al., tau-bench, 2024).
    """
    repeats = min((len(results) for results in maps), default=0)
    found: dict[str, float] = {}
    for k in range(1, repeats + 1):
        chances = [
            math.comb(sum(result.success for result in results), k) / math.comb(len(results), k) for results in maps
        ]
        found[str(k)] = fmean(chances)
    return found


def _moves(run: VerifiedRun) -> dict[str, Any] | None:
    """How many moves have which label; None where the maps are too large for exact values."""
    from drone_env.planning.optimal import solver_of  # loads Numba

    counts: dict[str, int] = defaultdict(int)
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
        for label, count in analysis.counts.items():
            counts[label] += count
        decisive += analysis.decisive
        best += sum(move.margin > 0 and move.regret == 0 for move in analysis.moves)
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
