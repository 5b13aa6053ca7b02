"""The loops over logs that every method shares, written in LLVM's language.

Every lane carries one stretch of one log. A single log is a chain of products, and products are
associative: the lanes of a tile take stretches that follow each other, and all are turned to where
the one before ended. Threads take runs of tiles, and start from the turns of those before, found
first. The cuts are the same for every number of threads.
"""

from __future__ import annotations

from typing import Any

from fastatt.flat.code import I64, Code, Int
from fastatt.gyro.chunk import ATTITUDES, FIRSTS, LOGS, MOST, STARTS, Chunk, larger
from fastatt.gyro.windows import CHUNK, LANES


class Loops(Chunk):
    """``sweep``, ``along`` and ``chain`` of one precision."""

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self._sweep()
        self._along()
        self._chain()

    def _sweep(self) -> None:
        """``sweep(job, work, q, first, last)``: lanes from attitudes q (L, 4) over their intervals.

        The first lane of the tile whose windows' loop is not made yet, ``last`` when all are done;
        such a tile is left as it was, but for its places in ``out``.
        """
        c = Code(self.module, "sweep", [self.wholes, self.reals, self.reals, I64, I64])
        b = c.b
        job, work, q, first, last = c.function.args
        last = Int(c, last)
        rows, most = c.place(work, ATTITUDES), c.place(work, MOST)
        field = {name: self.field(c, job, name) for name in ("history", "span", "count")}
        peak = self.array(c, job, "peak")
        with c.loop(Int(c, first), last, LANES) as tile:
            width = (last - tile).at_most(LANES)
            body, start = (
                c.place(self.array(c, job, name, self.wholes), tile) for name in ("body", "start")
            )
            with c.loop(0, LANES) as j:
                at = (tile + j.at_most(width - 1)) * 4
                for k in range(4):
                    c.store(rows, j + k * LANES, c.load(q, at + k))
                c.store(most, j, c.real(self.kind, 0.0))
            done = c.variable(0)
            with c.repeat_while(lambda: c.get(done) < field["count"]):
                n = c.get(done)
                left = (field["count"] - n).at_most(CHUNK)
                windows = (left + field["span"] - 1) // field["span"]
                need = windows * field["span"] + field["history"]
                where = [job, work, body, start]
                b.call(self.gather, [*where, width.value, n.value, need.value])
                self.turn(c, job, work, windows, lambda: c.give(tile))
                b.call(self.scatter, [*where, n.value, left.value, width.value])
                for g in self.groups:
                    q_last = self.vectors(c, rows, left * 4, g)
                    self.put_vectors(c, rows, 0, g, self.unit(c, self.lanes, q_last))
                c.set(done, n + left)
            with c.loop(0, width) as j:
                c.store(peak, tile + j, c.load(most, j))
                for k, value in enumerate(self.column(c, rows, 0, j)):
                    c.store(q, (tile + j) * 4 + k, value)
        b.fence("seq_cst")
        c.give(last)

    def _along(self) -> None:
        """``along(job, work, q, write, first, last)``: tiles of one log from q (4,), at the first.

        LANES stretches of CHUNK intervals in a row are one tile. Without ``write`` only the turn of
        each is found; with it attitudes are written, and q is left at the last tile's end. Gives
        the first tile whose windows' loop is not made yet, with q at its start, or ``last``.
        """
        c = Code(self.module, "along", [self.wholes, self.reals, self.reals, I64, I64, I64])
        b, real, lanes = c.b, self.real, self.lanes
        job, work, q, write, first, last = c.function.args
        write = Int(c, write) > 0
        rows, most, starts = (c.place(work, at) for at in (ATTITUDES, MOST, STARTS))
        log = self.field(c, job, "log")
        history, span = self.field(c, job, "history"), self.field(c, job, "span")
        peak, totals = self.array(c, job, "peak"), self.array(c, job, "totals")
        body, start = self.whole(c, work, LOGS), self.whole(c, work, FIRSTS)
        unit = [c.real(self.kind, x) for x in (1.0, 0.0, 0.0, 0.0)]
        a, total = self._quaternion(c), self._quaternion(c)
        a.set([c.load(q, k) for k in range(4)])
        highest = c.room(real)
        with c.loop(Int(c, first), Int(c, last)) as tile:
            with c.loop(0, LANES) as j:
                c.store(body, j, log.value)
                c.store(start, j, ((tile * LANES + j) * CHUNK).value)
            for g in self.groups:
                self.put_vectors(c, rows, 0, g, [c.splat(x, lanes) for x in unit])
                c.store_vector(most, g, c.splat(unit[1], lanes))
            where = [job, work, body, start]
            b.call(self.gather, [*where, c.raw(LANES), c.raw(0), (history + CHUNK).value])

            def undone() -> None:
                a.keep(q)
                c.give(tile)

            self.turn(c, job, work, c.whole(CHUNK) // span, undone)
            b.store(unit[1], highest)
            total.set(unit)
            # attitudes at the start of each lane, as if the lanes were one stretch, and at its end
            with c.loop(0, LANES) as j:
                b.store(larger(c, c.load(most, j), b.load(highest)), highest)
                for k, value in enumerate(total.get()):
                    c.store(starts, j + k * LANES, value)
                p = self.column(c, rows, 4 * CHUNK, j)
                total.set(self.unit(c, 1, self.product(c, 1, total.get(), p)))
            c.store(peak, tile, b.load(highest))
            with c.when(write):
                for g in self.groups:
                    before = [c.splat(x, lanes) for x in a.get()]
                    p = self.product(c, lanes, before, self.vectors(c, starts, 0, g))
                    with c.loop(0, 4 * CHUNK + 4, 4) as row:
                        turned = self.product(c, lanes, p, self.vectors(c, rows, row, g))
                        self.put_vectors(c, rows, row, g, turned)
                b.call(self.scatter, [*where, c.raw(0), c.raw(CHUNK), c.raw(LANES)])
                a.set(self.unit(c, 1, self.product(c, 1, a.get(), total.get())))
            with c.when(b.not_(write)):
                for k, value in enumerate(total.get()):
                    c.store(totals, tile * 4 + k, value)
        a.keep(q)
        b.fence("seq_cst")
        c.give(Int(c, last))

    def _chain(self) -> None:
        """``chain(q, totals, n)``: q after n further turns, one after the other."""
        c = Code(self.module, "chain", [self.reals, self.reals, I64])
        q, totals, n = c.function.args
        a = self._quaternion(c)
        a.set([c.load(q, k) for k in range(4)])
        with c.loop(0, Int(c, n)) as i:
            p = [c.load(totals, i * 4 + k) for k in range(4)]
            a.set(self.unit(c, 1, self.product(c, 1, a.get(), p)))
        a.keep(q)
        c.give(0)

    def _quaternion(self, c: Code) -> _Quaternion:
        return _Quaternion(c, [c.room(self.real) for _ in range(4)])


class _Quaternion:
    """A variable of four numbers."""

    def __init__(self, c: Code, places: list[Any]) -> None:
        self.c, self.places = c, places

    def get(self) -> list[Any]:
        return [self.c.b.load(place) for place in self.places]

    def set(self, q: list[Any]) -> None:
        for value, place in zip(q, self.places, strict=True):
            self.c.b.store(value, place)

    def keep(self, to: Any) -> None:
        """Write it to four numbers in a row."""
        for k, value in enumerate(self.get()):
            self.c.store(to, k, value)
