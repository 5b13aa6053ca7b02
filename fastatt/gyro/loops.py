"""The loops over logs that every method shares, written in LLVM's language.

Attitudes of a log are q = p∘r: p that at the start of a chunk of 48 intervals, r the turn since.
Turns of chunks are found side by side, of many logs or of one, and the chain of p goes through
them: a log's bits are the same whatever is beside it, however it is cut, on any number of threads.
"""

from __future__ import annotations

from typing import Any

from fastatt.flat.code import I64, Cells, Code, Int
from fastatt.gyro.chunk import ATTITUDES, FIRSTS, LOGS, MOST, STARTS, Chunk
from fastatt.gyro.windows import CHUNK, LANES


class Loops(Chunk):
    """``sweep``, ``along`` and ``chain`` of one precision."""

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self._sweep()
        self._along()
        self._chain()

    def _sweep(self) -> None:
        """``sweep(job, work, q, first, last)``: lanes from p and r, q (L, 8), over their intervals.

        The first lane of the tile whose windows' loop is not made yet, ``last`` when all are done;
        such a tile is left as it was, but for its places in ``out``.
        """
        c = Code(self.module, "sweep", [self.wholes, self.reals, self.reals, I64, I64])
        b, lanes = c.b, self.lanes
        job, work, q, first, last = c.function.args
        job, last = self.job(c, job), Int(c, last)
        rows, most, starts = (c.place(work, at) for at in (ATTITUDES, MOST, STARTS))
        field = {name: job.whole(name) for name in ("history", "span", "count", "phase")}
        body, start = self.whole(c, work, LOGS), self.whole(c, work, FIRSTS)
        begin = job.whole("first").value
        with c.loop(Int(c, first), last, LANES) as tile:
            width = (last - tile).at_most(LANES)
            with c.loop(0, LANES) as j:
                c.store(body, j, (tile + j).value)
                c.store(start, j, begin)
                at = (tile + j.at_most(width - 1)) * 8
                for k in range(4):
                    c.store(starts, j + k * LANES, c.load(q, at + k))
                    c.store(rows, j + k * LANES, c.load(q, at + (4 + k)))
                c.store(most, j, c.real(self.kind, 0.0))
            done, phase = c.variable(0), c.variable(field["phase"])
            with c.repeat_while(lambda: c.get(done) < field["count"]):
                n = c.get(done)
                left = (field["count"] - n).at_most(c.whole(CHUNK) - c.get(phase))
                windows = (left + field["span"] - 1) // field["span"]
                need = windows * field["span"] + field["history"]
                where = [job.pointer, work, body, start]
                b.call(self.gather, [*where, width.value, n.value, need.value])
                self.turn(c, job, work, windows, width, lambda: c.give(tile))
                b.call(self.scatter, [*where, n.value, left.value, width.value])
                whole = (c.get(phase) + left).equals(CHUNK)
                with self.groups(c, width) as g:
                    r = self.vectors(c, rows, left * 4, g)
                    p = self.vectors(c, starts, 0, g)
                    turned = self.unit(c, lanes, self.product(c, lanes, p, r))
                    one = [c.splat(x, lanes) for x in self.one(c)]
                    for place, after, before in (starts, turned, p), (rows, one, r):
                        pairs = zip(after, before, strict=True)
                        self.put_vectors(c, place, 0, g, [b.select(whole, *x) for x in pairs])
                c.set(done, n + left)
                c.set(phase, 0)
            with c.loop(0, width) as j:
                self.raise_peak(c, job, c.load(most, j))
                state = self.column(c, starts, 0, j) + self.column(c, rows, 0, j)
                for k, value in enumerate(state):
                    c.store(q, (tile + j) * 8 + k, value)
        b.fence("seq_cst")
        c.give(last)

    def _along(self) -> None:
        """``along(job, work, q, write, first, last)``: tiles of one log from p and r, q (8,).

        LANES chunks in a row are one tile, the last may be less. Without ``write`` only the turn of
        each chunk is found; with it attitudes are written, and q is left at the last tile's end.
        Gives the first tile whose windows' loop is not made yet, with q at its start, or ``last``.
        """
        c = Code(self.module, "along", [self.wholes, self.reals, self.reals, I64, I64, I64])
        b, lanes = c.b, self.lanes
        job, work, q, write, first, last = c.function.args
        job, write = self.job(c, job), Int(c, write) > 0
        rows, most, starts = (c.place(work, at) for at in (ATTITUDES, MOST, STARTS))
        names = ("history", "span", "log", "first", "count")
        history, span, log, begin, count = (job.whole(name) for name in names)
        totals = job.array("totals", self.reals)
        body, start = self.whole(c, work, LOGS), self.whole(c, work, FIRSTS)
        p, r = self._quaternion(c), self._quaternion(c)
        p.set([c.load(q, k) for k in range(4)])
        r.set([c.load(q, k) for k in range(4, 8)])

        def keep() -> None:
            for k, value in enumerate(p.get() + r.get()):
                c.store(q, k, value)

        with c.loop(Int(c, first), Int(c, last)) as tile:
            own = count - tile * (LANES * CHUNK)
            width = ((own + (CHUNK - 1)) // CHUNK).at_most(LANES)
            with c.loop(0, width) as j:
                c.store(body, j, log.value)
                c.store(start, j, (begin + (tile * LANES + j) * CHUNK).value)
            with self.groups(c, width) as g:
                self.put_vectors(c, rows, 0, g, [c.splat(x, lanes) for x in self.one(c)])
                c.store_vector(most, g, c.splat(c.real(self.kind, 0.0), lanes))
            windows = (own.at_most(CHUNK) + (span - 1)) // span
            where = [job.pointer, work, body, start]
            b.call(self.gather, [*where, width.value, c.raw(0), (history + windows * span).value])

            def undone() -> None:
                keep()
                c.give(tile)

            self.turn(c, job, work, windows, width, undone)
            with c.loop(0, width) as j:
                self.raise_peak(c, job, c.load(most, j))
                left = (own - j * CHUNK).at_most(CHUNK)
                turned = self.column(c, rows, left * 4, j)
                with c.when(write):
                    for k, value in enumerate(p.get()):
                        c.store(starts, j + k * LANES, value)
                    after = self.unit(c, 1, self.product(c, 1, p.get(), turned))
                    whole = left.equals(CHUNK)
                    for q_, ends in (p, (after, p.get())), (r, (self.one(c), turned)):
                        q_.set([b.select(whole, *x) for x in zip(*ends, strict=True)])
                with c.when(b.not_(write)):
                    for k, value in enumerate(turned):
                        c.store(totals, (tile * LANES + j) * 4 + k, value)
            with c.when(write):
                left = own.at_most(CHUNK).value
                b.call(self.scatter, [*where, c.raw(0), left, width.value])
        keep()
        b.fence("seq_cst")
        c.give(Int(c, last))

    def _chain(self) -> None:
        """``chain(q, totals, n)``: p after n further chunks' turns, one after the other."""
        c = Code(self.module, "chain", [self.reals, self.reals, I64])
        q, totals, n = c.function.args
        p = self._quaternion(c)
        p.set([c.load(q, k) for k in range(4)])
        with c.loop(0, Int(c, n)) as i:
            turned = [c.load(totals, i * 4 + k) for k in range(4)]
            p.set(self.unit(c, 1, self.product(c, 1, p.get(), turned)))
        for k, value in enumerate(p.get()):
            c.store(q, k, value)
        c.give(0)

    def one(self, c: Code) -> list[Any]:
        """No turn."""
        return [c.real(self.kind, x) for x in (1.0, 0.0, 0.0, 0.0)]

    def _quaternion(self, c: Code) -> Cells:
        return Cells(c, [self.real] * 4)
