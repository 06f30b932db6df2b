"""The figures of a run as tables for people, and as a page of Markdown."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple


class ReportTable(NamedTuple):
    """One table: its title, its headings (none where each row is a name and a value), its rows."""

    title: str
    head: tuple[str, ...]
    rows: Sequence[Sequence[str]]


def title(figures: dict[str, Any]) -> str:
    """What was flown, in one line."""
    config = figures["config"]
    return f"{config['model']} on {config['task']}, prompt {config['prompt']}"


def maps_line(figures: dict[str, Any]) -> str:
    """Which maps were flown, in words."""
    config = figures["config"]
    first, last = config["seeds"][0], config["seeds"][1] - 1
    maps = f"Map {first}" if first == last else f"Maps {first} to {last}"
    repeats = "one flight each" if config["repeats"] == 1 else f"{config['repeats']} flights each"
    return f"{maps} ({config['split']}), {repeats}."


def verdict(figures: dict[str, Any]) -> str:
    """The verdict in one word; in capitals where the figures do not count."""
    return figures["verdict"].upper() if figures["verdict"] == "invalid" else figures["verdict"]


def tables(figures: dict[str, Any]) -> list[ReportTable]:
    """All tables of the report, in order; those with nothing to tell are left out."""
    found = [
        ReportTable("Result", (), _result(figures)),
        ReportTable("On the same maps", ("who", "mean score"), _agents(figures)),
        ReportTable("Answers", ("outcome", "requests for actions"), _answers(figures)),
        ReportTable("Moves", ("move", "count"), _moves(figures)),
        ReportTable("Spent", (), _spent(figures)),
        ReportTable("Configuration", (), _configuration(figures)),
        ReportTable("Not finished", ("map", "flight over it", "status", "why"), _unfinished(figures)),
        ReportTable("Maps", ("map", "scores", "optimum", "delivered all", "steps", "WAIT in place"), _maps(figures)),
    ]
    return [table for table in found if table.rows]


def markdown(figures: dict[str, Any]) -> str:
    """The report as a page of Markdown."""
    reason = f": {figures['reason']}" if figures["reason"] else ""
    lines = [f"# {_plain(title(figures))}", "", f"**{verdict(figures)}**{_plain(reason)}", "", maps_line(figures)]
    for table in tables(figures):
        head = table.head or ("", "")
        lines += ["", f"## {table.title}", "", _row(head), "|" + "---|" * len(head), *map(_row, table.rows)]
    return "\n".join([*lines, ""])


def with_interval(figures: dict[str, Any]) -> str:
    """The mean score with its 95 % interval."""
    interval, score = figures["score_ci95"], figures["score"]
    return shown(score) + ("" if interval is None or score is None else f" ± {interval[1] - score:.4f}")


def shown(value: float | None) -> str:
    """A figure with four decimals, `-` where it is not known."""
    return "-" if value is None else f"{value:.4f}"


def percent(value: float | None) -> str:
    """A share in percent, `-` where it is not known."""
    return "-" if value is None else f"{value:.1%}"


def _result(figures: dict[str, Any]) -> list[tuple[str, str]]:
    flights, moves = figures["flights"], figures["moves"]
    rows = [
        ("score (95 %)", with_interval(figures)),
        ("delivered all", percent(figures["success_rate"])),
        *((f"pass^{k}", percent(share)) for k, share in figures["pass_hat_k"].items() if k != "1"),
        ("regret", shown(figures["regret"])),
        ("(score - random) / (optimal - random)", shown(figures["normalised"])),
        ("flights planned, flown", f"{flights['planned']}, {flights['flown']}"),
        ("errored, left out", str(flights["errored"])),
        ("unfinished, counted as waiting to the end", str(flights["unfinished"])),
        ("WAIT in place of an unusable answer", str(figures["waits"])),
    ]
    if moves is not None:
        rows.append(("best moves where it mattered", percent(moves["accuracy"])))
    return rows


def _agents(figures: dict[str, Any]) -> list[tuple[str, str]]:
    if figures["score"] is None:
        return []
    return [("this model", with_interval(figures)), *((name, shown(s)) for name, s in figures["baselines"].items())]


def _answers(figures: dict[str, Any]) -> list[tuple[str, str]]:
    return [(name, str(count)) for name, count in figures["turns"].items()]


def _moves(figures: dict[str, Any]) -> list[tuple[str, str]]:
    return [] if figures["moves"] is None else [(label, str(n)) for label, n in figures["moves"]["labels"].items()]


def _spent(figures: dict[str, Any]) -> list[tuple[str, str]]:
    calls, tokens, latency = figures["calls"], figures["tokens"], figures["latency_median"]
    return [
        ("requests; answers; from the cache", f"{calls['requests']}; {calls['answered']}; {calls['cached']}"),
        ("tokens: prompt, completion", f"{tokens['prompt']}, {tokens['completion']}"),
        ("answers without a count of tokens", str(calls["without_usage"])),
        ("cost in US dollars", shown(figures["cost_usd"])),
        ("median seconds for an answer", "-" if latency is None else f"{latency:.2f}"),
    ]


def _unfinished(figures: dict[str, Any]) -> list[tuple[str, ...]]:
    return [(str(f["seed"]), str(f["repeat"] + 1), f["status"], f["error"] or "") for f in figures["not_finished"]]


def _configuration(figures: dict[str, Any]) -> list[tuple[str, str]]:
    config = figures["config"]
    sampling = ", ".join(
        f"{name} {json.dumps(value)}" for name, value in config["sampling"].items() if value not in (None, {})
    )
    return [
        ("model", config["model"]),
        ("endpoint", config["base_url"]),
        ("task", f"{config['task']} version {config['task_version']}, rewards {config['reward_profile']}"),
        ("prompt", f"{config['prompt']} ({config['prompt_digest']}), last steps told: {config['history']}"),
        ("answers asked for as", config["answers"] + (", streamed" if config["stream"] else "")),
        ("sampling", sampling or "the endpoint's own"),
    ]


def _maps(figures: dict[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            str(of_map["seed"]),
            ", ".join(map(shown, of_map["scores"])),
            shown(of_map["optimum"]),
            f"{of_map['success']} of {len(of_map['scores'])}",
            ", ".join(map(str, of_map["steps"])),
            str(of_map["waits"]),
        )
        for of_map in figures["maps"]
    ]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(map(_plain, cells)) + " |" if any(cells) else "|" + " |" * len(cells)


def _plain(text: str) -> str:
    """A text that Markdown shows as it is: names and errors come from elsewhere."""
    for letter, code in (("&", "&amp;"), ("<", "&lt;"), *((letter, f"&#{ord(letter)};") for letter in "|[`*\\")):
        text = text.replace(letter, code)
    return text
