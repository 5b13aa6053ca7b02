"""The convergence of a run, measured by halving its step on a sample of its bodies."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt.methods import Method
from fastatt.propagation.breakpoints import corners_of
from fastatt.propagation.choice_of_method import method_of
from fastatt.propagation.ensemble import Ensemble
from fastatt.scene.scene import Scene, as_scene
from fastatt.trade.forcing import forcing
from fastatt.trade.ladder import LARGE, Ladder, largest_angle, times_compared
from fastatt.trade.measure import Case, Problem
from fastatt.trade.work_precision import spread

_HALVINGS = 7
_SURE = 3  # the least number of halvings, to have a reference for the error
# the largest difference by which an observed order may be below the declared one
_SLACK = 0.5
_STEPS = 2_000_000  # the most body-steps of a run of the check
# ratio of changes by halving beyond which rounding does not limit the coarser run
_CLEAR = 4.0
# ratio of differences beyond which the steps do not resolve the motion
_UNRESOLVED = 30.0


class ConvergenceWarning(UserWarning):
    """Warns that a method's error falls more slowly with the step size than its order predicts."""


@dataclass(frozen=True)
class ConvergenceCheck:
    """The result of :func:`check_convergence`.

    Attributes
    ----------
    method : str
        Name of the method.
    declared : int
        Declared order.
    order : float or None
        Observed order; None if rounding hides it, in the run itself (``limited_by`` "round-off") or
        in the one with half the step size ("truncation"), or if all steps were too large ("step").
    error : float
        Largest angle between the run and the finest one, rad, after each step or, for more than
        1024 steps, after the first ones and at as many equally spaced times.
    divided : int
        Ratio of the numbers of steps of the finest run and of this run.
    limited_by : str
        What limits the error: "truncation", "round-off" or "step".
    measured : int
        Number of bodies in the sample.
    n_bodies : int
        Number of bodies in the ensemble.
    passed : bool
        False if an order was observed that is below the declared one, if a rate, torque or force
        jumps where no breakpoint is declared, or if another step size that is no whole fraction of
        ``dt`` gives another motion.
    """

    method: str
    declared: int
    order: float | None
    error: float
    divided: int
    limited_by: str
    measured: int
    n_bodies: int
    passed: bool

    def __str__(self) -> str:
        order = "no observed order" if self.order is None else f"observed order {self.order:.2f}"
        return (
            f"{self.method}: {order}, declared {self.declared}; error {self.error:.1e} rad at most "
            f"over {self.measured} of {self.n_bodies} bodies, against a run with {self.divided} "
            f"times as many steps, limited by {self.limited_by}"
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
    representation: str = "quat",
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    t0: float = 0.0,
    sample: int = 64,
) -> ConvergenceCheck:
    """Measure the order and the error of a run by halving its step size on a sample of its bodies.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces.
    q0 : array_like of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`fastatt.propagate`.
    w0 : array_like of shape (3,) or (N, 3), optional
        Initial angular velocities along body axes, rad/s.
    v0 : array_like of shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s.
    r0 : array_like of shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m.
    s0 : array_like of shape (n,) or (N, n), optional
        Initial values of the scene's states.
    dt : float
        Step size of all bodies, s.
    n_steps : int
        Number of steps.
    method : str or Method, optional
        The method, as in :func:`fastatt.propagate`.
    representation : str, default "quat"
        The representation, as in :func:`fastatt.propagate`.
    dtype : {float64, float32}, optional
        Precision, as in :func:`fastatt.propagate`.
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.propagate`.
    t0 : float, default 0.0
        Time of the initial state, s.
    sample : int, default 64
        Number of bodies, half of them the fastest, the others chosen at random.

    Returns
    -------
    ConvergenceCheck
        The observed and the declared order, and the error.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit.

    Warns
    -----
    ConvergenceWarning
        If the observed order is below the declared one by more than 0.5: the method is wrong, or
        the rate, torque or force is not smooth, such as a sampled torque whose interval is not a
        whole number of steps. Also if a further run, whose steps do not divide ``dt``, differs: the
        others cannot detect a vibration that goes through whole cycles in each of their steps. Also
        if a rate, torque or force jumps at a time that is not declared as a breakpoint.

    Notes
    -----
    The step is halved three times, and further while the order is below the declared one, which
    takes 15 to some 250 times as long as the run on ``sample`` bodies. The check detects any error
    of the method that lowers its order, such as a wrong weight or sign or a stale rate. It does not
    detect that a method of the same order solves other equations. If rounding limits the error, the
    finest run has the larger rounding errors, so that ``error`` can exceed the error of the run
    itself. With breakpoints or a sampled controller, the parts of a divided step do not shrink in
    proportion to the step size: a lower order is then accepted if halving the steps reaches
    rounding.

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
    record = method_of(scene, method, representation)
    precision = checks.precision(dtype, q0, w0, v0, r0, s0).name
    step = checks.real("dt", dt, zero=False)
    count = checks.whole("n_steps", n_steps, 1)
    fastest = min((x.period for x in scene.samplings), default=math.inf)
    if abs(step) > fastest * (1.0 + 1e-9):
        raise ValueError(
            f"dt: found {step} with a controller that is sampled every {fastest} s; "
            "accepted: at most that, since longer steps are divided at the samples"
        )
    whole = Problem(ensemble, step * count, checks.real("t0", t0), n_threads)
    rows = spread(whole, checks.whole("sample", sample, 1), np.random.default_rng(0))
    case = Case(record, representation, precision)
    ladder = Ladder(whole.take(rows), case, count, times_compared(rows.size))
    declared = record.order_of(scene.kind)
    order = _order_of(ladder, declared)
    error = float(largest_angle(ladder.start.q, ladder.sight.q).max())
    first, *others = (float(change.max()) for change in ladder.changes)
    is_rounded = order is None and first <= _CLEAR * max(others)
    limited_by = "round-off" if is_rounded else "truncation"
    if order is None and error > LARGE:
        limited_by = "step"
    why = ""
    if declared and order is not None and order < declared - _SLACK:
        why = (
            f". Halving the step size divides the error by {2.0**order:.3g}, where order "
            f"{declared} predicts {2**declared}: a coefficient of the method is wrong, or the "
            "rate, torque or force is not smooth (declare its jumps and corners as "
            "Scene.breakpoints)"
        )
    # two step sizes may have the same error at a jump by chance
    elif record.is_stepped and (jump := forcing(ladder.problem, ladder.case, count).jump):
        why = f"; but {jump}"
    elif record.is_stepped and (apart := _unresolved(ladder)):
        order, error, limited_by = None, max(error, apart), "step"
        why = (
            ". A step size that is no whole fraction of dt gives another motion: the rate, torque "
            "or force varies within a step; take smaller steps"
        )
    check = ConvergenceCheck(
        method=record.name,
        declared=declared,
        order=order,
        error=error,
        divided=2 ** len(ladder.changes),
        limited_by=limited_by,
        measured=rows.size,
        n_bodies=ensemble.size,
        passed=not why,
    )
    if why:
        warnings.warn(f"{check}{why}", ConvergenceWarning, stacklevel=2)
    return check


def _unresolved(ladder: Ladder) -> float:
    """How far a run whose steps do not divide ``dt`` is from the others, rad; 0 if it is one."""
    if ladder.worst() > LARGE:
        return 0.0
    apart = float(ladder.apart().max())
    differs = apart > _UNRESOLVED * max(ladder.worst(), ladder.floor)
    # at corners, which dt meets, the difference falls with more steps
    return apart if differs and ladder.apart(1.54).max() >= 0.7 * apart else 0.0


def _order_of(ladder: Ladder, declared: int) -> float | None:
    """Halve until the declared order is observed: the largest one, None if rounding hides it."""
    orders: list[float] = []
    hidden = False
    for k in range(1, _HALVINGS + 1):
        if k > _SURE and ladder.first * 2**k * ladder.problem.ensemble.size > _STEPS:
            break
        ladder.halve()
        if k > 1 and not hidden:
            order = _order(ladder.changes[-2], ladder.changes[-1], ladder.floor)
            hidden = order is None
            if order is not None and not math.isnan(order):
                orders.append(order)
        if k >= _SURE and (hidden or (orders and max(orders) >= declared - _SLACK)):
            break
    best = max(orders, default=None)
    scene = ladder.problem.ensemble.scene
    is_divided = corners_of(scene).size > 0 or bool(scene.samplings or scene.switches)
    # the parts of a step between breakpoints do not shrink in proportion to the step size
    if best is not None and best < declared - _SLACK and hidden and is_divided:
        return None
    return best


def _order(coarse: NDArray[np.float64], fine: NDArray[np.float64], floor: float) -> float | None:
    """The median order of the bodies; NaN if there is none yet, None if rounding hides it."""
    clear = (fine > floor) & (coarse > floor)
    if not clear.any():
        return None
    small = clear & (coarse < LARGE)
    if not small.any():
        return math.nan
    return float(np.median(np.log2(coarse[small] / fine[small])))
