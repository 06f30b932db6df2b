"""Compiled code that is kept: found again by content alone, and never that of other sources."""

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import pytest

from drone_env.core import compile_cache
from drone_env.core.compile_cache import (
    CodeCache,
    cache_folder,
    compiled_once,
    digest_of_sources,
    is_compiled,
    tell_before_compiling,
)
from drone_env.errors import InvalidValueError
from drone_env.planning.elsewhere import range_kernel

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
    monkeypatch.setenv("DRONE_ENV_CACHE", str(folder))
    tell_before_compiling.cache_clear()
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


def counts(dispatcher: Any) -> tuple[int, int]:
    """(loaded, compiled)"""
    stats = dispatcher.stats
    return sum(stats.cache_hits.values()), sum(stats.cache_misses.values())


def files(chosen: Path) -> list[Path]:
    return sorted(file for file in chosen.rglob("*") if file.is_file())


def test_settings_of_numba_that_change_the_code(tmp_path: Path) -> None:
    source = KERNEL.replace("2 * x", "x[5]")
    array = import_module("numpy").zeros(1)
    load(tmp_path, source).twice(array)
    config: Any = import_module("numba.core.config")
    before = config.BOUNDSCHECK
    config.BOUNDSCHECK = 1
    try:
        checked = load(tmp_path, source).twice
        with pytest.raises(IndexError):
            checked(array)
    finally:
        config.BOUNDSCHECK = before


def test_only_functions_of_a_module() -> None:
    def local(x: int) -> int:
        return x

    for function in (local, lambda x: x, ModuleType.__repr__):
        with pytest.raises(InvalidValueError, match="functions of a module"):
            compiled_once()(function)


def test_the_digest_is_of_all_sources_and_of_nothing_else(tmp_path: Path) -> None:
    for part in ("core", "planning", "agents", "rl"):
        shutil.copytree(PACKAGE / part, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__"))
    seen = {digest_of_sources(tmp_path)}
    assert seen == {digest_of_sources(PACKAGE)}
    sources = sorted(tmp_path.rglob("*.py"))
    some = {"rules.py", "tables.py", "solver.py", "tours.py", "tour_features.py", "samples.py"}
    assert {file.name for file in sources} >= some
    for changed, file in enumerate(sources, start=1):
        file.write_bytes(file.read_bytes() + b"\n")
        seen.add(digest_of_sources(tmp_path))
        assert len(seen) == 1 + changed, file
    sources[-1].rename(sources[-1].with_suffix(".pz.py"))  # in the same place of the order
    assert digest_of_sources(tmp_path) not in seen
    assert digest_of_sources(tmp_path / "archive.zip") == ""


@pytest.mark.parametrize(("loaded", "now"), [("0123456789abcdef", "fedcba9876543210"), ("", "")])
def test_sources_that_changed_or_cannot_be_seen(
    loaded: str, now: str, tmp_path: Path, chosen: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compile_cache, "LOADED", loaded)
    monkeypatch.setattr(compile_cache, "digest_of_sources", lambda: now)
    with pytest.raises(FileNotFoundError, match="not those that this program began with"):
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
    assert {"step", "reset", "step_kernel", "step_kernel_threads", "value_kernel", "tour_kernel"} <= set(found)
    assert set(found.values()) == {CodeCache}


def test_a_folder_that_cannot_be_made(tmp_path: Path, chosen: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chosen.write_text("a file")
    assert load(tmp_path).twice(3) == 6
    tell_before_compiling()
    tell_before_compiling()
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "not kept: " in told
    assert str(chosen) in told


def test_what_is_told_before_compiling(tmp_path: Path, chosen: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tell_before_compiling()
    assert f"a few seconds; kept in {chosen}" in capsys.readouterr().err
    load(tmp_path).twice(3)
    tell_before_compiling.cache_clear()
    tell_before_compiling()
    assert capsys.readouterr().err == ""


def test_an_equal_source_shares_whatever_its_path_and_another_does_not(tmp_path: Path, chosen: Path) -> None:
    for place, expected in (("here", (0, 2)), ("there", (2, 0))):
        twice = load(tmp_path / place).twice
        assert (twice(3), twice(1.5), counts(twice)) == (6, 3.0, expected)
    assert [file.name.partition("-")[0] for file in files(chosen)] == ["kernels.twice"] * 2
    changed = load(tmp_path / "here", KERNEL.replace("2 * x", "x + x + 0")).twice
    assert (changed(3), counts(changed)) == (6, (0, 1))


def test_processes_that_compile_at_once_never_load_the_code_of_another_signature(tmp_path: Path, chosen: Path) -> None:
    load(tmp_path)
    code = "import sys, kernels; assert all(kernels.twice(eval(x)) == 2 * eval(x) for x in sys.argv[1:])"
    orders = [("1.5", "3"), ("3", "1.5")] * 2
    processes = [subprocess.Popen([sys.executable, "-c", code, *order], cwd=tmp_path) for order in orders]
    assert [process.wait() for process in processes] == [0] * len(orders)
    assert len(files(chosen)) == 2
    twice = load(tmp_path).twice
    assert (twice(3), twice(1.5), counts(twice)) == (6, 3.0, (2, 0))


def test_a_folder_that_disappears_or_that_a_relative_path_names(
    tmp_path: Path, chosen: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    twice = load(tmp_path).twice
    shutil.rmtree(chosen)
    assert twice(3) == 6
    assert not chosen.exists()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DRONE_ENV_CACHE", "relative")
    twice = load(tmp_path / "kernels").twice
    monkeypatch.chdir(tmp_path / "kernels")
    assert twice(3) == 6
    assert len(files(tmp_path / "relative")) == 1


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"HOME": "."}, ".cache/drone_env"),
        ({"HOME": ".", "XDG_CACHE_HOME": "xdg"}, "xdg/drone_env"),
        ({"HOME": ".", "NUMBA_CACHE_DIR": "numba"}, "numba"),
        ({"NUMBA_CACHE_DIR": "numba", "DRONE_ENV_CACHE": "ours"}, "ours"),
    ],
)
def test_the_folder_that_the_environment_names(
    variables: dict[str, str], folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DRONE_ENV_CACHE", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, str(tmp_path / value))
    assert cache_folder() == tmp_path / folder / compile_cache.LOADED
    kernels = load(tmp_path)
    assert not is_compiled(kernels.twice)
    kernels.twice(3)
    assert is_compiled(kernels.twice)
    assert not is_compiled(kernels.twice, range_kernel)


@pytest.mark.parametrize("home", ["a file", "read-only", "unknown", "others can write"])
@pytest.mark.parametrize("temporary", ["new", "others can write", "another user's", "a link"])
def test_without_a_private_folder_at_home_it_is_one_among_the_temporary_files_or_none(
    home: str, temporary: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DRONE_ENV_CACHE", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    at_home, folder = tmp_path / "home" / ".cache" / "drone_env", tmp_path / f"drone_env-{os.getuid()}"
    if home == "a file":
        (tmp_path / "home").write_text("")
    elif home == "read-only":  # root may write into folders that nobody may write into
        monkeypatch.setattr(os, "access", lambda path, mode: at_home not in Path(path).parents)
    elif home == "unknown":
        monkeypatch.setattr(Path, "is_absolute", lambda path: tmp_path / "home" not in path.parents)
    else:
        at_home.mkdir(parents=True)
        at_home.chmod(0o777)
    if temporary == "a link":
        folder.symlink_to(tmp_path)
    elif temporary == "others can write":
        folder.mkdir()
        folder.chmod(0o777)
    elif temporary == "another user's":
        folder.mkdir(mode=0o700)
        lstat = Path.lstat

        def owned_by_another(path: Path) -> os.stat_result:
            found = lstat(path)
            return os.stat_result((*found[:4], found.st_uid + (path == folder), *found[5:]))

        monkeypatch.setattr(Path, "lstat", owned_by_another)
    if temporary == "new":
        assert cache_folder() == folder / compile_cache.LOADED
        assert {path.stat().st_mode & 0o777 for path in (folder, cache_folder())} == {0o700}
    else:
        with pytest.raises(OSError, match=str(folder)):
            cache_folder()
        assert load(tmp_path / "kernels").twice(3) == 6
        assert not list(tmp_path.rglob("*.code"))
