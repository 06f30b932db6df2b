"""The grader of `easy_delivery`."""

from drone_env.graders.formula import make_grader

grade_easy = make_grader("easy_delivery")
"""The score of a state of `easy_delivery`, in [0.01, 0.99]; raises as `formula.grade`."""
