"""Formulas over single rows: derivatives go side by side, or rows are few and stay in place."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

from fastatt.flat.code import Code
from fastatt.flat.rows import Array, Rows, address_of, lanes_of, without_compiler
from fastatt.flat.traced import WIDEST, Traced
from fastatt.flat.writing import write


class Repeated(Rows):
    """As ``Rows``, of a formula whose derivatives go side by side: ``scalar_function``'s form.

    A vector holds the derivatives of one row's number in six or more directions. With a lane a row
    each direction would be operations of its own, six times as many to compile, and nothing gained
    where it runs; a ``Recurrence`` stays a loop. So the loop is over single rows.
    """

    _least = 64

    @cached_property
    def traced(self) -> Traced:
        """The formula for numbers and tuples of the widths of the inputs."""
        return self._trace(WIDEST)

    def _code(self, lanes: int) -> Code:
        """``rows(table, first, last)``, with the table that ``Rows`` makes."""
        code, (first, last), entries = self._begun()
        _, inner = entries.number(), entries.number()
        sources, targets, resources = self._arrays(entries)
        with code.loop(first, last) as i:
            s, b = i // inner, i % inner
            given: list[Any] = []
            for pointer, outer_stride, inner_stride, n in sources:
                row = code.place(pointer, s * outer_stride + b * inner_stride)
                given += [code.load(row, k) for k in range(n)]
            made = iter(write(code, self.traced, given, resources))
            for pointer, n in targets:
                for k in range(n):
                    code.store(pointer, i * n + k, next(made))
        code.give(0)
        return code


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
