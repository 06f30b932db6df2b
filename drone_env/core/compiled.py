"""The functions of the rules, compiled by Numba from the same source, and memory prefetching.

The first call of a function compiles it.
"""

from importlib import import_module
from inspect import isfunction
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable  # pyright: ignore

from drone_env.core import grid_generator, rules, seeds
from drone_env.core.compile_cache import compiled_once

cgutils: Any = import_module("numba.core.cgutils")

# Steps do not allocate, so they need no reference counts (`_nrt`). No divisor is zero (`error_model`). Calls would push
# all tables, so functions are inlined (`forceinline`). Together, these options make a step nine times faster.
OPTIONS: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}


def jitable(function: Any) -> Any:
    """A decorator: make a Python function callable from compiled code."""
    return register_jitable(**OPTIONS)(function)


def inlined(function: Any) -> Any:
    """The same, and compiled code contains the function at each call."""
    return register_jitable(forceinline=True, **OPTIONS)(function)


for module in (grid_generator, rules, seeds):
    for function in vars(module).values():
        if isfunction(function) and function.__module__ == module.__name__:
            inlined(function)

kernel = compiled_once(nogil=True, **OPTIONS)
"""A decorator: compile a function that releases the interpreter's lock."""

reset = compiled_once(**OPTIONS)(rules.reset)
step = compiled_once(**OPTIONS)(rules.step)

WRITE, HIGH_LOCALITY, DATA = 1, 3, 1
"""Arguments of LLVM's `prefetch`."""


def _prefetch(typing_context: Any, array: Any, i: Any, j: Any) -> Any:
    """In compiled code: start to load `array[i, j]` into the CPU cache. i and j are unsigned."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        struct = context.make_array(signature.args[0])(context, builder, arguments[0])
        given = list(zip(arguments, signature.args, strict=True))[1:]
        indices = [context.cast(builder, index, kind, types.uintp) for index, kind in given]
        address = cgutils.get_item_pointer(context, builder, signature.args[0], struct, indices, wraparound=False)
        pointer, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer, number, number, number])
        llvm_prefetch = builder.module.declare_intrinsic("llvm.prefetch", [pointer], kind)
        builder.call(llvm_prefetch, [builder.bitcast(address, pointer), *map(number, (WRITE, HIGH_LOCALITY, DATA))])
        return context.get_dummy_value()

    return types.void(array, i, j), generate


prefetch: Any = intrinsic(_prefetch)
