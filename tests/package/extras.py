"""The packages of each extra, as uv.lock has them."""

import re
from functools import cache
from importlib.metadata import packages_distributions

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from drone_env.toml_text import parse_toml
from tests.tools import ROOT, find_tool, ran

INSTALLED = packages_distributions()
PROJECT = parse_toml((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@cache
def pins(*extras: str) -> dict[str, Requirement]:
    """Return what the lock has installed on this machine for the package with extras, by name."""
    options = ["--frozen", "--offline", "--no-default-groups", "--no-emit-project", "--no-hashes"]
    exported = ran(find_tool("uv"), "export", *options, *(f"--extra={extra}" for extra in extras))
    assert exported.returncode == 0, exported.stderr
    lines = [Requirement(line) for line in exported.stdout.splitlines() if re.match(r"\w", line)]
    return {canonicalize_name(pin.name): pin for pin in lines if pin.marker is None or pin.marker.evaluate()}


@cache
def brought(*extras: str) -> frozenset[str]:
    """Return the top-level modules that the package with extras installs."""
    names = pins(*extras).keys()
    importable = {
        module
        for module, distributions in INSTALLED.items()
        if any(canonicalize_name(distribution) in names for distribution in distributions)
    }
    return frozenset(importable | {name.replace("-", "_") for name in names})
