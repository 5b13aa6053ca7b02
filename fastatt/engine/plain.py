"""The tile loop in Python, on arrays: the same formulas, for debugging and where nothing compiles.

It runs under ``NUMBA_DISABLE_JIT=1``, far slower; multiplications and additions are not fused. The
loop over tiles is numpy's, over all bodies at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.job import Forms, Job
from fastatt.engine.layout import BLOCK
from fastatt.engine.status import Status
from fastatt.flat import source
from fastatt.flat.finished import Flat
from fastatt.flat.nodes import Node

Array = NDArray[Any]
_EPS = 2.0**-52
_REALS = {"double": np.float64, "single": np.float32}


class PlainProgram:
    """What ``fastatt.engine.ensemble.Program`` is, without machine code."""

    def __init__(self, job: Job) -> None:
        self.formulas = job.formulas
        self.job = job
        self._functions: dict[int, tuple[Any, Any]] = {}

    def run(
        self, arrays: Mapping[str, Any], numbers: Mapping[str, float], span: Any,
        tiles: tuple[int, int], tables: Mapping[Any, Any],
    ) -> tuple[float, float]:  # fmt: skip
        """Steps of a span on some tiles: the largest turn of a step; whether there are flags."""
        width = self.job.width
        first, last = tiles[0] * width, min(tiles[1] * width, len(arrays["x"]))
        if first >= last:
            return 0.0, 0.0
        bodies = np.arange(first, last)
        with np.errstate(all="ignore"):
            if not self.job.own_steps:
                return _PlainRun(self, arrays, numbers, bodies, tables).go(span)
            steps = arrays["dt"][np.minimum(bodies, len(arrays["dt"]) - 1)]
            told = []
            for h in np.unique(steps):
                own = {**numbers, "h": h, "edge": numbers["edge"] * h}
                run = _PlainRun(self, arrays, own, bodies[steps == h], tables)
                told.append(run.go_between(span))
            return max(x for x, _ in told), max(x for _, x in told)

    def function(self, flat: Flat, tables: Mapping[Any, Any]) -> Any:
        """A graph as a function of arrays."""
        made = self._functions.get(id(flat))
        # a program serves every scene of a structure, each with tables of its own
        if made is None or made[0] is not tables:
            named = {k[1]: v for k, v in tables.items() if k[0] == "table"}
            made = self._functions[id(flat)] = tables, source.function(flat, tables=named)
        return made[1]


class _PlainRun:
    """One run over some bodies."""

    def __init__(
        self, program: PlainProgram, arrays: Mapping[str, Any], numbers: Mapping[str, float],
        bodies: Array, tables: Mapping[Any, Any],
    ) -> None:  # fmt: skip
        self.program, self.formulas, self.job = program, program.formulas, program.job
        self.arrays, self.numbers, self.bodies, self.tables = arrays, numbers, bodies, tables
        self.real = _REALS[self.job.kind]
        self.rows: dict[str, list[Array]] = {}
        self.rows["p"] = self._columns("p")
        self.rows["y"] = [*self._columns("q0"), *self._columns("y0")]
        self.turn = np.zeros(len(bodies), dtype=self.real)
        self.loud = np.zeros(len(bodies), dtype=bool)

    def _columns(self, name: str) -> list[Array]:
        array = np.atleast_2d(self.arrays[name])
        rows = array[np.minimum(self.bodies, len(array) - 1)] if len(array) else array
        return list(rows.T)

    def _evaluate(self, flat: Flat, **scalars: Any) -> list[Array]:
        """A row for each result, in its precision."""
        n = len(self.bodies)

        def input_of(node: Node) -> Any:
            group, *i = node.args
            value = scalars[group] if group in scalars else self.rows[group][i[0]]
            return np.asarray(value, dtype=_REALS[node.kind])

        given = (input_of(node) for node in flat.nodes if node.op == "in")
        found = self.program.function(flat, self.tables)(*given)
        kinds = [_REALS[flat.nodes[i].kind] for i in flat.results]
        pairs = zip(found, kinds, strict=True)
        return [np.broadcast_to(np.asarray(x, dtype=kind), (n,)) for x, kind in pairs]

    def _time(self, steps: float) -> float:
        return self.numbers["t0"] + steps * self.numbers["h"]

    def _begin(self, first: int) -> None:
        forms, numbers = self.formulas, self.numbers
        found = self._evaluate(forms.begin, t=numbers["t0"], h=numbers["h"], edge=numbers["edge"])
        sizes = (forms.size, forms.extras, forms.invariants)
        self.rows["c"] = self._evaluate(forms.constants)
        at = 0
        for name, size in zip(("x", "e", "invariants"), sizes, strict=True):
            self.rows[name] = found[at : at + size]
            at += size
        if first > 0:
            self.rows["x"] = list(self.arrays["x"][self.bodies].T)
        else:
            self.arrays["watch"][:, self.bodies] = 0.0
        if self.job.known:
            self._listen(first == 0, found[-1])

    def _end(self) -> tuple[float, float]:
        self.arrays["x"][self.bodies] = np.stack(self.rows["x"], axis=-1)
        return judged(self.job, self.arrays, self.numbers, self.bodies)

    def _advance(self, first: int, last: int) -> None:
        """A block of steps, and how far they turned."""
        self._block(first, last)
        watch = self.arrays["watch"][0]
        watch[self.bodies] = np.maximum(watch[self.bodies], self.turn)

    def go(self, span: Any) -> tuple[float, float]:
        """Steps [first, last) and their saves: the largest turn, and whether there are flags."""
        forms = self.formulas
        self._begin(span.first)
        if span.first == span.origin and (span.slot == 1 or span.n_steps == span.origin):
            self._save(span, span.origin)
        n = span.first
        while n < span.last:
            gone = n - span.origin
            stop = min(n + BLOCK, span.last, n + span.save_every - gone % span.save_every)
            if span.restore:
                stop = min(stop, (n // span.restore + 1) * span.restore)
            self._advance(n, stop)
            n = stop
            if span.restore and n % span.restore == 0 and forms.mend is not None:
                *x, far = self._evaluate(forms.mend)
                self.rows["x"] = list(x)
                self._worse(1, far)
            if (n - span.origin) % span.save_every == 0 or n == span.n_steps:
                self._save(span, n)
        return self._end()

    def go_between(self, span: Any) -> tuple[float, float]:
        """The same with saves at any times, of bodies with one step."""
        self._begin(span.first)
        times, slots = self.arrays["times"], self.arrays["slots"]
        n = self._on_grid(times[span.first - 1])[0] if span.first > 0 else 0
        for time, slot in zip(
            times[span.first : span.last], slots[span.first : span.last], strict=True
        ):
            count, rest = self._on_grid(time)
            while n < count:
                stop = min(n + BLOCK, count)
                self._advance(n, stop)
                n = stop
            if slot >= 0:
                self._hand_out(slot, n, rest)
        return self._end()

    def _on_grid(self, time: float) -> tuple[int, float]:
        """Steps to the last before a time, and what is left of one; rounding leaves nothing."""
        t0, h = self.numbers["t0"], self.numbers["h"]
        count = math.floor((time - t0) / h * (1.0 + 4.0 * _EPS))
        rest = time - (t0 + count * h)
        return count, rest if abs(rest) > 16.0 * _EPS * (abs(t0) + abs(time)) else 0.0

    def _hand_out(self, slot: int, n: int, rest: float = 0.0) -> None:
        """The states after n steps and what is left of one, which is done on a copy."""
        kept = dict(self.rows), self.numbers, self.turn
        t, since, edge = self._time(n), n * self.numbers["h"], self.numbers["edge"]
        if rest:
            last = edge / self.numbers["h"] * rest
            if self.formulas.regrid is not None:
                old = {"t": t, "since": since, "edge": edge}
                made = self._evaluate(self.formulas.regrid, **old, k=rest, other=last)
                size = self.formulas.size
                self.rows["x"], self.rows["e"] = made[:size], made[size:]
            self.numbers = {**self.numbers, "h": rest, "t0": t}
            self._block(0, 1)
            t, since, edge = t + rest, rest, last
        found = self._evaluate(self.formulas.save, t=t, since=since, edge=edge)
        self.rows, self.numbers, self.turn = kept
        size = self.formulas.handed_out
        self.arrays["out"][slot, self.bodies] = np.stack(found[:size], axis=-1)
        self.arrays["defect"][slot, self.bodies] = found[size]
        self._worse(1, np.abs(found[size]))
        self._worse(2, found[size + 1])

    def _listen(self, begins: bool, bound: Array) -> None:
        """Which bodies' turns are not known to be quiet; of the others keep what is known."""
        if not self.job.bounds:
            known = self.arrays["known"]
            bound = np.square(known[np.minimum(self.bodies, len(known) - 1)]).astype(self.real)
        quiet = bound <= self.real(self.numbers["quiet"] ** 2)
        self.loud = ~quiet
        if begins:
            watch = self.arrays["watch"][0]
            watch[self.bodies] = np.where(quiet, bound, 0.0)

    def _worse(self, row: int, value: Array) -> None:
        watch = self.arrays["watch"][row]
        before = watch[self.bodies]
        keep = (before >= value) | np.isnan(before)
        watch[self.bodies] = np.where(keep, before, value)

    def _save(self, span: Any, n: int) -> None:
        gone = n - span.origin
        slot = (gone - 1) // span.save_every + span.slot if gone > 0 else 0
        self._hand_out(slot, n)

    def _block(self, first: int, last: int) -> None:
        """The quick form, and the careful one for bodies for which that does not do."""
        before = self.rows["x"]
        self._steps(self.formulas.quick, self.job.look != "never", first, last)
        if not self.job.has_careful_form:
            return
        assert self.formulas.careful is not None
        far = self.loud if self.job.known else np.greater(self.turn, math.pi**2)
        if not far.any():
            return
        quick, turn = self.rows["x"], self.turn
        self.rows["x"] = before
        self._steps(self.formulas.careful, True, first, last)
        self.rows["x"] = [np.where(far, a, b) for a, b in zip(self.rows["x"], quick, strict=True)]
        self.turn = np.where(far, self.turn, turn)

    def _steps(self, forms: Forms, noted: bool, first: int, last: int) -> None:
        self.turn = np.zeros(len(self.bodies), dtype=self.real)
        h = self.numbers["h"]
        stages = self.job.method.stages or ((1.0, 1.0, 0.0),)
        for n in range(first, last):
            for share, other, at in stages:
                scalars = {"t": self._time(n + at), "h": share * h, "k": other * h}
                found = self._evaluate(forms.noted if noted else forms.plain, **scalars)
                if noted:
                    *found, z = found
                    self.turn = np.where(z > self.turn, z, self.turn)
                self.rows["x"] = list(found)


def judged(
    job: Job, arrays: Mapping[str, Any], numbers: Mapping[str, float], bodies: Array
) -> tuple[float, float]:
    """Flags of bodies from their last states and what the run watched: what ``run`` hands out."""
    square, norm, change = arrays["watch"][:, bodies]
    turn, real = np.sqrt(square), _REALS[job.kind]
    bad = np.isnan(sum(x * 0.0 for x in arrays["x"][bodies].T))
    large = Status.SINGULAR if job.attitude.has_poles else Status.STEP_TOO_LARGE
    given = arrays["flags"]
    flags = given[np.minimum(bodies, len(given) - 1)]
    for where, flag in (
        (bad, Status.NON_FINITE),
        (np.isinf(turn) & ~bad, Status.NOT_CONVERGED),
        ((turn > real(numbers["limit"])) & ~np.isinf(turn), large),
        (~(change <= real(numbers["invariant"])) & ~bad, Status.INVARIANT),
        (~(norm <= real(numbers["norm"])) & ~bad, Status.NORM_LOST),
    ):
        flags = flags | where * np.uint8(flag)
    arrays["status"][bodies] = flags
    return float(turn.max()), float(flags.any())
