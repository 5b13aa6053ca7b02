"""Runs by the closed solution, which takes no steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import rounding
from fastatt.attitudes import Attitude
from fastatt.engine.run import Results
from fastatt.engine.status import Status
from fastatt.propagation.initial import Initial
from fastatt.scene.scene import Scene


def evaluate(
    scene: Scene, attitude: Attitude, start: Initial, since: NDArray[Any], n_threads: int,
    results: Results,
) -> bool:  # fmt: skip
    """Write the states of a free body or a heavy top at some times since the start, s.

    Warns if rounding leaves few digits of the angles, and returns whether it did.
    """
    from fastatt import closed_form

    dtype, stored, solution = start.q.dtype, attitude.stored, closed_form.solution_of(scene)
    results.saves[..., -1] = results.status[...] = 0
    out = results.saves[..., :-1]
    with np.errstate(over="ignore", invalid="ignore"):
        closed_form.evaluate(
            solution, (start.q, start.y), since.astype(dtype), n_threads,
            (out[..., :stored], out[..., stored:]), attitude,
        )  # fmt: skip
        # a phase that overflows does so at all later times too
        total = results.saves[-1].sum()
        # |w| and what it gains are below twice their largest component
        largest = max(start.y.max(), -start.y.min()) + float(solution.gain.max())
        most = 2.0 * largest * max(abs(since[0]), abs(since[-1]))
    text = ""
    if not most <= rounding.most_turned(dtype) ** 0.5:
        angles = closed_form.turned(start.y, since, solution.gain)
        if text := rounding.of_angles(angles, dtype):
            rounding.warn(f"t: found rotations by {text}")
        far = angles > rounding.most_turned(dtype)
        results.status[...] = far * np.uint8(Status.STEP_TOO_LARGE)
    if not np.isfinite(total):
        bad = ~np.isfinite(results.saves).all(axis=(0, 2))
        results.status[...] |= bad * np.uint8(Status.NON_FINITE)
    return bool(text)
