"""The limits of methods: the largest steps, and warnings with a step size that would do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from fastatt import rounding
from fastatt.attitudes import Attitude
from fastatt.methods.method import TORQUED, Method
from fastatt.propagation.energy import angular_momentum
from fastatt.scene import torques
from fastatt.scene.equations import PrescribedRate
from fastatt.scene.models import Packed
from fastatt.scene.rates import bound, lengths
from fastatt.scene.scene import Scene

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan

# evaluations in a step beyond which monitoring the rotation angle takes almost no extra time
_STAGES = 4


def turn_limit(
    scene: Scene, method: Method, representation: Attitude, dtype: DTypeLike = np.float64
) -> float:
    """The largest ``|w| h`` of a step, rad; where one exponential is exact, that of rounding."""
    if scene.is_constant and method.exact_for_constant:
        return rounding.most_turned(dtype)
    kind = scene.kind
    return method.limit(representation, body=kind != "rate", torqued=kind == "torqued")


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


def _finite(w: NDArray[Any]) -> NDArray[np.float64]:
    rates = np.atleast_2d(w).astype(np.float64, copy=False)
    if np.isfinite((rates @ np.ones(3)).sum()):  # a tenth of the time
        return rates
    return np.nan_to_num(rates, posinf=0.0, neginf=0.0)


def _fastest(scene: Scene, w: NDArray[Any]) -> NDArray[np.float64]:
    """``|m|/I_min`` of each body, rad/s, which a free body's angular velocity never exceeds."""
    given = np.asarray(scene.inertia)
    least = scene.principal.moments.min(axis=-1)
    rates = _finite(w)
    if given.shape == (3,):  # a fifth of the time
        return np.asarray(np.sqrt(np.square(rates) @ np.square(given / least)))
    return np.asarray(lengths(angular_momentum(rates, given)) / least)


def known_turns(scene: Scene, choice: Any, packed: Packed) -> NDArray[np.float64] | float | None:
    """Bounds of each body's angular velocity, rad/s; None if they are not known before the run.

    The bound of free bodies is given as 0, since it follows from their initial momentum. There is
    no bound for coordinates with poles and for torques that depend on the position. A step with
    many stages is monitored always, since leaving monitoring out saves too little.
    """
    method: Method = choice.method
    if choice.attitude.has_poles or scene.needs_position:
        return None
    if method.rate_calls > _STAGES and not method.stages:
        return None
    turning = packed.structure.turning
    if isinstance(turning, PrescribedRate):
        with np.errstate(over="ignore", invalid="ignore"):
            return bound(turning.law, packed.params[..., : turning.n_params])
    return None if scene.kind == "torqued" else 0.0


def quiet_up_to(scene: Scene, method: Method, limit: float) -> float:
    """The largest known rotation angle of a step, rad, for which steps are not monitored."""
    if scene.is_constant and method.exact_for_constant:
        return 3.0  # of exponentials good up to π
    if method.measure == "asymmetry":
        return limit
    # within π with all a method's brackets; DMV converges up to 0.5
    return min(limit, 0.4 if method.measure == "momentum" else 1.0)


def decay(scene: Scene, h: Any) -> NDArray[np.float64]:
    """The largest c h/I of a scene's damping, for each body or for all."""
    if scene.kind != "torqued":
        return np.zeros(1)
    with np.errstate(over="ignore"):
        return np.atleast_1d(torques.fastest_decay(scene.torque, scene.principal.moments) * abs(h))


def warn(plan: Plan, angles: NDArray[Any]) -> bool:
    """Warn, once, of steps that are too large or too small, from the rotation angles, rad."""
    limit, damped, kind = plan.limit, plan.damped, plan.kind
    method, h = plan.choice.method, plan.clock.steps
    seen = np.asarray(angles)
    most = float(seen.max()) if seen.size else 0.0
    if not math.isfinite(most):
        seen = np.nan_to_num(seen, nan=0.0, posinf=0.0)
        most = float(seen.max())
    eps = float(np.finfo(kind).eps)
    if isinstance(h, np.ndarray):
        worst_of = seen if most > limit or not (damped > method.damping_limit).any() else damped
        if worst_of.size == 1:  # of all bodies, the one with the largest step
            h = float(h[np.abs(h).argmax()])
        else:
            h = float(np.broadcast_to(h, worst_of.shape)[worst_of.argmax()] if seen.size else 0.0)
    text = ""
    if most > limit:
        measure = "" if method.measure == "angle" else f" by the measure {method.measure!r}"
        text = (
            f"dt: a step of body {seen.argmax()} is {most:.3g} rad{measure}, {method.name}'s limit "
            f"is {limit:.3g} ({int((seen > limit).sum())} of {seen.size} bodies are past it): take "
            f"|dt| <= {abs(h) * limit / most:.3g}"
        )
    elif (damped > method.damping_limit).any():
        worst = float(damped.max())
        text = (
            f"dt: damping takes {worst:.3g} of the rate a step; {method.name} is trustworthy up "
            f"to {method.damping_limit:.3g}: take |dt| <= "
            f"{abs(h) * method.damping_limit / worst:.3g}"
        )
    elif 0.0 < most < eps and not plan.attitude.compensated:
        text = (
            f"dt: no step is more than {most:.3g} rad, which {kind} does not register: "
            f"take |dt| >= {abs(h) * 1e3 * eps / most:.3g}, or compensated=True"
        )
    elif found := rounding.of_angles(seen, kind):
        text = f"dt: found steps of {found}"
    if text:
        rounding.warn(text)
    return bool(text)
