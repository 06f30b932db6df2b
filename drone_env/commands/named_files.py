"""Files that arguments name: those that are registered before a command runs, and what was expected of missing ones."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from drone_env.envs.registry import PLUGINS, plugin_names, register_city, register_reward_file

REGISTERED: dict[str, Callable[[str], Any]] = {
    "--task": register_city,
    "--reward-profile": register_reward_file,
    "--reward": register_reward_file,
}
"""Of the options that take a name or a TOML file, what makes the file known by a name."""
AGENTS = "names of agents, AGENT:FILE.safetensors and FILE.zip:WRAPPER"
RECORD = "the record of a flight, as `drone-env fly --record` saves it"
REWARDS = "a reward profile or a TOML file with one (docs/reward.md)"
TAKES: dict[str, str] = {
    "--agent": AGENTS,
    "--agents": AGENTS,
    "compare": AGENTS,
    "replay": RECORD,
    "analyse-flight": RECORD,
    "--reward-profile": REWARDS,
    "--reward": REWARDS,
    "--task": "a task or the file of a city, as `drone-env city` writes it",
    "--checkpoint": "the network of an agent (.safetensors), as `drone-env train` writes it",
    "--prompt": "a prompt or a TOML file with one (docs/llm.md)",
    "--prompts": "prompts or TOML files with one (docs/llm.md)",
    "--set": "values, of reward_profile also TOML files with one",
    "--reward-profiles": "TOML files of reward profiles (docs/reward.md)",
    "city": "an extract of OpenStreetMap (.osm.pbf, .osm) or a map of the MovingAI benchmark (.map)",
    PLUGINS: "modules and the files of cities, comma-separated",
}
"""What options, and commands without one, take."""


def with_names(arguments: Sequence[str]) -> list[str]:
    """The arguments with a name for each file of a city or a reward profile, which is registered.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if it is none, or its name is that of another one.
    """
    named: list[str] = []
    for option, argument in _with_options(arguments):
        if option in REGISTERED and argument.endswith(".toml"):
            file = argument.partition("=")[2] if argument.startswith("-") else argument
            argument = argument.removesuffix(file) + REGISTERED[option](file).id
        named.append(argument)
    return named


def told(error: OSError, arguments: Sequence[str]) -> str:
    """An error of the system in a line: where an argument names the file, with what was expected there."""
    file = error.filename
    if not isinstance(file, (str, Path)):
        return str(error)
    wrong = f"{error.strerror}: {file}"
    for option, argument in _with_options(arguments):
        if str(file) in argument:
            option = option if option in TAKES else arguments[0]
            return f"{option} takes {TAKES[option]}; {wrong}" if option in TAKES else wrong
    return f"{PLUGINS} takes {TAKES[PLUGINS]}; {wrong}" if str(file) in plugin_names() else wrong


def _with_options(arguments: Sequence[str]) -> list[tuple[str, str]]:
    """Each argument with the option that it is, or stands behind."""
    found: list[tuple[str, str]] = []
    option = ""
    for argument in arguments:
        if argument.startswith("-"):
            option = argument.partition("=")[0].replace("_", "-")
        found.append((option, argument))
    return found
