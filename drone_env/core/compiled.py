"""The functions of the rules, compiled by Numba: the same source, not a second copy. Compiling takes the first call.

It also contains the prefetching of memory.
"""

from importlib import import_module
from inspect import isfunction
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable  # pyright: ignore

from drone_env.core import grid_generator, observation, rules, seeds
from drone_env.core.compile_cache import compiled_once

cgutils: Any = import_module("numba.core.cgutils")

# No step allocates, so reference counts are only a cost (`_nrt`); no divisor is ever zero (`error_model`); and the
# functions are pieces of one loop body (`forceinline`): a call would push all tables. Together they make a step nine
# times faster.
OPTIONS: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}
for module in (grid_generator, observation, rules, seeds):
    for function in vars(module).values():
        if isfunction(function) and function.__module__ == module.__name__:
            register_jitable(forceinline=True, **OPTIONS)(function)

kernel = compiled_once(nogil=True, **OPTIONS)
"""A decorator: a compiled function that other threads run beside."""


def jitable(function: Any) -> Any:
    """A decorator: compiled functions can call the function, which stays plain Python."""
    return register_jitable(**OPTIONS)(function)


reset = compiled_once(**OPTIONS)(rules.reset)
step = compiled_once(**OPTIONS)(rules.step)

FOR_WRITING, KEPT, DATA = 1, 3, 1
"""Arguments of LLVM's `prefetch`: the memory will be written, it will be used again, and it is no code."""


def _prefetch(typing_context: Any, array: Any, i: Any, j: Any) -> Any:
    """In compiled code: begin to load `array[i, j]` into the cache; i and j are unsigned. It changes no result."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        made = context.make_array(signature.args[0])(context, builder, arguments[0])
        given = list(zip(arguments, signature.args, strict=True))[1:]
        indices = [context.cast(builder, index, kind, types.uintp) for index, kind in given]
        address = cgutils.get_item_pointer(context, builder, signature.args[0], made, indices, wraparound=False)
        octet, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [octet, number, number, number])
        llvm_prefetch = builder.module.declare_intrinsic("llvm.prefetch", [octet], kind)
        builder.call(llvm_prefetch, [builder.bitcast(address, octet), *map(number, (FOR_WRITING, KEPT, DATA))])
        return context.get_dummy_value()

    return types.void(array, i, j), generate


prefetch: Any = intrinsic(_prefetch)
