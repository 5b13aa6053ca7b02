"""Formulas over rows of lanes: what every generated function is made of.

The memory is arrays of rows, each of which holds a number of every lane of a block. A function's
text is a few lines of Python, which call formulas by their names with all arrays and an offset into
each of them. A formula takes some lanes of some rows, and stores its results in the same lanes of
others: as vector instructions, or under ``NUMBA_DISABLE_JIT=1`` with NumPy.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from numba import types

from fastatt.codegen.call import TYPES
from fastatt.codegen.emitter import Emitter, pointers_of, raised, write
from fastatt.codegen.instructions import REALS, Code
from fastatt.codegen.lines import write_lines
from fastatt.codegen.memory import DTYPES, LINE
from fastatt.codegen.modules import generated
from fastatt.tracing import source
from fastatt.tracing.finished import Flat
from fastatt.tracing.traced import Traced

_WHOLE = types.CPointer(types.int64)

Name = tuple[Any, ...]
Resources = Sequence[tuple[str, Any]]


class Place(NamedTuple):
    """Where a number lies: ``row`` of an array, or of one for all lanes its place there.

    ``shared`` numbers do not change while the function runs, ``computed`` ones do; of ``indexed``
    ones the array's offset counts.
    """

    row: int
    array: int = 0
    of: Literal["lanes", "shared", "indexed", "computed"] = "lanes"


class StepTimes(NamedTuple):
    """The times of a formula: a graph of the number of steps, ("n",), and names of its results.

    The steps are the last argument of a formula that has a clock.
    """

    flat: Flat
    names: Sequence[Name]


class LaneFormula(NamedTuple):
    """A formula: its graph, the places of its inputs by their names, and those of its results.

    A ``Traced`` formula works on single lanes, another on as many as the function's shape says, or
    on ``lanes``. The result number ``largest`` is kept where it is larger than what was there. To
    the row ``finite``, if there is one, each result times zero is added: it stays zero while all of
    them are finite.
    """

    graph: Flat | Traced
    inputs: Mapping[Name, Place]
    results: Sequence[Place]
    finite: Place | None = None
    largest: int | None = None
    lanes: int = 0
    clock: StepTimes | None = None


class Shape(NamedTuple):
    """Precision of the rows, lanes in a row, and those that operations work on at a time."""

    kind: str
    block: int
    lanes: int


class LaneProgram(NamedTuple):
    """The function ``run(part, *arrays, whole, *numbers)`` of a text around calls of formulas.

    ``arrays`` are the precisions of arrays, ``numbers`` how many whole numbers come last. ``whole``
    holds the addresses of ``resources`` first; it is there unless these are None. Formulas are
    called as ``name(*arrays, whole, *offsets)``.
    """

    text: str
    formulas: Mapping[str, LaneFormula]
    shape: Shape
    arrays: Sequence[str]
    resources: Resources | None = None
    numbers: int = 2

    def compiled(self) -> Any:
        """Numba's ``CFunc``, compiled or loaded from disk."""
        memory = [types.CPointer(TYPES[kind]) for kind in self.arrays]
        keys = self.resources or ()
        key = [self.text, repr((tuple(self.shape), self.arrays, [key[0] for key in keys]))]
        for x in self.formulas.values():
            places = sorted(x.inputs.items()), *x[2:6]
            clock = x.clock and (x.clock.flat.spelled(()), x.clock.names)
            key += [x.graph.spelled(keys), repr((places, clock))]
        memory += [] if self.resources is None else [_WHOLE]
        arguments = types.int64, *memory, *[types.int64] * self.numbers
        names = ", ".join(f"a{i}" for i in range(len(arguments)))
        text = f"def run({names}):\n    lines({names})\n"
        return generated(text, arguments, {"lines": (arguments, self._write)}, "\0".join(key))

    def _write(self, code: Code, args: Sequence[Any]) -> None:
        """Write the text with its formulas."""
        calls = {name: partial(_emit, self, x, code) for name, x in self.formulas.items()}
        write_lines(code, self.text, args, calls)

    def in_python(self) -> Callable[..., None]:
        """The function on NumPy's arrays, ``whole`` a list of the resources; nothing is fused."""
        scope: dict[str, Any] = {name: _apply(self, x) for name, x in self.formulas.items()}
        exec(self.text, scope)
        found: Callable[..., None] = scope["run"]
        return found

    def split(self, args: Sequence[Any]) -> tuple[Sequence[Any], Any, Sequence[Any], Any]:
        """(arrays, whole, offsets, steps) of a formula's arguments; None for what is not there."""
        n = len(self.arrays)
        begin = n + (self.resources is not None)
        whole = args[n] if begin > n else None
        return args[:n], whole, args[begin : begin + n], args[-1]


def _emit(program: LaneProgram, formula: LaneFormula, code: Code, args: Sequence[Any]) -> None:
    """Write a formula where a call of it stands."""
    kind, block, lanes = program.shape
    lanes = formula.lanes or lanes
    arrays, whole, offsets, steps = program.split(args)
    pointers = pointers_of(code, whole, program.resources or ())
    times: dict[Name, tuple[Any, bool]] = {}

    def place(x: Place) -> tuple[Any, Any]:
        offset = offsets[x.array]
        at = x.row if x.of == "indexed" else x.row * block
        return arrays[x.array], code.b.add(offset, offset.type(at))

    def find(name: Name, _: str) -> tuple[Any, bool]:
        if name in times:
            return times[name]
        x = formula.inputs[name]
        if x.of == "lanes":
            return code.vector(*place(x), lanes), True
        if x.of == "computed":
            return code.load(arrays[x.array], x.row), False
        at = (arrays[x.array], x.row) if x.of == "shared" else place(x)
        return code.constant_load(*at), False

    if isinstance(formula.graph, Traced):
        given = [code.load(*place(x)) for x in formula.inputs.values()]
        values = write(code, formula.graph, given, pointers)
        values = [code.cast(kind, x) for x in values]
    else:
        emit = Emitter(code, lanes, pointers)
        if formula.clock is not None:
            times["n",] = code.b.sitofp(steps, REALS["double"]), False
            made = emit(formula.clock.flat, find)
            times |= zip(formula.clock.names, made, strict=True)
        values = emit.wide(formula.graph, find)
    for i, (x, value) in enumerate(zip(formula.results, values, strict=True)):
        kept = value
        if i == formula.largest:
            kept = raised(code, code.vector(*place(x), lanes), value)
        code.store_vector(*place(x), kept)
    if formula.finite is not None:
        zero = code.splat(code.real(kind, 0.0), lanes)
        total = code.vector(*place(formula.finite), lanes)
        for value in values:
            total = code.of("fadd", total, code.of("fmul", value, zero))
        code.store_vector(*place(formula.finite), total)


def _apply(program: LaneProgram, formula: LaneFormula) -> Callable[..., None]:
    """A formula as a Python function of arrays and offsets."""
    assert isinstance(formula.graph, Flat)
    flat, clock, block = formula.graph, formula.clock, program.shape.block
    lanes = formula.lanes or program.shape.lanes
    kinds = {node.args: DTYPES[node.kind] for node in flat.nodes if node.op == "in"}
    clock_of = None if clock is None else source.function(clock.flat)
    # a program serves every scene of a structure, each with its tables
    made: list[Any] = [None, None]

    def apply(*args: Any) -> None:
        arrays, whole, offsets, steps = program.split(args)
        if made[1] is None or made[0] is not whole:
            keys = enumerate(program.resources or ())
            tables = {key[1]: whole[i] for i, key in keys if key[0] == "table"}
            made[:] = whole, source.function(flat, tables=tables)

        def lanes_of(x: Place) -> Any:
            first = offsets[x.array] + x.row * block
            return arrays[x.array][first : first + lanes]

        def value(name: Name) -> Any:
            if name in times:
                return times[name]
            x = formula.inputs[name]
            if x.of == "lanes":
                return lanes_of(x)
            return arrays[x.array][x.row + (offsets[x.array] if x.of == "indexed" else 0)]

        times: dict[Name, Any] = {("n",): float(steps)}
        if clock is not None and clock_of is not None:
            found = clock_of(*map(value, clock.flat.inputs()))
            times |= zip(clock.names, found, strict=True)
        # copies, since results may go where inputs lie
        given = [np.array(value(name), kinds[name]) for name in flat.inputs()]
        results = zip(formula.results, made[1](*given), strict=True)
        for i, (x, result) in enumerate(results):
            to = lanes_of(x)
            to[:] = np.fmax(to, result) if i == formula.largest else result

    return apply


_PART = "    if part == {part}:\n        {loop}"
_LOOP = "for j in range(0, count, {lanes}): {name}(rows, whole, j)"
# without a loop no constants are loaded before it, more than there are registers
_ONCE = "{name}(rows, whole, 0)"


def lane_function(
    shape: Shape, formulas: Sequence[LaneFormula], resources: Resources = (), text: str = ""
) -> Any:
    """Numba's ``CFunc`` of ``run(part, rows, whole, count)``: a formula by its number, its lanes.

    ``text`` replaces the usual function, which calls ``formula0``, ``formula1``, ...
    """
    named = {f"formula{i}": formula for i, formula in enumerate(formulas)}
    loop = _LOOP if shape.block > shape.lanes else _ONCE
    calls = [loop.format(lanes=shape.lanes, name=name) for name in named]
    parts = [_PART.format(part=i, loop=call) for i, call in enumerate(calls)]
    text = text or "\n".join(["def run(part, rows, whole, count):", *parts, ""])
    return LaneProgram(text, named, shape, (shape.kind,), resources, numbers=1).compiled()


class Memory:
    """Memory for rows of lanes and, after them, for blocks of whole numbers."""

    def __init__(self, shape: Shape, rows: int, blocks: int) -> None:
        size = rows * shape.block * DTYPES[shape.kind].itemsize
        self._rows = size + -size % LINE
        self._bytes = ctypes.c_char * (self._rows + blocks * shape.block * 8 + LINE)

    def made(self) -> tuple[Any, int, int]:
        """Zeros for one thread: what holds them, the addresses of the rows and of the blocks."""
        held = self._bytes()
        first = ctypes.addressof(held)
        first += -first % LINE
        return held, first, first + self._rows
