"""A run's own order and error, by halving its step on a sample of its bodies."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.arrays import angle_between
from fastatt.propagation.ensemble import Ensemble
from fastatt.propagation.trajectory import Trajectory
from fastatt.rounding import noted

_HALVINGS = 7
# of a declared order: what is found may lie so far below
_SLACK = 0.5
# turns, rad, between two steps' results: more is no order yet
_LARGE = 0.3
_STEPS = 2_000_000  # body-steps that the check may take
_LOOKS = 1024  # times of a run at most
#: a run too long to be looked at after each step is looked at again over so small a part of it
EARLY = 8


class OrderWarning(UserWarning):
    """A method's error falls more slowly with the step than its order says."""


@dataclass(frozen=True)
class SelfCheck:
    """What halving the step of a run showed on a sample of its bodies.

    ``error`` is the largest angle, rad, that the run's own step is estimated to be off by, over the
    run or at its end; ``order`` the one observed, None where rounding hides it (``limited_by``
    "round-off") or the steps were too large for any ("step"); ``declared`` that of the method.
    ``passed`` is false where an order was observed and is below the declared one. ``norm`` is the
    largest departure of the state from its group, | |q| − 1 | or ‖C Cᵀ − 1‖.
    """

    method: str
    declared: int
    order: float | None
    error: float
    limited_by: str
    norm: float
    n_bodies: int
    passed: bool

    def __str__(self) -> str:
        found = "no order to be seen" if self.order is None else f"order {self.order:.2f}"
        return (
            f"{self.method}: {found}, declared {self.declared}; error {self.error:.1e} rad on "
            f"{self.n_bodies} bodies, limited by {self.limited_by}; norm off by {self.norm:.1e}"
        )


def examine(
    run: Callable[[Ensemble, float, int, int], Trajectory],
    ensemble: Ensemble,
    dt: float,
    n_steps: int,
    *,
    sample: int,
    at: str,
) -> SelfCheck:
    """Halve the step until the order shows, and warn with ``OrderWarning`` where it is too low.

    ``run(ensemble, dt, n_steps, save_every)`` propagates a sample, the fastest bodies and others
    evenly spaced.
    The differences of the results at h, h/2, h/4, … fall by 2^order each; where the first do not
    yet, as large steps have no order, the step is halved further, until rounding ends it.
    """
    some = ensemble.take(_sample(ensemble, sample))

    looks = _LOOKS if checks.choice("at", at, ("run", "end")) == "run" else 1

    def divided(by: int) -> list[Trajectory]:
        with noted():
            return [
                run(some, dt / by, n * by, -(-n // looks) * by) for n in beginnings(n_steps, looks)
            ]

    first, *early = divided(1)
    declared = first.record.order_of(ensemble.scene.kind)
    floor = _rounding(first, abs(dt) * n_steps)
    before = np.concatenate([x.q[1:] for x in (first, *early)])
    changes: list[NDArray[np.float64]] = []
    orders: list[float] = []
    for k in range(1, _HALVINGS + 1):
        n = n_steps * 2**k
        if k > 2 and n * some.size > _STEPS:
            break
        after = np.concatenate([x.q[1:] for x in divided(2**k)])
        changes.append(np.nan_to_num(angle_between(before, after), nan=np.pi).max(axis=0))
        before = after
        if k > 1:
            found = _order(changes[-2], changes[-1], floor * math.sqrt(2.0**k))
            if found is None:
                break
            if not math.isnan(found):
                orders.append(found)
            if orders and found >= declared - _SLACK:
                break
    order = max(orders, default=None)
    worst = float(changes[0].max())
    passed = declared == 0 or order is None or order >= declared - _SLACK
    limited = "truncation"
    if order is None:
        limited = "step" if worst > _LARGE else "round-off"
    check = SelfCheck(
        method=first.method,
        declared=declared,
        order=order,
        error=worst / (1.0 - 0.5 ** max(1, declared)),
        limited_by=limited,
        norm=float(np.abs(first.norm_error).max()),
        n_bodies=some.size,
        passed=passed,
    )
    if not passed:
        warnings.warn(
            f"{check}: the error falls more slowly than it should; either the method is not what "
            "it says, or what acts on the bodies is not smooth",
            OrderWarning,
            stacklevel=3,
        )
    return check


def beginnings(n: int, looks: int) -> list[int]:
    """Numbers of steps, of which the last is looked at after each: n, and of its beginnings.

    What decays does so from the beginning; with the end alone to look at, there are none.
    """
    found = [n]
    while found[-1] > looks > 1:
        found.append(-(-found[-1] // EARLY))
    return found


def _sample(ensemble: Ensemble, size: int) -> NDArray[np.intp]:
    n = ensemble.size
    rows = np.linspace(0, n - 1, min(n, size)).astype(np.intp)
    if ensemble.w0 is not None and ensemble.w0.ndim == 2 and n > size:
        fastest = np.argsort(np.linalg.norm(ensemble.w0, axis=1))[-(size // 4) :]
        rows = np.unique(np.concatenate([rows[:: 2 if size > 1 else 1], fastest]))
    return rows


def _rounding(run: Trajectory, seconds: float) -> float:
    """Angles, rad, below which two runs of a step may differ by rounding."""
    eps = float(np.finfo(run.state.dtype).eps)
    turned = float(np.linalg.norm(run.w, axis=-1).max()) * seconds
    return 20.0 * eps * (1.0 + turned + math.sqrt(seconds / abs(run.dt)))


def _order(coarse: NDArray[np.float64], fine: NDArray[np.float64], floor: float) -> float | None:
    """The order that the bodies show, median; NaN if none yet, None if rounding hides it."""
    clear = (fine > floor) & (coarse > floor)
    if not clear.any():
        return None
    small = clear & (coarse < _LARGE)
    if not small.any():
        return math.nan
    return float(np.median(np.log2(coarse[small] / fine[small])))
