"""Compiled code that is kept between runs, in a folder for each state of the sources.

Numba's own cache does not fit. It only looks at the file of a function, and ours call each other across files; and
when two processes write at once, it can store the code of one signature under another: both take the next free number.
Here each signature has a file of its own, named by a hash of everything that the code depends on.
"""

import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

from drone_env.files import replacing

PACKAGE = Path(__file__).parents[1]


def digest_of_sources(package: Path = PACKAGE) -> str:
    """A hash of everything that our compiled functions are made from; empty if there are no sources to read."""
    digest = hashlib.sha256()
    files = [file for part in ("core", "planning", "agents", "rl") for file in sorted((package / part).glob("*.py"))]
    for file in files:
        content = file.read_bytes()
        digest.update(f"{file.parent.name}/{file.name} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16] if files else ""


# `drone_env.core` imports this module before any other of its own: these are the sources that get loaded.
LOADED = digest_of_sources()


def cache_folder() -> Path:
    """The folder for the compiled code of these sources; created if necessary.

    Under `DRONE_ENV_CACHE` or else `NUMBA_CACHE_DIR` if one is set, else under the user's cache folder. The latter must
    be writable by this user alone, because loading code means running it.

    Raises:
        OSError: if there is none, or the sources have changed since they were loaded.
    """
    if not LOADED or digest_of_sources() != LOADED:
        raise FileNotFoundError(f"the sources in {PACKAGE} are not those that this program began with")
    chosen = os.environ.get("DRONE_ENV_CACHE") or os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        folder = Path(chosen).absolute() / LOADED  # a program may go to another folder later
        folder.mkdir(parents=True, exist_ok=True)
        return folder
    from platformdirs import user_cache_path  # imported lazily, as most processes compile nothing

    parent = user_cache_path("drone_env", appauthor=False)
    if not parent.is_absolute():
        raise FileNotFoundError(f"{parent} is the folder of a user without a home")
    for folder in (parent, parent / LOADED):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
        if hasattr(os, "getuid") and (found.st_uid != os.getuid() or found.st_mode & 0o022):
            raise PermissionError(f"{folder} is not a folder that this user alone can write")
        if not os.access(folder, os.W_OK):
            raise PermissionError(f"{folder} is not writable")
    return parent / LOADED


class CodeCache:
    """The cache of one compiled function, with the methods that Numba's dispatcher calls.

    Files are replaced as a whole, so any number of processes may write at once. A file that cannot be written is left
    out.

    Args:
        function: A function of a module.
        options: Its compile options.
        folder: The folder of the files.

    Raises:
        OSError: if the function's source cannot be read.
    """

    def __init__(self, function: Any, options: dict[str, Any], folder: Path) -> None:
        code = function.__code__
        self.cache_path = str(folder)
        self._name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        self._made_from = (
            # A function of the tests: `LOADED` does not contain its source.
            hashlib.sha256(Path(code.co_filename).read_bytes()).hexdigest(),
            (function.__module__, code.co_firstlineno, self._name, sorted(options.items()), sys.version),
            [import_module(package).__version__ for package in ("numba", "llvmlite", "numpy")],
        )

    def _file(self, signature: object, codegen: Any) -> Path:
        config: Any = import_module("numba.core.config")
        settings = (str(config.OPT), config.BOUNDSCHECK, config.DEBUGINFO_DEFAULT)
        everything = repr((self._made_from, settings, codegen.magic_tuple(), str(signature)))
        return Path(self.cache_path) / f"{self._name}-{hashlib.sha256(everything.encode()).hexdigest()[:32]}.code"

    def load_overload(self, sig: object, target_context: Any) -> Any:
        """The compile result for a signature, None if there is none."""
        target_context.refresh()
        with suppress(OSError):
            payload = self._file(sig, target_context.codegen()).read_bytes()
            compiler: Any = import_module("numba.core.compiler")
            return compiler.CompileResult._rebuild(target_context, *pickle.loads(payload))
        return None

    def save_overload(self, sig: object, data: Any) -> None:
        """Keep a compile result, unless it contains addresses of this process."""
        serialize: Any = import_module("numba.core.serialize")
        if not data.library.has_dynamic_globals:
            with suppress(OSError), replacing(self._file(sig, data.codegen)) as temporary:
                temporary.write_bytes(serialize.dumps(data._reduce()))


def compiled_once(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator: `numba.njit` with these options, whose compiled code is kept in `cache_folder()` if there is one.

    The function is one of a module, and calls only functions of its own file, of `core` and of `planning`.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        numba: Any = import_module("numba")
        dispatcher = numba.njit(**options)(function)
        with suppress(OSError):  # compiled in each process then; `tell_before_compiling` prints why
            dispatcher._cache = CodeCache(function, options, cache_folder())
        return dispatcher

    return decorate


def is_compiled(*functions: Any) -> bool:
    """Whether compiled code of all these functions of `compiled_once` is in the cache."""
    with suppress(OSError):
        names = [f"{function.__module__.rpartition('.')[2]}.{function.__name__}" for function in functions]
        return all(any(cache_folder().glob(f"{name}-*.code")) for name in names)
    return False


@lru_cache(maxsize=1)
def tell_before_compiling() -> None:
    """Print to standard error that compiling takes a while, if the cache is empty."""
    try:
        folder = cache_folder()
        if any(folder.glob("*.code")):
            return
        what_for = f"kept in {folder}"
    except OSError as error:
        what_for = f"not kept: {error}"
    print(f"drone_env: compiling the simulator for the first time, a few seconds; {what_for}", file=sys.stderr)
