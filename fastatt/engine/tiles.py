"""The tile loop: a block of bodies stays in the first-level cache for many steps.

A tile always runs its full width (the last body fills it up), so that every body meets the same
code whatever the size of the ensemble. All that a step touches lies in one piece of memory, a row
of lanes for each number.

Exponentials by polynomial hold up to π; a root and a division more make them good at any angle and
the step slower. So a block of steps runs in its quick form, and lanes in which that did not
do take the careful form's result, from the start of the block. The careful form is another program,
compiled only when a lane first needs it: ``tiles`` then returns the number of the tile where it
stopped, to be called again from there. The others keep what the quick form gave them: a fast
neighbour costs time, never a bit.

Looking at every turn makes the cheapest steps slower. Bodies whose turns are known beforehand to be
within the method's limit are stepped without it. Of other rates that are given, one step of six
or seven is looked at, and the length of a quaternion at the end of the block: beyond π the short
exponential is not of unit length.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir

from fastatt.engine.layout import BLOCK, WIDTH
from fastatt.engine.pieces import PACE, Pieces
from fastatt.engine.status import Status
from fastatt.flat.code import I64, REALS, Code, Given, Int, text_of
from fastatt.flat.rows import lanes_of

# ulps a step by which |q|² may change unsuspected: good exponentials bring 2.7 at most
ROUNDING = 4.0
_BYTE = ir.IntType(8).as_pointer()


def width_for(bodies: int, kind: str) -> int:
    """Width of the tile for a number of bodies: a power of two of vectors, at most ``WIDTH``."""
    width = lanes_of(kind)
    while width < min(bodies, WIDTH):
        width *= 2
    return width


class Writer(Pieces):
    """Writes the program of one job."""

    def quick(self) -> str:
        """The loop over tiles with the quick form of a block."""
        self._block("block", self.formulas.quick, self.job.look)
        self._begin()
        self._save()
        if self.formulas.mend is not None:
            self._mend()
        self._tiles()
        return text_of(self.module)

    def careful(self) -> str:
        """The form of a block that is good for any turn and looks at each."""
        self._block("careful", self.formulas.careful, "every")
        return text_of(self.module)

    # lanes that the quick form may not do for

    def _remember(self, code: Code, given: Given, rows: Any) -> None:
        """|q|² of every lane at the start of a block."""
        with self._squares(code, given, rows) as (j, (square,)):
            code.store_vector(rows, j + self.rows.offset("witness"), square)

    def _squares(self, code: Code, given: Given, rows: Any) -> Any:
        assert self.formulas.witness is not None
        return self._evaluated(code, given, rows, self.formulas.witness, ({}, None))

    def _doubt(self, code: Code, given: Given, rows: Any, n: Int) -> None:
        """Infinity in place of the squared turns of lanes whose |q|² n steps have changed.

        Not where it was no number before: another run would not mend it.
        """
        b = code.b
        eps = float(np.finfo(np.float64 if self.kind == "double" else np.float32).eps)
        steps = b.sitofp(n.value, self.real)
        bound = code.splat(b.fmul(steps, code.real(self.kind, ROUNDING * eps)), self.lanes)
        infinite = code.splat(code.real(self.kind, math.inf), self.lanes)
        with self._squares(code, given, rows) as (j, (after,)):
            before = code.vector(rows, j + self.rows.offset("witness"), self.lanes)
            change = b.call(code.intrinsic("llvm.fabs", after.type), [b.fsub(after, before)])
            kept = b.fcmp_ordered("<=", change, b.fmul(bound, before))
            kept = b.or_(kept, b.fcmp_unordered("uno", before, before))
            at = j + self.rows.offset("turn")
            turn = code.vector(rows, at, self.lanes)
            code.store_vector(rows, at, b.select(kept, turn, infinite))

    def _far(self, code: Code, rows: Any, far: Any) -> Any:
        """Mark lanes that turned by more than π in a step; whether there is any."""
        b = code.b
        found = code.variable(0)
        limit = code.real(self.kind, math.pi * math.pi)
        with code.lanes(self.width, 1) as j:
            turn = code.load(rows, j + self.rows.offset("turn"))
            one = b.zext(b.fcmp_ordered(">", turn, limit), I64)
            code.store(far, j, one)
            code.set(found, Int(code, b.or_(code.get(found).value, one)))
        return code.get(found) > 0

    def _loud(self, code: Code, given: Given, rows: Any, far: Any, base: Int) -> Any:
        """Mark lanes whose turns are not known to be quiet; whether there is any.

        Of the others the watch keeps what is known.
        """
        b = code.b
        found = code.variable(0)
        most = given.number("quiet")
        watch = given.array("watch", self.real.as_pointer())
        last, row = given.whole("bodies") - 1, self.rows.offset("bound")
        with code.lanes(self.width, 1) as j:
            if self.job.bounds:
                square = code.load(rows, j + row)
            else:
                known = given.array("known", REALS["double"].as_pointer())
                turn = code.load(known, (base + j).at_most(given.whole("rows_known") - 1))
                square = self._narrow(code, b.fmul(turn, turn))
            quiet = b.fcmp_ordered("<=", square, self._narrow(code, b.fmul(most, most)))
            one = b.zext(b.not_(quiet), I64)
            code.store(far, j, one)
            code.set(found, Int(code, b.or_(code.get(found).value, one)))
            begins = b.and_(given.whole("first").equals(0), quiet)
            with code.when(b.and_(begins, (base + j) <= last)):
                code.store(watch, base + j, square)
        return code.get(found) > 0

    def _judge(self, code: Code, given: Given, rows: Any, at: tuple[Int, Int]) -> None:
        """The flags of a lane, from its last state and from what the run watched."""
        b, (j, body) = code.b, at
        zero = code.real(self.kind, 0.0)
        spoilt = zero
        for i in range(self.formulas.size):
            spoilt = b.fadd(spoilt, b.fmul(code.load(rows, j + i * self.width), zero))
        bad = b.fcmp_unordered("uno", spoilt, spoilt)
        watch = given.array("watch", self.real.as_pointer())
        bodies = given.whole("bodies")
        square, norm, change = (code.load(watch, bodies * k + body) for k in range(3))
        turn = b.call(code.intrinsic("llvm.sqrt", self.real), [square])
        endless = b.fcmp_ordered("==", turn, code.real(self.kind, math.inf))
        limit, most_off, most_changed = (
            self._narrow(code, given.number(x)) for x in ("limit", "norm", "invariant")
        )
        large = Status.SINGULAR if self.job.attitude.has_poles else Status.STEP_TOO_LARGE
        well = b.not_(bad)
        last = given.whole("rows_flags") - 1
        flags = code.load(given.array("flags", _BYTE), body.at_most(last))
        for where, flag in (
            (bad, Status.NON_FINITE),
            (b.and_(endless, well), Status.NOT_CONVERGED),
            (b.and_(b.fcmp_ordered(">", turn, limit), b.not_(endless)), large),
            (b.and_(b.fcmp_unordered(">", change, most_changed), well), Status.INVARIANT),
            (b.and_(b.fcmp_unordered(">", norm, most_off), well), Status.NORM_LOST),
        ):
            bit = b.select(where, ir.Constant(flags.type, int(flag)), ir.Constant(flags.type, 0))
            flags = b.or_(flags, bit)
        code.store(given.array("status", _BYTE), body, flags)
        told = given.array("told", REALS["double"].as_pointer())
        most = turn if self.kind == "double" else b.fpext(turn, REALS["double"])
        flagged = b.uitofp(b.icmp_unsigned("!=", flags, ir.Constant(flags.type, 0)), most.type)
        for i, value in enumerate((most, flagged)):
            self._raise(code, told, i, value)

    def _raise(self, code: Code, array: Any, at: Any, value: Any) -> None:
        """Keep the larger of two numbers."""
        before = code.load(array, at)
        larger = code.b.fcmp_ordered(">", value, before)
        code.store(array, at, code.b.select(larger, value, before))

    def _again(self, code: Code, given: Given, memory: tuple[Any, Any, Any], steps: Any) -> None:
        """Run a block in its careful form from the states kept, and take the marked lanes' results.

        Returns from the program where that form is not there yet.
        """
        rows, kept, far = memory
        tile, first, last = steps
        b = code.b
        address = self._careful_block(code, given, tile)
        self._exchange(code, rows, kept)
        b.call(address, [rows, first.value, last.value, given.pointer])
        with (
            code.lanes(self.width, 1) as j,
            code.when(Int(code, code.load(far, j)) < 1),
            code.loop(0, self.copied, self.width) as row,
        ):
            code.store(rows, row + j, code.load(kept, row + j))

    def _careful_block(self, code: Code, given: Given, tile: Int) -> Any:
        """Where the careful form of a block is; returns from the program where it is not yet."""
        kind = ir.FunctionType(I64, [self.real.as_pointer(), I64, I64, I64.as_pointer()])
        with code.when(given.whole("careful").equals(0)):
            code.give(tile)
        return given.array("careful", kind.as_pointer())

    def _exchange(self, code: Code, a: Any, c: Any) -> None:
        with code.lanes(self.copied, self.lanes) as at:
            x, y = code.vector(a, at, self.lanes), code.vector(c, at, self.lanes)
            code.store_vector(a, at, y)
            code.store_vector(c, at, x)

    def _copy(self, code: Code, a: Any, c: Any) -> None:
        with code.lanes(self.copied, self.lanes) as at:
            code.store_vector(c, at, code.vector(a, at, self.lanes))

    def _tiles(self) -> None:
        """Steps [first, last) of tiles; the number of the tile that was not finished."""
        code, given, (first_tile, last_tile) = self._function("tiles", I64, I64)
        rows = code.room(self.real, self.rows.count * self.width)
        kept = code.room(self.real, self.copied)
        done = code.room(self.real, self.done)
        far = code.room(I64, self.width)
        with code.loop(Int(code, first_tile), Int(code, last_tile)) as tile:
            self._tile(code, given, (rows, kept, done, far), tile)
        code.give(Int(code, last_tile))

    def _tile(self, code: Code, given: Given, memory: Any, tile: Int) -> None:
        rows, _, done, far = memory
        b = code.b
        globals_ = self.module.globals
        args = given.pointer
        base = tile * self.width
        first, last = given.whole("first"), given.whole("last")
        every, restore = given.whole("save_every"), given.whole("restore")
        n_steps, bodies = given.whole("n_steps"), given.whole("bodies")
        b.call(globals_["begin"], [rows, done, tile.value, args])
        watch = given.array("watch", self.real.as_pointer())
        loud = self._begin_watch(code, given, rows, far, base)

        def save(n: Int) -> None:
            b.call(globals_["save"], [rows, done, tile.value, n.value, args])

        origin = given.whole("origin")
        due = b.or_(given.whole("slot").equals(1), n_steps.equals(origin))
        with code.when(b.and_(first.equals(origin), due)):
            save(first)
        at = code.variable(first)
        with code.repeat_while(lambda: code.get(at) < last):
            n = code.get(at)
            stop = (n + BLOCK).at_most(last)
            stop = stop.at_most(((n - origin) // every + 1) * every + origin)
            if self.formulas.mend is not None:
                limit = code.variable(stop)
                with code.when(restore > 0):
                    code.set(limit, stop.at_most((n // restore + 1) * restore))
                stop = code.get(limit)
            self._run_block(code, given, memory, (tile, n, stop), loud)
            with code.loop(0, (bodies - base).at_most(self.width)) as j:
                turn = code.load(rows, j + self.rows.offset("turn"))
                self._raise(code, watch, base + j, turn)
            code.set(at, stop)
            if self.formulas.mend is not None:
                with code.when(restore > 0), code.when((stop % restore).equals(0)):
                    b.call(globals_["mend"], [rows, tile.value, args])
            with code.when(b.or_(((stop - origin) % every).equals(0), stop.equals(n_steps))):
                save(stop)
        self._end_tile(code, given, rows, base)

    def _begin_watch(self, code: Code, given: Given, rows: Any, far: Any, base: Int) -> Any:
        """Nothing was seen yet; whether a lane's turns are not known to be quiet."""
        watch = given.array("watch", self.real.as_pointer())
        begins, bodies = given.whole("first").equals(0), given.whole("bodies")
        with code.when(begins), code.loop(0, (bodies - base).at_most(self.width)) as j:
            for row in range(3):
                code.store(watch, bodies * row + (base + j), code.real(self.kind, 0.0))
        return self._loud(code, given, rows, far, base) if self.job.known else None

    def _end_tile(self, code: Code, given: Given, rows: Any, base: Int) -> None:
        """The states, from which a run may go on, and the flags."""
        x, size = given.array("x", self.real.as_pointer()), self.formulas.size
        with code.loop(0, (given.whole("bodies") - base).at_most(self.width)) as j:
            with code.loop(0, size) as i:
                code.store(x, (base + j) * size + i, code.load(rows, i * self.width + j))
            self._judge(code, given, rows, (j, base + j))

    def _run_block(
        self, code: Code, given: Given, memory: Any, steps: tuple[Int, Int, Int], loud: Any
    ) -> None:
        rows, kept, _, far = memory
        b = code.b
        _, n, stop = steps
        arguments = [rows, n.value, stop.value, given.pointer]
        block = self.module.globals["block"]
        again = ((rows, kept, far), steps)
        if not self.job.has_careful_form:
            b.call(block, arguments)
        elif loud is not None:
            with code.when(loud):
                self._copy(code, rows, kept)
            b.call(block, arguments)
            with code.when(loud):
                self._again(code, given, *again)
        else:
            self._copy(code, rows, kept)
            many = (stop - n) > int(PACE)
            if self.formulas.witness is not None:
                with code.when(many):
                    self._remember(code, given, rows)
            b.call(block, arguments)
            if self.formulas.witness is not None:
                with code.when(many):
                    self._doubt(code, given, rows, stop - n)
            with code.when(self._far(code, rows, far)):
                self._again(code, given, *again)
