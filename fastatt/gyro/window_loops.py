"""The windows of a method as a generated function over the lanes of a chunk.

``run(action, samples, spans, attitudes, state, lanes, first, last)`` works on arrays of rows with a
number for each lane, in the first ``lanes`` of them. ``action`` selects what is done:

- ``windows``: the windows [first, last), one after the other, from the attitudes in rows 0 to 3.
- ``place``: attitudes [first, last) become p∘r, with p in the first rows of ``state``.
"""

from __future__ import annotations

import functools
import math
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
_TEXT = """
def run(action, samples, spans, attitudes, state, lanes, first, last):
    if action == {WINDOWS}:
        for j in range(0, lanes, {vector}):
            for n in range(first, last):
                {windows}
    if action == {PLACE}:
        for i in range(first, last):
            for j in range(0, lanes, {vector}): place({arrays}, j, j, i * {row} + j, j)
"""
# passes as long as a lane changes, according to a row of the state
_PASSES = """
                begin({offsets})
                moves, left = True, {passes}
                while moves and left > 0:
                    improve({offsets})
                    moves, left = False, left - 1
                    for k in range({moving} + j, {moving} + {vector} + j):
                        moves = moves or state[k] > 0.0
                read({offsets})
"""


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
            lanes=self._vector,
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
        place = self._formula(graph, products(p, q), "attitudes", 0)
        formulas = {"place": place, **self._windows(small_angle)}
        shape = Shape(self.precision, LANES, self._vector)
        arrays = dict.fromkeys(_ARRAYS, self.precision)
        return LaneProgram(self._text(), formulas, shape, arrays, numbers=3).compiled()

    def _text(self) -> str:
        arrays, iteration = ", ".join(_ARRAYS), self.window.iteration
        span = self.window.span * LANES
        offsets = f"{arrays}, n * {3 * span} + j, n * {span} + j, n * {4 * span} + j, j"
        windows = f"window({offsets})"
        if iteration:
            moving = (self._state - 1) * LANES
            windows = _PASSES.format(
                offsets=offsets, passes=iteration.passes, moving=moving, vector=self._vector
            ).strip()
        return _TEXT.format(
            WINDOWS=WINDOWS, PLACE=PLACE, vector=self._vector, windows=windows,
            arrays=arrays, row=4 * LANES,
        )  # fmt: skip

    # the formulas

    def _formula(self, graph: Graph, results: Any, array: str, first: int) -> LaneFormula:
        """A formula; its results go to the rows from the first on."""
        begin = {
            "v": ("samples", 0), "h": ("spans", 0), "q": ("attitudes", 0),
            "p": ("state", 0), "state": ("state", ITERATION),
        }  # fmt: skip

        def place(group: str, i: int) -> Place:
            array, row = begin[group]
            shared = group == "h" and not self.uneven
            return Place(row + i, array, "shared" if shared else "lanes")

        flat = Flat(graph, results, self.precision)
        inputs = {name: place(*name) for name in flat.inputs()}
        return LaneFormula(flat, inputs, [Place(first + i, array) for i in range(len(results))])

    def _windows(self, small_angle: bool) -> dict[str, LaneFormula]:
        """The attitudes of a window, the last of which is the first of the next window."""
        if self.window.iteration is not None:
            return self._iterated(self.window.iteration)
        graph = Graph()
        vectors = traceable(self.window.formula(self.increments))(*self._inputs(graph))
        exp = traceable(quat.exp_short if small_angle else quat.exp)
        turned = [x for i in range(0, len(vectors), 3) for x in exp(vectors[i : i + 3])]
        attitudes = products(graph.inputs(self.precision, "q", 4), turned)
        return {"window": self._formula(graph, attitudes, "attitudes", 4)}

    def _iterated(self, iteration: Iteration) -> dict[str, LaneFormula]:
        begin, again, end = Graph(), Graph(), Graph()
        state = iteration.begin(self.increments, *self._inputs(begin))
        size = len(state)
        self._state = ITERATION + size
        after = iteration.again(again.inputs(self.precision, "state", size))
        turns = iteration.read(end.inputs(self.precision, "state", size)[:-1])
        attitudes = products(end.inputs(self.precision, "q", 4), turns)
        return {
            "begin": self._formula(begin, state, "state", ITERATION),
            "improve": self._formula(again, after, "state", ITERATION),
            "read": self._formula(end, attitudes, "attitudes", 4),
        }

    def _inputs(self, graph: Graph) -> tuple[Any, Any]:
        """Samples and intervals of a window."""
        v = graph.inputs(self.precision, "v", 3 * self.window.samples(self.increments))
        n, equal = self.window.intervals, not self.uneven
        h = graph.inputs(self.precision, "h", 1 if equal else n)
        return v, h * n if equal else h


#: the program of a window, made once in a process
program = functools.cache(GyroProgram)
