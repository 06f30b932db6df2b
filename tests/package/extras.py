"""What each extra brings, and what each module of the package imports: read, not run."""

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from drone_env.installer import DISTRIBUTION
from tests.package.installed import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PACKAGE = ROOT / "drone_env"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


class Import(NamedTuple):
    """One imported name, such as `drone_env.core.tasks.get_task` or `torch.nn`."""

    name: str
    at_once: bool
    """Whether importing the module imports it, and nothing catches that it is missing."""


@cache
def brought(*extras: str) -> frozenset[str]:
    """The top-level names that the package with extras makes importable, from the metadata of what is here."""
    wanted = [Requirement(line) for line in PROJECT["dependencies"]]
    wanted += [Requirement(line) for extra in extras for line in PROJECT["optional-dependencies"][extra]]
    seen: set[tuple[str, str]] = set()
    while wanted:
        requirement = wanted.pop()
        name = canonicalize_name(requirement.name)
        for extra in ("", *requirement.extras):
            if (name, extra) in seen:
                continue
            seen.add((name, extra))
            if name == DISTRIBUTION:
                wanted += [Requirement(line) for line in PROJECT["optional-dependencies"].get(extra, [])]
                continue
            wanted += [needed for needed in _requires(name) if _holds(needed, extra)]
    names = {name for name, _ in seen}
    found = {name.replace("-", "_") for name in names}
    for module, distributions in _distributions().items():
        if any(canonicalize_name(distribution) in names for distribution in distributions):
            found.add(module)
    return frozenset(found)


@cache
def _distributions() -> Mapping[str, list[str]]:
    return packages_distributions()


@cache
def _requires(name: str) -> list[Requirement]:
    try:
        return [Requirement(line) for line in requires(name) or ()]
    except PackageNotFoundError:
        # What is not installed here, such as TRL, is known from the lock.
        return [Requirement(needed["name"]) for needed in _locked().get(name, [])]


@cache
def _locked() -> dict[str, list[dict[str, str]]]:
    packages = tomllib.loads((ROOT / "uv.lock").read_text(encoding="utf-8"))["package"]
    return {package["name"]: package.get("dependencies", []) for package in packages}


def _holds(requirement: Requirement, extra: str) -> bool:
    marker = requirement.marker
    return marker is None or marker.evaluate({"extra": extra}) or (bool(extra) and marker.evaluate({"extra": ""}))


def modules() -> Iterator[str]:
    """All modules of the package."""
    for file in sorted(PACKAGE.rglob("*.py")):
        yield ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def file_of(module: str) -> Path | None:
    """The file of a module of the package; None where the name is none."""
    path = ROOT.joinpath(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


@cache
def imports(file: Path) -> tuple[Import, ...]:
    """All imports of a file, but those for type checkers."""
    return tuple(_imports(ast.parse(file.read_text(encoding="utf-8")).body, at_once=True))


def _imports(body: list[ast.stmt], at_once: bool) -> Iterator[Import]:
    for node in body:
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, at_once) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (Import(f"{node.module}.{alias.name}", at_once) for alias in node.names)
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            yield from _imports(node.orelse, at_once)
        elif isinstance(node, ast.If) and ast.unparse(node.test).startswith("sys.version_info"):
            continue  # one of two ways to the same thing, by the version of Python
        else:
            caught = isinstance(node, ast.Try) and any(
                handler.type and re.search("ImportError|ModuleNotFoundError", ast.unparse(handler.type))
                for handler in node.handlers
            )
            later = caught or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
            for field in ("body", "orelse", "finalbody", "handlers"):
                inner = getattr(node, field, [])
                if isinstance(inner, list):
                    statements = [s for part in inner for s in (part.body if hasattr(part, "type") else [part])]
                    yield from _imports(statements, at_once and not later)


@cache
def stated(module: str) -> tuple[str, ...]:
    """The names of a package that importing a module states, and of those that stand above it."""
    parts = module.split(".")
    files = [file for n in range(1, len(parts) + 1) if (file := file_of(".".join(parts[:n])))]
    return tuple(found.name for file in files for found in imports(file) if found.at_once)


@cache
def loaded_by(module: str) -> frozenset[str]:
    """The foreign top-level names that importing a module of the package imports, through the package's others too."""
    seen: set[str] = set()
    foreign: set[str] = set()
    pending = [module]
    while pending:
        for name in stated(pending.pop()):
            own = name if file_of(name) else name.rpartition(".")[0]
            if not name.startswith("drone_env"):
                foreign.add(name.partition(".")[0])
            elif own not in seen:
                seen.add(own)
                pending.append(own)
    return frozenset(foreign - set(sys.stdlib_module_names))
