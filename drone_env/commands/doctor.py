"""`drone-env doctor`: what is installed, where data goes, and whether flights can be flown."""

import errno
import os
import platform
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, NamedTuple

from packaging.requirements import Requirement
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from drone_env import __version__
from drone_env.commands.printing import print_json
from drone_env.core.compile_cache import cache_folder
from drone_env.core.tasks import get_task
from drone_env.envs.registry import load_plugins, plugin_names
from drone_env.errors import DroneEnvError
from drone_env.files import data_folder
from drone_env.installer import DISTRIBUTION, install_command

MARKS = {"ok": "[green]ok[/]", "absent": "[dim]absent[/]", "attention": "[yellow]look[/]", "broken": "[red]broken[/]"}
LAST_PORT = 65535


class Finding(NamedTuple):
    """One result. `attention`: somebody should look at it. `broken`: flights or their records are in danger."""

    topic: str
    name: str
    status: Literal["ok", "absent", "attention", "broken"]
    detail: str


def doctor(port: int | None = None, host: str | None = None, data: Path | None = None, json: bool = False) -> int:
    """Check what is installed, where data goes, whether the port is free, and whether the settings are valid.

    Exit status: 0 if flights can be flown, 1 if something is broken: a package that is needed, a shipped network, a
    folder that cannot be written, a setting. An extra that is not installed and a port in use are not broken. The
    command leaves no file behind and prints no token.

    Example: drone-env doctor --port 9000

    Args:
        port: The port that a server would listen on; the default is DRONE_ENV_PORT or 8000.
        host: The address that it would listen on; the default is DRONE_ENV_HOST or 127.0.0.1.
        data: The data folder; the default is DRONE_ENV_DATA or `data`.
        json: Print JSON instead.
    """
    findings = list(_diagnose(port, host, data))
    broken = [finding.name for finding in findings if finding.status == "broken"]
    if json:
        rows = [finding._asdict() for finding in findings]
        print_json({"version": __version__, "healthy": not broken, "findings": rows})
        return 1 if broken else 0
    table = Table(box=None, title=f"drone-env {__version__}\n", title_justify="left", show_header=False)
    for before, finding in zip([None, *findings], findings, strict=False):
        topic = "" if before is not None and before.topic == finding.topic else finding.topic
        table.add_row(f"[bold]{topic}[/]", escape(finding.name), MARKS[finding.status], escape(finding.detail))
    console = Console()
    console.print(table)
    console.print(f"\n[red]Broken:[/] {escape(', '.join(broken))}" if broken else "\nFlights can be flown.")
    return 1 if broken else 0


def _diagnose(port: int | None, host: str | None, data: Path | None) -> Iterator[Finding]:
    yield Finding("system", "python", "ok", f"{platform.python_version()} ({sys.executable})")
    yield Finding("system", "platform", "ok", f"{platform.platform()}, {os.cpu_count()} cores")
    yield Finding("system", DISTRIBUTION, "ok", f"{__version__} from {Path(__file__).parents[1]}")
    yield from _packages()
    for task in ("easy_delivery", "medium_delivery", "hard_delivery", "tournet"):
        yield _checked("networks", task, partial(_network, task))
    settings = list(_settings())
    yield _checked("folders", "data", partial(_writable, data_folder() if data is None else data))
    yield _checked("folders", "results", partial(_writable, data_folder("results")))
    yield _checked("folders", "cache", lambda: _writable(cache_folder()))
    yield _port(
        os.environ.get("DRONE_ENV_HOST", "127.0.0.1") if host is None else host,
        os.environ.get("DRONE_ENV_PORT", "8000") if port is None else str(port),
    )
    yield from settings
    for name in filter(None, map(str.strip, plugin_names().split(","))):
        yield _checked("plugins", name, partial(_plugin, name))


def _checked(topic: str, name: str, check: Callable[[], str]) -> Finding:
    """The finding of a check that returns a detail, or raises an error if something is broken."""
    try:
        return Finding(topic, name, "ok", check())
    except (DroneEnvError, OSError) as error:
        return Finding(topic, name, "broken", str(error))


def _missing(extra: str = "") -> set[str]:
    """The unmet requirements of this package with an extra, and with the extras that it names."""
    missing: set[str] = set()
    for requirement in map(Requirement, metadata.requires(DISTRIBUTION) or []):
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        if requirement.name == DISTRIBUTION:
            missing.update(*map(_missing, requirement.extras))
            continue
        version = _version(requirement.name)
        if version is None or not requirement.specifier.contains(version, prereleases=True):
            missing.add(f"{requirement.name}{requirement.specifier} ({version or 'not'} installed)")
    return missing


@cache  # the extras share most requirements, and reading metadata is slow
def _version(name: str) -> str | None:
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(name)
    return None


def _packages() -> Iterator[Finding]:
    if _version(DISTRIBUTION) is None:
        yield Finding("packages", DISTRIBUTION, "attention", "not installed: requirements are not checked")
        return
    for name in ("numpy", "numba", "gymnasium", "torch"):
        absent = _version(name) is None
        yield Finding("packages", name, "absent" if absent else "ok", _version(name) or "not installed")
    for extra in ("", *sorted(metadata.metadata(DISTRIBUTION).get_all("Provides-Extra") or [])):
        missing = ", ".join(sorted(_missing(extra)))
        if not extra:
            yield Finding("packages", "required", "broken" if missing else "ok", missing or "complete")
        else:
            detail = f"{install_command(extra)} brings {missing}" if missing else "complete"
            yield Finding("extras", extra, "absent" if missing else "ok", detail)


def _network(name: str) -> str:
    from drone_env.agents.pathqnet import PathQNetAgent  # loads Numba, which other commands need not wait for
    from drone_env.agents.tournet import tour_network

    digest = tour_network(None).digest if name == "tournet" else PathQNetAgent(get_task(name)).config["network"]
    return f"digest {digest}"


def _writable(folder: Path) -> str:
    place = folder.absolute()
    # `os.path.exists`: `Path.exists` raises if a parent may not be entered.
    existing = next(parent for parent in (place, *place.parents) if os.path.exists(parent))
    # Permissions are not enough: root may write anywhere, but not to a read-only disk.
    try:
        tempfile.TemporaryFile(dir=existing).close()
    except OSError as error:
        raise OSError(f"{place} cannot be written: {error.strerror}") from None
    state = "" if existing == place else ", made when needed"
    return f"{place}{state}, {shutil.disk_usage(existing).free / 1e9:.1f} GB free"


def _port(host: str, port: str) -> Finding:
    name = f"{host}:{port}"
    if not port.isdecimal() or int(port) > LAST_PORT:
        return Finding("port", name, "attention", f"a port is 0 to {LAST_PORT}")
    try:
        socket.create_server((host, int(port))).close()
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        detail = "taken: give a server another with --port" if taken else f"cannot be listened on: {error}"
        return Finding("port", name, "attention", detail)
    return Finding("port", name, "ok", "free")


def _settings() -> Iterator[Finding]:
    if find_spec("pydantic_settings") is None:
        for part in ("server", "llm"):
            yield Finding("settings", part, "absent", f"not checked: the extra `{part}` reads them")
        return
    from drone_env.llm import settings as llm
    from drone_env.server import settings as server

    for name, meant in server.misspelt_variables().items():
        yield Finding("settings", name, "attention", f"is not a setting and is ignored; is {meant} meant?")
    yield _checked("settings", "server", lambda: f"valid: {sorted(server.load_settings().model_fields_set)}")
    try:
        settings = llm.load_settings()
        token = "without a token" if llm.token_for(settings, settings.api_base_url) is None else "with a token"
        yield Finding("settings", "llm", "ok", f"valid: {settings.model_name}, called {token}")
    except DroneEnvError as error:
        yield Finding("settings", "llm", "absent", f"no language model can be called: {error}")


def _plugin(name: str) -> str:
    try:
        load_plugins(name)
    except Exception as error:  # a module from outside may raise anything
        raise OSError(f"{type(error).__name__}: {error}") from error
    return "imported"
