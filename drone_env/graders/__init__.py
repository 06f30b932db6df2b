"""Graders compute the score of an episode from its state. Every task in `TASKS` has one."""

from drone_env.core.tasks import TASKS
from drone_env.graders.easy import grade_easy
from drone_env.graders.formula import Grader, grade, make_grader
from drone_env.graders.hard import grade_hard
from drone_env.graders.medium import grade_medium

GRADERS: dict[str, Grader] = {task.id: make_grader(task.id) for task in TASKS.values()} | {
    "easy_delivery": grade_easy,
    "medium_delivery": grade_medium,
    "hard_delivery": grade_hard,
}
"""Graders by task id."""

__all__ = ["GRADERS", "Grader", "grade", "grade_easy", "grade_hard", "grade_medium", "make_grader"]


def __getattr__(name: str) -> Grader:
    """Return the grader that a task refers to as `drone_env.graders:name`."""
    for task in TASKS.values():
        if task.grader == f"{__name__}:{name}":
            return GRADERS[task.id]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
