"""Folders of results: evaluations of agents, and runs of language models."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError, needs
from drone_env.results import folder as evaluation

if TYPE_CHECKING:
    from drone_env.results.by_map import FlownMap
    from drone_env.results.leaderboard import Judged, Refused


RUN = "run.json"
"""The file that a run of a language model begins with: `llm.run_folder`, which needs an extra, has the same name."""


class Kept(NamedTuple):
    """What a folder holds of one agent or model on one task."""

    name: str
    """Who flew, and in which folder."""
    task: TaskConfig
    split: str
    maps: range
    rows: "list[FlownMap]"
    unusable: dict[str, Any] | None
    """The unusable answers of a language model, as its report has them; None of an agent."""


def judged(path: Path) -> "list[Judged | Refused]":
    """What a folder is worth on the leaderboard: an evaluation, a run of a language model, or a folder of these.

    Raises:
        MissingPackageError: if there is a run of a language model, and the extra `llm` is not installed.
    """
    from drone_env.results.leaderboard import Refused, judge_evaluation

    if (path / evaluation.CONFIG).exists():
        return judge_evaluation(path)
    if (path / RUN).exists():
        with needs("llm"):
            from drone_env.llm.leaderboard import judge
        return [judge(path)]
    inside = sorted(file.parent for name in (evaluation.CONFIG, RUN) for file in path.glob(f"*/{name}"))
    if not inside:
        what = "no results in it" if path.is_dir() else "no such folder"
        return [Refused(path, f"{what}; give a folder of evaluate --out or infer --out", damaged=True)]
    return [one for folder in inside for one in judged(folder)]


def judged_once(paths: Iterable[Path]) -> "list[Judged | Refused]":
    """The same of many folders; one that is named twice, itself or by the folder that it lies in, counts once."""
    found: list[Judged | Refused] = []
    for path in paths:
        known = {one.path.resolve() for one in found}
        found += [one for one in judged(path) if one.path.resolve() not in known]
    return found


def kept(path: Path) -> list[Kept]:
    """What a folder holds, map by map.

    Raises:
        InvalidValueError: if it is not ranked on a leaderboard; the message says why.
        MissingPackageError: as `judged` does.
    """
    from drone_env.results.comparison import kept_maps
    from drone_env.results.leaderboard import Refused

    found: list[Kept] = []
    for one in judged(path):
        if isinstance(one, Refused):
            raise InvalidValueError(f"{path}: {one.reason}")
        config = one.figures["config"]
        name = one.figures.get("agent") or config["model"]
        task = get_task(config["task"], config["task_version"])
        rows = kept_maps(name, one.figures)
        maps, unusable = range(*config["seeds"]), one.figures.get("unusable")
        found.append(Kept(f"{name} ({path})", task, config["split"], maps, rows, unusable))
    return found
