"""Write the tables of the documentation that follow from the code: takes seconds.

python tools/docs_tables.py            writes them between their markers
python tools/docs_tables.py --check    changes nothing, and names what is not up to date
"""

import sys
import tarfile
from collections.abc import Callable
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import Any, cast

from pydantic_settings import BaseSettings

from drone_env.agents import AGENTS
from drone_env.city.openstreetmap import Rule, layers
from drone_env.core.actions import Event
from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.llm.config import InferenceSettings
from drone_env.llm.report import report
from drone_env.llm.run_folder import read_run
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.results.folder import SHIPPED, shipped_results, stored_results
from drone_env.results.leaderboard import group_by_maps
from drone_env.results.statistics import Summary
from drone_env.results.submission import SubmissionHead, read_submission
from drone_env.results.tables import markdown, number, percent, with_interval
from drone_env.server.settings import Settings

DOCS = Path(__file__).parents[1] / "docs"
SUBMISSIONS = DOCS.with_name("leaderboard")
TRANSCRIPTS = SUBMISSIONS / "transcripts.tar.xz"
STANDARD = [task for task in TASKS.values() if task.battery_capacity == task.max_steps]
BEST = "optimal"
SPECIAL = (Event.NONE, Event.DELIVERY)


def settings_table(settings: type[BaseSettings]) -> str:
    """Return the settings of a class as a table in Markdown."""
    prefix, rows = settings.model_config.get("env_prefix", ""), [("variable", "default", "meaning")]
    for name, field in settings.model_fields.items():
        several = isinstance(field.default, tuple)
        default = ",".join(cast(tuple[str, ...], field.default)) if several else str(field.default or "")
        shown = "in the package" if Path(default).is_absolute() else f"`{default}`" if default else "-"
        rows.append((f"`{prefix}{name.upper()}`", shown, f"{field.description}"))
    return markdown(rows)


def kinds() -> str:
    """The kinds of cells."""
    rows = [[str(int(cell)), kind.name, kind.emoji, kind.effect] for cell, kind in CELL_KINDS.items()]
    return markdown([["id", "name", "", "on the map"], *rows])


def environments() -> str:
    """Every task under its Gymnasium id."""
    rows = [["Gymnasium id", "grid", "telemetry", "nearest", "tournet", "optimum"]]
    for task in TASKS.values():
        scores = {agent: number(of["mean_score"]) for agent, of in figures_of(task).items()}
        flown = [scores.get(agent, "-") for agent in ("nearest", "tournet", BEST)]
        rows.append([f"`{task.gym_id}`", f"{task.width} x {task.height}", str(task.telemetry_size), *flown])
    return markdown(rows)


def numbers_of(task: TaskConfig) -> dict[str, str]:
    """The numbers of a task as text, by their names."""
    drain = ", ".join(f"{CELL_KINDS[kind].name} {units}" for kind, units in task.drain)
    others: dict[float, list[str]] = {}
    for event in (event.name.lower() for event in Event if event not in SPECIAL):
        others.setdefault(getattr(task, f"r_{event}"), []).append(event)
    rest = [f"{reward} {'else' if len(others) == 1 else ', '.join(events)}" for reward, events in others.items()]
    return {
        "grid": f"{task.width} x {task.height}",
        "parcels": str(task.deliveries),
        "buildings, trees, obstacles": "real" if task.terrain else f"{task.buildings}, {task.trees}, {task.obstacles}",
        "streets every": "real" if task.terrain else str(task.street_spacing or "-"),
        "steps": str(task.max_steps),
        "battery": str(task.battery_capacity),
        "drain": drain or "-",
        "closed": ", ".join(sorted(CELL_KINDS[kind].name for kind in task.impassable)) or "-",
        "pads, charge": f"{task.pads}, {task.charge_rate}" if task.pads else "-",
        "rewards of `tiered`": "; ".join([f"{task.r_delivery} delivery", *rest]),
    }


def tasks() -> str:
    """Return the numbers of all tasks, one row per task."""
    numbers = {task.id: numbers_of(task) for task in TASKS.values()}
    head = next(iter(numbers.values()))
    return markdown([["task", *head], *([f"`{task_id}`", *row.values()] for task_id, row in numbers.items())])


def of_cities() -> str:
    """The layers of a city."""
    rows: list[list[str]] = []
    for layer in layers():
        things = [f"`{described(rule)}`" for rule in (*layer.points, *layer.areas, *layer.coasts)]
        things += [f"`{described(rule)}` ({width:g} m)" for rule, width in layer.lines.items()]
        but = f"; not {', '.join(f'`{described(rule)}`' for rule in layer.unless)}" if layer.unless else ""
        share = f"{layer.share:.0%}" if layer.areas or layer.lines else "any"
        kind = "road (open)" if layer.kind == Cell.ROAD else layer.kind.name.lower()
        rows.append([layer.name, kind, share, ", ".join(things) + but])
    return markdown([["layer", "cell", "share", "things"], *rows])


def described(rule: Rule) -> str:
    """What a rule describes, as `layers.toml` has it."""
    return " ".join(f"{key}={value}" for key, value in rule)


CELLS: dict[str, Callable[[dict[str, Any]], str]] = {
    "Score (95 % interval)": lambda of: with_interval(of["mean_score"], of["score_ci95"]),
    "Ratio to the optimum, and share of flights that delivered all parcels": lambda of: (
        f"{number(of['score_ratio'])}, {of['success_rate']:.1%}"
    ),
}
"""The titles of tables of results, and how a cell shows the figures of an agent on a task."""


def figures_of(task: TaskConfig) -> dict[str, dict[str, Any]]:
    """The figures of the shipped results of a task by agent, the optimum last."""
    figures = {agent: summarise(*repeats) for agent, repeats in stored_results(SHIPPED, task.id)}
    return {agent: figures[agent] for agent in sorted(AGENTS, key=lambda name: name == BEST) if agent in figures}


def scores_of(task: TaskConfig) -> str:
    """The shipped results of a task: a row per agent; empty if there are none."""
    rows = [[agent, *(cell(of) for cell in CELLS.values())] for agent, of in figures_of(task).items()]
    return markdown([["agent", *CELLS], *rows]) if rows else ""


def agents(*families: str) -> str:
    """The shipped results of these families: a row per agent, a column per task."""
    tasks = [task for task in TASKS.values() if task.family in families]
    figures = [figures_of(task) for task in tasks]
    parts: list[str] = []
    flown = [agent for agent in sorted(AGENTS, key=lambda name: name == BEST) if any(agent in of for of in figures)]
    for title, cell in CELLS.items():
        rows = [["agent", *(task.short_name for task in tasks)]]
        rows += [[agent, *(cell(of[agent]) if agent in of else "-" for of in figures)] for agent in flown]
        parts.append(f"**{title}**\n\n{markdown(rows)}")
    return "\n\n".join(parts)


def leaderboard() -> str:
    """The verified submissions: a table for each family of tasks, those with most tasks and the highest ratio first."""
    submissions, parts = [read_submission(file) for file in sorted(SUBMISSIONS.glob("*.jsonl"))], list[str]()
    for family in dict.fromkeys(task.family for task in TASKS.values()):
        tasks, ranked = [task for task in TASKS.values() if task.family == family], list[tuple[int, float, list[str]]]()
        for head, results in submissions:
            flown = {task: Summary.of(results[task]) for task in tasks if task in results}
            if flown:
                cells = [with_interval(flown[t].score, flown[t].score_ci95) if t in flown else "-" for t in tasks]
                ratio = fmean(summary.ratio or 0 for summary in flown.values())
                ranked.append((len(flown), ratio, [submitter(head), str(head.maps), *cells, number(ratio)]))
        ranked.sort(key=lambda entry: entry[:2], reverse=True)
        rows = [[str(rank), *cells] for rank, (_, _, cells) in enumerate(ranked, 1)]
        head = ["", "agent", "maps", *(task.short_name for task in tasks), "of the optimum"]
        parts.append(f"**{family.capitalize()}**\n\n{markdown([head, *rows])}")
    return "\n\n".join(parts)


def submitter(head: SubmissionHead) -> str:
    """The agent with its link, and what is known about a language model."""
    name = f"[{head.agent}]({head.link if '://' in head.link else f'../{head.link}'})"
    return name if head.prompt is None else f"{name}, `{head.prompt}`, {percent(head.unusable)} unusable"


def cells_of(summary: Summary) -> list[str]:
    """Score, ratio to the optimum and share of flights that delivered all."""
    return [with_interval(summary.score, summary.score_ci95), number(summary.ratio), percent(summary.success_rate)]


def language_models() -> str:
    """The runs in the archive of transcripts, flown again, beside agents over the same maps: a table for each task."""
    parts: list[str] = []
    with TemporaryDirectory() as folder, tarfile.open(TRANSCRIPTS) as archive:
        archive.extractall(folder, filter="data")
        runs = [report(read_run(path)) for path in sorted(Path(folder).glob("*/*"))]
    for board in group_by_maps(runs):
        key, ranked = board.rows[0].results.key, list[tuple[float, list[str]]]()
        for entry in board.rows:
            told = entry.report
            unusable = f"{percent(told['unusable']['share'])} of {told['unusable']['of']}"
            verdict = f"{told['verdict']}{', marked' if told['unusable']['marked'] else ''}"
            figures = cells_of(entry.summary) if told["verdict"] == "valid" else ["-"] * 3
            row = [entry.agent, f"`{entry.prompt}`", *figures, unusable, verdict]
            ranked.append((entry.summary.score or 0, row))
        for agent in ("random", "nearest", BEST):
            of_agent = episodes_key(key.task, agent, range(*key.seeds), key.split)
            summary = Summary.of(shipped_results(of_agent) or run_episodes(of_agent))
            ranked.append((summary.score or 0, [agent, "-", *cells_of(summary), "-", "-"]))
        ranked.sort(key=lambda row: row[0], reverse=True)
        head = ["agent or model", "prompt", "score", "of the optimum", "delivered all", "unusable answers", "verdict"]
        title = f"{board.task.partition(' ')[0]}, the first {key.seeds[1] - key.seeds[0]} test maps"
        parts.append(f"**{title}**\n\n{markdown([head, *(row for _, row in ranked)])}")
    return "\n\n".join(parts)


def tables() -> dict[tuple[str, str], str]:
    """Every table, by its page and its name."""
    return {
        ("benchmark.md", "agents"): agents("standard", "skyline"),
        ("benchmark.md", "agents on rush"): agents("rush"),
        ("cities.md", "agents"): agents("city"),
        ("../leaderboard/README.md", "leaderboard"): leaderboard(),
        ("../leaderboard/README.md", "language models"): language_models(),
        ("rules.md", "kinds"): kinds(),
        ("tasks.md", "tasks"): tasks(),
        ("cities.md", "layers"): of_cities(),
        ("environments.md", "environments"): environments(),
        ("configuration.md", "settings of the server"): settings_table(Settings),
        ("configuration.md", "settings of language models"): settings_table(InferenceSettings),
    }


def between(name: str, text: str) -> str:
    """A generated text between its markers."""
    return f"<!-- {name}: generated -->\n\n{text}\n\n<!-- end of {name} -->"


def put(page: str, name: str, text: str) -> str:
    """The page with this text between the markers of this name."""
    begin, end = between(name, "").split("\n\n\n\n")
    before, rest = page.split(begin)
    return before + between(name, text) + rest.split(end)[1]


def changes() -> dict[Path, str]:
    """The files that are not up to date, and what they should hold."""
    files: dict[Path, str] = {}
    for (page, name), text in tables().items():
        path = DOCS / page
        files[path] = put(files.get(path) or path.read_text(encoding="utf-8"), name, text)
    return {path: text for path, text in files.items() if not path.is_file() or path.read_text("utf-8") != text}


if __name__ == "__main__":
    stale = changes()
    if "--check" in sys.argv[1:]:
        sys.exit("\n".join(f"{path} is not up to date: run tools/docs_tables.py" for path in stale) or None)
    for path, text in stale.items():
        path.write_text(text, encoding="utf-8")
