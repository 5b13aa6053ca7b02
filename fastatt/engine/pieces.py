"""The pieces of a tile's program: what a block steps, how a tile begins, is saved and mended."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import ir

from fastatt.engine.job import Formulas, Job
from fastatt.engine.layout import Rows, Table
from fastatt.flat.code import I64, REALS, Code, Given, Int
from fastatt.flat.finished import Flat
from fastatt.flat.llvm import POINTERS, Emitter, larger
from fastatt.flat.machine import processor
from fastatt.flat.rows import lanes_of

#: numbers that all lanes share, and a function of rows and lane of those that have a lane a body
Times = tuple[dict[str, Any], Callable[[Any, Int], dict[str, Any]] | None]
#: of bodies with steps of their own: the step, how many were taken, and when they began
OWN = ("dt", "before", "begin")
# φ⁴ steps from one look to the next: pulses of any period meet one before long
PACE = 6.854101966249685


class Pieces:
    """Writes the functions that a program of one job is made of."""

    def __init__(self, job: Job, formulas: Formulas) -> None:
        self.job, self.formulas = job, formulas
        self.kind = job.kind
        self.real = REALS[job.kind]
        self.lanes = lanes_of(job.kind)
        self.width = job.width
        own = 0 if job.shared else formulas.parameters
        #: rows that a row of doubles takes
        self.doubles = 1 if job.kind == "double" else 2
        self.rows = Rows(
            self.width,
            x=formulas.size,
            turn=1,
            e=formulas.extras,
            p=own * self.doubles,
            c=len(formulas.constants.results) * self.doubles,
            invariants=formulas.invariants,
            bound=int(job.known),
            witness=1,
            dt=self.doubles * job.own_steps,
            before=self.doubles * job.own_steps,
            begin=self.doubles * job.own_steps,
        )
        #: numbers of a tile: the states with their turns, and what is given or handed out
        self.copied = (formulas.size + 1) * self.width
        self.done = max(formulas.handed_out + 2, formulas.given) * self.width
        self.module = ir.Module("fastatt")

    def _function(self, name: str, *more: Any) -> tuple[Code, Given, list[Any]]:
        code = Code(self.module, name, [*more, I64.as_pointer()])
        *args, table = code.function.args
        for pointer in args:
            if isinstance(pointer.type, ir.PointerType):
                pointer.add_attribute("noalias")
        return code, Given(code, table, Table), args

    def _emitter(self, code: Code, given: Given) -> Emitter:
        keys = self.formulas.resources
        found = given.array("resources", I64.as_pointer()) if keys else None
        resources = {
            x: code.b.inttoptr(code.load(found, i), POINTERS[x[0]]) for i, x in enumerate(keys)
        }
        return Emitter(code, self.lanes, processor().fuses, resources)

    @contextmanager
    def _evaluated(
        self, code: Code, given: Given, rows: Any, flat: Flat, times: Times, y: Any = None
    ) -> Iterator[tuple[Int, list[Any]]]:
        """(lane, a formula's results) of all lanes, a vector at a time.

        Inputs are rows of the tile, initial values in ``y``, or what ``times`` says: numbers that
        all lanes share, and what gives those that have a lane a body though they lie in no row.
        """
        scalars, wide = times
        emit = self._emitter(code, given)
        before = emit.shared(flat, scalars)
        with code.lanes(self.width, self.lanes) as j:
            own = wide(rows, j) if wide else {}

            def find(name: tuple[Any, ...], kind: str) -> tuple[Any, bool]:
                group, *i = name
                if group in scalars and not i:
                    return scalars[group], False
                if i and i[0] in scalars.get(group, ()):
                    return scalars[group][i[0]], False
                if group in own:
                    return own[group], True
                if group == "y":
                    return code.vector(y, j + i[0] * self.width, self.lanes), True
                if group in ("p", "c"):
                    pointer, at = self._number(code, rows, group, i[0], kind)
                    return code.vector(pointer, j + at, self.lanes), True
                return code.vector(rows, j + self.rows.offset(group, i[0]), self.lanes), True

            yield j, emit.wide(flat, find, before)

    def _number(self, code: Code, rows: Any, group: str, i: int, kind: str) -> tuple[Any, int]:
        """Memory, and where in it a row of either precision begins, of parameters or constants."""
        at = self.rows.offset(group, i * self.doubles)
        if kind == self.kind:
            return rows, at
        return code.b.bitcast(rows, REALS[kind].as_pointer()), at // self.doubles

    def _shared(self, code: Code, given: Given) -> dict[str, Any]:
        """Parameters that all bodies share, as scalars by their numbers."""
        job = self.job
        shared = range(self.formulas.parameters) if job.shared else job.alike
        array = given.array("p", REALS["double"].as_pointer())
        return {"p": {i: code.load(array, i) for i in shared}}

    def _narrow(self, code: Code, value: Any) -> Any:
        """A double, or a vector of such, in the state's precision."""
        if self.kind == "double":
            return value
        vector = isinstance(value.type, ir.VectorType)
        return code.b.fptrunc(value, ir.VectorType(self.real, self.lanes) if vector else self.real)

    def _doubles(self, code: Code, rows: Any, name: str) -> Any:
        """A row of doubles."""
        return code.place(*self._number(code, rows, name, 0, "double"))

    def _clock(self, code: Code, given: Given, made: Any, even: Any = None) -> Times:
        """What ``made`` gives of a step's length, the steps taken and when they began.

        Of bodies with steps of their own that is a vector, unless those in the rows ``even`` are
        equal.
        """
        if even is not None:
            return made(*(code.load(self._doubles(code, even, x), 0) for x in OWN)), None
        if not self.job.own_steps:
            return made(given.number("h"), code.real("double", 0.0), given.number("t0")), None
        return {}, lambda rows, j: made(
            *(code.vector(self._doubles(code, rows, x), j, self.lanes) for x in OWN)
        )

    def _stepping(
        self, code: Code, given: Given, n: Int, parts: tuple[Any, Any, Any] | None, even: Any
    ) -> Times:
        """(t, h, k) of step n.

        ``parts`` are a stage's shares of the step and where in it the other flow acts; ``even`` the
        rows of a tile whose bodies' own steps are equal.
        """
        b = code.b
        numbers = [b.sitofp(n.value, REALS["double"]), *(parts or ())]
        if self.job.own_steps and even is None:
            numbers = [code.splat(x, self.lanes) for x in numbers]

        def made(step: Any, before: Any, begin: Any) -> dict[str, Any]:
            steps, spans = b.fadd(before, numbers[0]), [step, step]
            if parts:  # to a whole number first: the same bits of own steps and of one for all
                steps = b.fadd(steps, numbers[3])
                spans = [b.fmul(x, step) for x in numbers[1:3]]
            h, k = (self._narrow(code, x) for x in spans)
            return {"t": b.fadd(begin, b.fmul(steps, step)), "h": h, "k": k}

        return self._clock(code, given, made, even)

    def _block(self, name: str, forms: Any, look: str, *, even: bool = False) -> None:
        """Steps [first, last) of every lane; ``even`` of lanes whose own steps are equal."""
        code, given, (rows, first, last) = self._function(name, self.real.as_pointer(), I64, I64)
        begin, end = Int(code, first), Int(code, last)
        with code.lanes(self.width, self.lanes) as j:
            zero = code.splat(code.real(self.kind, 0.0), self.lanes)
            code.store_vector(rows, j + self.rows.offset("turn"), zero)
        shared = self._shared(code, given)

        def lanes(noted: bool, n: Int, parts: Any = None) -> None:
            scalars, wide = self._stepping(code, given, n, parts, rows if even else None)
            flat = forms.noted if noted else forms.plain
            times = {**scalars, **shared}, wide
            with self._evaluated(code, given, rows, flat, times) as (j, found):
                for i in range(self.formulas.size):
                    code.store_vector(rows, j + self.rows.offset("x", i), found[i])
                if noted:
                    at = j + self.rows.offset("turn")
                    most = larger(code, code.vector(rows, at, self.lanes), found[-1])
                    code.store_vector(rows, at, most)

        def step(n: Int, noted: bool) -> None:
            if not self.job.method.stages:
                lanes(noted, n)
                return
            stages = given.array("stages", REALS["double"].as_pointer())
            with code.loop(0, given.whole("stage_count")) as i:
                lanes(noted, n, tuple(code.load(stages, i * 3 + k) for k in range(3)))

        if look != "times":
            with code.loop(begin, end) as n:
                step(n, look == "every")
        else:
            self._at_times(code, begin, end, step)
        code.give(0)

    def _at_times(self, code: Code, begin: Int, end: Int, step: Any) -> None:
        """Steps of which some are looked at, and the last; of few, all."""
        b = code.b
        double = REALS["double"]
        pace = code.real("double", PACE)
        few = (end - begin) <= int(PACE)
        at = code.variable(begin)

        def whole_paces(n: Int) -> Any:
            return b.fptosi(b.fdiv(b.sitofp(n.value, double), pace), I64)

        with code.repeat_while(lambda: code.get(at) < end):
            begun = code.get(at)
            paces = Int(code, whole_paces(begun + 1)) + 1
            due = Int(code, b.fptosi(b.fmul(b.sitofp(paces.value, double), pace), I64))
            later = due.at_most(end) - 1
            seen = Int(code, b.select(few, begun.value, later.value))
            with code.loop(begun, seen) as n:
                step(n, False)
            step(seen, True)
            code.set(at, seen + 1)

    def _begin(self) -> None:
        """Load a tile: its bodies' numbers, and the states that they start from."""
        pointer = self.real.as_pointer()
        code, given, (rows, done, tile) = self._function("begin", pointer, pointer, I64)
        base = Int(code, tile) * self.width
        self._gather(code, given, done, base, ("q0", "rows_q"), 0, self.formulas.coordinates)
        beside = self.formulas.given - self.formulas.coordinates
        after = self.formulas.coordinates * self.width
        self._gather(code, given, done, base, ("y0", "rows_y"), after, beside)
        if not self.job.shared:
            own, at = self._number(code, rows, "p", 0, "double")
            self._gather(code, given, own, base, ("p", "rows_p"), at, self.formulas.parameters)
        if self.rows.sizes["c"]:
            constants = self.formulas.constants
            with self._evaluated(code, given, rows, constants, ({}, None)) as (j, found):
                for i, value in enumerate(found):
                    kind = constants.nodes[constants.results[i]].kind
                    pointer, at = self._number(code, rows, "c", i, kind)
                    code.store_vector(pointer, j + at, value)
        if self.job.own_steps:
            self._own_begin(code, given, rows, base)
        times, begin = self._moment(code, given, None), self.formulas.begin
        with self._evaluated(code, given, rows, begin, times, done) as (j, found):
            values = iter(found)
            for name in ("x", "e", "invariants", *(["bound"] if self.job.bounds else [])):
                for i in range(self.rows.sizes[name]):
                    code.store_vector(rows, j + self.rows.offset(name, i), next(values))
        with code.when(given.whole("first") > 0):
            self._gather(code, given, rows, base, ("x", "bodies"), 0, self.formulas.size)
        code.give(0)

    def _gather(
        self, code: Code, given: Given, rows: Any, base: Int, array: tuple[str, str], at: int,
        n: int,
    ) -> None:  # fmt: skip
        """Columns of an array into rows; its last row stands for all bodies after it."""
        if n == 0:
            return
        name, length = array
        pointer = given.array(name, rows.type)
        last = given.whole(length) - 1
        with code.lanes(self.width, 1) as j:
            source = (base + j).at_most(last) * n
            with code.loop(0, n) as i:
                code.store(rows, i * self.width + (j + at), code.load(pointer, source + i))

    def _save(self) -> None:
        """Hand out the states of a tile after n steps, and how far they left what they keep."""
        pointer = self.real.as_pointer()
        code, given, (rows, done, tile, n) = self._function("save", pointer, pointer, I64, I64)
        b = code.b
        steps = Int(code, n)
        size, times = self.formulas.handed_out, self._moment(code, given, steps)
        with self._evaluated(code, given, rows, self.formulas.save, times) as (j, found):
            for i, value in enumerate(found):
                code.store_vector(done, j + i * self.width, value)
        base = Int(code, tile) * self.width
        bodies = given.whole("bodies")
        width = (bodies - base).at_most(self.width)
        stride, slot = given.whole("stride"), self._slot(code, given, steps)
        out, defect, watch = (given.array(x, pointer) for x in ("out", "defect", "watch"))
        with code.loop(0, width) as j:
            body = base + j
            target = (slot * stride + body) * size
            for i in range(size):
                code.store(out, target + i, code.load(done, j + i * self.width))
            far = code.load(done, j + size * self.width)
            code.store(defect, slot * stride + body, far)
            magnitude = b.call(code.intrinsic("llvm.fabs", self.real), [far])
            self._worse(code, watch, bodies + body, magnitude)
            change = code.load(done, j + (size + 1) * self.width)
            self._worse(code, watch, bodies * 2 + body, change)
        code.give(0)

    def _slot(self, code: Code, given: Given, steps: Int) -> Int:
        """Which save is that after so many steps; of steps of each body's own, that number."""
        if self.job.own_steps:
            return steps
        gone = steps - given.whole("origin")
        number = (gone - 1) // given.whole("save_every") + given.whole("slot")
        return Int(code, code.b.select(gone > 0, number.value, code.raw(0)))

    def _moment(self, code: Code, given: Given, n: Int | None) -> Times:
        """What a run's begin (n None), or a save after n steps, needs of times."""
        b, edge = code.b, given.number("edge")
        share = code.splat(edge, self.lanes) if self.job.own_steps else None

        def made(step: Any, before: Any, begin: Any) -> dict[str, Any]:
            if n is not None and share is None:
                before = b.sitofp(n.value, REALS["double"])
            since = b.fmul(before, step)
            spans = {"h": step, "since": since, "edge": b.fmul(share, step) if share else edge}
            narrow = {name: self._narrow(code, x) for name, x in spans.items()}
            return {"t": b.fadd(begin, since), **narrow}

        scalars, wide = self._clock(code, given, made)
        return {**scalars, **self._shared(code, given)}, wide

    def _own_begin(self, code: Code, given: Given, rows: Any, base: Int) -> None:
        """Load each body's step."""
        step, before, begin = (self._doubles(code, rows, x) for x in OWN)
        self._gather(code, given, step, base, ("dt", "rows_own"), 0, 1)
        for row, value in ((before, code.real("double", 0.0)), (begin, given.number("t0"))):
            with code.lanes(self.width, self.lanes) as j:
                code.store_vector(row, j, code.splat(value, self.lanes))

    def _worse(self, code: Code, array: Any, at: Int, value: Any) -> None:
        """Keep the larger of two numbers, or NaN."""
        b = code.b
        before = code.load(array, at)
        keep = b.or_(b.fcmp_ordered(">=", before, value), b.fcmp_unordered("uno", before, before))
        code.store(array, at, b.select(keep, before, value))

    def _mend(self) -> None:
        """Bring the states nearer to their group; how far they had left it is not forgotten."""
        code, given, (rows, tile) = self._function("mend", self.real.as_pointer(), I64)
        size, mend = self.formulas.size, self.formulas.mend
        assert mend is not None
        with self._evaluated(code, given, rows, mend, ({}, None)) as (j, found):
            for i in range(size):
                code.store_vector(rows, j + self.rows.offset("x", i), found[i])
            code.store_vector(rows, j + self.rows.offset("turn"), found[size])
        base, bodies = Int(code, tile) * self.width, given.whole("bodies")
        watch = given.array("watch", self.real.as_pointer())
        with code.loop(0, (bodies - base).at_most(self.width)) as j:
            far = code.load(rows, j + self.rows.offset("turn"))
            self._worse(code, watch, bodies + base + j, far)
        code.give(0)
