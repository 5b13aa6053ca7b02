"""A function of numbers on every row of arrays, or of every log, traced and compiled once.

Each lane of a vector is a row. Results depend neither on the number of rows nor on that of threads.
Derivatives in six or more directions are in the lanes of a vector instead, and the loop is over
single rows: with a lane per row each direction would need separate operations, six times as many to
compile, at the same speed.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import numpy as np
from numba import config
from numpy.typing import NDArray

from fastatt._fork import cached_property
from fastatt.codegen.lanes import LaneFormula, Memory, Place, Shape, lane_function
from fastatt.codegen.memory import DTYPES, address_of
from fastatt.codegen.processor import processor
from fastatt.codegen.row_loops import TOTAL, row_loop
from fastatt.threads import each_in_threads
from fastatt.tracing.traced import WIDEST, Traced, Tuple, plain, trace

_VECTORS = 4  # vectors of a block
# rows for which another thread saves time, in blocks and one by one
_LEAST, _LEAST_ONE_BY_ONE = 1 << 13, 64
_PIECE = 1 << 16  # rows between two checks for Ctrl-C
_PIECES = 4  # pieces of each thread

Array = NDArray[Any]
#: numbers in a row; None for an array with one number in a row and no axis for it
Width = int | None


class _Made(NamedTuple):
    """A formula compiled for blocks of some rows: Numba's function, and its memory."""

    function: Any
    block: int
    memory: Memory


class _Source(NamedTuple):
    """An input: strides along both leading axes and from sample to sample, numbers in a row."""

    array: Array
    outer: int
    inner: int
    later: int
    width: int


class RowFunction:
    """``function`` of numbers, applied to every row of arrays; compiled at the first call.

    It takes a tuple of ``width`` traced numbers for each input (one number if the width is None),
    in the order of ``inputs``, and returns numbers in tuples, nested in any way. It may read
    tables, which a call provides, and call functions that are not traced. ``inputs`` are widths by
    name, ``outputs`` those of the output arrays; ``kind`` is the precision of all, "double" or
    "single".
    """

    _widest = WIDEST

    def __init__(
        self,
        function: Callable[..., Any],
        inputs: Mapping[str, Width],
        outputs: Sequence[Width],
        kind: str = "double",
    ) -> None:
        self._function = function
        self.inputs, self.outputs, self.kind = dict(inputs), tuple(outputs), kind
        self._dtype = DTYPES[kind]
        #: total widths of the inputs and of the outputs
        self._taken = sum(map(_count, self.inputs.values()))
        self._given = sum(map(_count, self.outputs))
        self._first_result = self._taken

    @cached_property
    def traced(self) -> Traced:
        """The function's operations."""
        return self._trace(self._widest)

    def _trace(self, widest: int) -> Traced:
        forms = [
            self.kind if n is None else Tuple(tuple, (self.kind,) * n) for n in self.inputs.values()
        ]
        made = trace(self._function, forms, widest, self.kind)
        count = len(made.flat.results)
        if count != self._given:
            raise ValueError(f"function: gives {count} numbers; accepted: {self._given}")
        return made

    @cached_property
    def _shape(self) -> Shape:
        """Blocks of a few vectors; single rows with derivatives or a recurrence."""
        if self.traced.lanes > 1 or self.traced.loop is not None:
            return Shape(self.kind, 1, 1)
        lanes = processor().lanes(self.kind)
        return Shape(self.kind, _VECTORS * lanes, lanes)

    @cached_property
    def _made(self) -> _Made:
        return self._compiled(self._shape)

    @cached_property
    def _made_for_few(self) -> _Made:
        """The function for single rows, since few rows would leave most lanes of a vector empty."""
        return self._compiled(Shape(self.kind, 1, 1))

    def _compiled(self, shape: Shape) -> _Made:
        traced, first = self.traced, self._first_result
        inputs = {("x", k): Place(k) for k in range(self._taken)}
        by_lanes = traced.lanes == 1 and traced.loop is None
        results = [Place(row) for row in range(first, first + self._given)]
        formula = LaneFormula(traced.flat if by_lanes else traced, inputs, results)
        function = lane_function(shape, [formula], traced.resources)
        memory = Memory(shape, self._taken + self._given, 3)
        return _Made(function, shape.block, memory)

    def _table(
        self,
        made: _Made,
        lengths: tuple[int, int, int],
        sources: Sequence[_Source],
        out: Sequence[Array],
        whole: array[int],
    ) -> array[int]:
        """The table of ``run_rows``; the lengths are rows, those of the last axis, and samples."""
        numbers = [made.function.address, _first(whole), *lengths, self._first_result]
        numbers += [len(sources), len(out)]
        for x, *rest in sources:
            numbers += [address_of(x), *rest]
        for x, n in zip(out, self.outputs, strict=True):
            numbers += [address_of(x), _count(n)]
        return array("q", numbers)

    def _run(self, table: array[int], n_threads: int, least: int) -> None:
        """Run the loop over all rows; ``least`` rows are worth another thread."""
        made = self._made
        loop = row_loop(self.kind, made.block)

        def run(first: int, last: int) -> None:
            _held, *at = made.memory.made()
            loop(_first(table), *at, first, last)

        in_pieces(table[TOTAL], n_threads, run, least)

    def __call__(
        self,
        *arrays: Any,
        tables: Mapping[int, Array] | None = None,
        n_threads: int = 1,
    ) -> tuple[Array, ...]:
        """(..., width) of each output from (..., width) of each input.

        The leading axes broadcast against each other without copies. ``tables`` are read by the
        function, by number. Results do not depend on ``n_threads``.

        Raises ``ValueError`` for shapes that do not fit.
        """
        given = [
            self._checked(name, n, x)
            for (name, n), x in zip(self.inputs.items(), arrays, strict=True)
        ]
        lead = np.broadcast_shapes(*[x.shape[:-1] for x in given])
        if without_compiler():
            return self._in_python(plain(self._trace(0), tables or {}), lead, given)
        total = math.prod(lead)
        if len(lead) > 2 and total:
            # more than two axes are reshaped to two, with a copy only if their strides do not fit
            given = [
                np.broadcast_to(x, (*lead, x.shape[-1])).reshape(-1, lead[-1], x.shape[-1])
                for x in given
            ]
        out = [np.empty((*lead, *_tail(n)), self._dtype) for n in self.outputs]
        if total:
            kept = {k: np.ascontiguousarray(x, dtype=np.float64) for k, x in (tables or {}).items()}
            whole = array("q", addresses(self.traced.resources, kept))
            sources = [_Source(x, *_strides(x), 0, x.shape[-1]) for x in given]
            lengths = total, lead[-1] if lead else 1, 1
            table = self._table(self._made, lengths, sources, out, whole)
            least = _LEAST_ONE_BY_ONE if self._made.block == 1 else _LEAST
            self._run(table, n_threads, least)
        return tuple(out)

    def bound(self, arrays: Sequence[Array], out: Sequence[Array]) -> Callable[[], object]:
        """A function without arguments that works on the current contents of the arrays.

        ``arrays`` are (n, width), (n,) for a width None, or one row for all, (1, width); ``out``
        are the same without the last form. All have the precision and are C-contiguous. An array in
        both is changed in place. The function keeps addresses: a copy of it works on the same
        arrays.
        """
        for x in (*arrays, *out):
            if x.dtype != self._dtype or not x.flags.c_contiguous:
                raise ValueError(f"arrays: found {x.dtype}; accepted: {self._dtype}, C-contiguous")
        if without_compiler():

            def slowly() -> None:
                for x, found in zip(out, self(*arrays), strict=True):
                    x[...] = found

            return slowly
        n = len(out[0])
        made = self._made_for_few if 2 * n <= processor().lanes(self.kind) else self._made
        widths = [math.prod(x.shape[1:]) for x in arrays]
        sources = [
            _Source(x, 0, 0 if len(x) == 1 else k, 0, k)
            for x, k in zip(arrays, widths, strict=True)
        ]
        whole, (memory, *at) = array("q"), made.memory.made()
        table = self._table(made, (n, n, 1), sources, out, whole)
        run = row_loop(self.kind, made.block)
        held, first = (arrays, out, whole, memory, table), _first(table)

        def quickly() -> object:
            assert held
            return run(first, *at, 0, n)

        return quickly

    def _checked(self, name: str, n: Width, value: Any) -> Array:
        """An input (..., n) in the precision, with the numbers of a row side by side."""
        x = np.asarray(value, self._dtype)
        x = x if x.flags.aligned else x.copy()
        if n is None:
            return x[..., None]
        if x.shape[-1:] != (n,):
            raise ValueError(f"{name}: has shape {x.shape}; accepted: (..., {n})")
        return x if n < 2 or x.strides[-1] == x.itemsize else np.ascontiguousarray(x)

    def _in_python(
        self, run: Callable[..., Any], lead: tuple[int, ...], given: Sequence[Array]
    ) -> tuple[Array, ...]:
        columns = [x[..., i] for x in given for i in range(x.shape[-1])]
        made = [np.broadcast_to(np.asarray(x, self._dtype), lead) for x in run(columns)]
        bounds = pairwise(accumulate(map(_count, self.outputs), initial=0))
        return tuple(
            np.stack(made[a:b], axis=-1).reshape((*lead, *_tail(n)))
            for n, (a, b) in zip(self.outputs, bounds, strict=True)
        )


class LogFunction(RowFunction):
    """``step(state, *sample, *given)`` over the samples of many logs, compiled at the first call.

    A row is a log. ``step`` returns the next state, of ``size`` numbers, from tuples of traced
    numbers: the state, those ``sampled``, and those ``given`` for a whole log. All are float64.
    """

    _widest = 0

    def __init__(
        self,
        step: Callable[..., Any],
        size: int,
        sampled: Mapping[str, int],
        given: Mapping[str, int],
    ) -> None:
        super().__init__(step, {"state": size, **sampled, **given}, (size,))
        # the result is the state for the next sample
        self._first_result = 0

    @cached_property
    def _shape(self) -> Shape:
        lanes = processor().lanes(self.kind)
        return Shape(self.kind, lanes, lanes)

    def __call__(  # type: ignore[override]
        self,
        start: Array,
        sampled: Sequence[Array],
        given: Sequence[Array],
        n_threads: int = 1,
    ) -> Array:
        """The states (N, size) of N logs after their samples, from those before.

        ``sampled`` are (N, n, k) or (1, n, k), ``given`` (N, k) or (1, k), float64.
        """
        n_logs, n = len(start), max(x.shape[1] for x in sampled)
        arrays = [np.ascontiguousarray(x, self._dtype) for x in (start, *sampled, *given)]
        # samples along an axis; an array without this axis, or with one sample, repeats it
        wide = [
            np.broadcast_to(x if x.ndim == 3 else x[:, None], (n_logs, n, x.shape[-1]))
            for x in arrays
        ]
        state = arrays[0].copy()
        if without_compiler():
            run = plain(self.traced, {})
            for i in range(n):
                now = [state, *(x[:, i] for x in wide[1:])]
                (state,) = self._in_python(run, (n_logs,), now)
        elif n:
            size = state.itemsize
            sources = [
                _Source(x, 0, x.strides[0] // size, x.strides[1] // size, x.shape[2]) for x in wide
            ]
            table = self._table(self._made, (n_logs, n_logs, n), sources, [state], array("q"))
            self._run(table, n_threads, self._made.block)
        return state


def _count(width: Width) -> int:
    return 1 if width is None else width


def _strides(x: Array) -> tuple[int, int]:
    """Strides in numbers along the last two leading axes; 0 for an axis of length 1."""
    lengths, strides = (1, 1, *x.shape[:-1]), (0, 0, *x.strides[:-1])
    outer, inner = (0 if lengths[axis] == 1 else strides[axis] // x.itemsize for axis in (-2, -1))
    return outer, inner


def _first(numbers: array[int]) -> int:
    """Address of the first of the numbers."""
    return numbers.buffer_info()[0]


def _tail(width: Width) -> tuple[int, ...]:
    return () if width is None else (width,)


_KNOWN: dict[Hashable, RowFunction] = {}


def rows(
    function: Callable[..., Any],
    inputs: Mapping[str, Width],
    outputs: Sequence[Width],
    kind: str = "double",
    key: Hashable = None,
) -> RowFunction:
    """The ``RowFunction`` of a function, made once in a process for a layout and a precision.

    ``key`` replaces a function that is made anew at each call; it contains everything on which the
    function's operations depend.
    """
    layout = function if key is None else key, tuple(inputs.items()), tuple(outputs), kind
    found = _KNOWN.get(layout)
    return found or _KNOWN.setdefault(layout, RowFunction(function, inputs, outputs, kind))


def kind_of(dtype: Any) -> str:
    """The precision in which arrays of a type are processed."""
    return "single" if np.dtype(dtype) == np.float32 else "double"


def without_compiler() -> bool:
    """Whether ``NUMBA_DISABLE_JIT`` requests plain Python."""
    return bool(config.DISABLE_JIT)


def in_pieces(n: int, n_threads: int, call: Callable[[int, int], Any], least: int) -> None:
    """``call(first, last)`` over n rows, in pieces of at least ``least`` rows on each thread."""
    pieces = max(min(_PIECES * n_threads if n_threads > 1 else 1, n // least), -(-n // _PIECE))
    if pieces < 2:
        call(0, n)
        return
    bounds = [n * i // pieces for i in range(pieces + 1)]
    each_in_threads([partial(call, *ends) for ends in pairwise(bounds)], n_threads)


def addresses(resources: Sequence[tuple[str, Any]], tables: Mapping[int, Array]) -> list[int]:
    """Where they lie, of tables in double precision."""
    return [address_of(tables[x]) if kind == "table" else x.address for kind, x in resources]
