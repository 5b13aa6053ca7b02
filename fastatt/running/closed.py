"""Runs in closed form: any time in one evaluation, no steps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastatt import closed_forms, rounding
from fastatt.engine.status import Status
from fastatt.flat.rows import address_of
from fastatt.running.asked import Handling, few
from fastatt.running.initial import Given
from fastatt.running.trajectory import Results, Trajectory

if TYPE_CHECKING:
    from fastatt.running.plan import Plan


class ClosedForm:
    """What evaluates some saves of a plan."""

    def __init__(self, plan: Plan, saves: int) -> None:
        self._form = closed_forms.form_of(plan.scene)
        attitude, self._handed, self._saves = plan.choice.attitude, plan.handed, saves
        self._plan = plan
        self._stored, self._offsets = attitude.stored, plan.handed.layout(saves)
        self._motion = closed_forms.Motion(
            self._form,
            plan.kind,
            (saves, plan.n_bodies),
            stored=None if attitude.stored == 4 else attitude.start,
        )
        self._gain = float(self._form.gain.max())
        # |w| t, rad, beyond which a body's is looked at
        self._calm = float(np.finfo(plan.kind).eps) ** -0.5

    def run(
        self, given: Given, t0: float, handling: Handling, raw: NDArray[np.uint8] | None
    ) -> Trajectory:
        """The trajectory at all saves, or a few of them at a time."""
        plan, clock = self._plan, self._plan.clock
        t, since = clock.times(t0), clock.since
        if handling.sink is None:
            raw = plan.memory(len(t)) if raw is None else raw
            flagged = self.fill(given, since, raw, handling.threads)
            return plan.promised(raw, flagged, t0, given.one_body)

        def part(slots: list[int]) -> Trajectory:
            raw = plan.memory(len(slots))
            ClosedForm(plan, len(slots)).fill(given, since[slots], raw, handling.threads)
            results = plan.handed.views(raw, len(slots))
            return Trajectory(**plan.handed.fields(t[slots], results, given.one_body))

        for slots in few(len(t)):
            handling.sink(part(slots[1:] if slots[1:2] > [1] else slots))
        return part([len(t) - 1])

    def fill(
        self, given: Given, since: NDArray[np.float64], raw: NDArray[np.uint8], threads: int
    ) -> bool:
        """Write results at times since the start, s; whether any body has a flag."""
        kind, w, first = self._handed.kind, given.y.reshape(-1), self._offsets[0]
        times = since
        if kind != since.dtype:
            with np.errstate(over="ignore"):
                times = since.astype(kind)
        start = (given.q, given.y)
        if self._motion.is_plain:
            out = self._handed.views(raw, self._saves).out
            parts = (out[..., : self._stored], out[..., self._stored :])
            self._motion.fill(start, times, parts, threads)
        else:
            at, width = address_of(raw), self._handed.width
            places = ((at, width), (at + self._stored * kind.itemsize, width))
            self._motion.write(start, times, places, threads)
        raw[first:] = 0
        flat = raw[:first].view(kind)
        with np.errstate(over="ignore", invalid="ignore"):
            # sums of squares: no square is larger, and of what is no number they are none
            turned, numbers = np.dot(w, w), np.dot(flat, flat)
        fastest = math.sqrt(turned) + self._gain
        most = fastest * abs(since.item(-1)) if since.size else 0.0
        if most <= self._calm and math.isfinite(numbers):
            return False
        return self._flagged(given, since, self._handed.views(raw, self._saves))

    def _flagged(self, given: Given, since: NDArray[np.float64], results: Results) -> bool:
        """Flag bodies whose results are no numbers, or that turned too far; warn of that."""
        out, status = results.out, results.status
        kind = out.dtype
        turned = closed_forms.turned(np.atleast_2d(given.y), since, self._form.gain)
        if text := rounding.of_angles(turned, kind):
            rounding.warn(f"t: found turns of {text}")
        with np.errstate(invalid="ignore"):
            bad = np.isnan(out @ np.zeros(out.shape[-1], dtype=kind)).any(axis=0)
            far = turned > rounding.most_turned(kind)
        status[...] = bad * np.uint8(Status.NON_FINITE) | far * np.uint8(Status.STEP_TOO_LARGE)
        return bool(status.any())
