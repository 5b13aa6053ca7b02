"""A formula with derivatives row by row over arrays: vectors have a lane a direction, not a row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property, partial
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from fastatt.flat.code import I64, REALS, Code, Int
from fastatt.flat.rows import Rows, Table
from fastatt.flat.traced import Traced, Tuple, flattened_forms, plain, trace
from fastatt.flat.writing import write
from fastatt.threads import each_in_threads

Array = NDArray[Any]
_PIECE = 64  # rows at least that a thread is given
_PIECES = 4  # of each thread


class Repeated(Rows):
    """As ``Rows``, of a formula whose derivatives go side by side: ``scalar_function``'s form.

    A vector holds the derivatives of one row's number in six or more directions. With a lane a row
    each direction would be operations of its own, six times as many to compile, and nothing gained
    where it runs; a ``Recurrence`` stays a loop. So the loop is over single rows.
    """

    @cached_property
    def traced(self) -> Traced:
        """The formula for numbers and tuples of the widths of the inputs."""
        return self._trace()

    @cached_property
    def _apart(self) -> Traced:
        """The same without lanes: a number for each derivative."""
        return self._trace(0)

    def _trace(self, *widest: int) -> Traced:
        forms = [
            self.kind if n is None else Tuple(tuple, (self.kind,) * n) for n in self.inputs.values()
        ]
        made = trace(self._function, forms, *widest)
        self._check(len(list(flattened_forms((made.form,)))))
        return made

    def _check(self, count: int) -> None:
        wanted = sum(1 if n is None else n for n in self.outputs)
        if count != wanted:
            raise ValueError(f"function: gives {count} numbers; accepted: {wanted}")

    @cached_property
    def _resources(self) -> list[tuple[str, Any]]:
        return self.traced.resources

    def _run(self, table: Any, total: int, n_threads: int) -> None:
        with self._lock:
            run = self._compiled
        in_pieces(total, n_threads, lambda first, last: run(table, first, last))

    def _in_python(
        self, lead: tuple[int, ...], given: list[Array], tables: Mapping[int, Array]
    ) -> tuple[Array, ...]:
        columns = [x[..., i] for x in given for i in range(x.shape[-1])]
        run = plain(self._apart, tables)
        made = [np.broadcast_to(np.asarray(x, self._dtype), lead) for x in run(columns)]
        bounds = pairwise(accumulate((1 if n is None else n for n in self.outputs), initial=0))
        return tuple(
            made[a].copy() if n is None else np.stack(made[a:b], axis=-1)
            for n, (a, b) in zip(self.outputs, bounds, strict=True)
        )

    def _code(self, lanes: int) -> Code:
        """``rows(table, first, last)``, with the table that ``Rows`` makes."""
        code = Code(ir.Module("rows"), "rows", [I64.as_pointer(), I64, I64])
        argument, first, last = code.function.args
        entries = Table(code, argument)
        entries.number()
        inner, real = entries.number(), REALS[self.kind]
        sources = [
            (entries.pointer(real), entries.number(), entries.number(), 1 if n is None else n)
            for n in self.inputs.values()
        ]
        targets = [(entries.pointer(real), 1 if n is None else n) for n in self.outputs]
        resources = entries.resources(self._resources)
        with code.loop(Int(code, first), Int(code, last)) as i:
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


def in_pieces(n: int, n_threads: int, call: Callable[[int, int], Any], least: int = _PIECE) -> None:
    """``call(first, last)`` over n rows, in pieces of at least ``least`` on each thread."""
    pieces = max(1, min(_PIECES * n_threads if n_threads > 1 else 1, n // least))
    bounds = [n * i // pieces for i in range(pieces + 1)]

    each_in_threads([partial(call, *ends) for ends in pairwise(bounds)], n_threads)
