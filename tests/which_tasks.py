"""Tasks that a test can do with: what all of them show."""

from drone_env.core.tasks import TASKS

SMALL = {name: task for name, task in TASKS.items() if task.width * task.height <= 400}
"""Those whose maps are small: on a whole city the same takes seconds, and shows nothing more."""
DRAWN = {name: task for name, task in TASKS.items() if task.terrain is None}
"""Those whose terrain is drawn, as many cells of each kind as the task says."""
