"""The grader of `hard_delivery`."""

from collections.abc import Mapping
from typing import Any

from drone_env.graders.formula import grade
from drone_env.models import DroneState


def grade_hard(state: DroneState | Mapping[str, Any]) -> float:
    """The score of a state of `hard_delivery`, in [0.01, 0.99]; raises as `formula.grade`."""
    return grade("hard_delivery", state)
