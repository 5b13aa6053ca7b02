"""A function of numbers on every row of arrays: traced and compiled once, a vector's lane a row.

Rows go in blocks of a few vectors: gathered into columns, worked on, handed out. A last block is
filled up with the last row, so that every row meets the same instructions: results depend neither
on the number of rows nor on that of threads.

Where derivatives go side by side, a vector holds those of one row's number in six or more
directions, and the loop is over single rows: with a lane a row each direction would be operations
of its own, six times as many to compile, and nothing gained where it runs.
"""

from __future__ import annotations

import ctypes
import math
import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import cached_property, partial
from itertools import accumulate, pairwise
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import config
from numpy.typing import NDArray

from fastatt.flat import machine
from fastatt.flat.code import I64, REALS, Code, Int, text_of
from fastatt.flat.llvm import POINTERS, Emitter
from fastatt.flat.traced import WIDEST, Traced, Tuple, plain, trace
from fastatt.flat.writing import write
from fastatt.threads import each_in_threads

DTYPES: dict[str, np.dtype[Any]] = {"double": np.dtype(np.float64), "single": np.dtype(np.float32)}
_VECTORS = 4  # of a block
_UNROLLED = 16  # columns that are copied without a loop
# rows that are worth a thread, of blocks and one by one
_LEAST, _LEAST_ONE_BY_ONE = 1 << 13, 64
_PIECE = 1 << 16  # rows between two looks at Ctrl-C
_PIECES = 4  # of each thread
_BYTE = ctypes.c_char

Array = NDArray[Any]
#: numbers in a row; None of an array that has one number a row, without an axis for it
Width = int | None


class Program:
    """A function of numbers as a program over arrays: traced once, compiled at the first call."""

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
        self._lock = threading.Lock()

    @cached_property
    def traced(self) -> Traced:
        """The function's operations."""
        return self._trace(0)

    def _trace(self, widest: int) -> Traced:
        forms = [
            self.kind if n is None else Tuple(tuple, (self.kind,) * n) for n in self.inputs.values()
        ]
        made = trace(self._function, forms, widest, self.kind)
        count, wanted = len(made.flat.results), sum(map(_count, self.outputs))
        if count != wanted:
            raise ValueError(f"function: gives {count} numbers; accepted: {wanted}")
        return made

    @cached_property
    def _compiled(self) -> Any:
        code = self._code(lanes_of(self.kind))
        program = machine.compiled(text_of(code.module))
        return program.function("rows", ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)

    @staticmethod
    def _begun() -> tuple[Code, tuple[Int, Int], Table]:
        """A program's function, the rows that it is called for, and its table."""
        code = Code(ir.Module("rows"), "rows", [I64.as_pointer(), I64, I64])
        argument, first, last = code.function.args
        return code, (Int(code, first), Int(code, last)), Table(code, argument)

    def _code(self, lanes: int) -> Code:
        raise NotImplementedError


class Rows(Program):
    """``function`` of numbers, applied to every row of arrays; compiled at the first call.

    Parameters
    ----------
    function : takes a tuple of ``width`` recorded numbers an input (one number where the width is
        None), in the order of ``inputs``, and gives numbers in tuples, nested at will: a kernel of
        ``flat.formulas``, or what is made of such. It may look up tables (``graph.gather``), which
        a call is given, and call opaque functions (``graph.opaque``), which have an ``address``.
    inputs : widths by name.
    outputs : widths of the arrays that the numbers are handed out to, in order.
    kind : "double" or "single", the precision of inputs and outputs.
    """

    @cached_property
    def traced(self) -> Traced:
        """The function's operations."""
        return self._trace(WIDEST)

    @cached_property
    def _one_by_one(self) -> bool:
        """Whether the loop is over single rows: of derivatives side by side, of a recurrence."""
        return self.traced.lanes > 1 or self.traced.loop is not None

    def __call__(
        self,
        *arrays: Any,
        tables: Mapping[int, Array] | None = None,
        n_threads: int = 1,
    ) -> tuple[Array, ...]:
        """(..., width) of each output from (..., width) of each input.

        The leading axes broadcast against each other; nothing is copied for it. ``tables`` are what
        the function looks up, by number. Results do not depend on ``n_threads``.

        Raises ``ValueError`` for shapes that do not fit.
        """
        given = [
            self._checked(name, n, x)
            for (name, n), x in zip(self.inputs.items(), arrays, strict=True)
        ]
        lead = np.broadcast_shapes(*[x.shape[:-1] for x in given])
        if without_compiler():
            return self._in_python(lead, given, tables or {})
        total = math.prod(lead)
        if len(lead) > 2 and total:
            # more axes are two: a copy only where one of the first does not follow the next
            given = [
                np.broadcast_to(x, (*lead, x.shape[-1])).reshape(-1, lead[-1], x.shape[-1])
                for x in given
            ]
        out = [np.empty((*lead, *_tail(n)), self._dtype) for n in self.outputs]
        if total:
            table = [total, lead[-1] if lead else 1]
            for x in given:
                table += [address_of(x), *_strides(x)]
            table += map(address_of, out)
            kept = {k: np.ascontiguousarray(x, dtype=np.float64) for k, x in (tables or {}).items()}
            table += addresses(self.traced.resources, kept)
            places = (ctypes.c_int64 * len(table))(*table)
            with self._lock:
                run = self._compiled
            least = _LEAST_ONE_BY_ONE if self._one_by_one else _LEAST
            in_pieces(total, n_threads, lambda a, b: run(places, a, b), least)
        return tuple(out)

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
        table = [n, n]
        for x in arrays:
            table += [address_of(x), 0, 0 if len(x) == 1 else math.prod(x.shape[1:])]
        table += map(address_of, out)
        places = (ctypes.c_int64 * len(table))(*table)
        run = self._compiled_for_few if 2 * n <= lanes_of(self.kind) else self._compiled
        held = arrays, out

        def quickly() -> object:
            assert held
            return run(places, 0, n)

        return quickly

    @cached_property
    def _compiled_for_few(self) -> Any:
        """Of single rows: with few of them most lanes of a vector would stay empty."""
        other = Rows(self._function, self.inputs, self.outputs, self.kind)
        other._one_by_one = True
        return other._compiled

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
        self, lead: tuple[int, ...], given: list[Array], tables: Mapping[int, Array]
    ) -> tuple[Array, ...]:
        columns = [x[..., i] for x in given for i in range(x.shape[-1])]
        run = plain(self._trace(0), tables)
        made = [np.broadcast_to(np.asarray(x, self._dtype), lead) for x in run(columns)]
        bounds = pairwise(accumulate(map(_count, self.outputs), initial=0))
        return tuple(
            np.stack(made[a:b], axis=-1).reshape((*lead, *_tail(n)))
            for n, (a, b) in zip(self.outputs, bounds, strict=True)
        )

    def _code(self, lanes: int) -> Code:
        """``rows(table, first, last)``: rows [first, last) of the arrays that a table describes.

        The table holds the number of rows and that of the last leading axis; address and strides
        along both leading axes of each input; the address of each output, and of each resource.
        """
        code, (first, last), entries = self._begun()
        total, inner = entries.number(), entries.number()
        arrays = self._arrays(entries)
        if self._one_by_one:
            self._single_rows(code, (first, last), inner, arrays)
            code.give(0)
            return code
        sources, targets, resources = arrays
        real, block = REALS[self.kind], _VECTORS * lanes
        size, flat = sum(map(_count, self.inputs.values())), self.traced.flat
        taken = code.room(real, block * max(1, size))
        made = code.room(real, block * max(1, len(flat.results)))
        emit = Emitter(code, lanes, machine.processor().fuses, resources)
        outer_at, inner_at = code.variable(0), code.variable(0)
        with code.loop(first, last, block) as base:
            count = (last - base).at_most(block)
            code.set(outer_at, base // inner)
            code.set(inner_at, base % inner)
            with code.loop(0, (count + (lanes - 1)) // lanes * lanes) as j:
                s, b, column = code.get(outer_at), code.get(inner_at), 0
                for pointer, outer_stride, inner_stride, n in sources:
                    row = code.place(pointer, s * outer_stride + b * inner_stride)
                    copy(code, n, row, 0, 1, taken, j + column, block)
                    column += n * block
                with code.when(base + j + 1 < total):
                    wraps = (b + 1).equals(inner)
                    code.set(outer_at, chosen(code, wraps, s + 1, s))
                    code.set(inner_at, chosen(code, wraps, 0, b + 1))
            with code.loop(0, count, lanes) as j:
                at = {("x", k): j + k * block for k in range(size)}
                for k, value in enumerate(emit.wide(flat, columns(code, taken, at, lanes))):
                    code.store_vector(made, j + k * block, value)
            with code.loop(0, count) as j:
                column = 0
                for pointer, n in targets:
                    row = code.place(pointer, (base + j) * n)
                    copy(code, n, made, j + column, block, row, 0, 1)
                    column += n * block
        code.give(0)
        return code

    def _single_rows(self, code: Code, bounds: tuple[Int, Int], inner: Int, arrays: Any) -> None:
        sources, targets, resources = arrays
        with code.loop(*bounds) as i:
            s, b = i // inner, i % inner
            given: list[Any] = []
            for pointer, outer_stride, inner_stride, n in sources:
                row = code.place(pointer, s * outer_stride + b * inner_stride)
                given += [code.load(row, k) for k in range(n)]
            made = iter(write(code, self.traced, given, resources))
            for pointer, n in targets:
                for k in range(n):
                    code.store(pointer, i * n + k, next(made))

    def _arrays(self, entries: Table) -> tuple[list[Any], list[Any], dict[Any, Any]]:
        """What the table says: (pointer, strides, width) of inputs, of outputs; resources."""
        real = REALS[self.kind]
        sources = [
            (entries.pointer(real), entries.number(), entries.number(), _count(n))
            for n in self.inputs.values()
        ]
        targets = [(entries.pointer(real), _count(n)) for n in self.outputs]
        return sources, targets, entries.resources(self.traced.resources)


def _count(width: Width) -> int:
    return 1 if width is None else width


def _strides(x: Array) -> tuple[int, int]:
    """From row to row in numbers, along the last two leading axes; 0 along one of length 1."""
    lengths, strides = (1, 1, *x.shape[:-1]), (0, 0, *x.strides[:-1])
    outer, inner = (0 if lengths[axis] == 1 else strides[axis] // x.itemsize for axis in (-2, -1))
    return outer, inner


def _tail(width: Width) -> tuple[int, ...]:
    return () if width is None else (width,)


_KNOWN: dict[Hashable, Rows] = {}


def rows(
    function: Callable[..., Any],
    inputs: Mapping[str, Width],
    outputs: Sequence[Width],
    kind: str = "double",
    key: Hashable = None,
) -> Rows:
    """The ``Rows`` of a function, made once a process for a layout and a precision.

    ``key`` stands for the function where that is made anew at each call; it says all that the
    function's operations depend on.
    """
    layout = function if key is None else key, tuple(inputs.items()), tuple(outputs), kind
    found = _KNOWN.get(layout)
    return found or _KNOWN.setdefault(layout, Rows(function, inputs, outputs, kind))


def kind_of(dtype: Any) -> str:
    """Precision in which arrays of a type are worked on."""
    return "single" if np.dtype(dtype) == np.float32 else "double"


def lanes_of(kind: str) -> int:
    """Numbers in one of the processor's vectors."""
    return machine.processor().vector // DTYPES[kind].itemsize


def without_compiler() -> bool:
    """Whether ``NUMBA_DISABLE_JIT`` asks for plain Python."""
    return bool(config.DISABLE_JIT)


def in_pieces(n: int, n_threads: int, call: Callable[[int, int], Any], least: int) -> None:
    """``call(first, last)`` over n rows, in pieces of at least ``least`` on each thread."""
    pieces = max(min(_PIECES * n_threads if n_threads > 1 else 1, n // least), -(-n // _PIECE))
    if pieces < 2:
        call(0, n)
        return
    bounds = [n * i // pieces for i in range(pieces + 1)]
    each_in_threads([partial(call, *ends) for ends in pairwise(bounds)], n_threads)


def address_of(x: Array) -> int:
    """Where an array's first number lies."""
    try:  # a quarter of the time of the other
        return ctypes.addressof(_BYTE.from_buffer(cast(Any, x)))
    except (TypeError, ValueError, BufferError):  # read-only, empty, or with gaps
        return int(x.__array_interface__["data"][0])


def addresses(resources: Sequence[tuple[str, Any]], tables: Mapping[int, Array]) -> list[int]:
    """Where they lie, of tables in double precision."""
    return [address_of(tables[x]) if kind == "table" else x.address for kind, x in resources]


class Table:
    """Reads the numbers and addresses that a program is given, one after the other."""

    def __init__(self, code: Code, pointer: Any) -> None:
        self._code, self._pointer, self.taken = code, pointer, 0

    def number(self) -> Int:
        """A whole number."""
        self.taken += 1
        return Int(self._code, self._code.load(self._pointer, self.taken - 1))

    def pointer(self, kind: Any) -> Any:
        """An address of numbers."""
        return self._code.b.inttoptr(self.number().value, kind.as_pointer())

    def resources(self, keys: Sequence[tuple[str, Any]]) -> dict[tuple[str, Any], Any]:
        """Addresses of tables (of doubles) and of opaque functions."""
        return {key: self._code.b.inttoptr(self.number().value, POINTERS[key[0]]) for key in keys}


def chosen(code: Code, test: Any, a: Any, b: Any) -> Int:
    """One of two whole numbers."""
    return Int(code, code.b.select(test, code.raw(a), code.raw(b)))


def copy(
    code: Code, n: int, source: Any, first: Any, step: int, target: Any, to: Any, stride: int
) -> None:
    """target[to + k stride] = source[first + k step], k < n."""
    if n <= _UNROLLED:
        for k in range(n):
            value = code.load(source, code.whole(first) + k * step)
            code.store(target, code.whole(to) + k * stride, value)
        return
    with code.loop(0, n) as i:
        value = code.load(source, code.whole(first) + i * step)
        code.store(target, code.whole(to) + i * stride, value)


def columns(
    code: Code, memory: Any, at: Mapping[tuple[Any, ...], Any], lanes: int
) -> Callable[[tuple[Any, ...], str], tuple[Any, bool]]:
    """For an ``Emitter``: the inputs as vectors, from where in memory they lie."""
    return lambda name, kind: (code.vector(memory, at[name], lanes), True)
