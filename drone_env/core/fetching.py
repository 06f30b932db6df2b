"""Telling the processor what memory will be needed, before it is."""

from importlib import import_module
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

cgutils: Any = import_module("numba.core.cgutils")

FOR_WRITING, KEPT, DATA = 1, 3, 1
"""What LLVM's `prefetch` gets: it will be written, it will be used again, and it is no code."""


def _fetch_early(typing_context: Any, array: Any, i: Any, j: Any) -> Any:
    """In compiled code: begin to bring `array[i, j]` into the cache; i and j are unsigned. It changes no result."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        made = context.make_array(signature.args[0])(context, builder, arguments[0])
        given = list(zip(arguments, signature.args, strict=True))[1:]
        indices = [context.cast(builder, index, kind, types.uintp) for index, kind in given]
        address = cgutils.get_item_pointer(context, builder, signature.args[0], made, indices, wraparound=False)
        octet, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [octet, number, number, number])
        prefetch = builder.module.declare_intrinsic("llvm.prefetch", [octet], kind)
        builder.call(prefetch, [builder.bitcast(address, octet), *map(number, (FOR_WRITING, KEPT, DATA))])
        return context.get_dummy_value()

    return types.void(array, i, j), generate


fetch_early: Any = intrinsic(_fetch_early)
