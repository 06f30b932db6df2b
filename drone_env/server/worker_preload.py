"""Loads all code that jobs need, including compiled code. The forkserver imports this module.

Workers then start in milliseconds and share its memory. Code that is not compiled yet is left to the first job that
needs it, because compiling takes a minute.
"""

import gc
from contextlib import suppress
from importlib import import_module

from drone_env.agents import make_agent
from drone_env.agents.tour_features import encode_kernel
from drone_env.core.compile_cache import is_compiled
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import DroneEnvError
from drone_env.planning import legs, solver, stops
from drone_env.planning.cell_states import battery_range, states_at_cells
from drone_env.planning.optimal import solver_of
from drone_env.planning.paths import cost_kernel

SOLVERS = (
    cost_kernel, legs.flight_kernel, legs.rank_kernel, legs.value_kernel, solver.score_kernel, solver.step_kernel
)  # fmt: skip
AGENTS = {
    "tournet": (encode_kernel,),
    "beam": (stops.measure_kernel, stops.beam_kernel, stops.route_kernel),
}
TASKS = ("easy", "skyline_easy")


for module in ("envs.rendering", "server.app"):
    import_module(f"drone_env.{module}")
if is_compiled(*SOLVERS):
    for task in TASKS:
        episode = Episode(task, seed=0)
        values = solver_of(episode)
        values.value(episode)
        values.best_actions()
        states_at_cells(episode)
        battery_range(episode, episode.cell, 1)
for name, kernels in AGENTS.items():
    for task in TASKS if is_compiled(*kernels) else ():
        with suppress(DroneEnvError):  # a job that uses an invalid network raises the error
            agent = make_agent(name, get_task(task))
            agent.reset(0)
            agent.act(Episode(task, seed=0).observation())
gc.collect()
gc.freeze()  # otherwise the collector writes to shared pages, which copies them
