"""What worker processes share: importing this loads all code that jobs need, compiled code included.

The process that workers are forked from imports it. Afterwards each worker starts in milliseconds, and the memory of
what is loaded here counts once.
"""

import gc
from contextlib import suppress
from importlib import import_module

from drone_env.agents import make_agent
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import DroneEnvError
from drone_env.planning.elsewhere import battery_range, places_of
from drone_env.planning.solvers import solver_of

for module in ("envs.rendering", "planning.bounds", "server.app"):
    import_module(f"drone_env.{module}")
for task in ("easy", "skyline_easy"):
    episode = Episode(task, seed=0)
    solver = solver_of(episode)
    solver.value(episode)
    solver.best_actions()
    places_of(episode)
    battery_range(episode, episode.cell, 1)
    with suppress(DroneEnvError):  # a network that cannot be read is told of when somebody flies by it
        agent = make_agent("tournet", get_task(task))
        agent.reset(0)
        agent.act(episode.observation())
gc.collect()
gc.freeze()  # the collector would copy pages that are shared
