"""`drone-env evaluate`: agents side by side on the same maps, beside the exact optimum."""

from pathlib import Path
from typing import Any

from drone_env import __version__
from drone_env.agents import NETWORK_AGENTS
from drone_env.agents.weights_file import network_of
from drone_env.commands.arguments import AgentNames, ClusterAddress, SeedRange, SplitName, chosen_maps
from drone_env.commands.contest import EngineName, JsonFile, TaskNames, cells_of, fly_cells, give_json, json_file
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.results.evaluate import summarise
from drone_env.results.interval import with_interval
from drone_env.results.tables import Table, number, percent, print_table

CHOICE = "|".join(NETWORK_AGENTS)


def evaluate(
    task: TaskNames = ("all",),
    agents: AgentNames = ("random", "greedy", "optimal"),
    split: SplitName = None,
    episodes: int | None = None,
    seeds: SeedRange = None,
    json: JsonFile = None,
    checkpoint: Path | None = None,
    out: Path | None = None,
    repeats: int = 1,
    engine: EngineName = "local",
    address: ClusterAddress = None,
) -> None:
    """Fly many maps with several agents and compare them, each beside the exact optimum of the same maps.

    Prints a table; a progress bar goes to standard error. Score: graded, 0.01 to 0.99, with its 95 % interval
    (Student's t over maps). Ratio: mean score / mean optimal score. Regret: mean of optimum less score. Excess: steps
    beyond the optimal flight, on delivered maps; below zero where the best flight takes its time to charge.
    docs/quoting.md says what of it to quote. An agent that cannot fly one of several tasks has a row of dashes there,
    and the reason below.

    Example: drone-env evaluate --task hard --agents greedy optimal --episodes 100 --json results.json

    Args:
        task: One or more tasks; `all` for every registered task.
        agents: One or more agents: names, `MODULE:NAME` for one of your own, `FILE.zip:WRAPPER` for a policy of
            Stable-Baselines3 and the wrapper that it was trained behind (docs/agents.md).
        split: Whose first maps to fly: test if nothing is said. Training never touches validation and test.
        episodes: How many maps of the split, 1000 if nothing is said.
        seeds: Fly the maps from A up to and not including B instead of a split's.
        checkpoint: Fly by the network in this file (.safetensors) instead of the shipped one: `pathqnet`, or `tournet`,
            as the file says.
        json: Write the figures to this file; - prints only the JSON on standard output.
        out: Keep the results of each 1,000 maps in this folder as they arrive; the same command goes on from there.
        repeats: How often an agent that draws lots flies each map; the mean counts.
        engine: Fly in this process, or on a Ray cluster (extra `cluster`); the figures are the same.
        address: The cluster: local starts one on this machine (if nothing is said), auto joins the one that runs here,
            HOST:PORT joins that one.
    """
    chosen_split, maps = chosen_maps(seeds, split, episodes, 1000)
    if checkpoint is not None:
        agents = _by_checkpoint(agents, checkpoint)
    json_file(json)
    flown = fly_cells(cells_of(task, agents, maps, chosen_split, repeats), engine, address, out)
    summaries = {
        t: {agent: summarise(*cell) for agent, cell in row.items() if isinstance(cell, tuple)}
        for t, row in flown.items()
    }
    nothing = dict.fromkeys(next(figures for row in summaries.values() for figures in row.values()))
    figures = {
        t.id: {
            "version": t.version,
            "split": chosen_split,
            "seeds": [maps.start, maps.stop],
            "episodes": len(maps),
            "repeats": repeats,
            "agents": {
                agent: summaries[t].get(agent) or {**nothing, "unsupported": str(cell)} for agent, cell in row.items()
            },
        }
        for t, row in flown.items()
    }
    report = {"package": __version__, "tasks": figures}
    if give_json(report, json):
        _print(report)


def _by_checkpoint(agents: tuple[str, ...], file: Path) -> tuple[str, ...]:
    """The agents, those that can fly by the network in a file by that one."""
    if not set(agents) & set(NETWORK_AGENTS):
        raise InvalidValueError(f"--checkpoint is the network of an agent: name it with --agents {CHOICE}")
    network = network_of(file)
    fits = [name for name, agent in NETWORK_AGENTS.items() if agent.network == network]
    if not set(agents) & set(fits):
        raise InvalidValueError(f"{file} is the network of {'|'.join(fits) or network}: name it with --agents")
    return tuple(f"{agent}:{file}" if agent in fits else agent for agent in agents)


def _print(report: dict[str, Any]) -> None:
    head = ("task", "agent", "score (95 %)", "optimum", "ratio", "regret", "success", "steps", "excess")
    rows = [
        (
            f"{get_task(task_id).short_name} v{of_task['version']}",
            agent,
            with_interval(figures["mean_score"], figures["score_ci95"]),
            number(figures["mean_optimal_score"]),
            number(figures["score_ratio"]),
            number(figures["mean_regret"]),
            percent(figures["success_rate"]),
            number(figures["mean_steps"], ".1f"),
            number(figures["mean_excess_steps"], ".2f"),
        )
        for task_id, of_task in report["tasks"].items()
        for agent, figures in of_task["agents"].items()
    ]
    flown = next(iter(report["tasks"].values()))
    start, stop = flown["seeds"]
    caption = f"{stop - start:,} maps a task, split {flown['split']}, seeds {start} to {stop - 1}"
    if flown["repeats"] > 1:
        caption += f", {flown['repeats']} flights over each of who draws lots"
    table = Table("Graded score beside the exact optimum of the same maps", head, rows)
    print_table(table, width=120, names=2, caption=caption, sections=True)
    for task_id, of_task in report["tasks"].items():
        for agent, figures in of_task["agents"].items():
            if "unsupported" in figures:
                print(f"{get_task(task_id).short_name}, {agent}: {figures['unsupported']}")
