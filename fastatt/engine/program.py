"""A job's formulas over the lanes of a tile: one function that Numba compiles, or NumPy's twin.

The function is called with a part, ``run(part, rows, wide, numbers, whole, first, last)``: how a
tile begins, a block of steps, what a save holds, the projection onto the group, and the change to
another step size. ``Layout`` says where in ``rows`` and ``wide`` each number of a lane lies.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from fastatt.codegen.emitter import POINTERS, Emitter, raised
from fastatt.codegen.instructions import REALS, Code
from fastatt.codegen.memory import DTYPES, address_of, aligned
from fastatt.codegen.modules import Emission, generated
from fastatt.codegen.processor import processor
from fastatt.engine.job import Formulas, Job
from fastatt.engine.loop import ADVANCE, BEGIN, PROJECT, REGRID, SAVE
from fastatt.engine.status import SAVED
from fastatt.tracing import source
from fastatt.tracing.finished import Flat, without_shared_calls
from fastatt.tracing.nodes import Node

#: the first of ``numbers``; parameters that bodies share follow, then a method's stages
T0, H, EDGE, PARAMETERS = range(4)
#: the first of ``whole``: the number of stages; addresses of tables and functions follow
STAGES, RESOURCES = range(2)
#: per-body steps: the step size, the steps taken before, the time at which they began, s, and the
#: step size that a tile's lanes change to
CLOCK = ("dt", "before", "begin", "other")

Array = NDArray[Any]


class Rows:
    """Where the numbers of a lane lie in an array of rows, by the names of groups."""

    def __init__(self, **sizes: int) -> None:
        self.sizes, self.count = sizes, sum(sizes.values())
        self.first = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))


class Layout:
    """The memory of a tile: ``rows`` of the state's precision, ``wide`` ones of doubles."""

    def __init__(self, formulas: Formulas) -> None:
        job = formulas.job
        kinds = formulas.constant_kinds
        self.constants = [(kind != job.kind, kinds[:i].count(kind)) for i, kind in enumerate(kinds)]
        self.rows = Rows(
            x=formulas.size,
            angle=1,
            e=formulas.extras,
            invariants=formulas.invariants,
            bound=int(job.known),
            c=kinds.count(job.kind),
            io=max(formulas.handed_out + len(SAVED), formulas.given),
        )
        own = {name: int(job.own_steps) for name in CLOCK}
        others = sum(kind != job.kind for kind in kinds)
        p = 0 if job.shared else formulas.parameters
        self.wide = Rows(p=p, c=others, **own, called=formulas.calls)

    def row(self, group: str, i: int) -> tuple[bool, int]:
        """(whether among the wide ones, number of the row)."""
        if group == "y":
            return False, self.rows.first["io"] + i
        if group == "c":
            wide, k = self.constants[i]
            return wide, (self.wide if wide else self.rows).first["c"] + k
        if group in self.wide.first:
            return True, self.wide.first[group] + i
        return False, self.rows.first[group] + i


@dataclass(frozen=True)
class Formula:
    """A formula over lanes: its graph, where results go, and what its times are.

    ``targets`` are (group, number) of the results; ``clock`` is "moment" for a state after so many
    steps, "step", "stage", or "" where no time occurs. Steps of ``even`` lanes have one clock.
    ``lanes`` is 1 of what is found once for all lanes, else 0.
    """

    flat: Flat = field(repr=False)
    targets: tuple[tuple[str, int], ...]
    clock: str = ""
    even: bool = False
    lanes: int = 0


class Program:
    """The function of a job; the form for any rotation angle is compiled when it is first needed.

    ``entry`` is an address, or a Python function where Numba is switched off.
    """

    def __init__(self, job: Job, *, plain: bool = False) -> None:
        self.job, self.formulas, self.plain = job, job.formulas, plain
        self.layout = Layout(self.formulas)
        self._lock, self._threads = threading.Lock(), threading.local()
        self._any_angle: Any = None
        self._made = self._compiled(small_angle=True)
        self.entry = self._made if plain else self._made.address

    @property
    def any_angle(self) -> Any:
        """The same of the form for any angle; 0 where it was not asked for yet."""
        if self._any_angle is None:
            return 0
        return self._any_angle if self.plain else self._any_angle.address

    def compile_any_angle(self) -> None:
        """Compile the form for any angle, if it is not there."""
        with self._lock:
            if self._any_angle is None:
                self._any_angle = self._compiled(small_angle=False)

    def memory(self) -> list[Any]:
        """Memory of a tile for the calling thread, as the loop takes it."""
        found: list[Any] | None = getattr(self._threads, "memory", None)
        if found is None:
            self._threads.arrays = found = self._new_memory()
            if not self.plain:
                found = [address_of(x) for x in found]
            self._threads.memory = found
        return found

    def _new_memory(self) -> list[Array]:
        """Arrays whose rows lie at multiples of a cache line."""
        job, layout = self.job, self.layout
        width, kind = job.width, DTYPES[job.kind]
        copies = int(job.own_steps)

        def rows(n: int, dtype: np.dtype[Any]) -> Array:
            return aligned(n * width, dtype)

        n_rows, n_wide = layout.rows.count, layout.wide.count
        size, double, whole = self.formulas.size, DTYPES["double"], np.dtype(np.int64)
        return [
            rows(n_rows, kind), rows(n_wide, double), rows(size + 1, kind), rows(1, whole),
            rows(1, whole), rows(size * copies, kind), rows(1, whole), rows(n_rows * copies, kind),
            rows(n_wide * copies, double),
        ]  # fmt: skip

    def _compiled(self, *, small_angle: bool) -> Any:
        if self.plain:
            return _PlainProgram(self, self._formulas(small_angle))
        return _Writer(self).compiled(self._formulas(small_angle))

    def _formulas(self, small_angle: bool) -> dict[str, Formula]:
        """The formulas by name; of the form for any angle the step alone."""
        forms, job = self.formulas, self.job
        step = forms.quick if small_angle else forms.careful
        assert step is not None
        noted = job.look != "never" or not small_angle
        flat = step.noted if noted else step.plain
        clock = "stage" if job.method.stages else "step"
        targets = _targets(x=forms.size, angle=int(noted))
        found = self._split("step", Formula(flat, targets, clock))
        if job.own_steps and forms.is_timed:
            found |= self._split("even_step", Formula(flat, targets, clock, even=True))
        if not small_angle:
            return found
        if forms.constant_kinds:
            found["constants"] = Formula(forms.constants, _targets(c=len(forms.constant_kinds)))
        begun = _targets(
            x=forms.size, e=forms.extras, invariants=forms.invariants, bound=int(job.bounds)
        )
        found["begin"] = Formula(forms.begin, begun, "moment")
        found["save"] = Formula(forms.save, _targets(io=forms.handed_out + len(SAVED)), "moment")
        if forms.mend is not None:
            found["project"] = Formula(forms.mend, _targets(x=forms.size, io=1))
        if job.own_steps and forms.regrid is not None:
            found["regrid"] = Formula(
                forms.regrid, _targets(x=forms.size, e=forms.extras), "moment"
            )
        return found

    def _split(self, name: str, formula: Formula) -> dict[str, Formula]:
        """A step, and the calls of functions that are the same for all lanes."""
        job = self.job
        own_clock = job.own_steps and not formula.even

        def is_shared(node: Node) -> bool:
            group, *i = node.args
            if not i:
                return not own_clock
            return group == "p" and (job.shared or i[0] in job.alike)

        calls, rest = without_shared_calls(formula.flat, is_shared)
        found = {name: replace(formula, flat=rest)}
        if calls is not None:
            targets = _targets(called=len(calls.results))
            found[f"{name}_calls"] = replace(formula, flat=calls, targets=targets, lanes=1)
        return found


def _targets(**sizes: int) -> tuple[tuple[str, int], ...]:
    return tuple((group, i) for group, n in sizes.items() for i in range(n))


# machine code

_CALL = "for j in range(0, {width}, {lanes}): {name}(rows, wide, numbers, whole, j, {n}, {i})"
_ONCE = "{name}(rows, wide, numbers, whole, 0, {n}, {i})"


class _Writer:
    """Writes the text of a program's function, and emits the formulas that it calls."""

    def __init__(self, program: Program) -> None:
        self.program, self.job, self.layout = program, program.job, program.layout
        self.kind, self.width = self.job.kind, self.job.width
        self.lanes = processor().lanes(self.kind)
        real = types.float64 if self.kind == "double" else types.float32
        number, whole = types.CPointer(types.float64), types.CPointer(types.int64)
        self.pointers = (types.CPointer(real), number, number, whole)

    def compiled(self, formulas: dict[str, Formula]) -> Any:
        """The function, compiled or loaded from disk."""
        key = repr((self.kind, self.width, vars(self.layout.rows), vars(self.layout.wide)))
        key += repr(self.layout.constants) + repr(sorted(self._shared().items()))
        keys = self.resources
        key += "".join(f"{name}{x.flat.spelled(keys)}{x}" for name, x in formulas.items())
        emissions = {name: self._emission(formula) for name, formula in formulas.items()}
        arguments = (types.int64, *self.pointers, types.int64, types.int64)
        return generated(self._text(formulas), arguments, emissions, key)

    def _text(self, formulas: dict[str, Formula]) -> str:
        def lanes(name: str, n: str = "first", i: str = "0") -> str:
            return _CALL.format(width=self.width, lanes=self.lanes, name=name, n=n, i=i)

        lines = ["def run(part, rows, wide, numbers, whole, first, last):"]
        parts = {BEGIN: ("constants", "begin"), SAVE: ("save",), PROJECT: ("project",)}
        for part, names in {**parts, REGRID: ("regrid",)}.items():
            there = [name for name in names if name in formulas]
            if there:
                lines += [f"    if part == {part}:", *(f"        {lanes(name)}" for name in there)]
        lines.append(f"    if part == {ADVANCE}:")
        angle = self.layout.rows.first["angle"] * self.width
        lines.append(f"        for j in range({angle}, {angle + self.width}): rows[j] = 0.0")
        depth = "        "
        if "even_step" in formulas:
            first = [self.layout.wide.first[name] * self.width for name in CLOCK[:3]]
            lines += [f"{depth}even = True", f"{depth}for j in range({self.width}):"]
            lines += [f"{depth}    even = even and wide[{k} + j] == wide[{k}]" for k in first]
            inner = depth + "    "
            lines += [f"{depth}if even:", *self._steps(formulas, lanes, "even_step", inner)]
            lines += [f"{depth}else:", *self._steps(formulas, lanes, "step", inner)]
        else:
            lines += self._steps(formulas, lanes, "step", depth)
        return "\n".join([*lines, ""])

    def _steps(
        self, formulas: dict[str, Formula], lanes: Callable[..., str], name: str, depth: str
    ) -> Iterator[str]:
        stages = bool(self.job.method.stages)
        i, inner = ("i", depth + "        ") if stages else ("0", depth + "    ")
        yield f"{depth}for n in range(first, last):"
        if stages:
            yield f"{depth}    for i in range(whole[{STAGES}]):"
        if f"{name}_calls" in formulas:
            yield inner + _ONCE.format(name=f"{name}_calls", n="n", i=i)
        yield inner + lanes(name, "n", i)

    def _shared(self) -> dict[int, int]:
        """Places among ``numbers`` of the parameters that bodies share."""
        n = self.program.formulas.parameters
        shared = range(n) if self.job.shared else self.job.alike
        return {i: PARAMETERS + i for i in shared}

    def _emission(self, formula: Formula) -> Emission:
        def emit(code: Code, args: Sequence[Any]) -> None:
            _Emitted(self, code, args, formula.lanes or self.lanes).write(formula)

        return (*self.pointers, *[types.int64] * 3), emit

    @property
    def resources(self) -> list[Any]:
        """Tables and functions that the formulas refer to."""
        return self.program.formulas.resources

    def shared_place(self, group: str, i: int) -> int | None:
        """Place among ``numbers`` of a parameter that all bodies share; None of another."""
        return self._shared().get(i) if group == "p" else None

    @property
    def stages_place(self) -> int:
        """Place of the stages among ``numbers``."""
        return PARAMETERS + self.program.formulas.parameters


class _Emitted:
    """One formula, written where a call of it stands."""

    def __init__(self, writer: _Writer, code: Code, args: Sequence[Any], lanes: int) -> None:
        self.writer, self.code, self.lanes = writer, code, lanes
        self.rows, self.wide, self.numbers, self.whole, self.lane, self.steps, self.stage = args

    def write(self, formula: Formula) -> None:
        """Load what the graph takes, write its operations, store the results."""
        code, keys = self.code, self.writer.resources
        resources = {
            key: code.b.inttoptr(code.constant_load(self.whole, RESOURCES + i), POINTERS[key[0]])
            for i, key in enumerate(keys)
        }
        emit = Emitter(code, self.lanes, processor().fuses, resources)
        times = self._times(formula)

        def find(name: tuple[Any, ...], kind: str) -> tuple[Any, bool]:
            if len(name) == 1:
                value = times[name[0]]
                return value, hasattr(value.type, "count")  # a vector
            at = self.writer.shared_place(*name)
            if at is not None:
                return code.constant_load(self.numbers, at), False
            if name[0] == "called":
                _, row = self.writer.layout.row(*name)
                return code.load(self.wide, row * self.writer.width), False
            return code.vector(*self._place(*name), self.lanes), True

        for target, value in zip(formula.targets, emit.wide(formula.flat, find), strict=True):
            pointer, at = self._place(*target)
            if target == ("angle", 0):
                value = raised(code, code.vector(pointer, at, self.lanes), value)  # noqa: PLW2901
            code.store_vector(pointer, at, value)

    def _place(self, group: str, i: int) -> tuple[Any, Any]:
        is_wide, row = self.writer.layout.row(group, i)
        at = self.code.b.add(self.lane, self.lane.type(row * self.writer.width))
        return (self.wide if is_wide else self.rows), at

    def _times(self, formula: Formula) -> dict[str, Any]:
        """The times of a formula, in the precision that the graph takes them in."""
        if not formula.clock:
            return {}
        code, b, own = self.code, self.code.b, self.writer.job.own_steps and not formula.even
        double = REALS["double"]

        def wide(x: Any) -> Any:
            return code.splat(x, self.lanes) if own else x

        def number(at: int) -> Any:
            return wide(code.constant_load(self.numbers, at))

        def clock(name: str) -> Any:
            at = self.writer.layout.wide.first[name] * self.writer.width
            if own:
                at = b.add(self.lane, self.lane.type(at))
                return code.vector(self.wide, at, self.lanes)
            return code.constant_load(self.wide, at)

        per_body = self.writer.job.own_steps
        step, begin = (clock("dt"), clock("begin")) if per_body else (number(H), number(T0))
        steps = wide(b.sitofp(self.steps, double))
        if per_body:
            # a state's own count says when it is; a block counts from there
            steps = clock("before") if formula.clock == "moment" else b.fadd(clock("before"), steps)
        found = {}
        if formula.clock == "stage":
            first = b.mul(self.stage, self.stage.type(3))
            first = b.add(first, self.stage.type(self.writer.stages_place))
            one = self.stage.type(1)
            places = (first, b.add(first, one), b.add(first, self.stage.type(2)))
            h, k, at = (wide(code.constant_load(self.numbers, x)) for x in places)
            # to a whole number first: the same bits for per-body steps and for one step for all
            steps = b.fadd(steps, at)
            found = {"h": b.fmul(h, step), "k": b.fmul(k, step)}
        elif formula.clock == "step":
            found = {"h": step, "k": step}
        since = b.fmul(steps, step)
        if formula.clock == "moment":
            share = number(EDGE)
            edge = b.fmul(share, step) if per_body else share
            found = {"h": step, "since": since, "edge": edge}
            if per_body:
                other = clock("other")
                found |= {"k": other, "other": b.fmul(share, other)}
        narrow = {name: code.narrow(self.writer.kind, x) for name, x in found.items()}
        return {"t": b.fadd(begin, since), **narrow}


# without machine code


class _PlainProgram:
    """The same function in NumPy, for ``NUMBA_DISABLE_JIT=1``: operations are not fused."""

    def __init__(self, program: Program, formulas: dict[str, Formula]) -> None:
        self.program, self.formulas, self.job = program, formulas, program.job
        self._dtype = DTYPES[self.job.kind]
        self._made: dict[str, tuple[Any, Any]] = {}

    def __call__(
        self, part: int, rows: Array, wide: Array, numbers: Array, whole: Any, first: int, last: int
    ) -> None:
        width = self.job.width
        rows, wide = rows.reshape(-1, width), wide.reshape(-1, width)
        memory = rows, wide, numbers, whole
        with np.errstate(all="ignore"):
            if part == BEGIN:
                self._apply("constants", memory, first)
                self._apply("begin", memory, first)
            elif part == ADVANCE:
                rows[self.program.layout.rows.first["angle"]] = 0.0
                for n in range(first, last):
                    for i in range(max(1, len(self.job.method.stages))):
                        self._apply("step_calls", memory, n, i)
                        self._apply("step", memory, n, i)
            else:
                self._apply(
                    {SAVE: "save", PROJECT: "project", REGRID: "regrid"}[part], memory, first
                )

    def _apply(self, name: str, memory: Any, n: int, i: int = 0) -> None:
        formula = self.formulas.get(name)
        if formula is None:
            return
        rows, wide, numbers, tables = memory
        times = self._times(formula, memory, n, i)

        def row(group: str, k: int) -> Array:
            is_wide, at = self.program.layout.row(group, k)
            return (wide if is_wide else rows)[at]  # type: ignore[no-any-return]

        def value(node: Any) -> Any:
            group, *k = node.args
            if not k:
                return np.asarray(times[group], DTYPES[node.kind])
            if group == "p" and (self.job.shared or k[0] in self.job.alike):
                return numbers[PARAMETERS + k[0]]
            return row(group, k[0])

        given = [value(node) for node in formula.flat.nodes if node.op == "in"]
        results = self._function(name, tables)(*given)
        for target, result in zip(formula.targets, results, strict=True):
            place = row(*target)
            place[:] = np.fmax(place, result) if target == ("angle", 0) else result

    def _function(self, name: str, tables: Any) -> Any:
        # a program serves every scene of a structure, each with tables of its own
        made = self._made.get(name)
        if made is None or made[0] is not tables:
            named = {key[1]: x for key, x in tables if key[0] == "table"}
            made = tables, source.function(self.formulas[name].flat, tables=named)
            self._made[name] = made
        return made[1]

    def _times(self, formula: Formula, memory: Any, n: int, i: int) -> dict[str, Any]:
        _, wide, numbers, _ = memory
        if not formula.clock:
            return {}
        step, begin, before, other = numbers[H], numbers[T0], float(n), 0.0
        if self.job.own_steps:
            step, gone, begin, other = (wide[self.program.layout.row(x, 0)[1]] for x in CLOCK)
            before = gone if formula.clock == "moment" else gone + n
        if formula.clock == "stage":
            h, k, at = self.job.method.stages[i]
            return {"t": begin + (before + at) * step, "h": h * step, "k": k * step}
        since = before * step
        if formula.clock == "step":
            return {"t": begin + since, "h": step, "k": step}
        share = numbers[EDGE]
        edge = share * step if self.job.own_steps else share
        times = {"t": begin + since, "h": step, "since": since, "edge": edge}
        return {**times, "k": other, "other": share * other}
