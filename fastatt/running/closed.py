"""Runs in closed form: any time in one evaluation, no steps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastatt import exact, rounding
from fastatt.arrays import quat_to_dcm
from fastatt.engine.status import Status
from fastatt.running.trajectory import Trajectory

if TYPE_CHECKING:
    from fastatt.running.asked import Handling
    from fastatt.running.initial import Given
    from fastatt.running.plan import Plan


def closed_form(
    plan: Plan, given: Given, t: NDArray[np.float64], t0: float, handling: Handling
) -> Trajectory:
    """The trajectory of a free body at the times t of a run that begins at t0."""
    kind, since = plan.kind, t - t0
    eps = float(np.finfo(kind).eps)
    with np.errstate(over="ignore"):
        # |w| is at most √3 of its components; what is no number is not quiet
        longest = abs(float(since[-1])) if since.size else 0.0
        most = math.sqrt(3.0) * max(float(given.y.max()), -float(given.y.min())) * longest
    is_quiet = most * eps <= math.sqrt(eps)
    times = since.astype(kind, copy=False)
    start = (given.q, given.y)
    q, w = exact.states(plan.scene.principal, start, times, plan.n_bodies, handling.threads)
    status = np.zeros(plan.n_bodies, dtype=np.uint8)
    with np.errstate(invalid="ignore", over="ignore"):
        if not is_quiet or not math.isfinite(float(q.sum()) + float(w.sum())):
            turned = exact.turned(np.atleast_2d(given.y), since)
            if text := rounding.of_angles(turned, kind):
                rounding.warn(f"t: found turns of {text}")
            far = turned > rounding.most_turned(kind)
            bad = np.isnan((q @ np.zeros(4, dtype=kind) + w @ np.zeros(3, dtype=kind)).sum(axis=0))
            status |= bad * np.uint8(Status.NON_FINITE) | far * np.uint8(Status.STEP_TOO_LARGE)
    return Trajectory(
        t=t,
        state=q if plan.choice.attitude.stored == 4 else quat_to_dcm(q).reshape(*q.shape[:2], 9),
        defect=np.zeros(q.shape[:2], dtype=kind),
        status=status,
        one_body=given.one_body,
        carried={"w": w},
        **plan.handed.told,
    )
