"""What is done with a chunk of every lane's log, written in LLVM's language.

A chunk of each lane's samples is turned into rows, a method's windows run across the lanes, and the
attitudes are turned back: in and out memory is touched once and in order.
"""

from __future__ import annotations

import ctypes
from typing import Any

from llvmlite import ir

from fastatt.flat.code import I32, I64, REALS, Code, Given, Int
from fastatt.flat.finished import Flat
from fastatt.flat.graph import Graph
from fastatt.flat.llvm import Emitter
from fastatt.flat.machine import processor
from fastatt.flat.rows import lanes_of
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
        ("data", ctypes.c_int64),  # samples (N, lead + n_samples, 3)
        ("n_samples", ctypes.c_int64),
        ("lead", ctypes.c_int64),  # samples, and intervals, that are known before the first
        ("head", ctypes.c_int64),  # those before a log (., n_head): how much of its first ones each
        ("n_head", ctypes.c_int64),
        ("tail", ctypes.c_int64),  # those after it (n_after, n_tail): how much of its last ones
        ("n_tail", ctypes.c_int64),
        ("n_after", ctypes.c_int64),
        ("spans", ctypes.c_int64),  # intervals (lead + n_spans), s
        ("n_spans", ctypes.c_int64),  # how many, 0 of equal ones
        ("interval", ctypes.c_double),  # each of these, s
        ("out", ctypes.c_int64),  # attitudes (N, n_out, 4)
        ("n_out", ctypes.c_int64),
        ("history", ctypes.c_int64),
        ("span", ctypes.c_int64),
        ("extra", ctypes.c_int64),  # samples more than intervals
        ("by_interval", ctypes.c_int64),  # samples are rates, over intervals of many lengths
        ("short", ctypes.c_int64),  # the windows' loop for turns of at most π
        ("wide", ctypes.c_int64),  # and for any; 0 where there is none yet
        ("first", ctypes.c_int64),  # first interval,
        ("count", ctypes.c_int64),  # how many,
        ("phase", ctypes.c_int64),  # and, side by side, how many of the first one's chunk are done
        ("log", ctypes.c_int64),  # of one log: which,
        ("totals", ctypes.c_int64),  # and the turn of each chunk (., 4)
        ("near", ctypes.c_double),  # angle below which turns are at most π
        ("factor", ctypes.c_double),  # a sample's angle over an interval, of equal intervals
    )


class Chunk:
    """Writes the functions of one precision into a program."""

    def __init__(self, kind: str) -> None:
        self.kind, self.real = kind, REALS[kind]
        self.size = 8 if kind == "double" else 4
        self.lanes = lanes_of(kind)
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
        c.function.attributes.add("noinline")
        return c, c.function.args

    @staticmethod
    def job(c: Code, pointer: Any) -> Given:
        """What the loops work on."""
        return Given(c, pointer, Job)

    def _number(self, c: Code, job: Given, name: str) -> Any:
        value = job.number(name)
        return value if self.kind == "double" else c.b.fptrunc(value, self.real)

    def raise_peak(self, c: Code, job: Given, value: Any) -> None:
        """Keep the larger of the job's peak and another."""
        at = job.place("peak")
        other = value if self.kind == "double" else c.b.fpext(value, REALS["double"])
        c.b.store(larger(c, other, c.b.load(at)), at)

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

    def groups(self, c: Code, width: Any) -> Any:
        """A loop over the lanes, a vector at a time."""
        return c.loop(0, c.whole(width), self.lanes)

    def _columns(self) -> Any:
        """Columns into rows of the lanes: ``rows`` numbers from each lane's pointer on.

        ``most`` gets each lane's largest absolute value. The last block overlaps the one before
        it; a column shorter than a block has room for one.
        """
        c, (pointers, n, width, to, most) = self._part(
            "columns", [self.wholes, I64, I64, self.reals, self.reals]
        )
        n, b, lanes = Int(c, n), c.b, self.lanes
        absolute = c.intrinsic("llvm.fabs", self.vector)
        highest = c.room(self.vector)
        last = (n - lanes).at_least(0)
        with self.groups(c, Int(c, width)) as g:
            b.store(ir.Constant(self.vector, [0.0] * lanes), highest)
            columns = [b.inttoptr(c.load(pointers, g + k), self.reals) for k in range(lanes)]
            with c.loop(0, (n + (lanes - 1)) // lanes) as block:
                i = (block * lanes).at_most(last)
                found = []
                for column in columns:
                    at = self._anywhere(c, c.place(column, i), lanes)
                    found.append(b.load(at, align=self.size))
                    c.prefetch(c.place(column, i + n))
                peak = b.load(highest)
                for k, row in enumerate(self._transposed(c, found)):
                    c.store_vector(to, (i + k) * LANES + g, row)
                    peak = larger(c, b.call(absolute, [row]), peak)
                b.store(peak, highest)
            c.store_vector(most, g, b.load(highest))
        c.give(0)
        return c.function

    def _gather(self) -> Any:
        """A chunk of every lane's samples and intervals, from interval n of its stretch on."""
        c, (job, work, body, start, width, n, need) = self._part(
            "gather", [self.wholes, self.reals, self.wholes, self.wholes, I64, I64, I64]
        )
        b, need, width, job = c.b, Int(c, need), Int(c, width), self.job(c, job)
        field = {name: job.whole(name) for name, _ in Job._fields_}
        data, spans = (job.array(name, self.reals) for name in ("data", "spans"))
        pointers, columns = self.whole(c, work, _POINTERS), c.place(work, _COLUMNS)
        m = need + field["extra"]
        lead, n_samples = field["lead"], field["n_samples"]
        known = c.whole(0) - lead
        lanes = (width + (self.lanes - 1)) // self.lanes * self.lanes
        with c.loop(0, lanes) as j:
            lane = j.at_most(width - 1)
            first = Int(c, c.load(start, lane)) + Int(c, n) - field["history"]
            log = Int(c, c.load(body, lane))
            own = c.place(data, (log * (lead + n_samples) + lead) * 3)
            column = c.place(columns, j * _COLUMN)
            inside = _all(c, first >= known, first + m <= n_samples, m * 3 >= self.lanes)
            at = b.select(inside, c.place(own, first * 3), column)
            c.store(pointers, j, b.ptrtoint(at, I64))
            with c.when(b.not_(inside)):
                begin = (known - first).at_least(0).at_most(m)
                end = (n_samples - first).at_most(m).at_least(begin)
                with c.loop(0, begin) as i:
                    row = c.whole(-1) - first - i
                    self._mix(c, job, "head", row, own, c.place(column, i * 3))
                self._copy(c, column, own, first * 3, (begin * 3, end * 3))
                near = c.place(own, (n_samples - field["n_tail"]) * 3)
                with c.loop(end, m) as i:
                    row = (first + i - n_samples).at_most(field["n_after"] - 1)
                    self._mix(c, job, "tail", row, near, c.place(column, i * 3))
                self._fill(c, column, m * 3)
        to = c.place(work, _SAMPLES)
        b.call(self.columns, [pointers, c.raw(m * 3), width.value, to, c.place(work, _PEAK)])
        with c.when(field["n_spans"] > 0):
            with c.loop(0, lanes) as j:
                lane = j.at_most(width - 1)
                first = Int(c, c.load(start, lane)) + Int(c, n) - field["history"]
                column = c.place(columns, j * _COLUMN)
                end = field["n_spans"]
                inside = _all(c, first >= known, first + need <= end, need >= self.lanes)
                at = b.select(inside, c.place(spans, first + lead), column)
                c.store(pointers, j, b.ptrtoint(at, I64))
                with c.when(b.not_(inside)):
                    with c.loop(0, need) as i:
                        k = (first + i).at_least(known).at_most(end - 1)
                        c.store(column, i, c.load(spans, k + lead))
                    self._fill(c, column, need)
            to = c.place(work, _INTERVALS)
            b.call(self.columns, [pointers, c.raw(need), width.value, to, c.place(work, _LONGEST)])
        c.give(0)
        return c.function

    def _mix(self, c: Code, job: Given, name: str, row: Int, samples: Any, to: Any) -> None:
        """A sample beyond a log: a row of a table times those near it."""
        b, double = c.b, REALS["double"]
        n = job.whole(f"n_{name}")
        table = c.place(job.array(name, double.as_pointer()), row * n)
        total = c.room(double)
        for axis in range(3):
            b.store(ir.Constant(double, 0.0), total)
            with c.loop(0, n) as k:
                x = c.load(samples, k * 3 + axis)
                x = x if self.kind == "double" else b.fpext(x, double)
                b.store(b.fadd(b.load(total), b.fmul(c.load(table, k), x)), total)
            value = b.load(total)
            c.store(to, axis, value if self.kind == "double" else b.fptrunc(value, self.real))

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
        with c.loop(n, n.at_least(self.lanes)) as i:
            c.store(column, i, c.real(self.kind, 0.0))

    def _choose(self) -> Any:
        """The windows' loop for a chunk: that for any turn if one may pass π in any lane.

        The largest component of each lane's angles over an interval is kept. Both loops give a turn
        of at most π the same bits: a lane's neighbours change none of its own.
        """
        c, (job, work, width) = self._part("choose", [self.wholes, self.reals, I64])
        b, lanes, job = c.b, self.lanes, self.job(c, job)
        by_interval = job.whole("by_interval") > 0
        factor = c.splat(self._number(c, job, "factor"), lanes)
        near = c.splat(self._number(c, job, "near"), lanes)
        far = c.variable(0)
        with self.groups(c, Int(c, width)) as g:
            longest = b.select(by_interval, c.vector(work, g + _LONGEST, lanes), factor)
            angle = b.fmul(c.vector(work, g + _PEAK, lanes), longest)
            c.store_vector(work, g + MOST, larger(c, angle, c.vector(work, g + MOST, lanes)))
            past = b.bitcast(b.fcmp_unordered(">=", angle, near), ir.IntType(lanes))
            b.store(b.or_(b.load(far), b.zext(past, I64)), far)
        short, wide = (c.raw(job.whole(name)) for name in ("short", "wide"))
        c.give(Int(c, b.select(c.get(far).equals(0), short, wide)))
        return c.function

    def turn(self, c: Code, job: Given, work: Any, windows: Any, width: Int, undone: Any) -> None:
        """A chunk's windows; where their loop is not made yet the function gives ``undone``."""
        b = c.b
        chosen = Int(c, b.call(self.choose, [job.pointer, work, width.value]))
        with c.when(chosen.equals(0)):
            undone()
        to = ir.FunctionType(I64, [self.reals, self.reals, self.reals, I64, I64]).as_pointer()
        with c.when(job.whole("n_spans").equals(0)):
            c.store(work, _INTERVALS, self._number(c, job, "interval"))
        given = [c.place(work, _SAMPLES), c.place(work, _INTERVALS)]
        given += [c.place(work, ATTITUDES), c.raw(windows), width.value]
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
        b, lanes, job = c.b, self.lanes, self.job(c, job)
        n, left = Int(c, n), Int(c, left)
        rows, starts, columns = (c.place(work, at) for at in (ATTITUDES, STARTS, _COLUMNS))
        m = left * 4 + 4
        size = max(lanes, 4)
        last = (m - size).at_least(0)
        with self.groups(c, Int(c, width)) as g:
            p = self.vectors(c, starts, 0, g)
            with c.loop(0, (m + (size - 1)) // size) as block:
                i = (block * size).at_most(last)
                found: list[Any] = []
                for k in range(0, size, 4):
                    found += self.product(c, lanes, p, self.vectors(c, rows, i + k, g))
                for k in range(0, size, lanes):
                    for lane, column in enumerate(self._transposed(c, found[k : k + lanes])):
                        to = c.place(columns, i + k + (g + lane) * _COLUMN)
                        b.store(column, self._anywhere(c, to, lanes), align=self.size)
        out, n_out = job.whole("out"), job.whole("n_out")
        aligned = (out % 16).equals(0)
        pieces, line = 16 // self.size, 64 // self.size
        with c.loop(0, Int(c, width)) as j:
            first = Int(c, c.load(start, j)) + n
            at = (first + Int(c, c.load(body, j)) * n_out) * 4
            to = c.place(b.inttoptr(out.value, self.reals), at)
            column = c.place(columns, j * _COLUMN)
            begin = Int(c, b.select(first.equals(0), c.raw(0), c.raw(4)))
            end = m.at_most((n_out - first) * 4)

            def move(i: Int, k: int, align: int) -> None:
                part = b.load(self._anywhere(c, c.place(column, i), k), align=self.size)
                made = b.store(part, self._anywhere(c, c.place(to, i), k), align=align)
                made.set_metadata("nontemporal", self.nontemporal)

            with c.when(aligned):
                # to the next line, whole lines, and the rest
                off = c.whole(0) - (out // self.size + at + begin)
                low = (begin + (off % line + line) % line).at_most(end)
                high = low + (end - low) // line * line
                for first, last, k in (begin, low, pieces), (low, high, line), (high, end, pieces):
                    with c.loop(first, last, k) as i:
                        move(i, k, k * self.size)
            with c.when(b.not_(aligned)), c.loop(begin, end) as i:
                move(i, 1, self.size)
        c.give(0)
        return c.function


def larger(c: Code, x: Any, y: Any) -> Any:
    """x where it is larger than y: a NaN in x is passed over."""
    return c.b.select(c.b.fcmp_ordered(">", x, y), x, y)


def _all(c: Code, *conditions: Any) -> Any:
    found = conditions[0]
    for more in conditions[1:]:
        found = c.b.and_(found, more)
    return found
