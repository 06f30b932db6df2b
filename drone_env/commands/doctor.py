"""`drone-env doctor`: what is installed, where data goes, and whether the environment works."""

import os
import platform
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from packaging.requirements import Requirement

from drone_env import __version__
from drone_env.agents import make_agent
from drone_env.commands.printing import print_json
from drone_env.core.compile_cache import cache_folder
from drone_env.envs.registry import load_plugins, plugin_names
from drone_env.errors import DISTRIBUTION, install_command
from drone_env.files import data_folder


class Finding(NamedTuple):
    """One result. `status` is `ok`, `absent` (an extra) or `broken` (flights may fail)."""

    topic: str
    name: str
    status: str
    detail: str


def doctor(json: bool = False) -> int:
    """Check packages, extras, shipped networks, folders, settings and plugins.

    Exit status: 0 if you can fly, 1 if something is broken. A missing extra is not broken. The command leaves no
    file behind and prints no token.

    Args:
        json: Print JSON.
    """
    findings = list(_diagnose())
    broken = [finding.name for finding in findings if finding.status == "broken"]
    if json:
        print_json({"version": __version__, "healthy": not broken, "findings": [row._asdict() for row in findings]})
    else:
        print("\n".join("{:9} {:16} {:9} {}".format(*finding) for finding in findings))
        print(f"\nBroken: {', '.join(broken)}" if broken else "\nFlights can be flown.")
    return 1 if broken else 0


def _diagnose() -> Iterator[Finding]:
    yield Finding("system", "python", "ok", f"{platform.python_version()} ({sys.executable}), {platform.platform()}")
    yield _checked("packages", "required", _complete, "")
    for extra in sorted({*metadata.metadata(DISTRIBUTION).get_all("Provides-Extra", [])} - {"dev", "docs", "test"}):
        yield _checked("extras", extra, _complete, extra, otherwise="absent")
    for task in ("easy_delivery", "medium_delivery", "hard_delivery"):
        yield _checked("networks", task, _network, "pathqnet", task)
    yield _checked("networks", "tournet", _network, "tournet", "easy")
    for name, folder in {"data": data_folder, "results": lambda: data_folder("results"), "cache": cache_folder}.items():
        yield _checked("folders", name, _writable, folder)
    if find_spec("pydantic_settings") is not None:
        from drone_env.llm.config import load_settings as llm
        from drone_env.server.settings import load_settings as server

        yield _checked("settings", "server", lambda: f"valid: {sorted(server().model_fields_set)}")
        yield _checked("settings", "llm", lambda: f"valid: {llm().model_name}", otherwise="absent")
    for plugin in plugin_names():
        yield _checked("plugins", plugin, load_plugins, [plugin])


def _checked(topic: str, name: str, check: Callable[..., object], *args: Any, otherwise: str = "broken") -> Finding:
    """Return the finding of a check, which returns a detail or raises any error, as a plugin may."""
    try:
        return Finding(topic, name, "ok", str(check(*args)))
    except Exception as error:
        return Finding(topic, name, otherwise, str(error))


def _complete(extra: str) -> str:
    missing = ", ".join(sorted(_missing(extra)))
    if missing:
        raise ModuleNotFoundError(f"missing: {missing}; run: {install_command(extra)}")
    return "complete"


def _missing(extra: str) -> set[str]:
    """Return the unmet requirements of this package with an extra, and with the extras that it names."""
    missing: set[str] = set()
    for requirement in map(Requirement, metadata.requires(DISTRIBUTION) or []):
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        installed = [found.version for found in metadata.distributions(name=requirement.name)]
        if requirement.name == DISTRIBUTION:
            missing.update(*map(_missing, requirement.extras))
        elif not list(requirement.specifier.filter(installed, prereleases=True)):
            missing.add(f"{requirement.name}{requirement.specifier}")
    return missing


def _network(agent: str, task: str) -> str:
    return f"digest {make_agent(agent, task).config['network']}"


def _writable(find: Callable[[], Path]) -> str:
    folder = find().absolute()
    existing = next(parent for parent in (folder, *folder.parents) if os.path.exists(parent))
    tempfile.TemporaryFile(dir=existing).close()  # permissions do not reveal a read-only disk
    return str(folder)
