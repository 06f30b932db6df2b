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
from drone_env.files import write_json, write_text
from drone_env.llm.answers import Unusable
from drone_env.llm.budget import Budget, Options
from drone_env.llm.rejections import described
from drone_env.llm.run_folder import RESULTS, load_config, results_of, turns_of
from drone_env.llm.runner import verdict_of
from drone_env.llm.verify import VerifiedRun, verified_run
from drone_env.results.analysis import LABELS, Move, analyse_actions
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, map_rows
from drone_env.results.statistics import Summary, mean_of, normalised, with_interval
from drone_env.results.tables import Table, known_sum, number, percent

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

NO_PRICES = Options()
BASELINES = ("random", "greedy", "pathqnet", "tournet", "optimal")


def report(run: VerifiedRun, options: Options = NO_PRICES, moves: bool = True) -> dict[str, Any]:
    """The figures of a run as JSON values; unknown ones are null.

    Means are over maps: flights over the same map are averaged first. `score_ci95` (`results.statistics`) is null for
    one map. `normalised` is (score - random) / (optimal - random) of the means over the same maps. `unusable` counts
    the answers that stayed unusable after their repair; above 5 % the run is marked. `models` counts the answers by
    the model that the endpoint names; "" if it names none. `changes` counts them by what their requests sent otherwise
    than the configuration says, because the endpoint rejects it. Tokens and cost are sums over the answers that report
    their tokens; `without_usage` counts the others.

    Args:
        run: The run.
        options: Contain the prices of tokens.
        moves: Whether to analyse every move, which takes time.
    """
    config = run.config
    counted = [result for result in run.results if result.status != "errored"]
    verdict, reason = verdict_of(config.flights, [str(result.status) for result in run.results])
    waits: Counter[int] = Counter()
    for result in counted:
        waits[result.seed] += result.waits
    seeds = sorted(waits)
    baselines = _baselines(run, seeds)
    flown = results_of(config, run.results, dict(zip(seeds, baselines["optimal"] or (), strict=False)))
    summary, maps = Summary.of(flown), map_rows(flown)
    means = {name: None if scores is None else mean_of(scores) for name, scores in baselines.items()}
    turns = turns_of(run.results)
    unusable = Unusable.among(turns)
    return {
        "format": "drone_env/llm-report",
        "config": config.model_dump(mode="json"),
        "models": dict(sorted(Counter(call.answer.model or "" for call in run.calls if call.answer).items())),
        "changes": dict(Counter(text for call in run.calls if call.answer for text in described(call.changes))),
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
        "pass_hat_k": _pass_hat_k([(row["success"], len(row["scores"])) for row in maps]),
        "regret": summary.regret,
        "normalised": normalised(summary.score, means["random"], means["optimal"]),
        "baselines": means,
        "turns": turns,
        "unusable": {**unusable._asdict(), "share": unusable.share, "marked": unusable.marked},
        "waits": sum(result.waits for result in run.results),
        "moves": _moves(run) if moves else None,
        **_spending(run, options),
        "maps": [{**row, "waits": waits[row["seed"]]} for row in maps],
    }


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
    figures = report(run, moves=False)
    if figures["verdict"] != "valid":
        return NotRanked(path, f"{figures['verdict']}: {figures['reason']}", damaged=False)
    optima = {row["seed"]: row["optimum"] for row in figures["maps"]}
    return LeaderboardEntry(path, figures, results_of(run.config, run.results, optima))


def unusable_of(figures: dict[str, Any]) -> Unusable:
    """The unusable answers of a run, from its report."""
    return Unusable(figures["unusable"]["answers"], figures["unusable"]["of"])


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
    """The number of the model's moves by label; None if the maps are too large for exact values.

    A WAIT in place of an unusable answer is no move of the model.
    """
    from drone_env.planning.optimal import solver_of  # loads Numba

    labels: Counter[str] = Counter(dict.fromkeys(LABELS, 0))
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
    return {"labels": dict(labels), "decisive": len(decisive), "accuracy": best / len(decisive) if decisive else None}


def _spending(run: VerifiedRun, options: Options) -> dict[str, Any]:
    budget = Budget(options)
    budget.resume(run.calls, run.requests)
    latencies = [call.latency for call in run.calls if call.answer is not None]
    return {
        "calls": {"answered": len(latencies), "requests": budget.requests, "without_usage": budget.unmetered},
        "tokens": {"prompt": budget.prompt_tokens, "completion": budget.completion_tokens, "total": budget.tokens},
        "cost_usd": budget.cost,
        "latency_median": median_high(latencies) if latencies else None,
    }


def write_report(run: VerifiedRun, figures: dict[str, Any]) -> None:
    """Write `report.json` and `report.md` into the run's folder, each whole or not at all."""
    from drone_env.results.pages import render

    config, verdict = figures["config"], figures["verdict"]
    first, last = config["seeds"][0], config["seeds"][1] - 1
    maps = f"Map {first}" if first == last else f"Maps {first} to {last}"
    repeats = "one flight each" if config["repeats"] == 1 else f"{config['repeats']} flights each"
    text = render(
        "llm.md",
        figures=figures,
        tables=[table for table in _tables(figures) if table.rows],
        title=f"{config['model']} on {config['task']}, prompt {config['prompt']}",
        maps=f"{maps} ({config['split']}), {repeats}.",
        verdict=verdict.upper() if verdict == "invalid" else verdict,
        unusable=unusable_of(figures),
    )
    write_json(run.path / "report.json", figures)
    write_text(run.path / "report.md", text)


def _tables(figures: dict[str, Any]) -> list[Table]:
    """The tables of the report, in order."""
    moves: dict[str, Any] = figures["moves"] or {"labels": {}}
    agents = [("this model", _score(figures)), *((name, number(mean)) for name, mean in figures["baselines"].items())]
    return [
        Table("Result", (), _result(figures)),
        Table("On the same maps", ("who", "mean score"), agents if figures["score"] is not None else []),
        Table("Answers", ("outcome", "requests for actions"), [(name, str(n)) for name, n in figures["turns"].items()]),
        Table("Moves", ("move", "count"), [(label, str(n)) for label, n in moves["labels"].items()]),
        Table("Spent", (), _spent(figures)),
        Table(
            "Not finished",
            ("map", "flight over it", "status", "why"),
            [(str(f["seed"]), str(f["repeat"] + 1), f["status"], f["error"] or "") for f in figures["not_finished"]],
        ),
    ]


def _score(figures: dict[str, Any]) -> str:
    return with_interval(figures["score"], figures["score_ci95"])


def _result(figures: dict[str, Any]) -> list[tuple[str, str]]:
    flights, moves = figures["flights"], figures["moves"]
    rows = [
        ("score (95 %)", _score(figures)),
        ("unusable answers", str(unusable_of(figures))),
        ("delivered all", percent(figures["success_rate"])),
        *((f"pass^{k}", percent(share)) for k, share in figures["pass_hat_k"].items() if k != "1"),
        ("regret", number(figures["regret"])),
        ("(score - random) / (optimal - random)", number(figures["normalised"])),
        ("flights planned, flown", f"{flights['planned']}, {flights['flown']}"),
        ("errored, left out", str(flights["errored"])),
        ("unfinished, counted as waiting to the end", str(flights["unfinished"])),
        ("WAIT in place of an unusable answer", str(figures["waits"])),
        *((f"answers for which {text}", str(answers)) for text, answers in figures["changes"].items()),
    ]
    return rows if moves is None else [*rows, ("best moves where it mattered", percent(moves["accuracy"]))]


def _spent(figures: dict[str, Any]) -> list[tuple[str, str]]:
    calls, tokens, missing = figures["calls"], figures["tokens"], figures["calls"]["without_usage"]
    return [
        ("requests; answers", f"{calls['requests']}; {calls['answered']}"),
        ("tokens: prompt", known_sum(tokens["prompt"], missing, "d")),
        ("tokens: completion", known_sum(tokens["completion"], missing, "d")),
        ("answers without a count of tokens", str(missing)),
        ("cost in US dollars", known_sum(figures["cost_usd"], missing, ".4f")),
        ("median seconds for an answer", number(figures["latency_median"], ".2f")),
    ]
