"""RKMK4: classical Runge-Kutta on the rotation vector's equation, one exponential."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.kernels.so3 import dexpinv_short
from fastatt.kernels.vec3 import add, axpy, dot, scale
from fastatt.methods.method import lie_method
from fastatt.rates import rate
from fastatt.representations import turn


class RKMK4(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    half = F(0.5) * h
    middle = rate(model, t + half, p, h)
    k1 = rate(model, t, p, h)
    k2 = dexpinv_short(scale(half, k1), middle)
    k3 = dexpinv_short(scale(half, k2), middle)
    k4 = dexpinv_short(scale(h, k3), rate(model, t + h, p, h))
    u = scale(F(1.0 / 6.0) * h, add(axpy(F(2.0), add(k2, k3), k1), k4))
    return turn(rep, x, u), dot(u, u)


METHOD = lie_method(
    RKMK4(),
    step,
    name="rkmk4",
    order=4,
    rate_calls=3,
    exponentials=1,
    exact_for_constant=False,  # its equation is singular at 2π
    summary="Runge-Kutta on the rotation vector; half of magnus4's error in large-angle coning",
    source="Munthe-Kaas, Appl. Numer. Math. 29 (1999) 115",
)
