"""The formulas of a job over the lanes of a tile, in one generated function.

The function is called with a part, ``run(part, rows, wide, numbers, whole, first, last)``: the
begin of a tile, a block of steps, the values of a save, the projection, the conversions to another
step size, to the state and from it, the functions of events, and the jump of states at a sample
time. ``Layout`` defines where in ``rows`` and ``wide`` each number of a lane lies.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.lanes import LaneFormula, LaneProgram, Place, Shape, StepTimes
from fastatt.codegen.memory import DTYPES, aligned
from fastatt.codegen.processor import processor
from fastatt.codegen.two_forms import TwoForms
from fastatt.engine.crossings import EVENT_ROWS
from fastatt.engine.job import Formulas, Job
from fastatt.engine.status import SAVED
from fastatt.engine.stops import ADVANCE, BEGIN, ENTER, LEAVE, PROJECT, SAVE, UPDATE, WATCH
from fastatt.tracing.finished import Flat, without_shared_calls
from fastatt.tracing.graph import Graph
from fastatt.tracing.nodes import Node

#: arrays of a program; all but the last have rows
ROWS, WIDE, NUMBERS = range(3)
#: the first of ``numbers``; parameters that bodies share follow, then a method's stages
T0, H, EDGE, PARAMETERS = range(4)
#: the clock of a lane: the step size, the steps taken before, the time at which they began, s, and
#: the least and the largest time at which rates, torques and forces are evaluated
CLOCK = ("dt", "before", "begin", "low", "high")

Array = NDArray[Any]


class Rows:
    """The positions of a lane's numbers in an array of rows, by the names of groups."""

    def __init__(self, **sizes: int) -> None:
        self.sizes, self.count = sizes, sum(sizes.values())
        self.first = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))


class Layout:
    """The memory of a tile: ``rows`` in the state's precision, ``wide`` ones of doubles."""

    def __init__(self, formulas: Formulas) -> None:
        job = formulas.job
        kinds = formulas.constant_kinds
        self.constants = [(kind != job.kind, kinds[:i].count(kind)) for i, kind in enumerate(kinds)]
        self.rows = Rows(
            x=formulas.size,
            event=EVENT_ROWS * len(job.events),
            angle=1,
            e=formulas.extras,
            invariants=formulas.invariants,
            bound=int(job.known),
            c=kinds.count(job.kind),
            io=max(formulas.handed_out + len(SAVED), formulas.given),
        )
        own = {name: int(job.own_steps or bool(job.events)) for name in CLOCK}
        others = sum(kind != job.kind for kind in kinds)
        p = 0 if job.shared else formulas.parameters
        self.wide = Rows(p=p, c=others, **own, called=formulas.calls)

    def row(self, group: str, i: int) -> tuple[bool, int]:
        """(whether in ``wide``, number of the row)."""
        if group == "y":
            return False, self.rows.first["io"] + i
        if group == "c":
            wide, k = self.constants[i]
            return wide, (self.wide if wide else self.rows).first["c"] + k
        if group in self.wide.first:
            return True, self.wide.first[group] + i
        return False, self.rows.first[group] + i


class Program(TwoForms):
    """The function of a job in its two forms."""

    def __init__(self, job: Job, *, plain: bool = False) -> None:
        self.job, self.formulas = job, job.formulas
        self.layout = Layout(self.formulas)
        super().__init__(plain=plain)

    def _new_memory(self) -> list[Array]:
        """Arrays whose rows lie at multiples of a cache line."""
        job, layout = self.job, self.layout
        width, kind = job.width, DTYPES[job.kind]
        copies = int(job.own_steps)

        def rows(n: int, dtype: np.dtype[Any]) -> Array:
            return aligned(n * width, dtype)

        n_rows, n_wide = layout.rows.count, layout.wide.count
        double, whole = DTYPES["double"], np.dtype(np.int64)
        carried = layout.rows.first["angle"] + 1
        return [
            rows(n_rows, kind), rows(n_wide, double), rows(carried, kind), rows(1, whole),
            rows(1, whole), rows((carried - 1) * copies, kind), rows(1, whole),
            rows(n_rows * copies, kind), rows(n_wide * copies, double),
            *([rows(11, double), rows(9, whole)] if job.is_searched else []),
            *([rows(carried - 1, kind)] if job.events and not job.is_searched else []),
        ]  # fmt: skip

    def _compiled(self, *, small_angle: bool) -> Any:
        formulas = self._formulas(small_angle)
        job = self.job
        lanes = job.width if self.plain else processor().lanes(job.kind)
        made = LaneProgram(
            "\n".join([*self._text(formulas, lanes), ""]), formulas,
            Shape(job.kind, job.width, lanes), (job.kind, "double", "double"),
            self.formulas.resources,
        )  # fmt: skip
        return made.in_python() if self.plain else made.compiled()

    def _formulas(self, small_angle: bool) -> dict[str, LaneFormula]:
        """The formulas by name; for the any-angle form the step alone."""
        forms, job = self.formulas, self.job
        # shorter steps take the any-angle form, if there is one
        has_small = small_angle and not (job.is_searched and job.has_any_angle_form)
        step = forms.small_angle if has_small else forms.any_angle
        assert step is not None
        monitored = job.monitored or not has_small
        flat = step.monitored if monitored else step.plain
        results = self._results(x=forms.size, angle=int(monitored))
        clock = "stage" if job.method.stages else "step"
        found = self._step("step", flat, results, clock, even=False)
        if job.own_steps and forms.is_timed and not job.is_searched:
            found |= self._step("even_step", flat, results, clock, even=True)

        def add(name: str, flat: Flat | None, clock: str = "", **sizes: int) -> None:
            if flat is not None:
                found[name] = self._formula(flat, self._results(**sizes), clock)

        if job.events and not job.is_searched:
            add("watch", forms.watch, "moment", event=EVENT_ROWS * len(job.events))
        if not small_angle:
            return found
        add("events", forms.events if job.events else None, "moment", event=len(job.events))
        constants = len(forms.constant_kinds)
        add("constants", forms.constants if constants else None, c=constants)
        add(
            "begin", forms.begin, "moment", x=forms.size, e=forms.extras,
            invariants=forms.invariants, bound=int(job.bounds),
        )  # fmt: skip
        add("save", forms.save, "moment", io=forms.handed_out + len(SAVED))
        add("project", forms.project, x=forms.size, io=1)
        if job.own_steps:
            add("leave", forms.leave, "moment", x=forms.size)
            add("enter", forms.enter, "moment", x=forms.size, e=forms.extras)
            add("update", None if job.is_searched else forms.update, "moment", x=forms.size)
        return found

    def _step(
        self, name: str, flat: Flat, results: list[Place], clock: str, *, even: bool
    ) -> dict[str, LaneFormula]:
        """A step, and calls of functions with the same arguments for all lanes."""
        job = self.job

        def is_shared(node: Node) -> bool:
            group, *i = node.args
            if not i:
                return even or not job.own_steps
            return group == "p" and (job.shared or i[0] in job.alike)

        calls, rest = without_shared_calls(flat, is_shared)
        largest = self.formulas.size if len(results) > self.formulas.size else None
        found = {name: self._formula(rest, results, clock, even=even)._replace(largest=largest)}
        if calls is not None:
            called = self._results(called=len(calls.results))
            made = self._formula(calls, called, clock, even=even)
            found[f"{name}_calls"] = made._replace(lanes=1)
        return found

    def _formula(
        self, flat: Flat, results: list[Place], clock: str, *, even: bool = False
    ) -> LaneFormula:
        """A formula; steps of ``even`` lanes share one clock."""
        time = self._clock(clock) if clock else None
        names = set(flat.inputs())
        if time is not None:
            names = (names - {*time.names}) | {*time.flat.inputs()} - {("n",)}
        inputs = {name: self._place(*name, even=even) for name in names}
        return LaneFormula(flat, inputs, results, clock=time)

    def _clock(self, which: str) -> StepTimes:
        """The times of a state after some steps, of a "moment", of a "step" or of a "stage"."""
        graph, own = Graph(), self.job.own_steps
        n, dt, begin = (graph.input("double", name) for name in ("n", "dt", "begin"))
        steps: Any = n
        if own:
            steps = graph.input("double", "before") + n
        found = {"h": dt, "k": dt}
        if which == "stage":
            h, k, at = graph.inputs("double", "stage", 3)
            # to a whole number first, for the same bits with one step size and with per-body ones
            steps = steps + at
            found = {"h": h * dt, "k": k * dt}
        since = steps * dt
        if which == "moment":
            share = graph.input("double", "share")
            found = {"h": dt, "edge": share * dt}
        # as a separate result, the time interval is rounded before it is added
        exact = {"whole": since, "t": begin + since}
        found["since"] = since
        kinds = ["double"] * len(exact) + [self.job.kind] * len(found)
        names = [(name,) for name in (*exact, *found)]
        return StepTimes(Flat(graph, [*exact.values(), *found.values()], kinds), names)

    def _results(self, **sizes: int) -> list[Place]:
        return [self._row(group, i) for group, n in sizes.items() for i in range(n)]

    def _row(self, group: str, i: int) -> Place:
        is_wide, row = self.layout.row(group, i)
        return Place(row, WIDE if is_wide else ROWS)

    def _place(self, group: str, i: int = 0, *, even: bool) -> Place:
        """The place of an input."""
        job, width = self.job, self.job.width
        if group == "p" and (job.shared or i in job.alike):
            return Place(PARAMETERS + i, NUMBERS, "shared")
        if group == "stage":
            return Place(PARAMETERS + self.formulas.parameters + i, NUMBERS, "indexed")
        if group == "share" or (group in CLOCK and not job.own_steps):
            return Place({"share": EDGE, "dt": H, "begin": T0}[group], NUMBERS, "shared")
        row = self._row(group, i)
        if group == "called" or (group in CLOCK and even):
            at = row.row * width
            return Place(at, row.array, "computed" if group == "called" else "shared")
        return row

    def _text(self, formulas: dict[str, LaneFormula], lanes: int) -> Iterator[str]:
        width = self.job.width

        def call(name: str, n: str = "first", i: str = "0", j: str = "j") -> str:
            steps = "" if formulas[name].clock is None else f", {n}"
            return f"{name}(rows, wide, numbers, whole, {j}, {j}, {i}{steps})"

        def steps(name: str, depth: str) -> Iterator[str]:
            yield f"{depth}for n in range(first, last):"
            i, inner = "0", depth + "    "
            if self.job.method.stages:
                # the number of stages comes after the resources
                yield f"{inner}for i in range(whole[{len(self.formulas.resources)}]):"
                i, inner = "3 * i", inner + "    "
            if f"{name}_calls" in formulas:
                yield inner + call(f"{name}_calls", "n", i, "0")
            yield f"{inner}for j in range(0, {width}, {lanes}): {call(name, 'n', i)}"
            if "watch" in formulas:
                watch = call("watch", "n + 1")
                yield f"{depth}    for j in range(0, {width}, {lanes}): {watch}"

        yield "def run(part, rows, wide, numbers, whole, first, last):"
        parts = [(BEGIN, "constants"), (BEGIN, "begin"), (SAVE, "save")]
        parts += [(PROJECT, "project"), (LEAVE, "leave"), (ENTER, "enter"), (WATCH, "events")]
        parts += [(UPDATE, "update")]
        there = [(part, name) for part, name in parts if name in formulas]
        if there:
            # one loop for all stages, since Numba compiles a condition faster than a loop
            yield f"    if part != {ADVANCE}:"
            yield f"        for j in range(0, {width}, {lanes}):"
            yield from (f"            if part == {part}: {call(name)}" for part, name in there)
            yield "        return"
        if "even_step" not in formulas:
            yield from steps("step", "    ")
            return
        yield "    even = True"
        yield f"    for j in range({width}):"
        for name in CLOCK[:3]:
            k = self.layout.wide.first[name] * width
            yield f"        even = even and wide[{k} + j] == wide[{k}]"
        yield "    if even:"
        yield from steps("even_step", "        ")
        yield "    else:"
        yield from steps("step", "        ")
