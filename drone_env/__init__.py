"""Drone Delivery Env: a drone delivers parcels on a generated city grid; every score is compared with the optimum.

Importing the package registers its environments with Gymnasium. Everything else is imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from drone_env.envs.registry import register_envs

if TYPE_CHECKING:
    from drone_env.agents import AGENTS, make_agent, register_agent
    from drone_env.agents.base import Agent
    from drone_env.core.actions import Action, Event, Outcome
    from drone_env.core.cells import Cell
    from drone_env.core.episode import Episode, EpisodeState
    from drone_env.core.grid_generator import CityMap, generate_city_map
    from drone_env.core.rewards import REWARD_PROFILES, RewardProfile
    from drone_env.core.seeds import SPLITS, next_seed, split_seeds
    from drone_env.core.tasks import TASKS, TaskConfig, get_task
    from drone_env.envs.registry import register_city, register_reward_profile, register_task
    from drone_env.graders import GRADERS
    from drone_env.models import DroneAction, DroneObservation, DroneState
    from drone_env.planning.optimal import Solution, solve
    from drone_env.results.evaluate import episodes_key, evaluate, run_episodes, summarise

__version__ = "0.5.0"

_HOMES = {
    "agents": ("AGENTS", "make_agent", "register_agent"),
    "agents.base": ("Agent",),
    "core.actions": ("Action", "Event", "Outcome"),
    "core.cells": ("Cell",),
    "core.episode": ("Episode", "EpisodeState"),
    "core.grid_generator": ("CityMap", "generate_city_map"),
    "core.rewards": ("REWARD_PROFILES", "RewardProfile"),
    "core.seeds": ("SPLITS", "next_seed", "split_seeds"),
    "core.tasks": ("TASKS", "TaskConfig", "get_task"),
    "envs.registry": ("register_city", "register_reward_profile", "register_task"),
    "results.evaluate": ("episodes_key", "evaluate", "run_episodes", "summarise"),
    "graders": ("GRADERS",),
    "models": ("DroneAction", "DroneObservation", "DroneState"),
    "planning.optimal": ("Solution", "solve"),
}
"""The public names by module."""

__all__ = ["__version__"]
__all__ += ["AGENTS", "Agent", "make_agent", "register_agent"]
__all__ += ["Action", "Event", "Outcome"]
__all__ += ["Cell"]
__all__ += ["Episode", "EpisodeState"]
__all__ += ["CityMap", "generate_city_map"]
__all__ += ["REWARD_PROFILES", "RewardProfile"]
__all__ += ["SPLITS", "next_seed", "split_seeds"]
__all__ += ["TASKS", "TaskConfig", "get_task"]
__all__ += ["register_city", "register_reward_profile", "register_task"]
__all__ += ["episodes_key", "evaluate", "run_episodes", "summarise"]
__all__ += ["GRADERS"]
__all__ += ["DroneAction", "DroneObservation", "DroneState"]
__all__ += ["Solution", "solve"]


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            value = globals()[name] = getattr(import_module(f"{__name__}.{home}"), name)
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)


register_envs()
