"""The figures of a run as tables and lines for people."""

import json
from typing import Any

from drone_env.llm.report import unusable_of
from drone_env.results.statistics import with_interval
from drone_env.results.tables import Table, number, percent


def page_values(figures: dict[str, Any]) -> dict[str, Any]:
    """What the templates of the report show: the figures, their tables, and the lines above them."""
    config = figures["config"]
    return {
        "figures": figures,
        "tables": tables(figures),
        "title": f"{config['model']} on {config['task']}, prompt {config['prompt']}",
        "maps": maps_line(config),
        # In capitals where the figures do not count.
        "verdict": figures["verdict"].upper() if figures["verdict"] == "invalid" else figures["verdict"],
        "score": _score(figures),
        "unusable": unusable_of(figures),
    }


def maps_line(config: dict[str, Any]) -> str:
    """Which maps a run flies, and how often."""
    first, last = config["seeds"][0], config["seeds"][1] - 1
    maps = f"Map {first}" if first == last else f"Maps {first} to {last}"
    repeats = "one flight each" if config["repeats"] == 1 else f"{config['repeats']} flights each"
    return f"{maps} ({config['split']}), {repeats}."


def tables(figures: dict[str, Any]) -> list[Table]:
    """All tables of the report, in order; those without rows are left out."""
    moves: dict[str, Any] = figures["moves"] or {"labels": {}}
    agents = [("this model", _score(figures)), *((name, number(mean)) for name, mean in figures["baselines"].items())]
    found = [
        Table("Result", (), _result(figures)),
        Table("On the same maps", ("who", "mean score"), agents if figures["score"] is not None else []),
        Table("Answers", ("outcome", "requests for actions"), [(name, str(n)) for name, n in figures["turns"].items()]),
        Table("Moves", ("move", "count"), [(label, str(n)) for label, n in moves["labels"].items()]),
        Table("Spent", (), _spent(figures)),
        Table("Configuration", (), _configuration(figures["config"], figures["models"])),
        Table(
            "Not finished",
            ("map", "flight over it", "status", "why"),
            [(str(f["seed"]), str(f["repeat"] + 1), f["status"], f["error"] or "") for f in figures["not_finished"]],
        ),
        Table(
            "Maps",
            ("map", "scores", "optimum", "delivered all", "steps", "WAIT in place"),
            [_map(of_map) for of_map in figures["maps"]],
        ),
    ]
    return [table for table in found if table.rows]


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
    ]
    return rows if moves is None else [*rows, ("best moves where it mattered", percent(moves["accuracy"]))]


def _spent(figures: dict[str, Any]) -> list[tuple[str, str]]:
    calls, tokens = figures["calls"], figures["tokens"]
    return [
        ("requests; answers; from the cache", f"{calls['requests']}; {calls['answered']}; {calls['cached']}"),
        ("tokens: prompt, completion", f"{tokens['prompt']}, {tokens['completion']}"),
        ("answers without a count of tokens", str(calls["without_usage"])),
        ("cost in US dollars", number(figures["cost_usd"])),
        ("median seconds for an answer", number(figures["latency_median"], ".2f")),
    ]


def _configuration(config: dict[str, Any], models: dict[str, int]) -> list[tuple[str, str]]:
    sampling = ", ".join(
        f"{name} {json.dumps(value)}" for name, value in config["sampling"].items() if value not in (None, {})
    )
    return [
        ("model", config["model"]),
        ("model that the endpoint names", ", ".join(name for name in models if name) or "none"),
        ("endpoint", config["base_url"]),
        ("task", f"{config['task']} version {config['task_version']}, rewards {config['reward_profile']}"),
        ("prompt", f"{config['prompt']} ({config['prompt_digest']}), last steps shown: {config['history']}"),
        ("answers asked for as", config["answers"]),
        ("sampling", sampling or "the endpoint's own"),
    ]


def _map(of_map: dict[str, Any]) -> tuple[str, ...]:
    return (
        str(of_map["seed"]),
        ", ".join(map(number, of_map["scores"])),
        number(of_map["optimum"]),
        f"{of_map['success']} of {len(of_map['scores'])}",
        ", ".join(map(str, of_map["steps"])),
        str(of_map["waits"]),
    )
