"""What `drone-env doctor` looks at, one function for each topic. Works where no extra is installed."""

import base64
import errno
import hashlib
import os
import platform
import shutil
import socket
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from packaging.requirements import Requirement

from drone_env import __version__
from drone_env.agents import tournet
from drone_env.agents.pathqnet import PathQNetAgent, shipped_network
from drone_env.core.compile_cache import cache_folder
from drone_env.core.tasks import TASKS
from drone_env.envs.registry import load_plugins, plugin_names
from drone_env.errors import DroneEnvError
from drone_env.files import data_folder
from drone_env.installer import DISTRIBUTION, install_command

Status = Literal["ok", "absent", "attention", "broken"]
SHIPPED = ("easy_delivery", "medium_delivery", "hard_delivery")
"""The tasks whose own networks come with the package."""
MEGABYTE = 1_000_000
LAST_PORT = 65535
DEFAULT_HOST, DEFAULT_PORT, DEFAULT_DATA = "127.0.0.1", 8000, Path("data")
"""What the server takes, where its package is not there to be asked."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        topic: What it belongs to.
        name: What was looked at.
        status: `ok`; `absent` where it is not installed and need not be; `attention` where somebody should look at it;
            `broken` where flights or their records are in danger.
        detail: The finding, for people.
        facts: The same as JSON values.
    """

    topic: str
    name: str
    status: Status
    detail: str
    facts: dict[str, object] = field(default_factory=dict[str, object])


def diagnose(port: int | None, host: str | None, data: Path | None) -> list[Finding]:
    """Everything, in the order in which it is shown. What is None comes from the settings."""
    settings, found_host, found_port, found_data = _server_settings()
    return [
        *_system(),
        *_packages(),
        *_extras(),
        *_networks(),
        *_folders(found_data if data is None else data),
        _port(found_host if host is None else host, found_port if port is None else port),
        *settings,
        *_inference_settings(),
        *_plugins(),
    ]


def _installed() -> metadata.Distribution | None:
    try:
        return metadata.distribution(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        return None


def _system() -> Iterator[Finding]:
    python = platform.python_version()
    yield Finding("system", "python", "ok", f"{python} ({sys.executable})", {"version": python})
    machine = f"{platform.platform()}, {platform.machine()}, {os.cpu_count()} cores"
    yield Finding("system", "platform", "ok", machine, {"cores": os.cpu_count()})
    installed = _installed()
    version = "nothing" if installed is None else installed.version
    differs = "" if version == __version__ else f", but {version} is installed"
    detail = f"{__version__} from {Path(__file__).parents[1]}{differs}"
    yield Finding("system", DISTRIBUTION, "attention" if differs else "ok", detail, {"version": __version__})


# The extras name each other and ask for much the same, and reading what is installed takes its time.
_version = cache(metadata.version)
_requirement = cache(Requirement)


def _unmet(requirement: Requirement) -> str | None:
    """Why a requirement is not met, None where it is."""
    try:
        version = _version(requirement.name)
    except metadata.PackageNotFoundError:
        return requirement.name
    if requirement.specifier.contains(version, prereleases=True):
        return None
    return f"{requirement.name}{requirement.specifier} (there is {version})"


def _missing(extra: str = "") -> dict[str, str]:
    """By name: why what the package asks for with this extra, and with those that it names, is not met."""
    installed = _installed()
    missing: dict[str, str] = {}
    for requirement in map(_requirement, (installed and installed.requires) or []):
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        if requirement.name == DISTRIBUTION:
            for other in requirement.extras:
                missing |= _missing(other)
        elif unmet := _unmet(requirement):
            missing[requirement.name] = unmet
    return missing


def _packages() -> Iterator[Finding]:
    for name, unmet in _missing().items():
        yield Finding("packages", name, "broken", f"missing: {unmet}")
    for name in ("numpy", "numba", "gymnasium"):
        version = metadata.version(name)
        yield Finding("packages", name, "ok", version, {"version": version})
    if find_spec("torch") is None:
        yield Finding("packages", "torch", "absent", "needed to train, not to fly")
        return
    import torch

    cuda = torch.cuda.is_available()
    where = f"CUDA {torch.version.cuda} on {torch.cuda.get_device_name()}" if cuda else "no CUDA device"
    yield Finding("packages", "torch", "ok", f"{torch.__version__}, {where}", {"cuda": cuda})


def _extras() -> Iterator[Finding]:
    installed = _installed()
    for extra in sorted((installed and installed.metadata.get_all("Provides-Extra")) or []):
        missing = sorted(_missing(extra).values())
        detail = f"{install_command(extra)} brings {', '.join(missing)}" if missing else "complete"
        yield Finding("extras", extra, "absent" if missing else "ok", detail, {"missing": missing})


def _networks() -> Iterator[Finding]:
    installed = _installed()
    # Of a wheel; an editable installation records no networks.
    recorded = {
        Path(str(file.locate())): file.hash.value for file in (installed and installed.files) or [] if file.hash
    }
    for name in (*SHIPPED, "tournet"):
        path = tournet.SHIPPED if name == "tournet" else shipped_network(TASKS[name])
        try:
            digest = (
                tournet.tour_network(None).digest if name == "tournet" else PathQNetAgent(TASKS[name]).config["network"]
            )
            content = path.read_bytes()
        except (DroneEnvError, OSError) as error:
            yield Finding("networks", name, "broken", str(error))
            continue
        sha256 = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        if recorded.get(path, sha256) != sha256:
            yield Finding("networks", name, "broken", f"{path} is not the file that was installed")
        else:
            detail = f"{len(content) / MEGABYTE:.2f} MB, digest {digest}"
            yield Finding("networks", name, "ok", detail, {"digest": digest})


def _folders(data: Path) -> Iterator[Finding]:
    yield _folder("data", data, "episodes, sessions, logs, checkpoints, runs of language models")
    yield _folder("results", data_folder("results"), "curves of training")
    try:
        cache = cache_folder()
    except OSError as error:
        yield Finding("folders", "cache", "broken", f"compiled code cannot be kept: {error}")
        return
    yield _folder("cache", cache, "compiled code")


def _folder(name: str, folder: Path, holds: str) -> Finding:
    place = folder.absolute()
    # `os.path`, as `Path.exists` raises where a parent may not be entered.
    existing = next(parent for parent in (place, *place.parents) if os.path.exists(parent))
    facts: dict[str, object] = {"path": str(place), "exists": existing == place, "writable": False}
    try:
        # Rights alone do not tell: root may write anywhere, but not to a disk that is mounted read-only.
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        return Finding("folders", name, "broken", f"{place} cannot be written ({holds}): {error.strerror}", facts)
    size = sum(file.stat().st_size for file in place.rglob("*") if file.is_file()) if existing == place else 0
    free = shutil.disk_usage(existing).free
    facts |= {"writable": True, "bytes": size, "free_bytes": free}
    state = f"{size / MEGABYTE:.1f} MB" if existing == place else "made when needed"
    return Finding("folders", name, "ok", f"{place} ({holds}): {state}, {free / MEGABYTE / 1000:.1f} GB free", facts)


def _port(host: str, port: int) -> Finding:
    name = f"{host}:{port}"
    if not 0 <= port <= LAST_PORT:  # some systems would look at the remainder, a port of their own
        return Finding("port", name, "attention", f"a port is 0 to {LAST_PORT}", {"free": False})
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            # As servers do: a connection that has just been closed does not take the port.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        detail = "taken: give a server another with --port" if taken else f"cannot be listened on: {error.strerror}"
        return Finding("port", name, "attention", detail, {"free": False})
    return Finding("port", name, "ok", "free", {"free": True})


def _server_settings() -> tuple[list[Finding], str, int, Path]:
    """The findings, and the host, port and data folder that a server would take."""
    if find_spec("pydantic_settings") is None:
        finding = Finding("settings", "server", "absent", "not checked: the extra `server` reads them")
        return [finding], DEFAULT_HOST, DEFAULT_PORT, DEFAULT_DATA
    from drone_env.server.settings import load_settings, misspelt_variables

    findings = [
        Finding("settings", name, "attention", f"is not a setting and is ignored; is {meant} meant?")
        for name, meant in misspelt_variables().items()
    ]
    try:
        settings = load_settings()
    except DroneEnvError as error:
        findings.append(Finding("settings", "server", "broken", str(error)))
        return findings, DEFAULT_HOST, DEFAULT_PORT, DEFAULT_DATA
    set_here = sorted(name for name in settings.model_fields_set)
    shown = ", ".join(f"DRONE_ENV_{name.upper()}" for name in set_here) or "none is set"
    findings.append(Finding("settings", "server", "ok", f"understood: {shown}", {"set": set_here}))
    return findings, settings.host, settings.port, settings.data


def _inference_settings() -> Iterator[Finding]:
    if find_spec("pydantic_settings") is None:
        yield Finding("settings", "llm", "absent", "not checked: the extra `llm` reads them")
        return
    from drone_env.llm.settings import ignored_variables, load_settings, token_for

    try:
        settings = load_settings()
        ignored = ignored_variables()
    except DroneEnvError as error:
        yield Finding("settings", "llm", "broken", str(error))
        return
    for name, hint in ignored.items():
        yield Finding("settings", name, "attention", hint)
    try:
        token = token_for(settings, settings.api_base_url)
    except DroneEnvError as error:
        yield Finding("settings", "llm", "absent", f"no language model can be asked: {error}")
        return
    carried = "without a token" if token is None else "with a token"
    yield Finding("settings", "llm", "ok", f"understood: {settings.model_name}, asked {carried}")


def _plugins() -> Iterator[Finding]:
    for name in filter(None, map(str.strip, plugin_names().split(","))):
        status, detail = "ok", "imported"
        try:
            load_plugins(name)
        except Exception as error:  # whatever a module from outside raises when it is imported
            status, detail = "broken", f"{type(error).__name__}: {error}"
        yield Finding("plugins", name, status, detail)
