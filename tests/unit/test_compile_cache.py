"""Compiled code that is kept: found again by content alone, and never that of other sources."""

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from filelock import FileLock

from drone_env.core import compile_cache
from drone_env.core.compile_cache import cache_folder, is_compiled, print_before_compiling
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
    return sorted(file for file in chosen.rglob("*.code") if file.is_file())


def test_sources_that_changed(tmp_path: Path, chosen: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compile_cache, "LOADED", "0123456789abcdef")
    with pytest.raises(FileNotFoundError, match="have changed since this program started"):
        cache_folder()
    assert load(tmp_path).twice(3) == 6
    assert files(chosen) == []


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


def test_one_process_compiles_and_who_has_waited_in_vain_does_so_too(
    tmp_path: Path, chosen: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load(tmp_path).twice(3)
    (file,) = files(chosen)
    code = file.read_bytes()
    lock = FileLock(f"{file}.lock", timeout=0)
    monkeypatch.setattr(compile_cache, "WAIT_SECONDS", 0)
    file.unlink()
    with lock:
        assert load(tmp_path).twice(3) == 6
    waiting = load(tmp_path).twice
    file.unlink()
    # The other process ends while this one waits for the lock.
    monkeypatch.setattr("filelock.FileLock.acquire", lambda *_, **__: file.write_bytes(code))
    assert (waiting(3), sum(waiting.stats.cache_misses.values())) == (6, 0)


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"HOME": ".", "XDG_CACHE_HOME": "xdg"}, "xdg/drone_env"),
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


def test_without_a_usable_folder_it_compiles_anew_and_says_why(
    tmp_path: Path, chosen: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen.write_text("")  # like a folder without permissions, which stops no root
    assert load(tmp_path).twice(3) == 6
    print_before_compiling()
    assert f"not cached: [Errno 20] Not a directory: '{chosen}" in capsys.readouterr().err
