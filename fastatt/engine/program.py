"""The formulas of a job over the lanes of a tile, in one generated function.

The function is called with a part, ``run(part, rows, wide, numbers, whole, first, last)``; the
parts are the first actions of ``engine.tape``. ``Layout`` defines where in ``rows`` and ``wide``
each number of a lane lies.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.lanes import LaneFormula, LaneProgram, Place, Shape, StepTimes
from fastatt.codegen.memory import DTYPES, aligned
from fastatt.codegen.modules import MachineCode
from fastatt.codegen.processor import processor
from fastatt.codegen.two_forms import TwoForms
from fastatt.engine import events
from fastatt.engine.job import WIDTH, Formulas, Job
from fastatt.engine.machine import PROGRAM, TIME, Tile
from fastatt.engine.status import DIAGNOSTICS, SAVED
from fastatt.engine.tape import Action
from fastatt.tracing.finished import Flat, without_shared_calls
from fastatt.tracing.graph import Graph
from fastatt.tracing.nodes import Node

Array = NDArray[Any]


def _firsts(**sizes: int) -> dict[str, int]:
    """The position of the first number of each group, and the ``total`` of all sizes."""
    return dict(zip((*sizes, "total"), accumulate(sizes.values(), initial=0), strict=True))


class Layout:
    """The memory of a tile.

    ``rows`` are in the state's precision, ``wide`` are doubles; ``numbers``, which all lanes share,
    are the time, the limits of the diagnostics, parameters, and a method's stages.
    """

    def __init__(self, formulas: Formulas) -> None:
        job = formulas.job
        constants = formulas.constants
        kinds = [constants.nodes[i].kind for i in constants.results]
        self.constants = [(kind != job.kind, kinds[:i].count(kind)) for i, kind in enumerate(kinds)]
        watched = events.sizes(job.events, formulas.size, formulas.extras)
        #: what a body takes with it from one tape to the next
        self.kept = {
            "x": formulas.size, "e": formulas.extras, "invariants": formulas.invariants,
            **watched, "angle": 1, "largest": len(SAVED), "status": 1,
        }  # fmt: skip
        #: which of these belong to events
        self.is_watched = np.repeat([x in watched for x in self.kept], [*self.kept.values()])
        handed_out = max(formulas.handed_out + 1, formulas.given)
        self.rows = _firsts(**self.kept, c=kinds.count(job.kind), io=handed_out)
        others = sum(kind != job.kind for kind in kinds)
        p = 0 if job.shared else formulas.parameters
        self.wide = _firsts(p=p, c=others, called=formulas.calls)
        self.numbers = _firsts(
            **dict.fromkeys(TIME.names or (), 1), limit=len(DIAGNOSTICS), p=formulas.parameters,
            stage=3 * len(job.method.stages),
        )  # fmt: skip

    def place(self, group: str, i: int = 0) -> Place:
        """The place of a number with a row of lanes."""
        if group == "y":
            return Place(self.rows["io"] + i)
        if group == "c":
            is_wide, k = self.constants[i]
            if is_wide:
                return Place(self.wide["c"] + k, "wide")
            return Place(self.rows["c"] + k)
        if group in self.wide:
            return Place(self.wide[group] + i, "wide")
        return Place(self.rows[group] + i)

    def places(self, **sizes: int) -> list[Place]:
        """The places of groups of numbers."""
        return [self.place(group, i) for group, n in sizes.items() for i in range(n)]


class Program(TwoForms):
    """The function of a job with small-angle steps, and that with any-angle steps."""

    def __init__(self, job: Job) -> None:
        self.job, self.formulas = job, job.formulas
        self.layout = Layout(self.formulas)
        super().__init__()

    def record(self, tables: int) -> Array:
        """What the machine has to know, with the address of the tables."""
        rows, record = self.layout.rows, np.zeros(1, PROGRAM)
        record["small_angle"], record["any_angle"] = self.entry, self.any_angle
        record["tables"], record["coordinates"] = tables, self.formulas.coordinates
        record["fork"], record["angle"], record["io"] = rows["middle"], rows["angle"], rows["io"]
        return record

    def _new_memory(self) -> tuple[Tile, Array, Array, Array]:
        """A thread's tile with its numbers, and two copies of rows."""
        layout, kind = self.layout, DTYPES[self.job.kind]
        numbers = aligned(layout.numbers["total"], DTYPES["double"])
        rows = self._rows(layout.rows["total"], kind)
        wide = self._rows(layout.wide["total"], DTYPES["double"])
        tile = Tile(rows, wide, numbers[: layout.numbers["limit"]].view(TIME))
        before, fork = (self._rows(layout.rows["largest"], kind) for _ in range(2))
        return tile, numbers, before, fork

    def _rows(self, n: int, kind: Any) -> Array:
        """Rows that begin at multiples of a cache line."""
        return aligned(max(1, n) * self.job.width, kind).reshape(-1, self.job.width)

    def _compiled(self, *, small_angle: bool) -> MachineCode:
        job, formulas = self.job, self._formulas(small_angle)
        lanes = processor().lanes(job.kind)
        return LaneProgram(
            "\n".join([*self._text(formulas, lanes), ""]), formulas,
            Shape(job.kind, job.width, lanes),
            {"rows": job.kind, "wide": "double", "numbers": "double"},
            self.formulas.resources,
        ).compiled()  # fmt: skip

    def _formulas(self, small_angle: bool) -> dict[str, LaneFormula]:
        """The formulas by name; with any-angle steps those alone."""
        forms, job, sizes = self.formulas, self.job, self.layout.kept
        watched = events.sizes(job.events, forms.size, forms.extras)
        step = forms.small_angle if small_angle else forms.any_angle
        assert step is not None
        formulas = self._step(step)

        def add(name: str, flat: Flat | None, clock: str = "", **sizes: int) -> None:
            if flat is not None:
                formulas[name] = self._formula(flat, self.layout.places(**sizes), clock)

        x, e = forms.size, forms.extras
        if job.events:
            add("watch", events.after_step(forms.scope()), "moment", x=x, **watched, angle=1)
        if not small_angle:
            return formulas
        if self.layout.constants:
            add("constants", forms.constants, c=len(self.layout.constants))
        add("start", forms.begin, "moment", **{x: sizes[x] for x in sizes if x not in watched})
        add("save", forms.save, "moment", io=forms.handed_out + 1, largest=len(SAVED))
        add("project", forms.project, x=x, largest=1)
        if forms.regrids:
            add("leave", forms.leave, "moment", x=x)
            add("enter", forms.enter, "moment", x=x, e=e)
        add("jump", forms.update, "moment", x=x)
        add("status", forms.status, status=1)
        if job.events:
            add("middle", events.middle(forms.scope()), "moment", middle=len(job.events))
            after = range(events.EVENT.index("after"), sizes["event"], len(events.EVENT))
            places = [*self.layout.places(last=x), *(self.layout.place("event", k) for k in after)]
            formulas["look"] = self._formula(forms.look, places, "moment")
        return formulas

    def _step(self, flat: Flat) -> dict[str, LaneFormula]:
        """A step, and calls of functions with the same arguments for all lanes."""
        job = self.job

        def is_shared(node: Node) -> bool:
            group, *i = node.args
            return not i or (group == "p" and (job.shared or i[0] in job.alike))

        calls, rest = without_shared_calls(flat, is_shared)
        clock = "stage" if job.method.stages else "step"
        places = self.layout.places(x=self.formulas.size, angle=1)
        step = self._formula(rest, places, clock)
        formulas = {"step": step._replace(largest=self.formulas.size)}
        if calls is not None:
            called = self.layout.places(called=len(calls.results))
            formulas["step_calls"] = self._formula(calls, called, clock)._replace(lanes=1)
        return formulas

    def _formula(self, flat: Flat, results: list[Place], clock: str) -> LaneFormula:
        time = self._clock(clock) if clock else None
        names = set(flat.inputs())
        if time is not None:
            names = (names - {*time.names}) | {*time.flat.inputs()} - {("n",)}
        return LaneFormula(flat, {name: self._place(*name) for name in names}, results, clock=time)

    def _clock(self, which: str) -> StepTimes:
        """The times of a state after some steps, of a "moment", of a "step" or of a "stage"."""
        graph = Graph()
        n, dt, begin = (graph.input("double", name) for name in ("n", "dt", "begin"))
        steps: Any = n
        spans = {"h": dt, "k": dt}
        if which == "stage":
            h, k, ahead = graph.inputs("double", "stage", 3)
            steps = steps + ahead
            spans = {"h": h * dt, "k": k * dt}
        since = steps * dt
        if which == "moment":
            spans = {"h": dt, "edge": graph.input("double", "share") * dt}
        # as a separate result, the time interval is rounded before it is added
        exact = {"whole": since, "t": begin + since}
        if which == "moment":
            exact["step"] = graph.input("double", "count") + n
        spans["since"] = since
        kinds = ["double"] * len(exact) + [self.job.kind] * len(spans)
        names = [(name,) for name in (*exact, *spans)]
        return StepTimes(Flat(graph, [*exact.values(), *spans.values()], kinds), names)

    def _place(self, group: str, i: int = 0) -> Place:
        """The place of an input."""
        job, numbers = self.job, self.layout.numbers
        if group == "stage":
            return Place(numbers["stage"] + i, "numbers", "indexed")
        is_own = group == "p" and not (job.shared or i in job.alike)
        if group in numbers and not is_own:
            return Place(numbers[group] + i, "numbers", "shared")
        place = self.layout.place(group, i)
        if group == "called":
            return Place(place.row * job.width, place.array, "computed")
        return place

    def _text(self, formulas: dict[str, LaneFormula], lanes: int) -> Iterator[str]:
        each = f"for j in range(0, {self.job.width}, {lanes}):"

        def call(name: str, n: str = "first", i: str = "0", j: str = "j") -> str:
            steps = "" if formulas[name].clock is None else f", {n}"
            return f"{name}(rows, wide, numbers, whole, {j}, {j}, {i}{steps})"

        yield "def run(part, rows, wide, numbers, whole, first, last):"
        parts = [(Action.START, "constants"), *((x, x.name.lower()) for x in Action)]
        there = [(part, name) for part, name in parts if name in formulas]
        if there:
            # one loop for all parts, since Numba compiles a condition faster than a loop
            yield f"    if part != {Action.STEPS}:"
            yield f"        {each}"
            yield from (f"            if part == {part}: {call(name)}" for part, name in there)
            yield "        return"
        yield "    for n in range(first, last):"
        i, depth = "0", " " * 8
        if self.job.method.stages:
            # the number of stages comes after the resources
            yield f"        for i in range(whole[{len(self.formulas.resources)}]):"
            i, depth = "3 * i", " " * 12
        if "step_calls" in formulas:
            yield depth + call("step_calls", "n", i, "0")
        yield f"{depth}{each} {call('step', 'n', i)}"
        if "watch" in formulas:
            yield f"        {each} {call('watch', 'n + 1')}"


@lru_cache(maxsize=256)
def program(job: Job) -> Program:
    """The program of a job, made once in a process."""
    return Program(job)


def width_for(bodies: int, lanes: int) -> int:
    """Width of a tile for a number of bodies: a power of two of vectors, at most ``WIDTH``."""
    return min(WIDTH, max(lanes, 1 << (bodies - 1).bit_length()))
