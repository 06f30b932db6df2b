"""The grader of `medium_delivery`."""

from drone_env.graders.formula import make_grader

grade_medium = make_grader("medium_delivery")
"""The score of a state of `medium_delivery`, in [0.01, 0.99]; raises as `formula.grade`."""
