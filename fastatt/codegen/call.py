"""Calls of the hand-written loops, and of generated functions by their addresses from these."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from fastatt.codegen.memory import address_of


def _pointer(kind: Any) -> Any:
    """An intrinsic: an address as a pointer to numbers of a type; in Python the array itself."""

    @intrinsic  # type: ignore[untyped-decorator]
    def pointer(typing_context: Any, address: Any) -> Any:
        def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return builder.inttoptr(args[0], context.get_value_type(sig.return_type))

        return types.CPointer(kind)(address), lower

    return pointer


def _same(array: Any, kind: str = "") -> Any:
    """The array itself."""
    return array


#: Numba's types by the names of precisions
TYPES = {"double": types.float64, "single": types.float32}
if config.DISABLE_JIT:
    doubles = wholes = octets = reals = _same
else:
    doubles, wholes, octets = map(_pointer, (types.float64, types.int64, types.uint8))

    @intrinsic(prefer_literal=True)  # type: ignore[untyped-decorator]
    def reals(typing_context: Any, address: Any, kind: Any) -> Any:
        """An address as a pointer to numbers of a precision, by its name, a constant."""

        def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return builder.inttoptr(args[0], context.get_value_type(sig.return_type))

        return types.CPointer(TYPES[kind.literal_value])(address, kind), lower


def call_generated(entry: Any, part: int, memory: Any, numbers: Any) -> None:
    """Call a generated function: ``run(part, *memory, *numbers)``, here one of Python."""
    entry(part, *memory, *numbers)


if not config.DISABLE_JIT:

    @intrinsic  # type: ignore[untyped-decorator]
    def call_generated(
        typing_context: Any, entry: Any, part: Any, memory: Any, numbers: Any
    ) -> Any:
        """Call a generated function by its address."""

        def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            address, number, *tuples = args
            given = [number]
            for values in tuples:
                given += cgutils.unpack_tuple(builder, values)
            of = ir.FunctionType(ir.VoidType(), [x.type for x in given]).as_pointer()
            builder.call(builder.inttoptr(address, of), given)
            return context.get_dummy_value()

        return types.void(entry, part, memory, numbers), lower


def call_loop(
    run: Callable[..., int], arrays: Sequence[Any], settings: Sequence[Any],
    limits: Sequence[float], first: int, last: int,
) -> int:  # fmt: skip
    """Call a loop of ``fastatt._jit.address_loop``; what it gives.

    ``arrays`` are C-contiguous, or addresses of such; without a compiler arrays alone.
    """
    if config.DISABLE_JIT:
        flat = [x.reshape(-1) if isinstance(x, np.ndarray) else x for x in arrays]
        with np.errstate(all="ignore"):
            return run(flat, settings, limits, first, last)
    addresses = [x if isinstance(x, int) else address_of(x) for x in arrays]
    numbers = array("q", addresses), array("q", settings), array("d", limits)
    return run(*(x.buffer_info()[0] for x in numbers), first, last)
