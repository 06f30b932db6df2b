"""The grader of `easy_delivery`."""

from collections.abc import Mapping
from typing import Any

from drone_env.graders.formula import grade
from drone_env.models import DroneState


def grade_easy(state: DroneState | Mapping[str, Any]) -> float:
    """The score of a state of `easy_delivery`, in [0.01, 0.99]; raises as `formula.grade`."""
    return grade("easy_delivery", state)
