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
    task = _register_city(path)
    named = [name.strip() for name in plugin_names().split(",") if name.strip()]
    absolute = str(Path(path).resolve())
    if absolute not in named:
        os.environ[PLUGINS] = ",".join([*named, absolute])
    return task


def _register_city(path: str | Path) -> TaskConfig:
    from drone_env.city.city_file import city_task  # which few need

    return register_task(city_task(path))


def task_argument(task: TaskConfig) -> str:
    """The name of a task on the command line: its short name, or the file of a city if that is known."""
    files = [Path(name.strip()) for name in plugin_names().split(",") if name.strip().endswith(".toml")]
    named = [file for file in files if file.stem == task.id] if task.terrain is not None else []
    if not named:
        return task.short_name
    return str(named[0].relative_to(Path.cwd()) if named[0].is_relative_to(Path.cwd()) else named[0])


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


def plugin_names() -> str:
    """What `DRONE_ENV_PLUGINS` names, comma-separated; empty for nothing."""
    return os.environ.get(PLUGINS, "")


def register_reward_file(path: str) -> RewardProfile:
    """Make the reward profile in a TOML file known by its id.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if it is no reward profile, or its id is that of another one.
    """
    from drone_env.reward_file import load_reward_profile  # which few need

    return register_reward_profile(load_reward_profile(path))


def load_plugins(names: str | None = None) -> list[ModuleType]:
    """Import the modules that `names` lists, comma-separated, in order; `DRONE_ENV_PLUGINS` if nothing is said.

    Of a name that ends in .toml, the city is registered.

    Raises:
        InvalidValueError: if there is no such module.
    """
    parts = [part.strip() for part in (plugin_names() if names is None else names).split(",")]
    for city in (part for part in parts if part.endswith(".toml")):
        _register_city(city)
    modules = [part for part in parts if part and not part.endswith(".toml")]
    for name in modules:
        if name.startswith("."):  # which Python would take for a part of a package
            raise InvalidValueError(f"{PLUGINS} takes modules and files that end in .toml, got {name!r}")
    try:
        return [import_module(name) for name in modules]
    except ModuleNotFoundError as error:
        raise InvalidValueError(f"{PLUGINS} takes modules that Python finds, comma-separated: {error}") from None
