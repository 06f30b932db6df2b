"""Check that every grader in the manifest can be found, called and believed: python check_graders.py [openenv.yaml]."""

import importlib
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

try:
    import yaml

    from drone_env.core.episode import Episode
    from drone_env.core.tasks import get_task
    from drone_env.models import DroneState
    from drone_env.planning.optimal import solve
    from drone_env.standard_output import guarded
except ModuleNotFoundError as error:
    # The package itself cannot be imported.
    command = runpy.run_path(str(Path(__file__).with_name("drone_env") / "errors.py"))["install_command"]("")
    sys.exit(f"check_graders.py: {error.name} is not installed; run: {command}")

TASKS_REQUIRED = 3


def resolve(path: str) -> Callable[[Any], float]:
    """The function behind `module:function`.

    Raises:
        ValueError: if the path is not of that form, or what it names is no function.
        ImportError, AttributeError: if there is no such module or function.
    """
    module, colon, name = path.partition(":")
    if not colon:
        raise ValueError(f"a grader is named as module:function, got {path!r}")
    grader: Callable[[Any], float] = getattr(importlib.import_module(module), name)
    if not callable(grader):
        raise ValueError(f"{path} is not a function")
    return grader


def check(path: str, task_id: str) -> str:
    """Call a grader on a mission at its start and on the optimal flight, as a model and as a dictionary.

    Raises:
        ValueError: if it does not give the score that the episode itself reports.
    """
    grader = resolve(path)
    task = get_task(task_id)
    episode = Episode(task)
    solution = solve(task, episode.reset(0))
    scores: list[float] = []
    for actions in ((), solution.actions):
        for action in actions:
            episode.step(action)
        state = DroneState.of(episode)
        for form in (state, state.model_dump(mode="json")):
            score = grader(form)
            if score != episode.score:
                raise ValueError(f"{path} says {score} where the episode scores {episode.score}")
        scores.append(episode.score)
    return f"{path}: {scores[0]:.2f} at the start, {scores[1]:.3f} for the optimal flight"


def main(manifest_path: str = str(Path(__file__).with_name("openenv.yaml"))) -> int:
    """Check all graders of a manifest; 0 if they are all right."""
    if manifest_path in ("-h", "--help"):
        print(__doc__)
        return 0
    try:
        manifest = yaml.safe_load(Path(manifest_path).read_text(encoding="utf-8"))
        pairs = [(entry["grader"], entry["id"]) for entry in manifest["tasks"]]
        listed = [entry["id"] for entry in manifest["graders"]]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError) as error:
        print(f"FAILED: cannot read tasks and graders from {manifest_path}: {error!r}")
        return 1
    named = [path for path, _ in pairs]
    problems = [f"{path} is listed under graders, but no task names it" for path in listed if path not in named]
    problems += [f"{path} is named by a task, but not listed under graders" for path in named if path not in listed]
    valid = 0
    for path, task_id in pairs:
        try:
            print(f"ok: {check(path, task_id)}")
            valid += 1
        except Exception as error:  # a grader is foreign code: whatever it raises is what is wrong with it
            problems.append(f"{path}: {error!r}")
    for problem in problems:
        print(f"FAILED: {problem}")
    print(f"Summary: {valid} valid graders found.")
    if problems or valid < TASKS_REQUIRED:
        print("LOCAL CHECK FAILED.")
        return 1
    print("LOCAL CHECK PASSED.")
    return 0


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(*sys.argv[1:2])))
