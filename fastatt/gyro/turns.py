"""A method's windows in LLVM's language: its formulas, traced, across the lanes of a chunk."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir

from fastatt.flat.code import I64, REALS, Cells, Code, Int
from fastatt.flat.finished import Flat
from fastatt.flat.graph import Graph
from fastatt.flat.llvm import Emitter
from fastatt.flat.machine import processor
from fastatt.flat.rows import lanes_of
from fastatt.flat.trace import traceable
from fastatt.gyro.windows import LANES, Iteration, Window
from fastatt.kernels import quat

Numbers = Sequence[Any]


def products(q: Numbers, d: Numbers) -> list[Any]:
    """q∘d of each of the flat quaternions d, flat."""
    mul = traceable(quat.mul)
    return [x for i in range(0, len(d), 4) for x in mul(q, d[i : i + 4])]


def exponentials(u: Numbers, wide: bool) -> list[Any]:
    """Flat quaternions of flat rotation vectors; of at most π, or ``wide`` of any angle."""
    exp = traceable(quat.exp if wide else quat.exp_short)
    return [x for i in range(0, len(u), 3) for x in exp(u[i : i + 3])]


class WindowsLoop:
    """``windows(samples, intervals, attitudes, n, width)``: n windows of rows that hold all lanes.

    The attitudes' first row is that at the start. ``intervals`` are rows too, or one number. Only
    the lanes' first ``width`` are looked at, a vector at a time.
    """

    def __init__(
        self, window: Window, increments: bool, kind: str, uneven: bool, wide: bool
    ) -> None:
        self.window, self.increments, self.kind = window, increments, kind
        self.uneven, self.wide = uneven, wide
        self.lanes = lanes_of(kind)
        self.vector = ir.VectorType(REALS[kind], self.lanes)
        self.module = ir.Module("windows")
        reals = REALS[kind].as_pointer()
        c = self.code = Code(self.module, "windows", [reals, reals, reals, I64, I64])
        self.emitter = Emitter(c, self.lanes, processor().fuses)
        self.samples, self.intervals, self.attitudes, n, width = c.function.args
        for pointer in c.function.args[:3]:
            pointer.add_attribute("noalias")
        self.interval = None if uneven else c.load(self.intervals, 0)
        self.q = self.state = Cells(c, [self.vector] * 4)
        iteration = window.iteration
        one = self._iterated(iteration) if iteration else self._by_formula()
        with c.loop(0, Int(c, width), self.lanes) as j:
            self.q.set(c.vector(self.attitudes, j + i * LANES, self.lanes) for i in range(4))
            with c.loop(0, Int(c, n)) as k:
                one(j, k)
        c.give(0)

    def _given(self, graph: Graph) -> tuple[Numbers, Numbers]:
        """Samples and intervals of a window."""
        v = graph.inputs(self.kind, "v", 3 * self.window.samples(self.increments))
        n = self.window.intervals
        h = graph.inputs(self.kind, "h", n) if self.uneven else graph.inputs(self.kind, "h", 1) * n
        return v, h

    def _by_formula(self) -> Callable[[Int, Int], None]:
        graph = Graph()
        v, h = self._given(graph)
        turns = traceable(self.window.formula(self.increments))(v, h)
        q = graph.inputs(self.kind, "q", 4)
        flat = Flat(graph, products(q, exponentials(turns, self.wide)), self.kind)
        # what equal intervals alone give is the same for all windows
        before = None if self.uneven else self.emitter.shared(flat, {"h": {0: self.interval}})
        return lambda j, k: self._write(flat, j, k, before)

    def _iterated(self, iteration: Iteration) -> Callable[[Int, Int], None]:
        begin = Graph()
        state = iteration.begin(self.increments, *self._given(begin))
        first = Flat(begin, state, self.kind)
        cells = self.state = Cells(self.code, [self.vector] * len(state))

        again = Graph()
        before = again.inputs(self.kind, "state", len(state))
        after = iteration.again(before)
        changed = [i for i in range(len(state)) if after[i] is not before[i]]
        improve = Flat(again, [after[i] for i in changed], self.kind)

        end = Graph()
        found = iteration.read(end.inputs(self.kind, "state", len(state))[:-1])
        read = Flat(end, products(end.inputs(self.kind, "q", 4), found), self.kind)

        def one(j: Int, k: Int) -> None:
            c, b = self.code, self.code.b
            cells.set(self._emit(first, j, k))
            left = c.variable(iteration.passes)
            bits = ir.IntType(self.lanes)

            def moves() -> Any:
                none = ir.Constant(self.vector, [0.0] * self.lanes)
                moving = b.bitcast(b.fcmp_ordered(">", cells[-1], none), bits)
                any_lane = b.icmp_unsigned("!=", moving, ir.Constant(bits, 0))
                return b.and_(any_lane, c.get(left) > 0)

            with c.repeat_while(moves):
                for i, value in zip(changed, self._emit(improve, j, k), strict=True):
                    cells[i] = value
                c.set(left, c.get(left) - 1)
            self._write(read, j, k)

        return one

    def _write(self, flat: Flat, j: Int, k: Int, before: Any = None) -> None:
        """The attitudes of window k, the last of which is the next one's first."""
        c, span = self.code, self.window.span
        values = self._emit(flat, j, k, before)
        for i, value in enumerate(values):
            c.store_vector(self.attitudes, (k * (4 * span) + 4 + i) * LANES + j, value)
        self.q.set(values[-4:])

    def _emit(self, flat: Flat, j: Int, k: Int, before: Any = None) -> list[Any]:
        c, span = self.code, self.window.span

        def given(name: tuple[Any, ...], kind: str) -> tuple[Any, bool]:
            group, i = name
            if group == "v":
                row = k * (3 * span) + i
                return c.vector(self.samples, row * LANES + j, self.lanes), True
            if group == "h" and self.uneven:
                return c.vector(self.intervals, (k * span + i) * LANES + j, self.lanes), True
            if group == "h":
                return self.interval, False
            return (self.q if group == "q" else self.state)[i], True

        return self.emitter.wide(flat, given, before)
