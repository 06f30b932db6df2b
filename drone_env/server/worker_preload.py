"""Loads all code that jobs need, including compiled code. The forkserver imports this module.

Workers then start in milliseconds and share its memory. Code that is not compiled yet is left to the first job that
needs it, because compiling takes a minute.
"""

import gc
from importlib import import_module

from drone_env.core.compile_cache import is_compiled
from drone_env.core.episode import Episode
from drone_env.planning import legs, solver
from drone_env.planning.cell_states import states_at_cells
from drone_env.planning.optimal import solver_of
from drone_env.planning.paths import cost_kernel

KERNELS = cost_kernel, legs.flight_kernel, legs.rank_kernel, legs.value_kernel, solver.score_kernel, solver.step_kernel

for module in ("envs.rendering", "server.app"):
    import_module(f"drone_env.{module}")
if is_compiled(*KERNELS):
    for task in ("easy", "skyline_easy"):
        episode = Episode(task, seed=0)
        solver_of(episode).best_actions()
        states_at_cells(episode)
gc.collect()
gc.freeze()  # otherwise the collector writes to shared pages, which copies them
