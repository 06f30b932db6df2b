"""The functions of the rules, compiled by Numba from the same source.

The first call of a function compiles it.
"""

from inspect import isfunction
from typing import Any

from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import grid_generator, rules, seeds
from drone_env.core.compile_cache import compiled_once

# Steps do not allocate, so they need no reference counts (`_nrt`). No divisor is zero (`error_model`). Calls would push
# all tables, so functions are inlined (`forceinline`). Together, these options make a step nine times faster.
OPTIONS: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}
# Only compiled code calls these functions: wrappers for C would be a seventh of the time that compiling takes.
CALLED: dict[str, Any] = {**OPTIONS, "no_cfunc_wrapper": True}


def jitable(function: Any) -> Any:
    """A decorator: make a Python function callable from compiled code."""
    return register_jitable(**CALLED)(function)


def inlined(function: Any) -> Any:
    """The same, and compiled code contains the function at each call."""
    return register_jitable(forceinline=True, **CALLED)(function)


for module in (grid_generator, rules, seeds):
    for function in vars(module).values():
        if isfunction(function) and function.__module__ == module.__name__:
            inlined(function)

kernel = compiled_once(nogil=True, **OPTIONS)
"""A decorator: compile a function that releases the interpreter's lock."""

reset = compiled_once(**OPTIONS)(rules.reset)
step = compiled_once(**OPTIONS)(rules.step)
