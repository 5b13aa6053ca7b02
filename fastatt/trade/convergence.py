"""A run's own order and error, by halving its step on a sample of its bodies."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt.attitudes import Attitude
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import attitude_of, method_of
from fastatt.propagation.ensemble import Ensemble
from fastatt.scene.scene import Scene, as_scene
from fastatt.trade.ladder import LARGE, Ladder, largest_angle, times_compared
from fastatt.trade.measure import Case, Problem
from fastatt.trade.work_precision import spread

_HALVINGS = 7
_SURE = 3  # halvings at least: what the error is measured against
# of a declared order: what is found may lie so far below
_SLACK = 0.5
_STEPS = 2_000_000  # body-steps of a run that the check may take


class ConvergenceWarning(UserWarning):
    """A method's error falls more slowly with the step than its order says."""


@dataclass(frozen=True)
class ConvergenceCheck:
    """What halving the step of a run showed on a sample of its bodies.

    ``error`` is the largest angle, rad, over the run or at its end, between the run and the finest
    that was made, of ``divided`` times as many steps; ``order`` the one observed, None where
    rounding hides it (``limited_by`` "round-off") or the steps were too large for any ("step");
    ``declared`` that of the method. ``passed`` is false where an order was observed and is below
    the declared one. ``norm`` is the largest norm error, | |q| − 1 | or ‖C Cᵀ − 1‖.
    """

    method: str
    declared: int
    order: float | None
    error: float
    divided: int
    limited_by: str
    norm: float
    measured: int
    n_bodies: int
    passed: bool

    def __str__(self) -> str:
        found = "no order to be seen" if self.order is None else f"order {self.order:.2f}"
        return (
            f"{self.method}: {found}, declared {self.declared}; error {self.error:.1e} rad at most "
            f"over {self.measured} of {self.n_bodies} bodies, against {self.divided} times the "
            f"steps, limited by {self.limited_by}; norm off by {self.norm:.1e}"
        )


def check_convergence(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike | None = None,
    *,
    v0: ArrayLike | None = None,
    r0: ArrayLike | None = None,
    s0: ArrayLike | None = None,
    dt: float,
    n_steps: int,
    method: str | Method | None = None,
    representation: str | Attitude = "quat",
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    t0: float = 0.0,
    sample: int = 64,
    at: str = "run",
) -> ConvergenceCheck:
    """Order and error that a run shows of itself, by halving its step on a sample of its bodies.

    The step is halved three times, and again while the order is below the declared one: takes 15 to
    some 250 times as long as the run takes on ``sample`` bodies, the fastest, the slowest and
    others by chance. The check sees any error of the method that lowers its order, such as a wrong
    weight or sign or a stale rate; it sees none that a method of the same order for other equations
    would make.

    Parameters
    ----------
    scene, q0, w0, v0, r0, s0, dt, n_steps, method, representation, dtype, n_threads, t0 :
        As of :func:`fastatt.propagate`, with one ``dt`` for all bodies.
    sample : int
        Number of bodies.
    at : {"run", "end"}
        Where attitudes are compared: over the run, after each of its steps or, of more than 1024,
        of the first ones and at so many even times; or at its end alone.

    Returns
    -------
    ConvergenceCheck
        ``order``, ``declared``, ``error``, ``limited_by``, ``norm``, ``passed``.

    Warns
    -----
    ConvergenceWarning
        The order observed is below the declared one by more than 0.5: the method is broken, or the
        rate, torque or force is not smooth, such as a sampled torque between whose samples a step
        is no whole fraction.

    Raises
    ------
    ValueError, TypeError
        An argument that does not fit, by name, with what is accepted.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> check = fa.check_convergence(
    ...     scene, (1, 0, 0, 0), (0.1, 0.2, 0.3), dt=0.5, n_steps=50, method="rk4"
    ... )
    >>> round(check.order), check.passed
    (4, True)
    """
    ensemble = Ensemble.of(as_scene(scene), q0, w0, v0, r0, s0)
    record = method_of(scene, method, attitude_of(representation))
    kind = checks.precision(dtype, q0, w0, v0, r0, s0).name
    step = checks.real("dt", dt, zero=False)
    count = checks.whole("n_steps", n_steps, 1)
    whole = Problem(ensemble, step * count, checks.real("t0", t0), n_threads)
    rows = spread(whole, checks.whole("sample", sample, 1), np.random.default_rng(0))
    most = times_compared(checks.choice("at", at, ("run", "end")), rows.size)
    ladder = Ladder(whole.take(rows), Case(record, representation, kind), count, most)
    order = _order_of(ladder, declared := record.order_of(scene.kind))
    passed = declared == 0 or order is None or order >= declared - _SLACK
    worst = float(largest_angle(ladder.start.q, ladder.sight.q).max())
    hidden = "step" if worst > LARGE else "round-off"
    check = ConvergenceCheck(
        method=record.name,
        declared=declared,
        order=order,
        error=worst,
        divided=2 ** len(ladder.changes),
        limited_by=hidden if order is None else "truncation",
        norm=float(np.abs(ladder.start.run.norm_error).max()),
        measured=rows.size,
        n_bodies=ensemble.size,
        passed=passed,
    )
    if not passed:
        warnings.warn(
            f"{check}: the error falls more slowly than it should; either the method is not what "
            "it says, or the rate, torque or force is not smooth",
            ConvergenceWarning,
            stacklevel=2,
        )
    return check


def _order_of(ladder: Ladder, declared: int) -> float | None:
    """Halve until the declared order shows: the largest observed, None where rounding hides it."""
    orders: list[float] = []
    hidden = False
    for k in range(1, _HALVINGS + 1):
        if k > _SURE and ladder.first * 2**k * ladder.problem.ensemble.size > _STEPS:
            break
        ladder.halve()
        if k > 1 and not hidden:
            found = _order(ladder.changes[-2], ladder.changes[-1], ladder.floor)
            hidden = found is None
            if found is not None and not math.isnan(found):
                orders.append(found)
        if k >= _SURE and (hidden or (orders and max(orders) >= declared - _SLACK)):
            break
    return max(orders, default=None)


def _order(coarse: NDArray[np.float64], fine: NDArray[np.float64], floor: float) -> float | None:
    """The order that the bodies show, median; NaN if none yet, None if rounding hides it."""
    clear = (fine > floor) & (coarse > floor)
    if not clear.any():
        return None
    small = clear & (coarse < LARGE)
    if not small.any():
        return math.nan
    return float(np.median(np.log2(coarse[small] / fine[small])))
