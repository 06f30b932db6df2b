"""Compiled code that is kept between runs.

It is found by the content of what it was compiled from, wherever that lies: clones and installations of equal sources
share it. Numba's own cache is bound to a source's path, looks only at the file that a function stands in (ours call
each other across files), and two processes that write at once can leave one signature's code under another's name.
"""

import hashlib
import os
import pickle
import stat
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
CHECKSUM_BYTES = hashlib.sha256().digest_size


def digest_of_sources(package: Path = PACKAGE) -> str:
    """A hash of all that our compiled functions are made from; empty where no sources are there to be read."""
    digest = hashlib.sha256()
    files = [file for part in ("core", "planning", "agents", "rl") for file in sorted((package / part).glob("*.py"))]
    for file in files:
        content = file.read_bytes()
        digest.update(f"{file.parent.name}/{file.name} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16] if files else ""


# `drone_env.core` imports this module before any other of its own: these are the sources that get loaded.
LOADED = digest_of_sources()


def cache_folder() -> Path:
    """The folder for the compiled code of these sources; made if need be.

    Under `DRONE_ENV_CACHE` if that is set, else under the user's cache folder, else (where that cannot be written, or
    others can write there) under the folder for temporary files, in one that is this user's alone.

    Raises:
        OSError: if there is none, or the sources are no longer those that were loaded.
    """
    if not LOADED or digest_of_sources() != LOADED:
        raise FileNotFoundError(f"the sources in {PACKAGE} are not those that this program began with")
    chosen = os.environ.get("DRONE_ENV_CACHE")
    if chosen:
        folder = Path(chosen).absolute() / LOADED  # a program may go to another folder later
        folder.mkdir(parents=True, exist_ok=True)
        return folder
    from platformdirs import user_cache_path  # slow to load, as `tempfile` is: most processes compile nothing

    with suppress(OSError, RuntimeError):  # the latter where nobody knows this user's home
        folder = user_cache_path("drone_env", appauthor=False) / LOADED
        if folder.is_absolute():  # else its `~` is that of a user without a home
            folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            _make_private(folder)
            _require_no_way_for_others(folder)
            if os.access(folder, os.W_OK):
                return folder
    import tempfile

    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"drone_env-{user}"
    _make_private(folder)
    folder /= LOADED
    _make_private(folder)
    return folder


def _make_private(folder: Path) -> None:
    """Make a folder that this user alone can write: who loads code from it runs that code, machine code or pickle.

    Raises:
        OSError: if it cannot be made, or is there and others can write it.
    """
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if hasattr(os, "getuid") and (found.st_uid != os.getuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        raise PermissionError(f"{folder} is not a folder that this user alone can write")


def _require_no_way_for_others(folder: Path) -> None:
    """See that nobody else can put another folder in the place of one.

    Raises:
        PermissionError: if a folder above it is another user's (the system's is none), or everybody can rename in it.
    """
    for above in folder.resolve().parents if hasattr(os, "getuid") else ():
        found = above.stat()
        renaming = found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX
        if found.st_uid not in (0, os.getuid()) or renaming:
            raise PermissionError(f"in {above} others can put another folder in the place of {folder}")


class KeptCode:
    """What Numba asks of a function's cache: the compiled code for each signature, here in a file each.

    A file begins with the hash of its rest, so that a damaged one counts as none. One that cannot be written is not.

    Args:
        function: A function of a module.
        options: What it is compiled with.
        folder: Where the files are.

    Raises:
        OSError: if the function's source cannot be read.
    """

    def __init__(self, function: Any, options: dict[str, Any], folder: Path) -> None:
        code = function.__code__
        self.cache_path = str(folder)
        self._name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        self._made_from = (
            # Functions of the tests may be kept too; of theirs, `cache_folder` knows nothing.
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
        try:
            content = self._file(sig, target_context.codegen()).read_bytes()
        except OSError:
            return None
        checksum, payload = content[:CHECKSUM_BYTES], content[CHECKSUM_BYTES:]
        if hashlib.sha256(payload).digest() != checksum:
            return None
        compiler: Any = import_module("numba.core.compiler")
        return compiler.CompileResult._rebuild(target_context, *pickle.loads(payload))

    def save_overload(self, sig: object, data: Any) -> None:
        """Keep a compile result, unless it holds addresses of this process."""
        if data.library.has_dynamic_globals:
            return
        serialize: Any = import_module("numba.core.serialize")
        payload = serialize.dumps(data._reduce())
        with suppress(OSError), replacing(self._file(sig, data.codegen)) as temporary:
            temporary.write_bytes(hashlib.sha256(payload).digest() + payload)

    def flush(self) -> None:
        """Forget what is kept of this function, as `recompile()` of a dispatcher wants it."""
        for file in Path(self.cache_path).glob(f"{self._name}-*.code"):
            file.unlink(missing_ok=True)


def compiled_once(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator: `numba.njit` with these options, whose compiled code is kept in `cache_folder()` where there is one.

    The function calls nothing but functions of its own file, of `core` and of `planning`.

    Raises:
        InvalidValueError: if the function is not one of a module; others can be equal by name and differ.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        if not function.__qualname__.isidentifier():
            raise InvalidValueError(f"compiled_once takes functions of a module, got {function.__qualname__}")
        numba: Any = import_module("numba")
        dispatcher = numba.njit(**options)(function)
        with suppress(OSError):  # compiled in each process then; `tell_before_compiling` says why
            dispatcher._cache = KeptCode(function, options, cache_folder())
        return dispatcher

    return decorate


@lru_cache(maxsize=1)
def tell_before_compiling() -> None:
    """Say on standard error that a wait is coming, if nothing has been compiled into the cache yet."""
    try:
        folder = cache_folder()
        if any(folder.glob("*.code")):
            return
        what_for = f"kept in {folder}"
    except OSError as error:
        what_for = f"not kept: {error}"
    print(f"drone_env: compiling the simulator for the first time, a few seconds; {what_for}", file=sys.stderr)
