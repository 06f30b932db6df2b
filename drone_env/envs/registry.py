"""Registration of your own tasks and reward profiles.

A module registers them when it is imported:

    courier = replace(get_task("easy"), id="courier", short_name="courier", grader="drone_env.graders:grade_courier")
    register_task(replace(courier, deliveries=2))
    register_reward_profile(RewardProfile("parcels", "a parcel pays", events=((Event.DELIVERY, Decimal(1)),)))
    register_agent("mine", MyAgent)

`gymnasium.make("my_module:DroneDelivery-Courier-v1")` imports `my_module` first. The command line, the server and the
nodes of a cluster import the modules in `DRONE_ENV_PLUGINS`. A name there that ends in .toml registers a city file.
"""

import os
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from types import ModuleType

import gymnasium

from drone_env.core.rewards import REWARD_PROFILES, RewardProfile
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import InvalidTaskError, InvalidValueError

PLUGINS = "DRONE_ENV_PLUGINS"
MIXTURE = "DroneDelivery-Mixture-v1"
FILES: dict[tuple[str, str], str] = {}
"""The files of registered cities and reward profiles as the caller named them, by the setting and the id."""


class StepLimit(int):
    """The steps of a task, for libraries that read `max_episode_steps`.

    The task itself ends after them, so they must not truncate, also if a search takes more steps from restored states.
    Gymnasium's `TimeLimit` truncates if `steps >= limit`, which Python computes as `limit <= steps` for a subclass of
    int.
    """

    def __le__(self, steps: int) -> bool:
        return False


def register_envs() -> None:
    """Register all tasks with Gymnasium, such as `DroneDelivery-Easy-v1`, and their mixture."""
    if MIXTURE not in gymnasium.registry:
        gymnasium.register(id=MIXTURE, entry_point="drone_env.envs.mixture:MixtureEnv")
    for task in TASKS.values():
        if task.gym_id not in gymnasium.registry:
            gymnasium.register(
                id=task.gym_id,
                # Not `additional_wrappers`, because Gymnasium does not allow them with a vector_entry_point.
                entry_point="drone_env.envs.wrappers:make",
                vector_entry_point="drone_env.envs.vector:DroneDeliveryVectorEnv",
                max_episode_steps=StepLimit(task.max_steps),
                kwargs={"task": task.id, "version": task.version},
            )


def register_task(task: TaskConfig) -> TaskConfig:
    """Register a task for command line, evaluation, Gymnasium and graders, and return it.

    Registering an equal task again has no effect.

    Raises:
        InvalidTaskError: if another task has the same id, short name or grader.
    """
    from drone_env.graders import GRADERS, make_grader  # imported lazily: loads Pydantic

    names = {task.id, task.short_name, task.grader}
    for other in TASKS.values():
        taken = sorted(names & {other.id, other.short_name, other.grader})
        if taken and other != task:
            raise InvalidTaskError(f"task {task.id!r}: {', '.join(taken)} already names the task {other.id!r}")
    TASKS[task.id] = task
    GRADERS.setdefault(task.id, make_grader(task.id))
    register_envs()
    return task


def register_city(path: str | Path) -> TaskConfig:
    """Register the task of a city file, here and, with `DRONE_ENV_PLUGINS`, in the processes that this one starts.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if the file does not define a task, or another task has its name.
    """
    from drone_env.city.city_file import city_task  # imported lazily: rarely needed

    task = register_task(city_task(path))
    FILES["task", task.id] = str(path)
    named, absolute = plugin_names(), str(Path(path).resolve())
    if absolute not in named:
        os.environ[PLUGINS] = ",".join([*named, absolute])
    return task


def register_reward_profile(profile: RewardProfile) -> RewardProfile:
    """Register a reward profile under its id, and return it.

    Registering an equal profile again has no effect.

    Raises:
        InvalidTaskError: if another profile has this id.
    """
    if REWARD_PROFILES.get(profile.id, profile) != profile:
        raise InvalidTaskError(f"reward profile {profile.id!r}: another profile has this id")
    REWARD_PROFILES[profile.id] = profile
    return profile


def plugin_names() -> tuple[str, ...]:
    """The comma-separated modules and city files in `DRONE_ENV_PLUGINS`."""
    return tuple(filter(None, map(str.strip, os.environ.get(PLUGINS, "").split(","))))


def register_reward_file(path: str) -> RewardProfile:
    """Register the reward profile of a TOML file.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if the file does not define a reward profile, or another profile has its id.
    """
    from drone_env.reward_file import load_reward_profile  # imported lazily: rarely needed

    profile = register_reward_profile(load_reward_profile(path))
    FILES["reward_profile", profile.id] = path
    return profile


def load_plugins(names: Iterable[str] | None = None) -> list[ModuleType]:
    """Import these modules, or those in `DRONE_ENV_PLUGINS`. A name that ends in .toml registers a city file.

    Raises:
        InvalidValueError: if there is no such module.
    """
    modules: list[ModuleType] = []
    for name in plugin_names() if names is None else names:
        if name.endswith(".toml"):
            from drone_env.city.city_file import city_task  # imported lazily: rarely needed

            register_task(city_task(name))
            continue
        try:
            modules.append(import_module(name))
        except (ModuleNotFoundError, TypeError) as error:  # TypeError: the name starts with a dot
            raise InvalidValueError(f"{PLUGINS} takes modules and files that end in .toml: {error}") from None
    return modules
