"""Formulas over rows of lanes, of which every generated function consists.

The memory is arrays of rows, each of which holds one number for every lane of a block. The text of
a function is a few lines of Python, which call formulas by name with all arrays and an offset into
each of them. A formula takes some lanes of some rows, and stores its results in the same lanes of
others, as vector instructions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from functools import partial
from typing import Any, Literal, NamedTuple

from numba import types

from fastatt.codegen.call import TYPES
from fastatt.codegen.emitter import Emitter, pointers_of, raised
from fastatt.codegen.instructions import REALS, Code
from fastatt.codegen.modules import Emission, MachineCode, generated
from fastatt.tracing.finished import Flat

_WHOLE = types.CPointer(types.int64)

Name = tuple[Any, ...]
Resources = Sequence[tuple[str, Any]]


class Place(NamedTuple):
    """The place of a number: ``row`` of an array, or its index in one that all lanes share.

    ``shared`` numbers do not change during a call of the function, ``computed`` ones do; the
    array's offset is added to the index of ``indexed`` ones.
    """

    row: int
    array: str = "rows"
    of: Literal["lanes", "shared", "indexed", "computed"] = "lanes"


class StepTimes(NamedTuple):
    """The times of a formula: a graph of the number of steps, ("n",), and names of its results.

    The number of steps is the last argument of a formula with a clock.
    """

    flat: Flat
    names: Sequence[Name]


class LaneFormula(NamedTuple):
    """A formula: its graph, the places of its inputs by name, and those of its results.

    It works on as many lanes of the rows as the function's shape says, or on ``lanes``; one with
    ``directions``, for which it uses the lanes of vectors, on single ones. A result
    from the number ``largest`` on replaces the previous value if it is larger.
    """

    graph: Flat
    inputs: Mapping[Name, Place]
    results: Sequence[Place]
    largest: int | None = None
    lanes: int = 0
    directions: int = 1
    clock: StepTimes | None = None


class Shape(NamedTuple):
    """Precision of the rows, lanes in a row, and lanes on which operations work at a time."""

    precision: str
    block: int
    lanes: int


class LaneProgram(NamedTuple):
    """The function ``run(part, *arrays, whole, *numbers)`` of a text around calls of formulas.

    ``arrays`` are the precisions of the arrays by name, and ``numbers`` is the number of integers
    that come last. ``whole`` begins with the addresses of ``resources``; it is absent if these are
    None. Formulas are called as ``name(*arrays, whole, *offsets)``.
    """

    text: str
    formulas: Mapping[str, LaneFormula]
    shape: Shape
    arrays: Mapping[str, str]
    resources: Resources | None = None
    numbers: int = 2

    def compiled(self) -> MachineCode:
        """The machine code, compiled or loaded from disk."""
        arrays = [types.CPointer(TYPES[precision]) for precision in self.arrays.values()]
        memory = arrays if self.resources is None else [*arrays, _WHOLE]
        keys = self.resources or ()
        key = [repr((tuple(self.shape), dict(self.arrays), [key[0] for key in keys]))]
        emissions: dict[str, Emission] = {}
        for name, x in self.formulas.items():
            places = sorted(x.inputs.items()), x.results, x.largest, x.lanes, x.directions
            clock = x.clock and (x.clock.flat.spelled(()), x.clock.names)
            key += [x.graph.spelled(keys), repr((places, clock))]
            whole = [types.int64] * (len(arrays) + (x.clock is not None))
            emissions[name] = (*memory, *whole), partial(_emit, self, x)
        arguments = types.int64, *memory, *[types.int64] * self.numbers
        return generated(self.text, arguments, emissions, "\0".join(key))


def _emit(program: LaneProgram, formula: LaneFormula, code: Code, args: Sequence[Any]) -> None:
    """Write a formula in place of a call of it."""
    block, lanes = program.shape.block, formula.lanes or program.shape.lanes
    n = len(program.arrays)
    begin = n + (program.resources is not None)
    arrays = dict(zip(program.arrays, args, strict=False))
    offsets = dict(zip(program.arrays, args[begin:], strict=False))
    whole = args[n] if begin > n else None
    pointers = pointers_of(code, whole, program.resources or ())
    times: dict[Name, tuple[Any, bool]] = {}

    def place(x: Place) -> tuple[Any, Any]:
        offset = offsets[x.array]
        first = x.row if x.of == "indexed" else x.row * block
        return arrays[x.array], code.b.add(offset, offset.type(first))

    def row(x: Place) -> Any:
        return code.vector(program.arrays[x.array], *place(x), lanes)

    def find(name: Name, precision: str) -> tuple[Any, bool]:
        if name in times:
            return times[name]
        x = formula.inputs[name]
        if x.of == "lanes":
            return code.cast(precision, row(x)), lanes > 1
        if x.of == "computed":
            return code.load(arrays[x.array], x.row), False
        of_all = (arrays[x.array], x.row) if x.of == "shared" else place(x)
        return code.constant_load(*of_all), False

    emit = Emitter(code, max(lanes, formula.directions), pointers)
    if formula.clock is not None:
        times["n",] = code.b.sitofp(args[-1], REALS["double"]), False
        times |= zip(formula.clock.names, emit(formula.clock.flat, find), strict=True)
    values = emit(formula.graph, find)
    for i, (x, (value, has_lanes)) in enumerate(zip(formula.results, values, strict=True)):
        stored = code.cast(program.arrays[x.array], value)
        stored = stored if has_lanes else code.splat(stored, lanes)
        if formula.largest is not None and i >= formula.largest:
            stored = raised(code, row(x), stored)
        code.store_vector(*place(x), stored)


class Part(IntEnum):
    """What a function of rows computes."""

    EACH = 0  #: its results
    CONSTANTS = 1  #: the numbers that they have in common


def lane_function(
    shape: Shape, formula: LaneFormula, resources: Resources = (),
    constants: LaneFormula | None = None,
) -> MachineCode:  # fmt: skip
    """Machine code of ``run(part, rows, whole, count)``: a formula in so many lanes.

    ``constants`` are numbers that it reads, computed by another one.
    """
    loop = f"for j in range(0, count, {shape.lanes}): "
    lines, formulas = ["def run(part, rows, whole, count):"], {"formula": formula}
    if constants is not None:
        formulas["constants"] = constants
        lines += [f"    if part == {Part.CONSTANTS}:"]
        lines += [f"        {loop}constants(rows, whole, j)", "        return"]
    text = "\n".join([*lines, f"    {loop}formula(rows, whole, j)", ""])
    return LaneProgram(
        text, formulas, shape, {"rows": shape.precision}, resources, numbers=1
    ).compiled()
