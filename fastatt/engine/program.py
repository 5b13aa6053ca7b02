"""The formulas of a job over the lanes of a tile, in one generated function.

The function is called with a part, ``run(part, rows, wide, numbers, whole, first, last)``; the
parts are the first actions of ``engine.tape``. A ``Program`` knows where in ``rows`` and
``wide`` each number of a lane lies.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.lanes import LaneFormula, LaneProgram, Place, Shape, StepTimes
from fastatt.codegen.memory import DTYPES, aligned
from fastatt.codegen.modules import MachineCode, TwoForms
from fastatt.codegen.processor import processor
from fastatt.engine import marks
from fastatt.engine.job import Job
from fastatt.engine.machine import PROGRAM, TIME, Tile
from fastatt.engine.tape import Action
from fastatt.tracing.finished import Flat, without_shared_calls
from fastatt.tracing.graph import Graph
from fastatt.tracing.nodes import Node

Array = NDArray[Any]


def _firsts(**sizes: int) -> dict[str, int]:
    """The position of the first number of each group, and the ``total`` of all sizes."""
    return dict(zip((*sizes, "total"), accumulate(sizes.values(), initial=0), strict=True))


#: the most bodies in a tile; few bodies take one vector
WIDTH = 64


class Program(TwoForms):
    """The function of a job with small-angle steps, and that with any-angle steps; their memory.

    A tile has a ``width``, the number of its bodies, which is less for small ensembles: that is
    faster and gives the same bits. ``rows`` are in the state's precision, ``wide`` are doubles;
    ``numbers``, which all lanes share, are the time, the limits of the diagnostics, parameters, and
    a method's stages: where each group begins.
    """

    def __init__(self, job: Job, width: int = WIDTH) -> None:
        self.job, self.width = job, width
        precisions = [job.constants.nodes[i].precision for i in job.constants.results]
        is_wide = [x != job.precision for x in precisions]
        self.constants = [
            (wide, precisions[:i].count(precisions[i])) for i, wide in enumerate(is_wide)
        ]
        event_groups, parameters = marks.groups(job), job.structure.n_params
        #: what a body takes with it from one tape to the next
        self.kept = {
            "x": job.size, "e": job.prepared, "invariants": job.invariants,
            "slides": len(job.switches), **event_groups,
            **{of.name: 1 for of in job.diagnostics}, "status": 1,
        }  # fmt: skip
        #: which of these belong to events, and are not known to a run that is resumed with others
        self.is_of_events = np.repeat([x in event_groups for x in self.kept], [*self.kept.values()])
        #: the columns of the others
        self.of_steps = np.flatnonzero(~self.is_of_events)
        handed_out = max(job.handed_out + 1, job.initial)
        self.rows = _firsts(**self.kept, c=len(precisions) - sum(is_wide), io=handed_out)
        p = 0 if job.shared else parameters
        self.wide = _firsts(p=p, c=sum(is_wide), called=job.calls)
        self.numbers = _firsts(
            **dict.fromkeys(TIME.names or (), 1), limit=len(job.diagnostics), p=parameters,
            stage=3 * len(job.method.stages),
        )  # fmt: skip
        super().__init__()

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

    def places(self, groups: Mapping[str, int]) -> list[Place]:
        """The places of groups of numbers."""
        return [self.place(group, i) for group, n in groups.items() for i in range(n)]

    def record(self, tables: int) -> Array:
        """What the machine has to know, with the address of the tables."""
        rows, record = self.rows, np.zeros(1, PROGRAM)
        record["small_angle"], record["any_angle"] = self.entry, self.any_angle
        record["tables"], record["coordinates"] = tables, self.job.attitude.coordinates
        record["fork"], record["angle"], record["io"] = rows["middle"], rows["angle"], rows["io"]
        return record

    def _new_memory(self) -> tuple[Tile, Array, Array, Array]:
        """A thread's tile with its numbers, and two copies of rows."""
        dtype = DTYPES[self.job.precision]
        numbers = aligned(self.numbers["total"], DTYPES["double"])
        rows = self._rows(self.rows["total"], dtype)
        wide = self._rows(self.wide["total"], DTYPES["double"])
        tile = Tile(rows, wide, numbers[: self.numbers["limit"]].view(TIME))
        before, fork = (self._rows(self.rows["angle"] + 1, dtype) for _ in range(2))
        return tile, numbers, before, fork

    def _rows(self, n: int, dtype: Any) -> Array:
        """Rows that begin at multiples of a cache line."""
        return aligned(max(1, n) * self.width, dtype).reshape(-1, self.width)

    def _compiled(self, *, small_angle: bool) -> MachineCode:
        job, formulas = self.job, self._formulas(small_angle)
        lanes = processor().lanes(job.precision)
        return LaneProgram(
            "\n".join([*self._text(formulas, lanes), ""]), formulas,
            Shape(job.precision, self.width, lanes),
            {"rows": job.precision, "wide": "double", "numbers": "double"}, job.resources,
        ).compiled()  # fmt: skip

    def _formulas(self, small_angle: bool) -> dict[str, LaneFormula]:
        """The formulas by name; with any-angle steps those alone."""
        job, step = self.job, self.job.small_angle if small_angle else self.job.any_angle
        assert step is not None
        formulas = self._step(step)

        def add(name: str, flat: Flat | None, clock: str = "") -> None:
            if flat is not None:
                formulas[name] = self._formula(flat, self.places(flat.groups), clock)

        if job.watched:
            add("watch", marks.after_step(job.scope()), "moment")
        if not small_angle:
            return formulas
        if self.constants:
            places = self.places({"c": len(self.constants)})
            formulas["constants"] = self._formula(job.constants, places, "")
        add("start", job.begin, "moment")
        add("save", job.save, "moment")
        add("project", job.project, "moment" if job.switches else "")
        if job.regrids:
            add("leave", job.leave, "moment")
            add("enter", job.enter, "moment")
        for k, flat in enumerate(job.updates):
            add(f"jump{k}", flat, "moment")
        add("status", job.status)
        if job.watched:
            add("middle", marks.middle(job.scope()), "moment")
            add("look", job.look, "moment")
        return formulas

    def _step(self, flat: Flat) -> dict[str, LaneFormula]:
        """A step, and calls of functions with the same arguments for all lanes."""
        job = self.job

        def is_shared(node: Node) -> bool:
            group, *i = node.args
            return not i or (group == "p" and (job.shared or i[0] in job.alike))

        calls, rest = without_shared_calls(flat, is_shared)
        clock = "stage" if job.method.stages else "step"
        step = self._formula(rest, self.places(flat.groups), clock)
        formulas = {"step": step._replace(largest=job.size)}
        if calls is not None:
            called = self.places({"called": len(calls.results)})
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
        precisions = ["double"] * len(exact) + [self.job.precision] * len(spans)
        names = [(name,) for name in (*exact, *spans)]
        return StepTimes(Flat(graph, [*exact.values(), *spans.values()], precisions), names)

    def _place(self, group: str, i: int = 0) -> Place:
        """The place of an input."""
        job, numbers = self.job, self.numbers
        if group == "stage":
            return Place(numbers["stage"] + i, "numbers", "indexed")
        is_own = group == "p" and not (job.shared or i in job.alike)
        if group in numbers and not is_own:
            return Place(numbers[group] + i, "numbers", "shared")
        place = self.place(group, i)
        if group == "called":
            return Place(place.row * self.width, place.array, "computed")
        return place

    def _text(self, formulas: dict[str, LaneFormula], lanes: int) -> Iterator[str]:
        each = f"for j in range(0, {self.width}, {lanes}):"

        def call(name: str, n: str = "first", i: str = "0", j: str = "j") -> str:
            steps = "" if formulas[name].clock is None else f", {n}"
            return f"{name}(rows, wide, numbers, whole, {j}, {j}, {i}{steps})"

        yield "def run(part, rows, wide, numbers, whole, first, last):"
        parts = [(int(Action.START), "constants"), *((int(x), x.name.lower()) for x in Action)]
        parts += [(Action.JUMP + k, f"jump{k}") for k in range(len(self.job.updates))]
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
            yield f"        for i in range(whole[{len(self.job.resources)}]):"
            i, depth = "3 * i", " " * 12
        if "step_calls" in formulas:
            yield depth + call("step_calls", "n", i, "0")
        yield f"{depth}{each} {call('step', 'n', i)}"
        if "watch" in formulas:
            yield f"        {each} {call('watch', 'n + 1')}"


@lru_cache(maxsize=256)
def program(job: Job, width: int) -> Program:
    """The program of a job, made once in a process."""
    return Program(job, width)


def width_for(bodies: int, lanes: int) -> int:
    """Width of a tile for a number of bodies: a power of two of vectors, at most ``WIDTH``."""
    return min(WIDTH, max(lanes, 1 << (bodies - 1).bit_length()))
