"""`drone-env`: the command line. A new command is a module of `drone_env.commands` and a name in `COMMANDS`."""

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import tyro
from tyro.extras import SubcommandApp

from drone_env import __version__
from drone_env.commands.arguments import register_files
from drone_env.envs.registry import load_plugins
from drone_env.errors import AgentError, DroneEnvError, InvalidValueError, UnknownNameError
from drone_env.standard_output import guarded, print_error

DESCRIPTION = (
    "A drone delivers parcels on a generated city grid. `drone-env COMMAND --help` is the manual of a command."
)
COMMANDS = (
    *("fly", "evaluate", "leaderboard", "submit", "verify", "solve", "audit"),
    *("train", "plot", "infer", "replay", "dataset", "city", "serve", "doctor"),
)


def _module(name: str) -> Any:
    return import_module(f"drone_env.commands.{name}")


def _run_command(arguments: Sequence[str]) -> int | None:
    """Run a command; wrong options end the program with status 2."""
    if arguments[:1] in (["-h"], ["--help"]):
        overview = SubcommandApp()
        for name in COMMANDS:
            overview.command(getattr(_module(name), name))
        overview.cli(prog="drone-env", description=DESCRIPTION, args=["--help"])
    if not arguments or arguments[0].startswith("-"):
        raise InvalidValueError("name a command, such as fly, evaluate or train; drone-env --help lists all")
    name, *rest = arguments
    if name not in COMMANDS:
        raise UnknownNameError("command", name, COMMANDS)
    module = _module(name)
    rest = register_files(module.expand_config(rest) if name == "train" else rest)
    command = module.train_command(rest) if name == "train" else getattr(module, name)
    return tyro.cli(command, prog=f"drone-env {name}", args=rest, config=[tyro.conf.DisallowNone])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status: 0 for success, 1 for a failed check, 2 for any other error."""
    return guarded(lambda: _run(list(sys.argv[1:] if arguments is None else arguments)))


def _run(arguments: list[str]) -> int:
    if arguments == ["--version"]:
        print(f"drone-env {__version__}")
        return 0
    try:
        if arguments[:1] != ["doctor"]:  # it reports broken plugins itself
            load_plugins()
        return int(_run_command(arguments) or 0)
    except BrokenPipeError:
        raise
    except (DroneEnvError, OSError, MemoryError) as error:
        if isinstance(error, AgentError):
            print(error.trace, end="", file=sys.stderr)
        print_error(error)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
