"""`drone-env doctor`: what is installed, where data goes, and whether flights can be flown."""

import os
import platform
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement

from drone_env import __version__
from drone_env.agents import make_agent
from drone_env.commands.printing import print_json
from drone_env.core.compile_cache import cache_folder
from drone_env.envs.registry import load_plugins, plugin_names
from drone_env.errors import DISTRIBUTION, install_command
from drone_env.files import data_folder


class Finding(NamedTuple):
    """One result. Its status is `ok`, `absent`, `attention` (look at it) or `broken` (flights are in danger)."""

    topic: str
    name: str
    status: str
    detail: str


def doctor(port: int | None = None, json: bool = False) -> int:
    """Check what is installed, where data goes, whether the port is free, and whether the settings are valid.

    Exit status: 0 if flights can be flown, 1 if something is broken: a package that is needed, a shipped network, a
    folder that cannot be written, a setting. An extra that is not installed and a port in use are not broken. The
    command leaves no file behind and prints no token.

    Example: drone-env doctor --port 9000

    Args:
        port: The port that a server would listen on; the default is DRONE_ENV_PORT or 8000.
        json: Print JSON instead.
    """
    findings = list(_diagnose(os.environ.get("DRONE_ENV_PORT", "8000") if port is None else str(port)))
    broken = [finding.name for finding in findings if finding.status == "broken"]
    if json:
        print_json({"version": __version__, "healthy": not broken, "findings": [row._asdict() for row in findings]})
    else:
        print("\n".join("{:9} {:16} {:9} {}".format(*finding) for finding in findings))
        print(f"\nBroken: {', '.join(broken)}" if broken else "\nFlights can be flown.")
    return 1 if broken else 0


def _diagnose(port: str) -> Iterator[Finding]:
    python = f"{platform.python_version()} ({sys.executable}), {platform.platform()}, {os.cpu_count()} cores"
    yield Finding("system", "python", "ok", python)
    yield from _packages()
    for network in ("easy_delivery", "medium_delivery", "hard_delivery", "tournet"):
        yield _checked("networks", network, partial(_network, network))
    folders = {"data": data_folder, "results": partial(data_folder, "results"), "cache": cache_folder}
    for name, folder in folders.items():
        yield _checked("folders", name, partial(_writable, folder))
    yield _checked("port", port, partial(_free, port), otherwise="attention")
    if find_spec("pydantic_settings") is not None:
        from drone_env.llm.settings import load_settings as llm
        from drone_env.server.settings import load_settings as server

        yield _checked("settings", "server", lambda: f"valid: {sorted(server().model_fields_set)}")
        yield _checked("settings", "llm", lambda: f"valid: {llm().model_name}", otherwise="absent")
    for plugin in plugin_names():
        yield _checked("plugins", plugin, partial(load_plugins, [plugin]))


def _packages() -> Iterator[Finding]:
    try:
        extras = metadata.metadata(DISTRIBUTION).get_all("Provides-Extra") or []
    except metadata.PackageNotFoundError:
        yield Finding("packages", "required", "attention", f"{DISTRIBUTION} is not installed: nothing to compare with")
        return
    for extra in ("", *sorted(extras)):
        missing = ", ".join(sorted(_missing(extra)))
        status = "ok" if not missing else "absent" if extra else "broken"
        detail = f"{install_command(extra)} brings {missing}" if missing else "complete"
        yield Finding("extras" if extra else "packages", extra or "required", status, detail)


def _checked(topic: str, name: str, check: Callable[[], object], otherwise: str = "broken") -> Finding:
    """The finding of a check, which returns a detail or raises any error, as a plugin may."""
    try:
        return Finding(topic, name, "ok", str(check()))
    except Exception as error:
        return Finding(topic, name, otherwise, str(error))


def _missing(extra: str) -> set[str]:
    """The unmet requirements of this package with an extra, and with the extras that it names."""
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


def _network(name: str) -> str:
    agent, task = ("tournet", "easy") if name == "tournet" else ("pathqnet", name)
    return f"digest {make_agent(agent, task).config['network']}"


def _writable(find: Callable[[], Path]) -> str:
    folder = find().absolute()
    existing = next(parent for parent in (folder, *folder.parents) if os.path.exists(parent))
    tempfile.TemporaryFile(dir=existing).close()  # permissions alone do not show that a disk is read-only
    return f"{folder}, {shutil.disk_usage(existing).free / 1e9:.1f} GB free"


def _free(port: str) -> str:
    socket.create_server((os.environ.get("DRONE_ENV_HOST", "127.0.0.1"), int(port))).close()
    return "free"
