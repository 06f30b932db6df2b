"""Compiled code that is kept: found again by content alone, and never that of other sources."""

import importlib.util
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numba
import pytest

from drone_env.core import compile_cache
from drone_env.core.compile_cache import CodeCache, cache_folder, digest_of_sources, is_compiled, print_before_compiling
from drone_env.planning.paths import cost_kernel

PACKAGE = compile_cache.PACKAGE
KERNEL = """
from drone_env.core.compile_cache import compiled_once

@compiled_once()
def twice(x):
    return 2 * x
"""


@pytest.fixture(autouse=True)
def chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder, which `DRONE_ENV_CACHE` names."""
    folder = tmp_path / "cache"
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DRONE_ENV_CACHE", str(folder))
    print_before_compiling.cache_clear()
    yield folder
    sys.modules.pop("kernels", None)


def load(folder: Path, source: str = KERNEL) -> ModuleType:
    """The source as the module `kernels` in this folder, loaded as by a new process."""
    folder.mkdir(exist_ok=True)
    file = folder / "kernels.py"
    file.write_text(source)
    spec = importlib.util.spec_from_file_location("kernels", file)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["kernels"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def files(chosen: Path) -> list[Path]:
    return sorted(file for file in chosen.rglob("*") if file.is_file())


def test_the_digest_is_of_all_sources(tmp_path: Path) -> None:
    for part in ("core", "planning", "agents", "rl"):
        shutil.copytree(PACKAGE / part, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__"))
    assert digest_of_sources(tmp_path) == compile_cache.LOADED
    sources = sorted(tmp_path.rglob("*.py"))
    sources[-1].rename(sources[-1].with_suffix(".pz.py"))  # in the same place of the order
    assert digest_of_sources(tmp_path) != compile_cache.LOADED


def test_sources_that_changed(tmp_path: Path, chosen: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compile_cache, "LOADED", "0123456789abcdef")
    with pytest.raises(FileNotFoundError, match="have changed since this program started"):
        cache_folder()
    assert load(tmp_path).twice(3) == 6
    assert files(chosen) == []


def test_all_functions_of_the_package_are_kept() -> None:
    found = {}
    for file in [*(PACKAGE / "core").glob("*.py"), *(PACKAGE / "planning").glob("*.py")]:
        module = import_module(f"drone_env.{file.parent.name}.{file.stem}")
        for name, value in vars(module).items():
            if isinstance(value, numba.core.dispatcher.Dispatcher):
                found[name] = type(value._cache)
    assert {"step", "reset", "step_kernel", "value_kernel"} <= set(found)
    assert set(found.values()) == {CodeCache}


def test_what_is_told_before_compiling(tmp_path: Path, chosen: Path, capsys: pytest.CaptureFixture[str]) -> None:
    print_before_compiling()
    assert f"a few seconds; cached in {chosen}" in capsys.readouterr().err
    load(tmp_path).twice(3)
    print_before_compiling.cache_clear()
    print_before_compiling()
    assert capsys.readouterr().err == ""


def test_an_equal_source_shares_whatever_its_path_and_another_does_not(tmp_path: Path, chosen: Path) -> None:
    for place, compiled in (("here", 2), ("there", 0)):
        twice = load(tmp_path / place).twice
        assert (twice(3), twice(1.5), sum(twice.stats.cache_misses.values())) == (6, 3.0, compiled)
    assert [file.name.partition("-")[0] for file in files(chosen)] == ["kernels.twice"] * 2
    assert load(tmp_path / "here", KERNEL.replace("2 * x", "x + x + 1")).twice(3) == 7


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"HOME": ".", "XDG_CACHE_HOME": "xdg"}, "xdg/drone_env"),
        ({"HOME": ".", "NUMBA_CACHE_DIR": "numba"}, "numba"),
        ({"NUMBA_CACHE_DIR": "numba", "DRONE_ENV_CACHE": "ours"}, "ours"),
    ],
)
def test_the_folder_that_the_environment_names(
    variables: dict[str, str], folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DRONE_ENV_CACHE")
    for name, value in variables.items():
        monkeypatch.setenv(name, str(tmp_path / value))
    assert cache_folder() == tmp_path / folder / compile_cache.LOADED
    kernels = load(tmp_path)
    assert not is_compiled(kernels.twice)
    kernels.twice(3)
    assert is_compiled(kernels.twice)
    assert not is_compiled(kernels.twice, cost_kernel)


@pytest.mark.parametrize("variable", ["HOME", "DRONE_ENV_CACHE"])
def test_a_folder_of_the_temporary_directory_replaces_one_that_cannot_be_used(
    variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DRONE_ENV_CACHE")
    monkeypatch.setenv(variable, str(tmp_path / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    users = cache_folder().parent
    shutil.rmtree(users)
    users.write_text("")  # like a folder without permissions, which stops no root
    folder = cache_folder()
    assert folder == tmp_path / f"drone_env-{os.getuid()}" / compile_cache.LOADED
    assert load(tmp_path / "kernels").twice(3) == 6
    assert [file.parent for file in tmp_path.rglob("*.code")] == [folder]
    folder.parent.chmod(0o777)  # others could replace the code that this process runs
    print_before_compiling()
    assert f"not cached: others than this user can write to {folder.parent}" in capsys.readouterr().err
