"""The windows of a method as a generated function over the lanes of a chunk.

``run(action, samples, spans, attitudes, state, first, last)`` works on arrays of rows with a number
for each lane. ``action`` selects what is done:

- ``windows``: the windows [first, last), one after the other, from the attitudes in rows 0 to 3.
- ``place``: attitudes [first, last) become p∘r, with p in the first rows of ``state``.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from fastatt.codegen.lanes import LaneFormula, LaneProgram, Place, Shape
from fastatt.codegen.memory import DTYPES, aligned
from fastatt.codegen.modules import MachineCode, TwoForms
from fastatt.codegen.processor import processor
from fastatt.gyro.loops import ITERATION, LANES, PLACE, WINDOWS, Tile, WindowShape
from fastatt.kernels import quat
from fastatt.methods.windows import CHUNK, MOST_HISTORY, Iteration, Window, products
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Graph
from fastatt.tracing.trace import traceable

_ARRAYS = ("samples", "spans", "attitudes", "state")
_PRECISIONS = {dtype: precision for precision, dtype in DTYPES.items()}
_CALL = "{name}(samples, spans, attitudes, state, {offsets})"
_Formulas = dict[str, LaneFormula]


class GyroProgram(TwoForms):
    """The function of a method's window in its two forms.

    ``uneven`` intervals are rows, equal ones are one number.
    """

    def __init__(
        self, window: Window, increments: bool, dtype: np.dtype[Any], uneven: bool
    ) -> None:
        self.window, self.increments, self.uneven = window, increments, uneven
        self.dtype, self.precision = dtype, _PRECISIONS[dtype]
        self._vector = processor().lanes(self.precision)
        self._state = ITERATION
        self.shape = WindowShape(
            history=window.history,
            span=window.span,
            extra=not increments,
            is_uneven=uneven,
            near=0.0 if window.iteration else window.near,
        )
        # an iteration has the same form for all angles
        super().__init__(one_form=window.iteration is not None)

    def _new_memory(self) -> Tile:
        """Rows for samples, intervals, attitudes and state of a tile's lanes."""
        shapes = (
            (CHUNK + MOST_HISTORY + 1, 3), (CHUNK + MOST_HISTORY,), (CHUNK + 1, 4), (self._state,)
        )  # fmt: skip
        return Tile(*(aligned(math.prod(x) * LANES, self.dtype).reshape(*x, LANES) for x in shapes))

    def _compiled(self, *, small_angle: bool) -> MachineCode:
        graph = Graph()
        p, q = (graph.inputs(self.precision, name, 4) for name in "pq")
        placed = Flat(graph, products(p, q), self.precision)
        formulas = {
            "place": self._formula(placed, "attitudes", 0),
            **self._windows(small_angle),
        }
        text = "\n".join([*self._text(), ""])
        shape = Shape(self.precision, LANES, self._vector)
        lane_program = LaneProgram(text, formulas, shape, dict.fromkeys(_ARRAYS, self.precision))
        return lane_program.compiled()

    def _text(self) -> Iterator[str]:
        lanes = f"for j in range(0, {LANES}, {self._vector}):"
        yield "def run(action, samples, spans, attitudes, state, first, last):"
        yield f"    if action == {WINDOWS}:"
        yield f"        {lanes}"
        yield "            for n in range(first, last):"
        span = self.window.span * LANES
        at = f"n * {3 * span} + j, n * {span} + j, n * {4 * span} + j, j"
        if self.window.iteration is None:
            yield f"                {_CALL.format(name='window', offsets=at)}"
        else:
            yield from _passes(self.window.iteration, at, self._state - 1, self._vector)
        yield f"    if action == {PLACE}:"
        yield "        for i in range(first, last):"
        place = _CALL.format(name="place", offsets=f"j, j, i * {4 * LANES} + j, j")
        yield f"            {lanes} {place}"

    # the formulas

    def _formula(self, flat: Flat, array: str, first: int) -> LaneFormula:
        """A formula; its results go to the rows from the first on."""
        begin = {
            "v": ("samples", 0), "h": ("spans", 0), "q": ("attitudes", 0),
            "p": ("state", 0), "state": ("state", ITERATION),
        }  # fmt: skip

        def place(group: str, i: int) -> Place:
            array, row = begin[group]
            shared = group == "h" and not self.uneven
            return Place(row + i, array, "shared" if shared else "lanes")

        inputs = {name: place(*name) for name in flat.inputs()}
        results = [Place(first + i, array) for i in range(len(flat.results))]
        return LaneFormula(flat, inputs, results)

    def _windows(self, small_angle: bool) -> _Formulas:
        """The attitudes of a window, the last of which is the first of the next window."""
        if self.window.iteration is not None:
            return self._iterated(self.window.iteration)
        graph = Graph()
        vectors = traceable(self.window.formula(self.increments))(*self._given(graph))
        exp = traceable(quat.exp_short if small_angle else quat.exp)
        turned = [x for i in range(0, len(vectors), 3) for x in exp(vectors[i : i + 3])]
        attitudes = products(graph.inputs(self.precision, "q", 4), turned)
        return {"window": self._formula(Flat(graph, attitudes, self.precision), "attitudes", 4)}

    def _iterated(self, iteration: Iteration) -> _Formulas:
        begin, again, end = Graph(), Graph(), Graph()
        state = iteration.begin(self.increments, *self._given(begin))
        size = len(state)
        self._state = ITERATION + size
        after = iteration.again(again.inputs(self.precision, "state", size))
        turns = iteration.read(end.inputs(self.precision, "state", size)[:-1])
        read = products(end.inputs(self.precision, "q", 4), turns)
        return {
            "begin": self._formula(Flat(begin, state, self.precision), "state", ITERATION),
            "improve": self._formula(Flat(again, after, self.precision), "state", ITERATION),
            "read": self._formula(Flat(end, read, self.precision), "attitudes", 4),
        }

    def _given(self, graph: Graph) -> tuple[Any, Any]:
        """Samples and intervals of a window."""
        v = graph.inputs(self.precision, "v", 3 * self.window.samples(self.increments))
        n = self.window.intervals
        h = (
            graph.inputs(self.precision, "h", n)
            if self.uneven
            else graph.inputs(self.precision, "h", 1) * n
        )
        return v, h


def _passes(iteration: Iteration, at: str, row: int, lanes: int) -> Iterator[str]:
    """Passes as long as a lane changes, according to a row of the state."""
    begin, improve, read = (
        _CALL.format(name=name, offsets=at) for name in ("begin", "improve", "read")
    )
    depth = " " * 16
    yield f"{depth}{begin}"
    yield f"{depth}moves, left = True, {iteration.passes}"
    yield f"{depth}while moves and left > 0:"
    yield f"{depth}    {improve}"
    yield f"{depth}    moves, left = False, left - 1"
    yield f"{depth}    for k in range({row * LANES} + j, {row * LANES + lanes} + j):"
    yield f"{depth}        moves = moves or state[k] > 0.0"
    yield f"{depth}{read}"


#: the program of a window, made once in a process
program = functools.cache(GyroProgram)
