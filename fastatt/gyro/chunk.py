"""What is done with a chunk of every lane's log, written in LLVM's language.

A chunk of each lane's samples is turned into rows, a method's windows run across the lanes, and the
attitudes are turned back: in and out memory is touched once and in order.
"""

from __future__ import annotations

import ctypes
from typing import Any

from llvmlite import ir

from fastatt.flat.code import I32, I64, REALS, Code, Int
from fastatt.flat.finished import Flat
from fastatt.flat.graph import Graph
from fastatt.flat.llvm import Emitter
from fastatt.flat.machine import processor
from fastatt.flat.trace import traceable
from fastatt.gyro.windows import CHUNK, LANES, MOST_HISTORY
from fastatt.kernels import quat


def _rounded(n: int) -> int:
    return -(-n // LANES) * LANES


# the scratch memory, in numbers: rows with a number a lane, and a column for each lane
_V_ROWS = _rounded(3 * (CHUNK + MOST_HISTORY + 1))
_H_ROWS = _rounded(CHUNK + MOST_HISTORY)
_Q_ROWS = _rounded(4 * CHUNK + 4)
_COLUMN = max(_V_ROWS, _H_ROWS, _Q_ROWS)
_SAMPLES = 0
_INTERVALS = _SAMPLES + _V_ROWS * LANES
ATTITUDES = _INTERVALS + _H_ROWS * LANES
_COLUMNS = ATTITUDES + _Q_ROWS * LANES
_PEAK = _COLUMNS + _COLUMN * LANES
_LONGEST = _PEAK + LANES
MOST = _LONGEST + LANES
STARTS = MOST + LANES
_WHOLE = STARTS + 4 * LANES
# and after them whole numbers
_POINTERS, LOGS, FIRSTS, _WHOLES = 0, LANES, 2 * LANES, 3 * LANES


def scratch_size(kind: str) -> int:
    """Bytes of the scratch memory that a call needs, at an address that is a multiple of 64."""
    return _WHOLE * (8 if kind == "double" else 4) + 8 * _WHOLES


class Job(ctypes.Structure):
    """What the loops work on; arrays by their addresses, C-contiguous."""

    _fields_ = (
        ("peak", ctypes.c_double),  # largest component of an angle over an interval, rad
        ("data", ctypes.c_int64),  # samples (N, n_samples, 3)
        ("n_samples", ctypes.c_int64),
        ("before", ctypes.c_int64),  # samples before each log (N, n_before, 3)
        ("n_before", ctypes.c_int64),
        ("after", ctypes.c_int64),  # and after it (N, n_after, 3)
        ("n_after", ctypes.c_int64),
        ("spans", ctypes.c_int64),  # the interval, s, or the intervals
        ("n_spans", ctypes.c_int64),  # how many, 0 of equal ones
        ("lead", ctypes.c_int64),  # and how many are known before them
        ("out", ctypes.c_int64),  # attitudes (N, n_out, 4)
        ("n_out", ctypes.c_int64),
        ("history", ctypes.c_int64),
        ("span", ctypes.c_int64),
        ("extra", ctypes.c_int64),  # samples more than intervals
        ("by_interval", ctypes.c_int64),  # samples are rates, over intervals of many lengths
        ("short", ctypes.c_int64),  # the windows' loop for turns of at most π
        ("wide", ctypes.c_int64),  # and for any; 0 where there is none yet
        ("first", ctypes.c_int64),  # first interval
        ("count", ctypes.c_int64),  # of side by side: how many,
        ("phase", ctypes.c_int64),  # and how many of the first one's chunk are done
        ("log", ctypes.c_int64),  # of one log: which,
        ("chunks", ctypes.c_int64),  # how many chunks,
        ("totals", ctypes.c_int64),  # and the turn of each (chunks, 4)
        ("near", ctypes.c_double),  # angle below which turns are at most π
        ("factor", ctypes.c_double),  # a sample's angle over an interval, of equal intervals
    )


_PLACES = {field[0]: i for i, field in enumerate(Job._fields_)}


def lanes_of(kind: str) -> int:
    """Numbers in one of the processor's vectors, at most ``LANES``."""
    return min(LANES, processor().vector // (8 if kind == "double" else 4))


class Chunk:
    """Writes the functions of one precision into a program."""

    def __init__(self, kind: str) -> None:
        self.kind, self.real = kind, REALS[kind]
        self.size = 8 if kind == "double" else 4
        self.lanes = lanes_of(kind)
        self.groups = range(0, LANES, self.lanes)
        self.vector = ir.VectorType(self.real, self.lanes)
        self.reals, self.wholes = self.real.as_pointer(), I64.as_pointer()
        self.module = ir.Module("samples")
        self.nontemporal = self.module.add_metadata([ir.Constant(I32, 1)])
        self.columns = self._columns()
        self.gather = self._gather()
        self.choose = self._choose()
        self.scatter = self._scatter()

    # short words

    def _part(self, name: str, arguments: list[Any]) -> tuple[Code, list[Any]]:
        """A function of its own, compiled once."""
        c = Code(self.module, name, arguments)
        c.function.linkage = "internal"
        c.function.attributes.add("noinline")
        return c, c.function.args

    def field(self, c: Code, job: Any, name: str) -> Int:
        """A whole number of the job."""
        return Int(c, c.load(job, _PLACES[name]))

    def _number(self, c: Code, job: Any, name: str) -> Any:
        at = c.b.bitcast(c.place(job, _PLACES[name]), REALS["double"].as_pointer())
        value = c.b.load(at)
        return value if self.kind == "double" else c.b.fptrunc(value, self.real)

    def raise_peak(self, c: Code, job: Any, value: Any) -> None:
        """Keep the larger of the job's peak and another."""
        double = REALS["double"]
        at = c.b.bitcast(c.place(job, _PLACES["peak"]), double.as_pointer())
        other = value if self.kind == "double" else c.b.fpext(value, double)
        c.b.store(larger(c, other, c.b.load(at)), at)

    def array(self, c: Code, job: Any, name: str, to: Any = None) -> Any:
        """An array of the job."""
        return c.b.inttoptr(c.raw(self.field(c, job, name)), to or self.reals)

    def whole(self, c: Code, work: Any, first: int) -> Any:
        """Whole numbers of the scratch memory."""
        return c.place(c.b.bitcast(c.place(work, _WHOLE), self.wholes), first)

    def _anywhere(self, c: Code, pointer: Any, n: int) -> Any:
        """The address of n numbers in a row."""
        return c.b.bitcast(pointer, ir.VectorType(self.real, n).as_pointer())

    def _formula(self, formula: Any, *groups: str) -> Flat:
        """A kernel of quaternions."""
        graph = Graph()
        return Flat(graph, formula(*(graph.inputs(self.kind, g, 4) for g in groups)), self.kind)

    def _apply(self, c: Code, lanes: int, flat: Flat, **given: Any) -> list[Any]:
        emitter = Emitter(c, lanes, processor().fuses)
        return emitter.wide(flat, lambda name, kind: (given[name[0]][name[1]], lanes > 1))

    def product(self, c: Code, lanes: int, p: Any, q: Any) -> list[Any]:
        """p∘q."""
        return self._apply(c, lanes, self._formula(traceable(quat.mul), "p", "q"), p=p, q=q)

    def unit(self, c: Code, lanes: int, q: Any) -> list[Any]:
        """Quaternion q at unit length, by a Newton step."""
        return self._apply(c, lanes, self._formula(traceable(quat.renormalise), "q"), q=q)

    def column(self, c: Code, pointer: Any, row: Any, j: Any) -> list[Any]:
        """A quaternion in one lane of rows."""
        return [c.load(pointer, (c.whole(row) + k) * LANES + j) for k in range(4)]

    def vectors(self, c: Code, pointer: Any, row: Any, j: Any) -> list[Any]:
        """A quaternion in the lanes from j on of rows."""
        return [c.vector(pointer, (c.whole(row) + k) * LANES + j, self.lanes) for k in range(4)]

    def put_vectors(self, c: Code, pointer: Any, row: Any, j: Any, q: list[Any]) -> None:
        """Change it."""
        for k in range(4):
            c.store_vector(pointer, (c.whole(row) + k) * LANES + j, q[k])

    def _transposed(self, c: Code, rows: list[Any]) -> list[Any]:
        """n vectors of n numbers: halves of them are exchanged, then quarters, …."""
        rows, n, step = list(rows), len(rows), 1
        while step < n:
            low = [i if i & step == 0 else n + i - step for i in range(n)]
            high = [i + step if i & step == 0 else n + i for i in range(n)]
            kind = ir.VectorType(I32, n)
            for i in range(n):
                if i & step == 0:
                    a, b = rows[i], rows[i + step]
                    rows[i] = c.b.shuffle_vector(a, b, ir.Constant(kind, low))
                    rows[i + step] = c.b.shuffle_vector(a, b, ir.Constant(kind, high))
            step *= 2
        return rows

    # the parts of a chunk

    def _columns(self) -> Any:
        """Columns into rows of the lanes: ``rows`` numbers from each lane's pointer on.

        ``most`` gets each lane's largest absolute value. The last block overlaps the one before
        it; a column shorter than a block has room for one.
        """
        c, (pointers, n, to, most) = self._part(
            "columns", [self.wholes, I64, self.reals, self.reals]
        )
        n, b, lanes = Int(c, n), c.b, self.lanes
        absolute = c.intrinsic("llvm.fabs", self.vector)
        peaks = {g: c.room(self.vector) for g in self.groups}
        for peak in peaks.values():
            b.store(ir.Constant(self.vector, [0.0] * lanes), peak)
        last = at_least(c, n - lanes, 0)
        with c.loop(0, (n + (lanes - 1)) // lanes) as block:
            i = (block * lanes).at_most(last)
            for g in self.groups:
                found = []
                for lane in range(g, g + lanes):
                    column = b.inttoptr(c.load(pointers, lane), self.reals)
                    at = self._anywhere(c, c.place(column, i), lanes)
                    found.append(b.load(at, align=self.size))
                    c.prefetch(c.place(column, i + n))
                peak = b.load(peaks[g])
                for k, row in enumerate(self._transposed(c, found)):
                    c.store_vector(to, (i + k) * LANES + g, row)
                    peak = larger(c, b.call(absolute, [row]), peak)
                b.store(peak, peaks[g])
        for g in self.groups:
            c.store_vector(most, g, b.load(peaks[g]))
        c.give(0)
        return c.function

    def _gather(self) -> Any:
        """A chunk of every lane's samples and intervals, from interval n of its stretch on."""
        c, (job, work, body, start, width, n, need) = self._part(
            "gather", [self.wholes, self.reals, self.wholes, self.wholes, I64, I64, I64]
        )
        b, need, width = c.b, Int(c, need), Int(c, width)
        field = {name: self.field(c, job, name) for name in _PLACES}
        data, before, after, spans = (
            self.array(c, job, name) for name in ("data", "before", "after", "spans")
        )
        pointers = self.whole(c, work, _POINTERS)
        m = need + field["extra"]
        with c.loop(0, LANES) as j:
            lane = j.at_most(width - 1)
            log = Int(c, c.load(body, lane))
            first = Int(c, c.load(start, lane)) + Int(c, n) - field["history"]
            own = c.place(data, log * field["n_samples"] * 3)
            column = c.place(work, _COLUMNS + j * _COLUMN)
            inside = _all(c, first >= 0, first + m <= field["n_samples"], m * 3 >= self.lanes)
            at = b.select(inside, c.place(own, first * 3), column)
            c.store(pointers, j, b.ptrtoint(at, I64))
            with c.when(b.not_(inside)):
                lead = at_least(c, c.whole(0) - first, 0).at_most(m)
                end = at_least(c, (field["n_samples"] - first).at_most(m), lead)
                edge = (log * field["n_before"] + field["n_before"] + first) * 3
                with c.loop(0, lead * 3) as i:
                    c.store(column, i, c.load(before, edge + i))
                self._copy(c, column, own, first * 3, (lead * 3, end * 3))
                with c.loop(end, m) as i:
                    k = (first + i - field["n_samples"]).at_most(field["n_after"] - 1)
                    for axis in range(3):
                        value = c.load(after, (log * field["n_after"] + k) * 3 + axis)
                        c.store(column, i * 3 + axis, value)
                self._fill(c, column, m * 3)
        to = c.place(work, _SAMPLES)
        b.call(self.columns, [pointers, c.raw(m * 3), to, c.place(work, _PEAK)])
        with c.when(field["n_spans"] > 0):
            known = c.whole(0) - field["lead"]
            with c.loop(0, LANES) as j:
                lane = j.at_most(width - 1)
                first = Int(c, c.load(start, lane)) + Int(c, n) - field["history"]
                column = c.place(work, _COLUMNS + j * _COLUMN)
                end = field["n_spans"]
                inside = _all(c, first >= known, first + need <= end, need >= self.lanes)
                at = b.select(inside, c.place(spans, first), column)
                c.store(pointers, j, b.ptrtoint(at, I64))
                with c.when(b.not_(inside)):
                    with c.loop(0, need) as i:
                        k = at_least(c, first + i, known).at_most(field["n_spans"] - 1)
                        c.store(column, i, c.load(spans, k))
                    self._fill(c, column, need)
            to = c.place(work, _INTERVALS)
            b.call(self.columns, [pointers, c.raw(need), to, c.place(work, _LONGEST)])
        c.give(0)
        return c.function

    def _copy(self, c: Code, to: Any, source: Any, shift: Int, bounds: tuple[Int, Int]) -> None:
        """to[i] = source[shift + i] for i in [first, last), vectors first."""
        first, last = bounds
        rest = first + (last - first) // self.lanes * self.lanes
        with c.loop(first, rest, self.lanes) as i:
            part = c.b.load(
                self._anywhere(c, c.place(source, shift + i), self.lanes), align=self.size
            )
            at = self._anywhere(c, c.place(to, i), self.lanes)
            c.b.store(part, at, align=self.size)
        with c.loop(rest, last) as i:
            c.store(to, i, c.load(source, shift + i))

    def _fill(self, c: Code, column: Any, n: Int) -> None:
        """Zeros up to the length of a block."""
        with c.loop(n, at_least(c, n, self.lanes)) as i:
            c.store(column, i, c.real(self.kind, 0.0))

    def _choose(self) -> Any:
        """The windows' loop for a chunk: that for any turn if one may pass π in any lane.

        The largest component of each lane's angles over an interval is kept. Both loops give a turn
        of at most π the same bits: a lane's neighbours change none of its own.
        """
        c, (job, work) = self._part("choose", [self.wholes, self.reals])
        b, lanes = c.b, self.lanes
        by_interval = self.field(c, job, "by_interval") > 0
        factor = c.splat(self._number(c, job, "factor"), lanes)
        near = c.splat(self._number(c, job, "near"), lanes)
        far = []
        for g in self.groups:
            longest = b.select(by_interval, c.vector(work, _LONGEST + g, lanes), factor)
            angle = b.fmul(c.vector(work, _PEAK + g, lanes), longest)
            c.store_vector(work, MOST + g, larger(c, angle, c.vector(work, MOST + g, lanes)))
            past = b.fcmp_unordered(">=", angle, near)
            bits = ir.IntType(lanes)
            far.append(b.icmp_unsigned("!=", b.bitcast(past, bits), ir.Constant(bits, 0)))
        for more in far[1:]:
            far[0] = b.or_(far[0], more)
        short, wide = (c.raw(self.field(c, job, name)) for name in ("short", "wide"))
        c.give(Int(c, b.select(far[0], wide, short)))
        return c.function

    def turn(self, c: Code, job: Any, work: Any, windows: Any, undone: Any) -> None:
        """A chunk's windows; where their loop is not made yet the function gives ``undone``."""
        b = c.b
        chosen = Int(c, b.call(self.choose, [job, work]))
        with c.when(chosen.equals(0)):
            undone()
        to = ir.FunctionType(I64, [self.reals, self.reals, self.reals, I64]).as_pointer()
        own = b.ptrtoint(c.place(work, _INTERVALS), I64)
        uneven = self.field(c, job, "n_spans") > 0
        intervals = b.select(uneven, own, c.raw(self.field(c, job, "spans")))
        given = [c.place(work, _SAMPLES), b.inttoptr(intervals, self.reals)]
        given += [c.place(work, ATTITUDES), c.raw(windows)]
        b.call(b.inttoptr(chosen.value, to), given)

    def _scatter(self) -> Any:
        """The attitudes p∘r of ``left`` intervals to their places, past the cache.

        p of each lane are those at the chunks' starts, r the rows. What is written once and not
        read again here goes past the cache; an ordinary store would first fetch the line that it
        overwrites. The first attitude of a log is written too: whoever touches a page first pays
        for it, on its thread.
        """
        c, (job, work, body, start, n, left, width) = self._part(
            "scatter", [self.wholes, self.reals, self.wholes, self.wholes, I64, I64, I64]
        )
        b, lanes, n, left = c.b, self.lanes, Int(c, n), Int(c, left)
        rows, starts, columns = (c.place(work, at) for at in (ATTITUDES, STARTS, _COLUMNS))
        m = left * 4 + 4
        size = max(lanes, 4)
        last = at_least(c, m - size, 0)
        for g in self.groups:
            p = self.vectors(c, starts, 0, g)
            with c.loop(0, (m + (size - 1)) // size) as block:
                i = (block * size).at_most(last)
                found: list[Any] = []
                for k in range(0, size, 4):
                    found += self.product(c, lanes, p, self.vectors(c, rows, i + k, g))
                for k in range(0, size, lanes):
                    for lane, column in enumerate(self._transposed(c, found[k : k + lanes])):
                        to = c.place(columns, i + (k + (g + lane) * _COLUMN))
                        b.store(column, self._anywhere(c, to, lanes), align=self.size)
        out = self.field(c, job, "out")
        n_out = self.field(c, job, "n_out")
        aligned = (out % 16).equals(0)
        pieces = 16 // self.size
        with c.loop(0, Int(c, width)) as j:
            first = Int(c, c.load(start, j)) + n
            to = c.place(
                b.inttoptr(out.value, self.reals), (first + Int(c, c.load(body, j)) * n_out) * 4
            )
            column = c.place(columns, j * _COLUMN)
            begin = Int(c, b.select(first.equals(0), c.raw(0), c.raw(4)))
            with c.when(aligned), c.loop(begin, m, 4) as i:
                for k in range(0, 4, pieces):
                    part = b.load(self._anywhere(c, c.place(column, i + k), pieces), align=16)
                    at = self._anywhere(c, c.place(to, i + k), pieces)
                    b.store(part, at, align=16).set_metadata("nontemporal", self.nontemporal)
            with c.when(b.not_(aligned)), c.loop(begin, m) as i:
                made = b.store(c.load(column, i), c.place(to, i))
                made.set_metadata("nontemporal", self.nontemporal)
        c.give(0)
        return c.function


def at_least(c: Code, x: Int, low: Any) -> Int:
    """The larger of two whole numbers."""
    return Int(c, c.b.select(x > low, x.value, c.raw(low)))


def larger(c: Code, x: Any, y: Any) -> Any:
    """x where it is larger than y: a NaN in x is passed over."""
    return c.b.select(c.b.fcmp_ordered(">", x, y), x, y)


def _all(c: Code, *conditions: Any) -> Any:
    found = conditions[0]
    for more in conditions[1:]:
        found = c.b.and_(found, more)
    return found
