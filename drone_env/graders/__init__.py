"""Graders: from the state of an episode to its score."""

from collections.abc import Callable, Mapping
from typing import Any

from drone_env.graders.easy import grade_easy
from drone_env.graders.hard import grade_hard
from drone_env.graders.medium import grade_medium
from drone_env.models import DroneState

Grader = Callable[[DroneState | Mapping[str, Any]], float]

GRADERS: dict[str, Grader] = {
    "easy_delivery": grade_easy,
    "medium_delivery": grade_medium,
    "hard_delivery": grade_hard,
}

__all__ = ["GRADERS", "Grader", "grade_easy", "grade_hard", "grade_medium"]
