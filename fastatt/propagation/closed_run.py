"""Runs by the closed solution, which takes no steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import rounding
from fastatt._cached import cached_property
from fastatt.attitudes import Attitude
from fastatt.engine.run import Results
from fastatt.engine.status import DIAGNOSTICS, FLAGS, Status
from fastatt.propagation.initial import Initial
from fastatt.scene.scene import Scene


@dataclass(frozen=True)
class ClosedRun:
    """What diagnostics read of a run by the closed solution."""

    start: Initial
    #: times of the saves since the start, s
    since: NDArray[Any]
    #: what the angular velocities gain, rad/s
    gain: NDArray[np.float64]

    @property
    def dtype(self) -> np.dtype[Any]:
        """The precision of the state."""
        return self.start.q.dtype

    @cached_property
    def angles(self) -> NDArray[np.float64]:
        """``|w| t`` of each body, rad, or a bound of all that is far from losing digits."""
        from fastatt.closed_form import turned

        y, since = self.start.y, self.since
        with np.errstate(over="ignore", invalid="ignore"):
            # |w| and what it gains are below twice their largest component
            largest = max(y.max(), -y.min()) + float(self.gain.max())
            most = 2.0 * largest * max(abs(since[0]), abs(since[-1]))
        if most <= rounding.most_turned(self.dtype) ** 0.5:
            return np.array([most])
        return turned(y, since, self.gain)


def evaluate(
    scene: Scene, attitude: Attitude, start: Initial, since: NDArray[Any], n_threads: int,
    results: Results,
) -> bool:  # fmt: skip
    """Write the states of a free body or a heavy top at some times since the start, s.

    Warns if rounding leaves few digits of the angles, and returns whether it did.
    """
    from fastatt import closed_form

    stored, solution = attitude.stored, closed_form.solution_of(scene)
    run = ClosedRun(start, since, solution.gain)
    results.saves[..., -1] = results.status[...] = 0
    out = results.saves[..., :-1]
    with np.errstate(over="ignore", invalid="ignore"):
        closed_form.evaluate(
            solution, (start.q, start.y), since.astype(run.dtype), n_threads,
            (out[..., :stored], out[..., stored:]), attitude,
        )  # fmt: skip
        # a phase that overflows does so at all later times too
        total = results.saves[-1].sum()
    for of in DIAGNOSTICS:
        if of.closed is not None:
            results.status[...] |= of.closed(run) * FLAGS(of.flag)
    if not np.isfinite(total):
        bad = ~np.isfinite(results.saves).all(axis=(0, 2))
        results.status[...] |= bad * FLAGS(Status.NON_FINITE)
    if run.angles.max() <= rounding.most_half_right(run.dtype):
        return False
    if text := rounding.of_angles(run.angles, run.dtype):
        rounding.warn(f"t: found rotations by {text}")
    return bool(text)
