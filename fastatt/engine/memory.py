"""Instructions that NumPy code has no word for: a store past the cache, a prefetch, a maximum.

Attitudes are written once and not read again here. An ordinary store first fetches the line that
it overwrites; a non-temporal one does not: 1.4 instead of 3.8 ns an attitude out of the cache.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic
def stream(typingctx: Any, array: types.Array, index: types.Type, value: types.Type) -> Any:
    """array[index] = value, past the cache; array is flat and contiguous, index in range."""
    if not (isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"):
        return None

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(array)(context, builder, arguments[0]).data
        store = builder.store(arguments[2], builder.gep(data, [arguments[1]]))
        one = builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)])
        store.set_metadata("nontemporal", one)
        return context.get_dummy_value()

    return types.void(array, types.intp, array.dtype), codegen


@intrinsic
def prefetch(typingctx: Any, array: types.Array, index: types.Type) -> Any:
    """Ask for the cache line of array[index]; an index out of range does nothing."""
    if not (isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"):
        return None

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(array)(context, builder, arguments[0]).data
        pointer = builder.gep(data, [arguments[1]])
        number = ir.IntType(32)
        function = builder.module.declare_intrinsic(
            "llvm.prefetch", (pointer.type,), ir.FunctionType(
                ir.VoidType(), [pointer.type, number, number, number]
            )
        )  # fmt: skip
        read, near, data_cache = (ir.Constant(number, k) for k in (0, 3, 1))
        builder.call(function, [pointer, read, near, data_cache])
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen


@intrinsic
def maximum(typingctx: Any, a: types.Type, b: types.Type) -> Any:
    """The larger of two floats that are not negative.

    They are compared as integers. Of ``a if a > b else b`` with one in memory LLVM makes a
    comparison and a masked store, which cost 2 % of a step more than a maximum and a store.
    """
    if not isinstance(a, types.Float) or a != b:
        return None

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = ir.IntType(a.bitwidth)
        x, y = (builder.bitcast(v, bits) for v in arguments)
        most = builder.select(builder.icmp_signed(">", x, y), x, y)
        return builder.bitcast(most, arguments[0].type)

    return a(a, a), codegen
