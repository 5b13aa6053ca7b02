"""Calls of generated functions by their addresses, from hand-written loops."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fastatt._numba import NOTHING

#: Numba's types by the names of precisions
TYPES = {"double": types.float64, "single": types.float32}
#: what functions of numbers take
ACCEPTED = "accepted are float64 or float32 and tuples of them: write 1.0 instead of 1"


@intrinsic  # type: ignore[untyped-decorator]
def call(typing_context: Any, entry: Any, part: Any, memory: Any, numbers: Any) -> Any:
    """Call a part of a generated function by its address.

    ``memory`` are addresses, and ``numbers`` integers.
    """

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        address, number, arrays, integers = args
        values = [number]
        for i in range(len(memory)):
            place = builder.extract_value(arrays, i)
            values.append(builder.inttoptr(place, ir.IntType(64).as_pointer()))
        values += [builder.extract_value(integers, i) for i in range(len(numbers))]
        of = ir.FunctionType(ir.VoidType(), [x.type for x in values]).as_pointer()
        builder.call(builder.inttoptr(address, of), values)
        return NOTHING

    return types.void(entry, part, memory, numbers), lower
