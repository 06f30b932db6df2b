"""The report of a sweep as a page of Markdown."""

from collections.abc import Sequence
from typing import Any


def markdown(figures: dict[str, Any]) -> str:
    """The report as a page of Markdown."""
    config, count = figures["config"], figures["trials_by_status"]
    optimum = next((of["test"]["optimum"] for of in figures["settings"] if of["test"]), None)
    greedy = figures["greedy"]
    common = ", ".join(f"{name} {value}" for name, value in figures["common"].items())
    lines = [
        f"# Sweep of {config['task']}, preset {config['preset']}",
        "",
        f"{len(config['settings'])} settings with {config['seeds']} seeds each: {count['finished']} trials finished, "
        f"{count['stopped']} stopped early, {count['failed']} failed, {count['unfinished']} unfinished.",
        *([f"In all settings: {common}."] if common else []),
        "",
        "## Settings",
        "",
        f"Over the first {config['test_maps']:,} test maps (mean optimum {_number(optimum)}, greedy "
        f"{_number(greedy['score'])}, ratio {_number(greedy['ratio'])}). Brackets: 95 % bootstrap intervals over seeds "
        "and maps; with one seed, over maps alone.",
        "",
        *_table(
            ("setting", "seeds", "score", "of the optimum", "delivered all", "score of each seed"),
            [_finished(of) for of in figures["settings"] if of["test"]],
        ),
    ]
    stopped = [of for of in figures["settings"] if of["stopped_at"] is not None]
    if stopped:
        best = _number(figures["validation_optimum"])
        lines += [
            "",
            "## Stopped early",
            "",
            "The worse half of the settings, by the mean over their seeds of the best validation score so far "
            f"(optimum {best}), each with all its seeds. They have not flown the test maps.",
            "",
            *_table(
                ("setting", "stopped at", "validation score"),
                [
                    (
                        f"{of['setting']}: {of['label']}",
                        f"{of['stopped_at']:,} episodes",
                        _number(of["validation"][str(of["stopped_at"])]),
                    )
                    for of in stopped
                ],
            ),
        ]
    failed = [trial for trial in figures["trials"] if trial["status"] == "failed"]
    if failed:
        rows = [(trial["name"], f"{trial['episodes']:,}", _plain(trial["error"] or "")) for trial in failed]
        lines += ["", "## Failed", "", *_table(("trial", "episodes before", "error"), rows)]
    lines += ["", "![learning curves](curves.png)", "", "![final scores](scores.png)", "", "## Trials", ""]
    lines += _table(
        ("trial", "status", "episodes", "updates", "seconds", "taken up", "validation", "test", "network"),
        [_trial(trial) for trial in figures["trials"]],
    )
    lines += ["", "## Commands", "", "Each trains the network of its trial alone, bit for bit on the same machine.", ""]
    lines += ["```bash", *(trial["command"] for trial in figures["trials"]), "```", ""]
    return "\n".join(lines)


def _finished(of: dict[str, Any]) -> tuple[str, ...]:
    test = of["test"]
    return (
        f"{of['setting']}: {of['label']}",
        f"{of['seeds_finished']} of {of['seeds']}",
        _with_interval(test["score"]),
        "-" if test["ratio"] is None else _with_interval(test["ratio"]),
        f"{test['success']:.1%}",
        " ".join(f"{score:.4f}" for score in test["seed_scores"]),
    )


def _trial(trial: dict[str, Any]) -> tuple[str, ...]:
    status = trial["status"]
    return (
        trial["name"],
        status if trial["stopped_at"] is None else f"stopped at {trial['stopped_at']:,}",
        f"{trial['episodes']:,}",
        f"{trial['updates']:,}",
        f"{trial['seconds']:.0f}",
        "once" if trial["parts"] == 1 else f"{trial['parts']} times",
        _number(trial["validation_score"]),
        _number(trial["test_score"]),
        trial["network"] or "-",
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [_row(head), "|" + "---|" * len(head), *(_row(row) for row in rows)]


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _plain(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _with_interval(figure: dict[str, Any]) -> str:
    low, high = figure["ci95"]
    return f"{figure['mean']:.4f} [{low:.4f}, {high:.4f}]"
