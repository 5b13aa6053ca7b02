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
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from fastatt._cached import cached_property
from fastatt.codegen.lanes import LaneFormula, Place, Shape, lane_function
from fastatt.codegen.memory import DTYPES, address_of, aligned
from fastatt.codegen.modules import MachineCode
from fastatt.codegen.processor import processor
from fastatt.codegen.row_loops import INPUTS, RESULTS, filled, joined, row_machine
from fastatt.threads import in_threads
from fastatt.tracing.traced import WIDEST, Traced, Tuple, trace

_VECTORS = 4  # vectors of a block
# rows for which another thread saves time, in blocks and one by one
_LEAST, _LEAST_ONE_BY_ONE = 1 << 13, 64
_PIECE = 1 << 16  # rows between two checks for Ctrl-C
_PIECES = 4  # pieces of each thread

Array = NDArray[Any]
#: numbers in a row; None for an array with one number in a row and no axis for it
Width = int | None


class _Made(NamedTuple):
    """A formula compiled for blocks: its machine code, and its number of rows of lanes."""

    function: MachineCode
    shape: Shape
    rows: int

    def memory(self) -> Array:
        """Rows of lanes for one thread."""
        precision, block = DTYPES[self.shape.precision], self.shape.block
        return aligned(self.rows * block, precision).reshape(self.rows, block)


class RowFunction:
    """``function`` of numbers, applied to every row of arrays; compiled at the first call.

    It takes a tuple of ``width`` traced numbers for each input (one number if the width is None),
    in the order of ``inputs``, and returns numbers in tuples, nested in any way. It may read
    tables, which a call provides, and call functions that are not traced. ``inputs`` are widths by
    name, ``outputs`` those of the output arrays; ``precision`` is the precision of all, "double" or
    "single". ``native`` formulas are for machine code only (``fastatt.tracing.native``).

    ``constants`` is a function of all inputs but the last one; ``function`` takes its results, a
    tuple of numbers, after the inputs. They are computed when one of those inputs changes.
    """

    _widest = WIDEST

    def __init__(
        self,
        function: Callable[..., Any],
        inputs: Mapping[str, Width],
        outputs: Sequence[Width],
        precision: str = "double",
        *,
        native: bool = False,
        constants: Callable[..., Any] | None = None,
    ) -> None:
        self._function, self._native, self._constants = function, native, constants
        self.inputs, self.outputs, self.precision = dict(inputs), tuple(outputs), precision
        self._dtype = DTYPES[precision]
        #: total widths of the inputs and of the outputs
        self._taken = sum(map(_count, self.inputs.values()))
        self._given = sum(map(_count, self.outputs))

    @cached_property
    def traced(self) -> Traced:
        """The function's operations."""
        forms = list(map(self._form, self.inputs.values()))
        if self.constants is not None:
            forms.append(self._form(len(self.constants.flat.results)))
        return trace(self._function, forms, self._widest, self.precision, native=self._native)

    @cached_property
    def constants(self) -> Traced | None:
        """The operations of the constants."""
        if self._constants is None:
            return None
        forms = list(map(self._form, self.inputs.values()))[:-1]
        return trace(self._constants, forms, 0, self.precision, native=self._native)

    @cached_property
    def _resources(self) -> list[tuple[str, Any]]:
        return self.traced.resources

    def _form(self, n: Width) -> Any:
        return self.precision if n is None else Tuple(tuple, (self.precision,) * n)

    @cached_property
    def _read(self) -> int:
        """The number of rows of lanes that the function reads: inputs, then constants."""
        return self._taken + (len(self.constants.flat.results) if self.constants else 0)

    @property
    def _first_result(self) -> int:
        """The first row of lanes with results."""
        return self._read

    @property
    def _held(self) -> int:
        """The rows of lanes on which the constants depend."""
        return self._taken - _count([*self.inputs.values()][-1]) if self.constants else 0

    @cached_property
    def _shape(self) -> Shape:
        """Blocks of a few vectors; single rows with derivatives.

        Two vectors together hide the latency of long chains of operations on constants.
        """
        if self.traced.lanes > 1:
            return Shape(self.precision, 1, 1)
        lanes = processor().lanes(self.precision)
        if self._constants:
            return Shape(self.precision, 2 * lanes, 2 * lanes)
        return Shape(self.precision, _VECTORS * lanes, lanes)

    @cached_property
    def _made(self) -> _Made:
        return self._compiled(self._shape)

    @cached_property
    def _form_for_few(self) -> _Made:
        """The function for single rows, since few rows would leave most lanes of a vector empty."""
        return self._compiled(Shape(self.precision, 1, 1))

    def _compiled(self, shape: Shape) -> _Made:
        places = [Place(row) for row in range(self._read + self._given)]

        def formula(traced: Traced, first: int, n: int) -> LaneFormula:
            inputs = {("x", k): place for k, place in enumerate(places[: self._read])}
            results = places[first : first + n]
            return LaneFormula(traced.flat, inputs, results, directions=traced.lanes)

        constants = None
        if self.constants:
            constants = formula(self.constants, self._taken, self._read - self._taken)
        results = formula(self.traced, self._first_result, self._given)
        function = lane_function(shape, results, self.traced.resources, constants)
        return _Made(function, shape, len(places))

    def _run(
        self, sources: list[Array], results: list[Array], whole: array[int], n_threads: int
    ) -> None:
        """Apply the function to arrays (S, B, k), all rows of a sample before the next sample."""
        form, (samples, n) = self._made, results[0].shape[:2]
        least = _LEAST if form.shape.block > 1 else _LEAST_ONE_BY_ONE
        run, entry = row_machine(self.precision), form.function.address
        # constants are computed for each piece, so that few samples are not divided
        by_samples = samples > 1 and self._first_result and (samples >= n or not self._held)
        along, across = (samples, n) if by_samples else (n, samples)

        def some(a: int, z: int) -> None:
            piece = np.s_[a:z] if by_samples else np.s_[:, a:z]
            inputs = filled([x[piece] for x in sources], INPUTS)
            outputs = filled([x[piece] for x in results], RESULTS)
            rows = self._held, self._first_result
            run(entry, _first(whole), form.memory(), inputs, outputs, *rows)

        in_pieces(along, n_threads, some, -(-least // across), max(1, _PIECE // across))

    def __call__(
        self,
        *arrays: Any,
        tables: Mapping[int, Array] | None = None,
        n_threads: int = 1,
        out: Sequence[Array] = (),
    ) -> tuple[Array, ...]:
        """(..., width) of each output from (..., width) of each input.

        The leading axes broadcast against each other without copies. ``tables`` are read by the
        function, by number. The results are written into ``out``, whose rows may have gaps between
        them, if it is given. Results do not depend on ``n_threads``.

        Raises ``ValueError`` for shapes that do not fit.
        """
        inputs = [
            self._checked(name, n, x)
            for (name, n), x in zip(self.inputs.items(), arrays, strict=True)
        ]
        lead = np.broadcast_shapes(*[x.shape[:-1] for x in inputs])
        total = math.prod(lead)
        if len(lead) > 2 and total:
            # more than two axes are reshaped to two, with a copy only if their strides do not fit
            inputs = [
                np.broadcast_to(x, (*lead, x.shape[-1])).reshape(-1, lead[-1], x.shape[-1])
                for x in inputs
            ]
        out = out or [np.empty((*lead, *_tail(n)), self._dtype) for n in self.outputs]
        if total:
            rows = lead[-1] if lead else 1
            shape = total // rows, rows
            results = [x.reshape(*shape, _count(n)) for x, n in zip(out, self.outputs, strict=True)]
            sources = [_wide(x, (*shape, x.shape[-1])) for x in inputs]
            read = {k: np.ascontiguousarray(x, dtype=np.float64) for k, x in (tables or {}).items()}
            whole = array("q", addresses(self._resources, read))
            self._fill(results, joined(sources, INPUTS), whole, n_threads)
        return tuple(out)

    def _fill(
        self, results: list[Array], sources: list[Array], whole: array[int], n_threads: int
    ) -> None:
        """Fill results (S, B, k); those beyond ``RESULTS`` are computed side by side."""
        wide, (samples, rows) = joined(results, RESULTS), results[0].shape[:2]
        last = wide[-1]
        if rows < self._made.shape.block and rows < samples:
            # a lane for each sample
            sources, wide = ([x.swapaxes(0, 1) for x in each] for each in (sources, wide))
            for b in range(rows):
                one, to = ([x[b : b + 1] for x in each] for each in (sources, wide))
                self._run(one, to, whole, n_threads)
        else:
            self._run(sources, wide, whole, n_threads)
        if len(results) > RESULTS:
            beyond = results[RESULTS - 1 :]
            ends = np.cumsum([x.shape[2] for x in beyond])[:-1]
            for x, columns in zip(beyond, np.split(last, ends, 2), strict=True):
                x[...] = columns

    def bound(self, arrays: Sequence[Array], out: Sequence[Array]) -> Callable[[], object]:
        """A function without arguments that works on the current contents of the arrays.

        ``arrays`` are (n, width), (n,) for a width None, or one row for all, (1, width); ``out``
        are the same without the last form. All have the precision and are C-contiguous. An array in
        both is changed in place. The function keeps addresses: a copy of it works on the same
        arrays.
        """
        n = len(out[0])
        is_few = 2 * n <= processor().lanes(self.precision)
        form = self._form_for_few if is_few else self._made
        wide = [np.broadcast_to(x, (n, *x.shape[1:])).reshape(1, n, -1) for x in arrays]
        run, whole, memory = row_machine(self.precision), array("q"), form.memory()
        sources = filled(wide, INPUTS)
        results = filled([x.reshape(1, n, -1) for x in out], RESULTS)
        entry, rows = form.function.address, (self._held, self._first_result)
        call = partial(run, entry, _first(whole), memory, sources, results, *rows)
        call.function = form.function  # type: ignore[attr-defined]  # as in ``scalar``
        return call

    def _checked(self, name: str, n: Width, value: Any) -> Array:
        """An input (..., n) in the precision, with the numbers of a row side by side."""
        x = np.asarray(value, self._dtype)
        x = x if x.flags.aligned else x.copy()
        if n is None:
            return x[..., None]
        if x.shape[-1:] != (n,):
            raise ValueError(f"{name}: has shape {x.shape}; accepted: (..., {n})")
        return x if n < 2 or x.strides[-1] == x.itemsize else np.ascontiguousarray(x)


class LogFunction(RowFunction):
    """``step(state, *sample, *given)`` over the samples of many logs, compiled at the first call.

    A row is a log. ``step`` returns the next state from tuples of traced numbers: the state, those
    ``sampled``, and those ``given`` for a whole log. All are float64.
    """

    _widest = 0
    # the result is the state for the next sample
    _first_result = 0

    @cached_property
    def _shape(self) -> Shape:
        lanes = processor().lanes(self.precision)
        return Shape(self.precision, lanes, lanes)

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
        wide = [np.broadcast_to(x, (n_logs, x.shape[-1])) for x in given]
        shared = [np.concatenate(wide, axis=1)] if wide else []
        arrays = [np.ascontiguousarray(x, self._dtype) for x in (start, *sampled, *shared)]
        state = arrays[0].copy()
        if n:
            # samples first; an array without them, or with one, repeats it
            wide = [x.swapaxes(0, 1) if x.ndim == 3 else x[None] for x in arrays]
            sources = [np.broadcast_to(x, (n, n_logs, x.shape[-1])) for x in wide]
            last = as_strided(state, (n, *state.shape), (0, *state.strides))
            self._run(sources, [last], array("q"), n_threads)
        return state


def _wide(x: Array, shape: tuple[int, ...]) -> Array:
    """Rows that broadcast, without the time of NumPy's function where nothing is to be done."""
    return x.reshape(shape) if x.size == math.prod(shape) else np.broadcast_to(x, shape)


def _count(width: Width) -> int:
    return 1 if width is None else width


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
    precision: str = "double",
    key: Hashable = None,
) -> RowFunction:
    """The ``RowFunction`` of a function, made once in a process for a layout and a precision.

    ``key`` replaces a function that is made anew at each call; it contains everything on which the
    function's operations depend.
    """
    layout = function if key is None else key, tuple(inputs.items()), tuple(outputs), precision
    known = _KNOWN.get(layout)
    return known or _KNOWN.setdefault(layout, RowFunction(function, inputs, outputs, precision))


def precision_of(dtype: Any) -> str:
    """The precision in which arrays of a type are processed."""
    return "single" if np.dtype(dtype) == np.float32 else "double"


def in_pieces(
    n: int, n_threads: int, call: Callable[[int, int], Any], least: int, most: int
) -> None:
    """``call(first, last)`` over n rows, in pieces of ``least`` to ``most`` rows on each thread."""
    pieces = max(min(_PIECES * n_threads if n_threads > 1 else 1, n // least), -(-n // most))
    if pieces < 2:
        call(0, n)
        return
    bounds = [n * i // pieces for i in range(pieces + 1)]
    in_threads([partial(call, *ends) for ends in pairwise(bounds)], n_threads)


def addresses(resources: Sequence[tuple[str, Any]], tables: Mapping[int, Array]) -> list[int]:
    """Where they lie, of tables in double precision."""
    return [address_of(tables[x]) if what == "table" else x.address for what, x in resources]
