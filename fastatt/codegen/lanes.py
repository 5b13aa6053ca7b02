"""Formulas over rows of lanes: one generated function, called by the hand-written loops.

The memory is an array of rows, each of a block of lanes. A formula takes the lanes of some rows and
stores its results in the same lanes of others.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from numba import types

from fastatt.codegen.emitter import Emitter
from fastatt.codegen.instructions import Code
from fastatt.codegen.memory import DTYPES, LINE
from fastatt.codegen.modules import Emission, generated
from fastatt.codegen.processor import processor
from fastatt.codegen.writing import pointers_of, spelled, write
from fastatt.tracing.finished import Flat
from fastatt.tracing.traced import Traced

_WHOLE = types.CPointer(types.int64)
_PART = "    if part == {part}:\n        {loop}"
_LOOP = "for j in range(0, count, {lanes}): {name}(rows, whole, j)"
# without a loop no constants are loaded before it, more than there are registers
_ONCE = "{name}(rows, whole, 0)"

Name = tuple[Any, ...]


class LaneFormula(NamedTuple):
    """A formula: its graph, the rows of its inputs by their names, and those of its results.

    A ``Traced`` formula works on single lanes. To the row ``finite``, if there is one, each result
    times zero is added: it stays zero while all of them are finite.
    """

    graph: Flat | Traced
    inputs: Mapping[Name, int]
    results: Sequence[int]
    finite: int | None = None


class Shape(NamedTuple):
    """Precision of the rows, lanes in a row, and those that operations work on at a time."""

    kind: str
    block: int
    lanes: int


def lane_function(
    shape: Shape,
    formulas: Sequence[LaneFormula],
    resources: Sequence[tuple[str, Any]] = (),
    text: str = "",
) -> Any:
    """Numba's ``CFunc`` of ``run(part, rows, whole, count)``: a formula by its number, its lanes.

    ``whole`` holds the addresses of ``resources``. ``text`` replaces the usual function, which
    calls ``formula0``, ``formula1``, ... as (rows, whole, first lane).
    """
    real = types.float64 if shape.kind == "double" else types.float32
    pointers = types.CPointer(real), _WHOLE
    names = [f"formula{i}" for i in range(len(formulas))]
    loop = _LOOP if shape.block > shape.lanes else _ONCE
    calls = [loop.format(lanes=shape.lanes, name=name) for name in names]
    parts = [_PART.format(part=i, loop=call) for i, call in enumerate(calls)]
    key = [repr((tuple(shape), [key[0] for key in resources]))]
    for x in formulas:
        key += [spelled(x.graph, resources), repr((sorted(x.inputs.items()), x.results, x.finite))]
    emissions: dict[str, Emission] = {
        name: ((*pointers, types.int64), _Writer(shape, formula, resources))
        for name, formula in zip(names, formulas, strict=True)
    }
    text = text or "\n".join(["def run(part, rows, whole, count):", *parts, ""])
    return generated(text, (types.int64, *pointers, types.int64), emissions, "\0".join(key))


class _Writer:
    """Writes a formula where a call of it stands."""

    def __init__(
        self, shape: Shape, formula: LaneFormula, resources: Sequence[tuple[str, Any]]
    ) -> None:
        self.shape, self.formula, self.resources = shape, formula, resources

    def __call__(self, code: Code, args: Sequence[Any]) -> None:
        (rows, whole, lane), formula, shape = args, self.formula, self.shape
        pointers = pointers_of(code, whole, self.resources)

        def at(row: int) -> Any:
            return code.b.add(lane, lane.type(row * shape.block))

        if isinstance(formula.graph, Traced):
            given = [code.load(rows, at(row)) for row in formula.inputs.values()]
            values = write(code, formula.graph, given, pointers)
        else:
            emit = Emitter(code, shape.lanes, processor().fuses, pointers)
            values = emit.wide(
                formula.graph,
                lambda name, kind: (
                    code.vector(rows, at(formula.inputs[name]), shape.lanes),
                    True,
                ),
            )
        for row, value in zip(formula.results, values, strict=True):
            code.store_vector(rows, at(row), value)
        if formula.finite is not None:
            zero = code.splat(code.real(shape.kind, 0.0), shape.lanes)
            total = code.vector(rows, at(formula.finite), shape.lanes)
            for value in values:
                total = code.of("fadd", total, code.of("fmul", value, zero))
            code.store_vector(rows, at(formula.finite), total)


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
