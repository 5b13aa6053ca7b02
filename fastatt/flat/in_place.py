"""``Rows`` on arrays that stay where they are, for calls that are many and short."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from functools import cached_property

from fastatt.flat.repeated import Repeated
from fastatt.flat.rows import Array, Rows, address_of, lanes_of, without_compiler


class InPlace(Rows):
    """A function whose arrays are known beforehand, results written over arguments if need be."""

    @cached_property
    def _one_by_one(self) -> Repeated:
        """For few rows, with which most lanes of a vector would stay empty."""
        return Repeated(self._function, self.inputs, self.outputs, self.kind)

    def bound(self, arrays: Sequence[Array], out: Sequence[Array]) -> Callable[[], object]:
        """A function of nothing that works on what the arrays hold when it is called.

        ``arrays`` are (n, width), (n,) of a width None, or one row for all, (1, width); ``out`` the
        same without the last; all of the precision, C-contiguous. One that is in both is changed in
        place. It knows where they lie: a copy of it works on the same arrays.
        """
        for x in (*arrays, *out):
            if x.dtype != self._dtype or not x.flags.c_contiguous:
                raise ValueError(f"arrays: found {x.dtype}; accepted: {self._dtype}, C-contiguous")
        if without_compiler():

            def slowly() -> None:
                for x, made in zip(out, self(*arrays), strict=True):
                    x[...] = made

            return slowly
        n = len(out[0])
        program = self._one_by_one if 2 * n <= lanes_of(self.kind) else self
        table = [n, n]
        for x in arrays:
            table += [address_of(x), 0, 0 if len(x) == 1 else math.prod(x.shape[1:])]
        table += map(address_of, out)
        places = (ctypes.c_int64 * len(table))(*table)
        run, held = program._compiled, (arrays, out)  # noqa: SLF001

        def quickly() -> object:
            assert held
            return run(places, 0, n)

        return quickly
