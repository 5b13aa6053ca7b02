"""Runs in closed form: any time in one evaluation, no steps."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import rounding
from fastatt.attitudes import QUATERNION, Attitude
from fastatt.codegen.memory import address_of
from fastatt.engine.status import Status
from fastatt.propagation import closed_forms
from fastatt.propagation.initial import Given
from fastatt.propagation.options import Handling, few
from fastatt.propagation.trajectory import Results, Trajectory

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan


@cache
def stored_of(attitude: Attitude) -> Callable[[Any], Any]:
    """What a trajectory holds in a representation, of a quaternion."""
    return lambda q: attitude.raw(attitude.start(q))


class ClosedForm:
    """What evaluates a plan's saves, or those of some numbers."""

    def __init__(self, plan: Plan, saves: int, slots: list[int] | None = None) -> None:
        self._form = closed_forms.form_of(plan.scene)
        attitude, self._handed, self._saves = plan.choice.attitude, plan.handed, saves
        self._plan, self._slots = plan, slots
        self._stored = attitude.stored
        self._motion = closed_forms.Evaluation(
            self._form,
            plan.kind,
            (saves, plan.n_bodies),
            stored=None if attitude is QUATERNION else stored_of(attitude),
        )

    @cached_property
    def _silent(self) -> float:
        """|w|² up to which no body rotates so far that its rounding needs a check."""
        longest = max(np.abs(self._since).max(initial=0.0), np.finfo(np.float64).tiny)
        most = float(np.finfo(self._handed.kind).eps) ** -0.5 / float(longest)
        return float(most * most - self._form.gain.max() ** 2)

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

    def run(self, given: Given, t: NDArray[np.float64], handling: Handling) -> Trajectory:
        """The trajectory at all saves, at times ``t``, or a few of them at a time."""
        plan, handed = self._plan, self._handed
        if handling.sink is None:
            results = self.fill(given, handling.threads)
            return Trajectory(**handed.fields(t, results, given.one_body))

        def part(slots: list[int]) -> Trajectory:
            results = ClosedForm(plan, len(slots), slots).fill(given, handling.threads)
            return Trajectory(**handed.fields(t[slots], results, given.one_body))

        for slots in few(len(t)):
            handling.sink(part(slots[1:] if slots[1:2] > [1] else slots))
        return part([len(t) - 1])

    def fill(self, given: Given, threads: int) -> Results:
        """The results of all saves."""
        handed, stored = self._handed, self._stored
        results = Results.empty(self._saves, handed.n_bodies, handed.width, handed.kind)
        results.norm_error[...] = 0.0
        results.status[...] = 0
        start, out = (given.q, given.y), results.out
        if self._motion.is_plain:
            self._motion.fill(start, self._times, (out[..., :stored], out[..., stored:]), threads)
            self._flag(given, results)
            return results
        at, width = address_of(out), handed.width
        places = ((at, width), (at + stored * handed.kind.itemsize, width))
        if self._motion.write(start, self._times, places, threads, self._silent):
            self._flag(given, results)
        return results

    def _flag(self, given: Given, results: Results) -> None:
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
