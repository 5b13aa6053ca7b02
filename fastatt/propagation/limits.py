"""The limits of methods: the largest steps, and warnings with a step size that would do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import rounding
from fastatt._cached import cached_property
from fastatt.attitudes import Attitude
from fastatt.engine.status import FLAGS, Status, count_flags
from fastatt.methods.method import TORQUED, Method
from fastatt.propagation.initial import Initial
from fastatt.scene.models import Packed
from fastatt.scene.scene import Scene
from fastatt.scene.torque_record import fastest_decay


@dataclass(frozen=True, eq=False)
class StepLimits:
    """The largest and the smallest steps for which the method of a run is trustworthy."""

    scene: Scene
    method: Method
    attitude: Attitude
    dtype: np.dtype[Any]
    #: the step size, s, of all bodies or of each
    dt: NDArray[np.float64]

    @cached_property
    def turn(self) -> float:
        """The largest ``|w| h`` of a step, rad; where one exponential is exact, by rounding."""
        scene, method, kind = self.scene, self.method, self.scene.kind
        if scene.is_constant and method.exact_for_constant:
            return rounding.most_turned(self.dtype)
        return method.limit(self.attitude.family, body=kind != "rate", torqued=kind == "torqued")

    @cached_property
    def damped(self) -> NDArray[np.float64]:
        """The largest c h/I of a scene's damping, for each body or for all."""
        if self.scene.kind != "torqued":
            return np.zeros(1)
        with np.errstate(over="ignore"):
            fastest = fastest_decay(self.scene.torque, self.scene.principal.moments)
            return np.atleast_1d(fastest * abs(self.dt))

    @cached_property
    def too_damped(self) -> NDArray[np.bool_]:
        """Where damping is beyond the method's limit."""
        return np.asarray(self.damped > self.method.damping_limit)

    @cached_property
    def usual(self) -> tuple[float, float]:
        """Between which largest angles of a step, rad, there is nothing to warn of."""
        if self.too_damped.any():
            return math.inf, 0.0
        least = 0.0 if self.attitude.compensated else float(np.finfo(self.dtype).eps)
        return least, min(self.turn, rounding.most_half_right(self.dtype))

    def warn_of_states(self, packed: Packed, start: Initial, t0: float) -> None:
        """Warn of states of the scene that change too fast for the steps, at the start."""
        from fastatt.propagation.stiffness import fastest_states

        decay, frequency = fastest_states(packed, start, t0)
        h, limit = float(np.abs(self.dt).max()), self.method.damping_limit
        for rate, most, what in (
            (decay, limit, "decays at"), (frequency, 0.5 * limit, "oscillates at"),
        ):  # fmt: skip
            if rate * h > most:
                rounding.warn(
                    f"dt: a state of the scene {what} {rate:.3g} 1/s, by the eigenvalues of ∂ṡ/∂s, "
                    f"{rate * h:.3g} a step; {self.method.name} is trustworthy up to "
                    f"{most:.3g}: take |dt| <= {most / rate:.3g}"
                )
                return

    def warn(self, start: Initial, angles: Any = None, status: Any = None) -> bool:
        """Warn, once, of steps that are too large or too small.

        Of each body's first step before the run; after it of the largest angles, rad, or of the
        first steps where these are the reason. The angles from which no number is left are not
        known.
        """
        least, most = self.usual
        if angles is not None and not np.count_nonzero(status) and least <= angles.max() <= most:
            return False
        first = np.zeros(1)
        if self.scene.kind != "rate":
            first = first_step(self.scene, self.method, start.y[:, :3], self.dt)
        text = "" if angles is None else self._advice(angles)
        if angles is None or text or (status & Status.NON_FINITE).any():
            text = self._advice(first) or text
        # a run whose only step is a shorter last one gives no warning
        if angles is not None and angles.max() < least <= first.max() and not status.any():
            text = ""
        if text:
            rounding.warn(text)
        return bool(text)

    def _advice(self, angles: NDArray[Any]) -> str:
        """The warning of steps that are too large or too small, from rotation angles, or ""."""
        limit, damped, method, h = self.turn, self.damped, self.method, self.dt
        seen = np.where(angles < np.inf, angles, 0.0)
        most = float(seen.max(initial=0.0))
        eps = float(np.finfo(self.dtype).eps)
        if most > limit:
            measure = "" if method.measure == "angle" else f" by the measure {method.measure!r}"
            return (
                f"dt: a step of body {seen.argmax()} is {most:.3g} rad{measure}, {method.name}'s "
                f"limit is {limit:.3g} ({int((seen > limit).sum())} of {seen.size} bodies are past "
                f"it): take |dt| <= {_step_of(h, seen) * limit / most:.3g}"
            )
        if self.too_damped.any():
            worst = float(damped.max())
            return (
                f"dt: damping takes {worst:.3g} of the rate a step; {method.name} is trustworthy "
                f"up to {method.damping_limit:.3g}: take |dt| <= "
                f"{_step_of(h, damped) * method.damping_limit / worst:.3g}"
            )
        if 0.0 < most < eps and not self.attitude.compensated:
            return (
                f"dt: no step is more than {most:.3g} rad, which {self.dtype} does not register: "
                f"take |dt| >= {_step_of(h, seen) * 1e3 * eps / most:.3g}, or compensated=True"
            )
        rounded = rounding.of_angles(np.array([most]), self.dtype)
        return f"dt: found steps of {rounded}" if rounded else ""


def warn_of_status(status: NDArray[FLAGS], *, is_warned: bool) -> None:
    """Warn, once, of the bodies with a flag, unless the steps ``is_warned`` of are the reason."""
    if not np.count_nonzero(status):
        return
    flagged, of_steps = np.flatnonzero(status), Status.STEP_TOO_LARGE | Status.NON_FINITE
    if not (is_warned and (status & of_steps).any()):
        flags = ", ".join(f"{name} ({count})" for name, count in count_flags(status).items())
        rounding.warn(
            f"status: found {flags}, {flagged.size} of {status.size} bodies, the first of them "
            f"body {flagged[0]}; their results are not to be trusted",
            RuntimeWarning,
        )


def first_step(scene: Scene, method: Method, w: NDArray[Any], h: Any) -> NDArray[np.float64]:
    """The angle that the method limits, rad, in each body's first step; w is (N, 3)."""
    from fastatt.invariants.energy import angular_momentum

    rates = w.astype(np.float64, copy=False)
    with np.errstate(over="ignore", invalid="ignore"):
        angle = _lengths(rates) * abs(h)
        if method.measure == "angle":
            return np.asarray(angle)
        moments = np.sort(scene.principal.moments, axis=-1)
        least, middle, most = np.moveaxis(moments, -1, 0)
        # a free body's angular velocity is never above |m|/I_min
        momentum = _lengths(angular_momentum(rates, np.asarray(scene.inertia))) / least * abs(h)
        if method.measure == "momentum":
            return np.asarray(momentum)
        between = (1.0 - least / middle) * (least / middle - least / most)
        apart = np.asarray(momentum * np.sqrt(np.abs(between)))
        if scene.kind != "torqued":
            return apart
        return np.asarray(np.maximum(angle, method.limits[TORQUED] / method.limit("quat") * apart))


def _lengths(v: NDArray[Any]) -> NDArray[np.float64]:
    """Lengths of rows (N, 3), whose squares may overflow."""
    return np.asarray(np.hypot(np.hypot(v[:, 0], v[:, 1]), v[:, 2]))


def _step_of(h: Any, measured: NDArray[Any]) -> float:
    """The size of the step of the body of which most was measured, s."""
    return abs(float(np.broadcast_to(h, measured.shape)[measured.argmax()]))
