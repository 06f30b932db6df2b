"""The report of a run: scores with the optimum of each map and the scores of other agents on the same maps."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from statistics import fmean, median_high
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drone_env.core.episode import Episode
from drone_env.errors import CheckpointError, DroneEnvError, TooLargeError, UnsupportedTaskError
from drone_env.files import write_json, write_text
from drone_env.llm.answers import TurnKind, Unusable
from drone_env.llm.budget import Budget, Options
from drone_env.llm.rejections import described
from drone_env.llm.run_folder import RESULTS, FlightResult, load_config, results_of, turns_of
from drone_env.llm.runner import Verdict, verdict_of
from drone_env.llm.verify import VerifiedRun, verified_run
from drone_env.results.analysis import LABELS, Label, Move, analyse_actions
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, map_rows
from drone_env.results.result import Results
from drone_env.results.statistics import Summary, mean_of, normalised, with_interval
from drone_env.results.tables import Table, known_sum, number, percent

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

NO_PRICES = Options()
BASELINES = ("random", "greedy", "pathqnet", "tournet", "optimal")


class MoveCounts(NamedTuple):
    """The number of the model's moves by label, of decisive ones, and the share of best ones among these."""

    labels: dict[Label, int]
    decisive: int
    accuracy: float | None


@dataclass(frozen=True)
class RunReport:
    """The figures of a run; unknown ones are None. Means are over maps: flights over the same map are averaged first.

    Attributes:
        run: The run.
        verdict, reason: Its verdict, and why it is not valid.
        results: The flights that count: all that did not error.
        summary: Their statistics.
        waits: Number of steps by map that are a WAIT because the answer was unusable.
        baselines: The mean scores of other agents over the same maps; None for an agent that does not support the task.
        pass_hat_k: For each k, the chance that k flights over one map all deliver everything.
        turns: Number of requests for actions by outcome.
        changes: Number of answers by what their requests sent otherwise, because the endpoint rejects the original.
        moves: The model's moves; None if they are not analysed, or the maps are too large for exact values.
        budget: Requests and tokens.
        latency_median: The median of the seconds for an answer.
    """

    run: VerifiedRun
    verdict: Verdict
    reason: str
    results: Results
    summary: Summary
    waits: Counter[int]
    baselines: dict[str, float | None]
    pass_hat_k: dict[str, float]
    turns: dict[TurnKind, int]
    changes: dict[str, int]
    moves: MoveCounts | None
    budget: Budget
    latency_median: float | None

    @property
    def unusable(self) -> Unusable:
        """The answers that stayed unusable after their repair; above 5 % the run is marked."""
        return Unusable.among(self.turns)

    @property
    def normalised(self) -> float | None:
        """(score - random) / (optimal - random) of the means over the same maps."""
        return normalised(self.summary.score, self.baselines["random"], self.baselines["optimal"])

    @property
    def flights(self) -> dict[str, int]:
        """Number of flights that were planned, flown, counted, errored, and not flown to their end."""
        flown = self.run.results
        errored = sum(result.status == "errored" for result in flown)
        return {
            "planned": self.run.config.flights,
            "flown": len(flown),
            "counted": len(flown) - errored,
            "errored": errored,
            "unfinished": sum(not result.ended and result.status != "errored" for result in flown),
        }

    @property
    def not_finished(self) -> list[FlightResult]:
        """The flights that did not finish."""
        return [result for result in self.run.results if result.status != "finished"]

    def to_json(self) -> dict[str, Any]:
        """The report as JSON values.

        `models` counts the answers by the model that the endpoint names; "" if it names none. Tokens and cost are sums
        over the answers that report their tokens; `without_usage` counts the others.
        """
        calls, budget, unusable = self.run.calls, self.budget, self.unusable
        named = ("seed", "repeat", "status", "error")
        return {
            "format": "drone_env/llm-report",
            "config": self.run.config.model_dump(mode="json"),
            "models": dict(sorted(Counter(call.answer.model or "" for call in calls if call.answer).items())),
            "changes": self.changes,
            "verdict": self.verdict,
            "reason": self.reason,
            "flights": self.flights,
            "not_finished": [{name: getattr(result, name) for name in named} for result in self.not_finished],
            "score": self.summary.score,
            "score_ci95": self.summary.score_ci95,
            "success_rate": self.summary.success_rate,
            "pass_hat_k": self.pass_hat_k,
            "regret": self.summary.regret,
            "normalised": self.normalised,
            "baselines": self.baselines,
            "turns": self.turns,
            "unusable": {**unusable._asdict(), "share": unusable.share, "marked": unusable.marked},
            "waits": sum(result.waits for result in self.run.results),
            "moves": self.moves and self.moves._asdict(),
            "calls": {"answered": budget.answers, "requests": budget.requests, "without_usage": budget.unmetered},
            "tokens": {"prompt": budget.prompt_tokens, "completion": budget.completion_tokens, "total": budget.tokens},
            "cost_usd": budget.cost,
            "latency_median": self.latency_median,
            "maps": [{**row, "waits": self.waits[row["seed"]]} for row in map_rows(self.results)],
        }


def report(run: VerifiedRun, options: Options = NO_PRICES, moves: bool = True) -> RunReport:
    """Compute the figures of a run.

    Args:
        run: The run.
        options: Contain the prices of tokens.
        moves: Whether to analyse every move, which takes time.
    """
    waits: Counter[int] = Counter()
    for result in run.results:
        if result.status != "errored":
            waits[result.seed] += result.waits
    seeds = sorted(waits)
    baselines = _baselines(run, seeds)
    results = results_of(run.config, run.results, dict(zip(seeds, baselines["optimal"] or (), strict=False)))
    verdict, reason = verdict_of(run.config.flights, [str(result.status) for result in run.results])
    answered = [call for call in run.calls if call.answer is not None]
    budget = Budget(options)
    budget.resume(run.calls)
    return RunReport(
        run=run,
        verdict=verdict,
        reason=reason,
        results=results,
        summary=Summary.of(results),
        waits=waits,
        baselines={name: None if scores is None else mean_of(scores) for name, scores in baselines.items()},
        pass_hat_k=_pass_hat_k([(row["success"], len(row["scores"])) for row in map_rows(results)]),
        turns=turns_of(run.results),
        changes=dict(Counter(text for call in answered for text in described(call.changes))),
        moves=_moves(run) if moves else None,
        budget=budget,
        latency_median=median_high(call.latency for call in answered) if answered else None,
    )


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
    found = report(run, moves=False)
    if found.verdict != "valid":
        return NotRanked(path, f"{found.verdict}: {found.reason}", damaged=False)
    return LeaderboardEntry(path, found.to_json(), found.results)


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


def _moves(run: VerifiedRun) -> MoveCounts | None:
    """The number of the model's moves by label; None if the maps are too large for exact values.

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
    return MoveCounts(dict(labels), len(decisive), best / len(decisive) if decisive else None)


def write_report(found: RunReport) -> None:
    """Write `report.json` and `report.md` into the run's folder, each whole or not at all."""
    from drone_env.results.pages import render

    config = found.run.config
    first, last = config.seeds[0], config.seeds[1] - 1
    maps = f"Map {first}" if first == last else f"Maps {first} to {last}"
    repeats = "one flight each" if config.repeats == 1 else f"{config.repeats} flights each"
    text = render(
        "llm.md",
        tables=[table for table in _tables(found) if table.rows],
        title=f"{config.model} on {config.task}, prompt {config.prompt}",
        maps=f"{maps} ({config.split}), {repeats}.",
        verdict=found.verdict.upper() if found.verdict == "invalid" else found.verdict,
        reason=found.reason,
        unusable=found.unusable,
    )
    write_json(found.run.path / "report.json", found.to_json())
    write_text(found.run.path / "report.md", text)


def _tables(found: RunReport) -> list[Table]:
    """The tables of the report, in order."""
    score = with_interval(found.summary.score, found.summary.score_ci95)
    agents = [("this model", score), *((name, number(mean)) for name, mean in found.baselines.items())]
    unfinished = [(str(f.seed), str(f.repeat + 1), f.status, f.error or "") for f in found.not_finished]
    labels = {} if found.moves is None else found.moves.labels
    return [
        Table("Result", (), _result(found, score)),
        Table("On the same maps", ("who", "mean score"), agents if found.summary.score is not None else []),
        Table("Answers", ("outcome", "requests for actions"), [(name, str(n)) for name, n in found.turns.items()]),
        Table("Moves", ("move", "count"), [(label, str(n)) for label, n in labels.items()]),
        Table("Spent", (), _spent(found)),
        Table("Not finished", ("map", "flight over it", "status", "why"), unfinished),
    ]


def _result(found: RunReport, score: str) -> list[tuple[str, str]]:
    flights, moves = found.flights, found.moves
    rows = [
        ("score (95 %)", score),
        ("unusable answers", str(found.unusable)),
        ("delivered all", percent(found.summary.success_rate)),
        *((f"pass^{k}", percent(share)) for k, share in found.pass_hat_k.items() if k != "1"),
        ("regret", number(found.summary.regret)),
        ("(score - random) / (optimal - random)", number(found.normalised)),
        ("flights planned, flown", f"{flights['planned']}, {flights['flown']}"),
        ("errored, left out", str(flights["errored"])),
        ("unfinished, counted as waiting to the end", str(flights["unfinished"])),
        ("WAIT in place of an unusable answer", str(sum(result.waits for result in found.run.results))),
        *((f"answers for which {text}", str(answers)) for text, answers in found.changes.items()),
    ]
    return rows if moves is None else [*rows, ("best moves where it mattered", percent(moves.accuracy))]


def _spent(found: RunReport) -> list[tuple[str, str]]:
    budget = found.budget
    return [
        ("requests; answers", f"{budget.requests}; {budget.answers}"),
        ("tokens: prompt", known_sum(budget.prompt_tokens, budget.unmetered, "d")),
        ("tokens: completion", known_sum(budget.completion_tokens, budget.unmetered, "d")),
        ("answers without a count of tokens", str(budget.unmetered)),
        ("cost in US dollars", known_sum(budget.cost, budget.unmetered, ".4f")),
        ("median seconds for an answer", number(found.latency_median, ".2f")),
    ]
