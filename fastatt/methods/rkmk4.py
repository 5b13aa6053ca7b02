"""RKMK4: classical Runge-Kutta on the rotation vector's equation, one exponential."""

from __future__ import annotations

from typing import NamedTuple

from fastatt._jit import helper
from fastatt.kernels.so3 import dexpinv_short
from fastatt.kernels.vec3 import add, axpy, dot, scale
from fastatt.methods.method import larger, lie_method
from fastatt.motion import angular_velocity, attitude_of, given, momentum_of, momentum_rate
from fastatt.rates import rate
from fastatt.representations import gain_vector, plain, turn, value


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
    return turn(rep, x, u), larger(dot(u, u), h * h * dot(k1, k1))


@helper
def stage(rep, model, t, x, u, m, p):
    """(u̇, ṁ) of the rotation vector u from the attitude x and of the momentum m."""
    rate_of_m = momentum_rate(rep, model, t, turn(rep, x, u), m, p)
    return dexpinv_short(u, angular_velocity(m, p)), rate_of_m


def body_step(method, rep, model, t, h, x, p):
    F = type(h)
    half = F(0.5) * h
    bare = plain(rep)
    a = value(rep, attitude_of(rep, x))
    m = value(rep, momentum_of(rep, x))
    middle = given(model, t + half, p, h)
    k1 = angular_velocity(m, p)
    n1 = momentum_rate(bare, model, given(model, t, p, h), a, m, p)
    k2, n2 = stage(bare, model, middle, a, scale(half, k1), axpy(half, n1, m), p)
    k3, n3 = stage(bare, model, middle, a, scale(half, k2), axpy(half, n2, m), p)
    k4, n4 = stage(bare, model, given(model, t + h, p, h), a, scale(h, k3), axpy(h, n3, m), p)
    sixth = F(1.0 / 6.0) * h
    u = scale(sixth, add(axpy(F(2.0), add(k2, k3), k1), k4))
    d = scale(sixth, add(axpy(F(2.0), add(n2, n3), n1), n4))
    end = turn(rep, attitude_of(rep, x), u)
    z = larger(dot(u, u), h * h * dot(k1, k1))
    return end + gain_vector(rep, momentum_of(rep, x), d), z


METHOD = lie_method(
    RKMK4(),
    step,
    body=body_step,
    name="rkmk4",
    order=4,
    rate_calls=3,
    exponentials=1,
    limit=1.8,
    body_limit=1.9,
    damping_limit=1.7,
    exact_for_constant=False,  # its equation is singular at 2π
    summary="Runge-Kutta on the rotation vector; half of magnus4's error in large-angle coning",
    source="Munthe-Kaas, Appl. Numer. Math. 29 (1999) 115",
)
