"""A cache of compiled code between runs, with one folder per version of the sources.

Numba's own cache has two problems. It only checks the file of a function, but our functions call others across files.
And if two processes write at once, it can store the code of one signature under another. Here each signature has its
own file, named by a hash of everything that the code depends on.
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

from drone_env.errors import InvalidValueError
from drone_env.files import replacing

PACKAGE = Path(__file__).parents[1]
WAIT_SECONDS = 120
"""How long to wait for code that another process compiles."""


def digest_of_sources(package: Path = PACKAGE) -> str:
    """A hash of the sources of all compiled functions; empty if there are no sources."""
    digest = hashlib.sha256()
    files = [file for part in ("core", "planning", "agents", "rl") for file in sorted((package / part).glob("*.py"))]
    for file in files:
        content = file.read_bytes()
        digest.update(f"{file.parent.name}/{file.name} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16] if files else ""


# `drone_env.core` imports this module first, so this is the hash of the sources that the process loads.
LOADED = digest_of_sources()


def cache_folder() -> Path:
    """Return the folder for the compiled code of these sources, and create it if necessary.

    It is in `DRONE_ENV_CACHE`, else in `NUMBA_CACHE_DIR`, else in the user's cache folder.

    Raises:
        OSError: if there is no such folder, or the sources have changed since the process loaded them.
    """
    if not LOADED or digest_of_sources() != LOADED:
        raise FileNotFoundError(f"the sources in {PACKAGE} have changed since this program started")
    parent = os.environ.get("DRONE_ENV_CACHE") or os.environ.get("NUMBA_CACHE_DIR") or _users_folder()
    folder = Path(parent).absolute() / LOADED  # absolute, because the program may change its working directory
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK) and not any(folder.glob("*.code")):
        raise PermissionError(f"{folder} is not writable; set DRONE_ENV_CACHE to a folder that is")
    return folder


def _users_folder() -> Path:
    from platformdirs import user_cache_path  # imported lazily: most processes compile nothing

    # Without a home folder, a new platformdirs raises an error, and an old one returns "~/.cache".
    with suppress(RuntimeError):
        folder = user_cache_path("drone_env", appauthor=False)
        if folder.is_absolute():
            return folder
    raise FileNotFoundError("this user has no home folder; set DRONE_ENV_CACHE")


class CodeCache:
    """The cache of one compiled function, with the methods that Numba's dispatcher calls.

    Files are replaced atomically, so several processes may write at once. Failures to write are ignored. Of processes
    that need the same code at once, one compiles it, and the others wait for its file.

    Args:
        function: A module-level function.
        options: Its compile options.
        folder: The folder of the files.
    """

    def __init__(self, function: Any, options: dict[str, Any], folder: Path) -> None:
        code = function.__code__
        self.cache_path = str(folder)
        self._locks: dict[str, Any] = {}
        self._name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        self._dependencies = (
            # `LOADED` does not contain the source of functions in tests.
            hashlib.sha256(Path(code.co_filename).read_bytes()).hexdigest(),
            (function.__module__, code.co_firstlineno, self._name, sorted(options.items()), sys.version),
            [import_module(package).__version__ for package in ("numba", "llvmlite", "numpy")],
        )

    def _file(self, signature: object, codegen: Any) -> Path:
        config: Any = import_module("numba.core.config")
        settings = (str(config.OPT), config.BOUNDSCHECK, config.DEBUGINFO_DEFAULT)
        key = repr((self._dependencies, settings, codegen.magic_tuple(), str(signature)))
        return Path(self.cache_path) / f"{self._name}-{hashlib.sha256(key.encode()).hexdigest()[:32]}.code"

    def load_overload(self, sig: object, target_context: Any) -> Any:
        """Return the compile result for a signature, or None if it is not cached."""
        target_context.refresh()
        file = self._file(sig, target_context.codegen())
        with suppress(OSError):
            if not file.exists():
                from filelock import FileLock  # slow to load, and seldom needed

                # `save_overload` releases it. Nobody waits for ever for a process that is stopped meanwhile.
                self._locks[str(sig)] = FileLock(f"{file}.lock", timeout=WAIT_SECONDS)
                self._locks[str(sig)].acquire()
            payload = file.read_bytes()
            self._release(sig)
            compiler: Any = import_module("numba.core.compiler")
            return compiler.CompileResult._rebuild(target_context, *pickle.loads(payload))
        return None

    def save_overload(self, sig: object, data: Any) -> None:
        """Store a compile result, unless it contains addresses of this process."""
        serialize: Any = import_module("numba.core.serialize")
        if not data.library.has_dynamic_globals:
            with suppress(OSError), replacing(self._file(sig, data.codegen)) as temporary:
                temporary.write_bytes(serialize.dumps(data._reduce()))
        self._release(sig)

    def _release(self, sig: object) -> None:
        lock = self._locks.pop(str(sig), None)
        if lock is not None:
            lock.release()


def compiled_once(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator: `numba.njit` with these options, and a cache in `cache_folder()` if there is one.

    The function must be module-level, and call only functions of its own file, of `core` and of `planning`.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        numba: Any = import_module("numba")
        if numba.config.DISABLE_JIT:
            raise InvalidValueError("NUMBA_DISABLE_JIT is set, but batches and planners need compiled code: unset it")
        dispatcher = numba.njit(**options)(function)
        with suppress(OSError):  # without a cache; `print_before_compiling` prints why
            dispatcher._cache = CodeCache(function, options, cache_folder())
        return dispatcher

    return decorate


def is_compiled(*functions: Any) -> bool:
    """Whether the cache contains compiled code of all these functions."""
    with suppress(OSError):
        names = [f"{function.__module__.rpartition('.')[2]}.{function.__name__}" for function in functions]
        return all(any(cache_folder().glob(f"{name}-*.code")) for name in names)
    return False


@lru_cache(maxsize=1)
def print_before_compiling() -> None:
    """If the cache is empty, print to standard error that compiling takes a while."""
    try:
        folder = cache_folder()
        if any(folder.glob("*.code")):
            return
        cache = f"cached in {folder}"
    except OSError as error:
        cache = f"not cached: {error}"
    print(f"drone_env: compiling the simulator for the first time, a few seconds; {cache}", file=sys.stderr)
