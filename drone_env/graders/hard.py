"""The grader of `hard_delivery`."""

from drone_env.graders.formula import make_grader

grade_hard = make_grader("hard_delivery")
"""The score of a state of `hard_delivery`, in [0.01, 0.99]; raises as `formula.grade`."""
