"""Agents over the same maps of several tasks: what `evaluate` and `compare` share."""

import contextlib
import sys
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from drone_env import __version__
from drone_env.agents import file_of
from drone_env.commands.arguments import TASK, say_trusted
from drone_env.commands.printing import print_json, progress_bar
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import CheckpointError, InvalidValueError, TooLargeError, UnsupportedTaskError
from drone_env.files import write_json
from drone_env.planning.optimal import require_solvable
from drone_env.results.evaluate import EpisodeResults, EpisodesKey, episodes_key, repeats_of
from drone_env.results.folder import Engine, ResultsFolder, evaluate_keys, local_engine

TaskNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar=f"all|{TASK}")]
EngineName = Literal["local", "ray"]
JsonFile = Annotated[str | None, tyro.conf.arg(metavar="FILE|-")]

Cannot = CheckpointError | TooLargeError | UnsupportedTaskError
"""Why an agent cannot fly a task."""
Cell = tuple[EpisodesKey, ...] | Cannot
"""What an agent is to fly of a task, with its repeats."""
Cells = dict[TaskConfig, dict[str, Cell]]
"""By task and agent."""
Flown = tuple[EpisodeResults, ...] | Cannot
"""What an agent has flown of a task, with its repeats."""


def cells_of(tasks: Sequence[str], agents: Sequence[str], maps: range, split: str, repeats: int) -> Cells:
    """What each agent is to fly of each task.

    Raises:
        UnknownNameError, InvalidValueError, OSError: for names, seeds and files that are wrong.
        CheckpointError, TooLargeError, UnsupportedTaskError: if nobody can fly anything, or a file that is named
            fits no task.
    """
    if not tasks or not agents:
        raise InvalidValueError("--task and --agents take one name or more")
    say_trusted(agents)
    named = [t for name in tasks for t in (TASKS.values() if name == "all" else [get_task(name)])]
    cells = {t: {agent: _cell(t, agent, maps, split, repeats) for agent in agents} for t in dict.fromkeys(named)}
    # Somebody must fly something, and a file that is named must fit a task.
    for judged in (agents, *([agent] for agent in agents if file_of(agent))):
        all_cells = [row[agent] for row in cells.values() for agent in judged]
        reasons = [cell for cell in all_cells if not isinstance(cell, tuple)]
        if len(reasons) == len(all_cells):
            raise reasons[0]
    return cells


def _cell(task: TaskConfig, agent: str, maps: range, split: str, repeats: int) -> Cell:
    try:
        if agent == "optimal":
            require_solvable(task)
        return repeats_of(episodes_key(task, agent, maps, split), repeats)
    except (TooLargeError, UnsupportedTaskError) as error:
        return error
    except CheckpointError as error:
        if file_of(agent) is None:
            raise  # a file of the package is damaged
        return error


def fly_cells(
    cells: Cells, engine: EngineName = "local", address: str | None = None, out: Path | None = None
) -> dict[TaskConfig, dict[str, Flown]]:
    """Fly what there is to fly, with a progress bar.

    Args:
        cells: What to fly.
        engine: Where.
        address: The cluster.
        out: The folder that the results are kept in.

    Raises:
        InvalidValueError, OSError: from the folder, and for an address without a cluster.
        ClusterError: from the cluster.
        AgentError, InvalidValueError: if an agent fails.
    """
    if address is not None and engine != "ray":
        raise InvalidValueError("--address names a cluster: give it with --engine ray")
    keys = [key for row in cells.values() for cell in row.values() if isinstance(cell, tuple) for key in cell]
    folder = None if out is None else ResultsFolder(out, keys)
    flights, kept = sum(key.seeds[1] - key.seeds[0] for key in keys), 0
    with progress_bar("maps", flights) as advance:

        def arrived(piece: EpisodeResults) -> None:
            nonlocal kept
            kept += len(piece.seeds)
            advance(len(piece.seeds), f"{get_task(piece.key.task).short_name} {piece.key.agent}")

        try:
            with _engine(engine, address) as chosen:
                results = evaluate_keys(keys, chosen, folder, arrived)
        except BaseException:
            if folder is not None and folder.package == __version__:
                told = f"stopped: {kept:,} of {flights:,} flights are kept in {out}; the same command goes on there"
                print(f"{told}, with agents as they are (one that is mended needs a new folder)", file=sys.stderr)
            raise
    return {
        task: {
            agent: tuple(results[key] for key in cell) if isinstance(cell, tuple) else cell
            for agent, cell in row.items()
        }
        for task, row in cells.items()
    }


@contextlib.contextmanager
def _engine(name: EngineName, address: str | None) -> Generator[Engine, None, None]:
    if name == "local":
        yield local_engine
        return
    from drone_env.cluster.connect import connect

    with connect(address):
        from drone_env.cluster.episodes import fly_on_nodes

        yield fly_on_nodes


def json_file(json: str | None) -> Path | None:
    """The file that `--json` names; None for standard output, or for none.

    Raises:
        InvalidValueError: if it cannot be written there.
    """
    target = None if json in (None, "-") else Path(json)
    if target is not None and (not target.name or target.is_dir() or not target.parent.is_dir()):
        raise InvalidValueError(f"--json takes - or a file in a folder that exists, got {json!r}")
    return target


def give_json(report: dict[str, Any], json: str | None) -> bool:
    """Give a report to what `--json` names; whether people are to be told as well.

    Raises:
        InvalidValueError, OSError: if it cannot be written there.
    """
    target = json_file(json)
    if json == "-":
        print_json(report)
    elif target is not None:
        write_json(target, report)
    return json != "-"
