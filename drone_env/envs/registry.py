"""Registration of tasks, under their Gymnasium ids too, and of reward profiles from outside the package.

A module registers its own when it is imported:

    courier = replace(get_task("easy"), id="courier", short_name="courier", grader="drone_env.graders:grade_courier")
    register_task(replace(courier, deliveries=2))
    register_reward_profile(RewardProfile("parcels", "a parcel pays", events=((Event.DELIVERY, Decimal(1)),)))
    register_agent("mine", MyAgent)

`gymnasium.make("my_module:DroneDelivery-Courier-v1")` imports `my_module` first; the command line and the server import
what `DRONE_ENV_PLUGINS` names, and so do the nodes of a cluster. A name that ends in .toml is the file of a city, whose
task is registered.
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


def register_envs() -> None:
    """Register each task and version with Gymnasium that is not registered yet, such as `DroneDelivery-Easy-v1`."""
    for task in TASKS.values():
        if task.gym_id not in gymnasium.registry:
            gymnasium.register(
                id=task.gym_id,
                # A function, not `additional_wrappers`: those cannot be combined with a vector_entry_point.
                entry_point="drone_env.envs.wrappers:make",
                vector_entry_point="drone_env.envs.vector:DroneDeliveryVectorEnv",
                kwargs={"task": task.id, "version": task.version, "gym_id": task.gym_id},
            )


def check_gym_id(gym_id: str | None, task: TaskConfig) -> None:
    """See that an environment made under a Gymnasium id flies the task of that id.

    Raises:
        InvalidValueError: if it is another task's.
    """
    if gym_id not in (None, task.gym_id):
        raise InvalidValueError(f"{gym_id} does not fly task {task.id!r}: make {task.gym_id}, or leave the task out")


def register_task(task: TaskConfig) -> TaskConfig:
    """Make a task known by its names everywhere: command line, evaluation, Gymnasium, graders; the task is handed back.

    Registering an equal task again changes nothing.

    Raises:
        InvalidTaskError: if its id, short name or grader is that of another task.
    """
    from drone_env.graders import GRADERS, make_grader  # loads Pydantic, which the package's face does without

    check_names(task)
    TASKS[task.id] = task
    GRADERS.setdefault(task.id, make_grader(task.id))
    register_envs()
    return task


def check_names(task: TaskConfig) -> None:
    """See that no other task has one of the names of a task.

    Raises:
        InvalidTaskError: if one has.
    """
    names = {task.id, task.short_name, task.grader}
    for other in TASKS.values():
        taken = sorted(names & {other.id, other.short_name, other.grader})
        if taken and other != task:
            raise InvalidTaskError(f"task {task.id!r}: {', '.join(taken)} already names the task {other.id!r}")


def register_city(path: str | Path) -> TaskConfig:
    """Register the task of a city's file, here and, by `DRONE_ENV_PLUGINS`, in the processes that this one starts.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if it is no city that can be a task, or its name is that of another task.
    """
    from drone_env.city.city_file import city_task  # which few need

    task = register_task(city_task(path))
    named, absolute = plugin_names(), str(Path(path).resolve())
    if absolute not in named:
        os.environ[PLUGINS] = ",".join([*named, absolute])
    return task


def task_argument(task: TaskConfig) -> str:
    """The name of a task on the command line: its short name, or the file of a city if that is known."""
    for file in map(Path, plugin_names()):
        if task.terrain is not None and file.suffix == ".toml" and file.stem == task.id:
            return str(file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file)
    return task.short_name


def register_reward_profile(profile: RewardProfile) -> RewardProfile:
    """Make a reward profile known by its name everywhere; the profile is handed back.

    Registering an equal profile again changes nothing.

    Raises:
        InvalidTaskError: if its id is that of another profile.
    """
    if REWARD_PROFILES.get(profile.id, profile) != profile:
        raise InvalidTaskError(f"reward profile {profile.id!r}: there is another one of this name")
    REWARD_PROFILES[profile.id] = profile
    return profile


def plugin_names() -> tuple[str, ...]:
    """The modules and cities that `DRONE_ENV_PLUGINS` names, comma-separated."""
    return tuple(filter(None, map(str.strip, os.environ.get(PLUGINS, "").split(","))))


def register_reward_file(path: str) -> RewardProfile:
    """Make the reward profile in a TOML file known by its id.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if it is no reward profile, or its id is that of another one.
    """
    from drone_env.reward_file import load_reward_profile  # which few need

    return register_reward_profile(load_reward_profile(path))


def load_plugins(names: Iterable[str] | None = None) -> list[ModuleType]:
    """Import these modules, or those that `DRONE_ENV_PLUGINS` names; a name that ends in .toml registers its city.

    Raises:
        InvalidValueError: if there is no such module.
    """
    modules: list[ModuleType] = []
    for name in plugin_names() if names is None else names:
        if name.endswith(".toml"):
            from drone_env.city.city_file import city_task  # which few need

            register_task(city_task(name))
            continue
        try:
            modules.append(import_module(name))
        except (ModuleNotFoundError, TypeError) as error:  # a TypeError for a name that begins with a dot
            raise InvalidValueError(f"{PLUGINS} takes modules and files that end in .toml: {error}") from None
    return modules
