"""`drone-env doctor`: what is installed, where data goes, and whether the environment works."""

import os
import platform
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

from drone_env.agents import make_agent
from drone_env.core.compile_cache import cache_folder
from drone_env.envs.registry import load_plugins, plugin_names
from drone_env.errors import DISTRIBUTION, install_command
from drone_env.files import data_folder

Finding = tuple[str, str, str, str]
"""Topic, name, status and detail. The status is `ok`, `absent` (an extra, the cache) or `broken` (flights may fail)."""


def doctor() -> int:
    """Check packages, extras, shipped networks, folders and plugins.

    Exit status: 0 if you can fly, 1 if something is broken. A missing extra is not broken. The command leaves no
    file behind.
    """
    broken: list[str] = []
    for topic, name, status, detail in _diagnose():
        print(f"{topic:9} {name:16} {status:9} {detail}")
        if status == "broken":
            broken.append(name)
    print(f"\nBroken: {', '.join(broken)}" if broken else "\nFlights can be flown.")
    return 1 if broken else 0


def _diagnose() -> Iterator[Finding]:
    yield _checked("system", "python", lambda: f"{platform.python_version()} ({sys.executable}), {platform.platform()}")
    yield _checked("packages", "required", lambda: _complete(""))
    for extra in sorted({*metadata.metadata(DISTRIBUTION).get_all("Provides-Extra", [])} - {"dev", "docs", "test"}):
        yield _checked("extras", extra, partial(_complete, extra), "absent")
    for name in ("pathqnet", "ppo", "tournet"):
        yield _checked("networks", name, partial(_network, name, "easy"))
    for name, find in {"data": data_folder, "results": partial(data_folder, "results")}.items():
        yield _checked("folders", name, partial(_writable, find))
    # Without the cache, every process compiles anew, and flies.
    yield _checked("folders", "cache", partial(_writable, cache_folder), "absent")
    for plugin in plugin_names():
        yield _checked("plugins", plugin, partial(load_plugins, [plugin]))


def _checked(topic: str, name: str, check: Callable[[], object], otherwise: str = "broken") -> Finding:
    """Return the finding of a check, which returns a detail or raises any error, as a plugin may."""
    try:
        status, detail = "ok", str(check())
    except Exception as error:
        status, detail = otherwise, str(error)
    return topic, name, status, detail


def _complete(extra: str) -> str:
    if missing := _missing(extra):
        raise ModuleNotFoundError(f"missing: {', '.join(sorted(missing))}; run: {install_command(extra)}")
    return "complete"


def _missing(extra: str) -> set[str]:
    """Return the unmet requirements of this package with an extra, and with the extras that it names."""
    missing: set[str] = set()
    for requirement in map(Requirement, metadata.requires(DISTRIBUTION) or []):
        if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
            installed = [found.version for found in metadata.distributions(name=requirement.name)]
            if requirement.name == DISTRIBUTION:
                missing.update(*map(_missing, requirement.extras))
            elif not list(requirement.specifier.filter(installed, prereleases=True)):
                missing.add(f"{requirement.name}{requirement.specifier}")
    return missing


def _network(agent: str, task: str) -> str:
    return f"digest {make_agent(agent, task).config['network']}"


def _writable(find: Callable[[], Path]) -> Path:
    folder = find().absolute()
    existing = next(parent for parent in (folder, *folder.parents) if os.path.exists(parent))
    tempfile.TemporaryFile(dir=existing).close()  # permissions do not reveal a read-only disk
    return folder
