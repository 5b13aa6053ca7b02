"""RKMK4: classical Runge-Kutta on the rotation vector's equation, one exponential."""

from __future__ import annotations

from typing import Any

from fastatt.methods.lie_group import body_step, lie_method
from fastatt.tracing.formulas import Vector, axpy, plus, scale, so3


def exponents(w: Any, t: Any, h: Any) -> Any:
    half = 0.5 * h
    k1 = w(t)
    middle = w(t + half)
    k2 = so3.dexpinv_short(scale(half, k1), middle)
    k3 = so3.dexpinv_short(scale(half, k2), middle)
    k4 = so3.dexpinv_short(scale(h, k3), w(t + h))
    return (scale(1.0 / 6.0 * h, plus(axpy(2.0, plus(k2, k3), k1), k4)),)


def body(slope: Any, t: Any, h: Any, m: Vector) -> Any:
    half = 0.5 * h

    def stage(time: Any, u: Vector, m: Vector) -> Any:
        """(u̇, ṁ) of the rotation vector u from the start, and of the momentum m."""
        w, rate_of_m = slope(time, (u,), m)
        return so3.dexpinv_short(u, w), rate_of_m

    k1, n1 = slope(t, (), m)
    k2, n2 = stage(t + half, scale(half, k1), axpy(half, n1, m))
    k3, n3 = stage(t + half, scale(half, k2), axpy(half, n2, m))
    k4, n4 = stage(t + h, scale(h, k3), axpy(h, n3, m))
    sixth = 1.0 / 6.0 * h
    u = scale(sixth, plus(axpy(2.0, plus(k2, k3), k1), k4))
    return (u,), scale(sixth, plus(axpy(2.0, plus(n2, n3), n1), n4))


METHOD = lie_method(
    "rkmk4",
    4,
    exponents,
    body=body_step(body),
    rate_calls=3,
    body_calls=4,
    exponentials=1,
    limit=1.8,
    body_limit=1.9,
    damping_limit=1.7,
    exact_for_constant=False,  # its equation is singular at 2π
    tried_on=(),
    summary="Runge-Kutta on the rotation vector; less error than magnus4 in coning near 1 rad",
    source="Munthe-Kaas, Appl. Numer. Math. 29 (1999) 115",
)
