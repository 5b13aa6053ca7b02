"""The tile loop where each body has a step of its own, and saves are at any times.

Bodies step together, each by its own step, to the last of their own steps before a save; one that
is there waits. What is handed out is one shorter step of the same method from there, on a copy: the
steps of a body depend neither on its neighbours nor on when it is looked at.
"""

from __future__ import annotations

from typing import Any

from fastatt.engine.layout import BLOCK
from fastatt.engine.pieces import OWN
from fastatt.engine.tiles import Writer
from fastatt.flat.code import I64, REALS, Code, Given, Int, text_of

_WHOLE = I64.as_pointer()
_EPS = 2.0**-52


class OwnWriter(Writer):
    """Writes the program of a job whose bodies have steps of their own."""

    def quick(self) -> str:
        """The loop over tiles with the quick form of a block."""
        step = self.formulas.quick, self.job.look
        if self.formulas.is_timed:
            self._block("even", *step, even=True)
            self._block("uneven", *step)
            self._either()
        else:
            self._block("block", *step)
        self._begin()
        self._save()
        self._regrid()
        self._tiles()
        return text_of(self.module)

    def _either(self) -> None:
        """A block of steps: what depends on time alone is found once where lanes share it."""
        code, given, (rows, *steps) = self._function("block", self.real.as_pointer(), I64, I64)
        b = code.b
        differ = code.variable(0)
        for name in OWN:
            row = self._doubles(code, rows, name)
            first = code.load(row, 0)
            with code.lanes(self.width, 1) as j:
                other = b.fcmp_unordered("!=", code.load(row, j), first)
                found = b.or_(code.get(differ).value, b.zext(other, I64))
                code.set(differ, Int(code, found))
        call, arguments = self.module.globals, [rows, *steps, given.pointer]
        with code.when(code.get(differ).equals(0)):
            b.call(call["even"], arguments)
            code.give(0)
        b.call(call["uneven"], arguments)
        code.give(0)

    def _regrid(self) -> None:
        """From states on the grid of one step to states as they are stepped with another.

        ``old`` rows hold the first step, ``new`` ones the second; results go to ``made``.
        """
        regrid = self.formulas.regrid
        if regrid is None:
            return
        pointer = self.real.as_pointer()
        code, given, (old, new, made) = self._function("regrid", pointer, pointer, pointer)
        shared, moment = self._moment(code, given, None)
        assert moment is not None

        def both(rows: Any, j: Int) -> dict[str, Any]:
            later = moment(new, j)
            return {**moment(rows, j), "k": later["h"], "other": later["edge"]}

        with self._evaluated(code, given, old, regrid, (shared, both)) as (j, found):
            at = iter(found)
            for name in ("x", "e"):
                for i in range(self.rows.sizes[name]):
                    code.store_vector(made, j + self.rows.offset(name, i), next(at))
        code.give(0)

    def _tiles(self) -> None:
        """Saves [first, last) of tiles; the number of the tile that was not finished."""
        code, given, (first_tile, last_tile) = self._function("tiles", I64, I64)
        rows, kept = self.rows.count * self.width, self.copied
        sizes = {"rows": rows, "other": rows, "made": rows, "kept": kept, "still": kept}
        sizes["done"] = self.done
        memory = {name: code.room(self.real, n) for name, n in sizes.items()}
        memory |= {name: code.room(I64, self.width) for name in ("far", "left")}
        with code.loop(Int(code, first_tile), Int(code, last_tile)) as tile:
            self._own_tile(code, given, memory, tile)
        code.give(Int(code, last_tile))

    def _own_tile(self, code: Code, given: Given, memory: dict[str, Any], tile: Int) -> None:
        rows, far = memory["rows"], memory["far"]
        b, args = code.b, given.pointer
        call = self.module.globals
        base = tile * self.width
        first = given.whole("first")
        b.call(call["begin"], [rows, memory["done"], tile.value, args])
        loud = self._begin_watch(code, given, rows, far, base)
        step, before, _ = (self._doubles(code, rows, x) for x in OWN)
        with code.when(first > 0), code.lanes(self.width, 1) as j:
            count, _ = self._on_grid(code, given, code.load(step, j), first - 1)
            code.store(before, j, b.sitofp(count.value, REALS["double"]))
        with code.loop(first, given.whole("last")) as save:
            self._leg(code, given, memory, (tile, save), loud)
            slot = Int(code, code.load(given.array("slots", _WHOLE), save))
            with code.when(slot >= 0):
                self._look_between(code, given, memory, (tile, save, slot))
        self._end_tile(code, given, rows, base)

    def _on_grid(self, code: Code, given: Given, step: Any, save: Any) -> tuple[Int, Any]:
        """Steps of a body from the begin to the last before a save, and what is left of one, s.

        What rounding leaves is nothing.
        """
        b = code.b
        double = REALS["double"]

        def size(x: Any) -> Any:
            return b.call(code.intrinsic("llvm.fabs", double), [x])

        t0, time = given.number("t0"), code.load(given.array("times", double.as_pointer()), save)
        ratio = b.fdiv(b.fsub(time, t0), step)
        most = b.fmul(ratio, code.real("double", 1.0 + 4.0 * _EPS))
        whole = b.call(code.intrinsic("llvm.floor", double), [most])
        rest = b.fsub(time, b.fadd(t0, b.fmul(whole, step)))
        rounding = b.fmul(b.fadd(size(t0), size(time)), code.real("double", 16.0 * _EPS))
        is_rest = b.fcmp_ordered(">", size(rest), rounding)
        rest = b.select(is_rest, rest, code.real("double", 0.0))
        return Int(code, b.fptosi(whole, I64)), rest

    def _leg(
        self, code: Code, given: Given, memory: dict[str, Any], at: tuple[Int, Int], loud: Any
    ) -> None:
        """Each body's steps to its last before a save."""
        rows, still, left = memory["rows"], memory["still"], memory["left"]
        tile, save = at
        b = code.b
        base = tile * self.width
        step, before, _ = (self._doubles(code, rows, x) for x in OWN)
        most = code.variable(0)
        with code.lanes(self.width, 1) as j:
            gone = Int(code, b.fptosi(code.load(before, j), I64))
            count = self._on_grid(code, given, code.load(step, j), save)[0] - gone
            code.store(left, j, count.value)
            code.set(most, code.get(most).at_least(count))
            with code.when(count <= 0):
                self._keep(code, rows, still, j)
        n = code.variable(0)
        with code.repeat_while(lambda: code.get(n) < code.get(most)):
            begin = code.get(n)
            stop = code.variable((begin + BLOCK).at_most(code.get(most)))
            with code.lanes(self.width, 1) as j:
                count = Int(code, code.load(left, j))
                with code.when(count > begin):
                    code.set(stop, code.get(stop).at_most(count))
            end = code.get(stop)
            everything = (rows, memory["kept"], memory["done"], memory["far"])
            self._run_block(code, given, everything, (tile, begin, end), loud)
            watch = given.array("watch", self.real.as_pointer())
            last = given.whole("bodies") - 1 - base
            with code.lanes(self.width, 1) as j:
                count = Int(code, code.load(left, j))
                with code.when(b.and_(count >= end, j <= last)):
                    turn = code.load(rows, j + self.rows.offset("turn"))
                    self._raise(code, watch, base + j, turn)
                with code.when(count.equals(end)):
                    self._keep(code, rows, still, j)
            code.set(n, end)
        with code.lanes(self.width, 1) as j:
            self._keep(code, still, rows, j)
            count, _ = self._on_grid(code, given, code.load(step, j), save)
            code.store(before, j, b.sitofp(count.value, REALS["double"]))

    def _keep(self, code: Code, source: Any, target: Any, lane: Int) -> None:
        """A lane's state."""
        with code.loop(0, self.formulas.size) as i:
            code.store(target, i * self.width + lane, code.load(source, i * self.width + lane))

    def _look_between(
        self, code: Code, given: Given, memory: dict[str, Any], at: tuple[Int, Int, Int]
    ) -> None:
        """Hand out the states at a save: after what is left of a step, on a copy."""
        rows, other = memory["rows"], memory["other"]
        tile, save, slot = at
        b, args = code.b, given.pointer
        zero = code.real("double", 0.0)
        with code.lanes(self.rows.count * self.width, self.lanes) as i:
            code.store_vector(other, i, code.vector(rows, i, self.lanes))
        step = self._doubles(code, other, "dt")
        some = code.variable(0)
        with code.lanes(self.width, 1) as j:
            _, rest = self._on_grid(code, given, code.load(step, j), save)
            partly = b.fcmp_unordered("!=", rest, zero)
            code.store(memory["left"], j, b.zext(partly, I64))
            with code.when(partly):
                code.set(some, 1)
                code.store(step, j, rest)
        with code.when(code.get(some) > 0):
            self._partly(code, given, memory, tile)
        b.call(self.module.globals["save"], [other, memory["done"], tile.value, slot.value, args])

    def _partly(self, code: Code, given: Given, memory: dict[str, Any], tile: Int) -> None:
        """One shorter step of the lanes that are marked, in the form that is good for any turn."""
        rows, other, made = memory["rows"], memory["other"], memory["made"]
        b, args = code.b, given.pointer
        regrid = self.formulas.regrid
        if regrid is not None:
            b.call(self.module.globals["regrid"], [rows, other, made, args])
        old = self._doubles(code, rows, "dt")
        _, before, begin = (self._doubles(code, other, x) for x in OWN)
        with (
            code.lanes(self.width, 1) as j,
            code.when(Int(code, code.load(memory["left"], j)) > 0),
        ):
            # the time where the shorter step begins, by the longer ones before it
            gone = b.fmul(code.load(before, j), code.load(old, j))
            code.store(begin, j, b.fadd(code.load(begin, j), gone))
            code.store(before, j, code.real("double", 0.0))
            if regrid is not None:
                for name in ("x", "e"):
                    for i in range(self.rows.sizes[name]):
                        lane = j + self.rows.offset(name, i)
                        code.store(other, lane, code.load(made, lane))
        run = self.module.globals["block"]
        if self.job.has_careful_form:
            run = self._careful_block(code, given, tile)
        b.call(run, [other, code.raw(0), code.raw(1), args])
        with code.lanes(self.width, 1) as j:
            partly = Int(code, code.load(memory["left"], j)) > 0
            one = code.real("double", 1.0)
            code.store(before, j, b.select(partly, one, code.load(before, j)))
            with code.when(b.not_(partly)):
                self._keep(code, rows, other, j)
