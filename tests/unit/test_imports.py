"""What importing the package loads, and who may import whom."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.tools import ROOT, ran

PACKAGE = ROOT / "drone_env"
HEAVY = {
    *("PIL", "fastapi", "fastmcp", "gradio", "httpx", "matplotlib", "numba", "openenv", "pandas", "pydantic"),
    *("huggingface_hub", "pygame", "ray", "torch", "tyro"),
}
ALLOWED_IN_CORE = {"drone_env", "filelock", "numpy", "numba", "llvmlite", "platformdirs", *sys.stdlib_module_names}

# Each floor may import from the floors below it, and from its own.
FLOORS = [
    {"errors", "files", "toml_text"},
    {"core"},
    {"city", "planning", "models", "reward_file", "standard_output"},
    {"graders"},
    {"envs"},
    {"agents"},
    {"flights"},
    {"results"},
    {"rl"},
    {"client", "openenv_client"},
    {"llm"},
    {"datasets", "server"},
    {"cluster"},
    {"commands", "cli", "__main__"},
]


def imported_names(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            yield str(node.module)


def modules() -> Iterator[tuple[str, Path]]:
    """(part of the package, file) of every module but the package's face."""
    for file in sorted(PACKAGE.rglob("*.py")):
        part = file.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if part != "__init__":
            yield part, file


def floor(part: str) -> int:
    return next(i for i, parts in enumerate(FLOORS) if part in parts)


@pytest.mark.parametrize(
    ("code", "allowed"),
    [
        ("from drone_env.cli import main; main(['fly', '--agent', 'pathqnet'])", ("tyro",)),
        ("import drone_env.client", ("httpx",)),
        ("import drone_env.commands.serve, drone_env.server.app; drone_env.server.app.app", ("fastapi", "pydantic")),
    ],
)
def test_nothing_heavy_is_loaded(code: str, allowed: tuple[str, ...]) -> None:
    code = f"{code}; import sys; print(*sys.modules, file=sys.stderr)"
    done = ran(sys.executable, "-c", code)
    loaded = set(done.stderr.split())
    assert done.returncode == 0
    assert {"drone_env", "numpy"} <= loaded
    assert loaded & HEAVY == set(allowed)


def test_imports_point_inwards() -> None:
    imports = [(part, file, name) for part, file in modules() for name in imported_names(file)]
    outwards = [
        (str(file.relative_to(PACKAGE)), name)
        for part, file, name in imports
        if name.startswith("drone_env.") and floor(name.split(".")[1]) > floor(part)
    ]
    foreign = {name for part, _, name in imports if part == "core" and name.partition(".")[0] not in ALLOWED_IN_CORE}
    assert (outwards, foreign) == ([], set())
