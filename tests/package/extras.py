"""The packages of each extra, from the metadata of installed packages."""

from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from drone_env.errors import DISTRIBUTION
from drone_env.toml_text import parse_toml
from tests.package.installed import ROOT

INSTALLED = packages_distributions()
PROJECT = parse_toml((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@cache
def brought(*extras: str) -> frozenset[str]:
    """Return the top-level modules that the package with extras installs."""
    wanted = [Requirement(line) for line in PROJECT["dependencies"]]
    wanted += [Requirement(line) for extra in extras for line in PROJECT["optional-dependencies"][extra]]
    seen: set[tuple[str, str]] = set()
    while wanted:
        requirement = wanted.pop()
        name = canonicalize_name(requirement.name)
        for extra in {"", *requirement.extras} - {extra for known, extra in seen if known == name}:
            seen.add((name, extra))
            if name == DISTRIBUTION:
                needed = [Requirement(line) for line in PROJECT["optional-dependencies"].get(extra, [])]
            else:
                needed = [one for one in _requires(name) if not one.marker or one.marker.evaluate({"extra": extra})]
            wanted += needed
    names = {name for name, _ in seen}
    importable = {
        module
        for module, distributions in INSTALLED.items()
        if any(canonicalize_name(distribution) in names for distribution in distributions)
    }
    return frozenset(importable | {name.replace("-", "_") for name in names})


def _requires(name: str) -> list[Requirement]:
    try:
        return [Requirement(line) for line in requires(name) or ()]
    except PackageNotFoundError:
        return []
