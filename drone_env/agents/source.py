"""Source code of agents: where `MODULE:NAME` is, and what identifies it."""

import hashlib
import re
import sys
from functools import partial
from importlib import import_module
from inspect import getsource
from pathlib import Path
from typing import Any, cast
from uuid import uuid4

from drone_env.errors import InvalidValueError

ADDRESS = re.compile(r" at 0x[0-9a-f]+")
MODULE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


def is_address(name: str) -> bool:
    """Return whether a name has the form `MODULE:NAME`."""
    return MODULE.fullmatch(name) is not None


def imported(address: str) -> Any:
    """Return the member of `MODULE:NAME`. Modules are imported from Python's path or the working directory.

    Raises:
        InvalidValueError: if there is no such module, or no such member in it.
    """
    module, _, name = address.partition(":")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)  # last, so that installed packages have priority
    try:
        found = import_module(module)
    except (Exception, SystemExit) as error:  # importing a module runs any code
        reason = f"{type(error).__name__}: {error}"
        raise InvalidValueError(f"agent {address!r}: cannot import module {module!r}: {reason}") from error
    if not hasattr(found, name):
        raise InvalidValueError(f"agent {address!r}: {found.__file__} has no {name!r}")
    return getattr(found, name)


def identity(policy: Any) -> dict[str, object]:
    """Return the identity of code: its name and a digest of its module's file. A `partial` adds its arguments.

    Code without such a file, as in a REPL, is identified by its source text; without that, each time is another one.
    """
    if isinstance(policy, partial):
        bound = cast("partial[Any]", policy)
        return {**identity(bound.func), "bound": ADDRESS.sub("", f"{bound.args} {bound.keywords}")}
    module = getattr(policy, "__module__", None) or "builtins"
    file = getattr(sys.modules.get(module), "__file__", None)
    code: Any = policy if hasattr(policy, "__qualname__") else policy.__class__
    try:
        content = Path(file).read_bytes() if file and Path(file).is_file() else getsource(code).encode()
    except (OSError, TypeError):
        content = uuid4().bytes
    return {"agent": f"{module}:{code.__qualname__}", "source": hashlib.sha256(content).hexdigest()[:16]}
