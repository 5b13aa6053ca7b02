"""Steps of each body's own, and saves at any times: what a user gives, as a clock."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.running.asked import Clock, OwnClock

_EPS = float(np.finfo(np.float64).eps)


def clock_of(
    dt: Any, n_steps: Any, saves: tuple[Any, Any], begin: float, bodies: int
) -> Clock | OwnClock:
    """The clock of a run; ``saves`` are ``save_every`` and ``save_at``.

    Raises ``ValueError`` and ``TypeError`` for what does not fit.
    """
    save_every, save_at = saves
    if save_at is None and not isinstance(dt, (list, tuple)) and np.ndim(dt) == 0:
        return Clock.of(dt, n_steps, save_every)
    if save_every is not None:
        other = "save_at" if save_at is not None else "steps of each body's own"
        raise ValueError(f"save_every: found with {other}; accepted: save_at alone")
    steps = checks.array("dt", dt, "a number or (N,)", [(), (-1,)]).astype(np.float64)
    steps = np.ascontiguousarray(np.atleast_1d(steps))
    if steps.size not in (1, bodies):
        raise ValueError(f"dt: found {steps.size} steps; accepted: one, or {bodies} of the bodies")
    if not ((steps > 0.0).all() or (steps < 0.0).all()):
        raise ValueError("dt: found steps of both signs or 0; accepted: all above 0, or all below")
    counts = _counts(n_steps, steps.size)
    ends = counts * steps
    end = float(ends[0])
    if np.ptp(ends) > 8.0 * _EPS * (abs(end) + abs(begin)):
        b = int(np.abs(ends - end).argmax())
        raise ValueError(
            f"n_steps: body {b} ends after {ends[b]:.17g} s, body 0 after {end:.17g} s; accepted: "
            "dt * n_steps the same of all bodies, to rounding"
        )
    if not np.isfinite(begin + end):
        raise ValueError(f"dt: the run overflows at {begin} + {end} s; accepted: shorter")
    at = np.array([begin + end]) if save_at is None else _times(save_at, begin, begin + end)
    return OwnClock.made(steps, int(counts.max()), at, begin)


def _counts(n_steps: Any, n: int) -> NDArray[np.int64]:
    if np.ndim(n_steps) == 0:
        return np.full(n, checks.whole("n_steps", n_steps, 0), dtype=np.int64)
    found = np.asarray(n_steps)
    if found.dtype.kind not in "iu" or found.shape != (n,) or (found < 0).any():
        raise ValueError(
            f"n_steps: found {checks.brief(n_steps)}; accepted: a whole number, or ({n},) of them, "
            "at least 0"
        )
    return found.astype(np.int64)


def _times(save_at: Any, begin: float, end: float) -> NDArray[np.float64]:
    at = checks.array("save_at", save_at, "(S,) times, s", [(-1,)]).astype(np.float64)
    forward = end >= begin
    slack = 16.0 * _EPS * (abs(begin) + abs(end))
    first, last = (begin, end) if forward else (end, begin)
    outside = (at < first - slack) | (at > last + slack)
    if outside.any():
        k = int(outside.argmax())
        raise ValueError(
            f"save_at[{k}] is {at[k]:.17g}; accepted: from {first:.17g} to {last:.17g}"
        )
    steps = np.diff(at)
    if ((steps < 0.0) if forward else (steps > 0.0)).any():
        raise ValueError("save_at: found times out of order; accepted: in the order of the run")
    return np.ascontiguousarray(at)
