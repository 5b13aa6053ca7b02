"""The limits of methods: the largest steps, and warnings with a step size that would do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from fastatt import rounding
from fastatt.attitudes import Attitude
from fastatt.engine.status import Status, count_flags
from fastatt.methods.method import TORQUED, Method
from fastatt.propagation.energy import angular_momentum
from fastatt.scene.scene import Scene
from fastatt.scene.torque_record import fastest_decay

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan


def turn_limit(
    scene: Scene, method: Method, attitude: Attitude, dtype: DTypeLike = np.float64
) -> float:
    """The largest ``|w| h`` of a step, rad; where one exponential is exact, that of rounding."""
    if scene.is_constant and method.exact_for_constant:
        return rounding.most_turned(dtype)
    kind = scene.kind
    return method.limit(attitude.family, body=kind != "rate", torqued=kind == "torqued")


def first_step(scene: Scene, method: Method, w: NDArray[Any], h: Any) -> NDArray[np.float64]:
    """The angle that the method limits, rad, in each body's first step; w is (3,) or (N, 3)."""
    with np.errstate(over="ignore", invalid="ignore"):
        if method.measure == "angle":
            return np.asarray(lengths(_finite(w)) * abs(h))
        m = np.asarray(_fastest(scene, w) * abs(h))
        if method.measure == "momentum":
            return m
        least, middle, most = np.moveaxis(np.sort(scene.principal.moments, axis=-1), -1, 0)
        between = (1.0 - least / middle) * (least / middle - least / most)
        apart = np.asarray(m * np.sqrt(np.abs(between)))
        if scene.kind != "torqued":
            return apart
        share = method.limits[TORQUED] / method.limit("quat")
        return np.asarray(np.maximum(lengths(_finite(w)) * abs(h), share * apart))


def lengths(v: NDArray[Any]) -> NDArray[np.float64]:
    """Lengths of rows (N, 3), by a matrix product, since NumPy reduces short rows slowly."""
    sizes = np.asarray(np.sqrt((v * v) @ np.ones(3)))
    if np.isfinite(sizes).all():
        return sizes
    return np.asarray(np.hypot(np.hypot(v[:, 0], v[:, 1]), v[:, 2]))  # squares overflow


def _finite(w: NDArray[Any]) -> NDArray[np.float64]:
    rates = np.atleast_2d(w).astype(np.float64, copy=False)
    if np.isfinite((rates @ np.ones(3)).sum()):  # a tenth of the time
        return rates
    return np.nan_to_num(rates, posinf=0.0, neginf=0.0)


def _fastest(scene: Scene, w: NDArray[Any]) -> NDArray[np.float64]:
    """``|m|/I_min`` of each body, rad/s, which a free body's angular velocity never exceeds."""
    inertia = np.asarray(scene.inertia)
    least = scene.principal.moments.min(axis=-1)
    rates = _finite(w)
    if inertia.shape == (3,):  # a fifth of the time
        return lengths(rates * (inertia / least))
    return np.asarray(lengths(angular_momentum(rates, inertia)) / least)


def decay(scene: Scene, h: Any) -> NDArray[np.float64]:
    """The largest c h/I of a scene's damping, for each body or for all."""
    if scene.kind != "torqued":
        return np.zeros(1)
    with np.errstate(over="ignore"):
        return np.atleast_1d(fastest_decay(scene.torque, scene.principal.moments) * abs(h))


def warn(plan: Plan, angles: NDArray[Any]) -> bool:
    """Warn, once, of steps that are too large or too small, from the rotation angles, rad."""
    limit, damped, kind = plan.limit, plan.damped, plan.kind
    method, h = plan.choice.method, plan.clock.dt
    seen = np.nan_to_num(angles, posinf=0.0)
    most = float(seen.max(initial=0.0))
    eps = float(np.finfo(kind).eps)
    text = ""
    if most > limit:
        measure = "" if method.measure == "angle" else f" by the measure {method.measure!r}"
        text = (
            f"dt: a step of body {seen.argmax()} is {most:.3g} rad{measure}, {method.name}'s limit "
            f"is {limit:.3g} ({int((seen > limit).sum())} of {seen.size} bodies are past it): take "
            f"|dt| <= {_step_of(h, seen) * limit / most:.3g}"
        )
    elif (damped > method.damping_limit).any():
        worst = float(damped.max())
        text = (
            f"dt: damping takes {worst:.3g} of the rate a step; {method.name} is trustworthy up "
            f"to {method.damping_limit:.3g}: take |dt| <= "
            f"{_step_of(h, damped) * method.damping_limit / worst:.3g}"
        )
    elif 0.0 < most < eps and not plan.attitude.compensated:
        text = (
            f"dt: no step is more than {most:.3g} rad, which {kind} does not register: "
            f"take |dt| >= {_step_of(h, seen) * 1e3 * eps / most:.3g}, or compensated=True"
        )
    elif angles_lost := rounding.of_angles(seen, kind):
        text = f"dt: found steps of {angles_lost}"
    if text:
        rounding.warn(text)
    return bool(text)


def _step_of(h: Any, measured: NDArray[Any]) -> float:
    """The size of the step of the body of which most was measured, s."""
    return abs(float(np.broadcast_to(h, measured.shape)[measured.argmax()]))


def warn_of_status(status: NDArray[np.uint8]) -> None:
    """Warn, once, of the bodies with a flag, unless too large steps were warned of."""
    flagged = np.flatnonzero(status)
    if flagged.size and not (status & Status.STEP_TOO_LARGE).any():
        flags = ", ".join(f"{name} ({count})" for name, count in count_flags(status).items())
        rounding.warn(
            f"status: found {flags}, {flagged.size} of {status.size} bodies, the first of them "
            f"body {flagged[0]}; their results are not to be trusted",
            RuntimeWarning,
        )
