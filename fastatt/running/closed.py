"""Runs in closed form: any time in one evaluation, no steps."""

from __future__ import annotations

import math
import struct
from functools import cached_property
from typing import TYPE_CHECKING, Any

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
    """What evaluates a plan's saves, or those of some numbers."""

    def __init__(self, plan: Plan, saves: int, slots: list[int] | None = None) -> None:
        self._form = closed_forms.form_of(plan.scene)
        attitude, self._handed, self._saves = plan.choice.attitude, plan.handed, saves
        self._plan, self._slots = plan, slots
        self._stored, self._offsets = attitude.stored, plan.handed.layout(saves)
        self._motion = closed_forms.Motion(
            self._form,
            plan.kind,
            (saves, plan.n_bodies),
            stored=None if attitude.stored == 4 else attitude.start,
        )
        self._length = plan.clock.end * plan.clock.h

    @cached_property
    def _calm(self) -> int:
        """Bits of |w|² up to which no body turns so far that it has to be looked at."""
        longest = max(np.abs(self._since).max(initial=0.0), np.finfo(np.float64).tiny)
        most = float(np.finfo(self._handed.kind).eps) ** -0.5 / float(longest)
        (bits,) = struct.unpack(
            "q", struct.pack("d", most * most - float(self._form.gain.max()) ** 2)
        )
        return int(bits)

    @cached_property
    def _since(self) -> NDArray[np.float64]:
        """Times since the start, s."""
        since = self._plan.clock.since
        return since if self._slots is None else since[self._slots]

    @cached_property
    def _times(self) -> NDArray[Any]:
        """The same in the precision of the run."""
        with np.errstate(over="ignore"):
            return self._since.astype(self._handed.kind)

    def run(
        self, given: Given, t0: float, handling: Handling, raw: NDArray[np.uint8] | None
    ) -> Trajectory:
        """The trajectory at all saves, or a few of them at a time."""
        plan, clock = self._plan, self._plan.clock
        if not math.isfinite(t0 + self._length):
            clock.times(t0)  # which refuses it
        if handling.sink is None:
            raw = plan.memory(self._saves) if raw is None else raw
            flagged = self.fill(given, raw, handling.threads)
            return plan.promised(raw, flagged, t0, given.one_body)
        t = clock.times(t0)

        def part(slots: list[int]) -> Trajectory:
            raw = plan.memory(len(slots))
            ClosedForm(plan, len(slots), slots).fill(given, raw, handling.threads)
            results = plan.handed.views(raw, len(slots))
            return Trajectory(**plan.handed.fields(t[slots], results, given.one_body))

        for slots in few(len(t)):
            handling.sink(part(slots[1:] if slots[1:2] > [1] else slots))
        return part([len(t) - 1])

    def fill(self, given: Given, raw: NDArray[np.uint8], threads: int) -> bool:
        """Write results to a run's memory; whether any body has a flag."""
        raw[self._offsets[0] :] = 0
        start, stored = (given.q, given.y), self._stored
        if self._motion.is_plain:
            out = self._handed.views(raw, self._saves).out
            self._motion.fill(start, self._times, (out[..., :stored], out[..., stored:]), threads)
            odd = True
        else:
            at, width = address_of(raw), self._handed.width
            places = ((at, width), (at + stored * self._handed.kind.itemsize, width))
            odd = self._motion.write(start, self._times, places, threads, self._calm)
        return odd and self._flagged(given, self._handed.views(raw, self._saves))

    def _flagged(self, given: Given, results: Results) -> bool:
        """Flag bodies whose results are no numbers, or that turned too far; warn of that."""
        out, status = results.out, results.status
        kind = out.dtype
        turned = closed_forms.turned(np.atleast_2d(given.y), self._since, self._form.gain)
        if text := rounding.of_angles(turned, kind):
            rounding.warn(f"t: found turns of {text}")
        with np.errstate(invalid="ignore"):
            bad = np.isnan(out @ np.zeros(out.shape[-1], dtype=kind)).any(axis=0)
            far = turned > rounding.most_turned(kind)
        status[...] = bad * np.uint8(Status.NON_FINITE) | far * np.uint8(Status.STEP_TOO_LARGE)
        return bool(status.any())
