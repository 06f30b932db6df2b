"""Prompts beside each other, map by map, in runs that differ in nothing else; and what a point of score takes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drone_env.llm.report import unusable_of
from drone_env.llm.report_tables import maps_line
from drone_env.results.result import Results
from drone_env.results.statistics import DIFFERENCES, PairedComparison, ci95, mean_of, with_interval
from drone_env.results.tables import Table, number, percent


def paired(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The figures of runs beside each other, as JSON values; what is not known is null.

    `difference` is the mean, over the maps that count in both, of the score less that of the first run;
    `difference_ci95` is its interval. A point of score is a flight that scores 1: tokens and US dollars a point are all
    that was spent by the sum of the scores of the flights that count.

    Args:
        runs: The figures of `report`, with one prompt each.
    """
    results = [Results.of_report(run["config"]["prompt"], run) for run in runs]
    rows: list[dict[str, Any]] = []
    for run, flown in zip(runs, results, strict=True):
        differences = PairedComparison.of(flown, results[0]).differences
        points = sum(sum(of_map["scores"]) for of_map in run["maps"])
        tokens = sum(run["tokens"].values())
        same = ("verdict", "reason", "score", "score_ci95", "success_rate", "regret", "waits", "unusable", "cost_usd")
        rows.append(
            {name: run[name] for name in same}
            | {
                "prompt": run["config"]["prompt"],
                "maps": len(differences),
                "difference": mean_of(differences),
                "difference_ci95": ci95(differences, DIFFERENCES),
                "tokens": tokens,
                "tokens_per_point": tokens / points if points else None,
                "usd_per_point": run["cost_usd"] / points if points and run["cost_usd"] is not None else None,
            }
        )
    return {"format": "drone_env/llm-paired-report", "config": runs[0]["config"], "runs": rows}


def write_paired_report(folder: Path, runs: Sequence[dict[str, Any]]) -> list[str]:
    """Write `report.json` and `report.md`, each whole or not at all; the same in a few lines, for people.

    Raises:
        OSError: if they cannot be written.
    """
    from drone_env.results.pages import render, write_pages

    figures = paired(runs)
    config = figures["config"]
    first = figures["runs"][0]["prompt"]
    head = ("prompt", "score (95 %)", f"less that of {first}", "maps", "delivered all", "unusable", "tokens")
    rows = [
        (
            row["prompt"] + ("" if row["verdict"] == "valid" else f" ({row['verdict']}: {row['reason']})"),
            with_interval(row["score"], row["score_ci95"]),
            with_interval(row["difference"], row["difference_ci95"]),
            str(row["maps"]),
            percent(row["success_rate"]),
            str(unusable_of(row)),
            number(row["tokens"], ","),
            number(row["tokens_per_point"], ",.0f"),
            number(row["cost_usd"]),
            number(row["usd_per_point"]),
        )
        for row in figures["runs"]
    ]
    table = Table("", (*head, "tokens a point", "US dollars", "US dollars a point"), rows)
    title = f"{config['model']} on {config['task']}, by prompt"
    page = render("prompts.md", title=title, maps=maps_line(config), table=table)
    write_pages(folder, figures, {"report.md": page})
    lines = [
        f"{name}: score {score}, unusable answers {unusable}, {more} against {first}"
        for name, score, more, _, _, unusable, *_ in rows
    ]
    return [*lines, f"report: {folder / 'report.md'}"]
