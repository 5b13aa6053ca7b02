"""CF4: commutator-free, two exponentials."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.kernels.vec3 import add, axpy, dot, neg, scale
from fastatt.methods.method import larger, lie_method
from fastatt.motion import angular_velocity, attitude_of, given, momentum_of, momentum_rate
from fastatt.rates import rate
from fastatt.representations import gain_vector, plain, turn, value


class CF4(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    a = rate(model, t + F(0.21132486540518713) * h, p, h)
    b = rate(model, t + F(0.7886751345948129) * h, p, h)
    # weights ¼ ± √3/6
    big = F(0.5386751345948129) * h
    small = F(-0.038675134594812865) * h
    u = axpy(big, a, scale(small, b))
    v = axpy(small, a, scale(big, b))
    # each is about half of the turn
    return turn(rep, turn(rep, x, u), v), F(4.0) * larger(dot(u, u), dot(v, v))


def body_step(method, rep, model, t, h, x, p):
    F = type(h)
    half = F(0.5) * h
    bare = plain(rep)
    a = value(rep, attitude_of(rep, x))
    m = value(rep, momentum_of(rep, x))
    k1 = angular_velocity(m, p)
    t2 = given(model, t + half, p, h)
    n1 = momentum_rate(bare, model, given(model, t, p, h), a, m, p)
    a2 = turn(bare, a, scale(half, k1))
    m2 = axpy(half, n1, m)
    k2 = angular_velocity(m2, p)
    n2 = momentum_rate(bare, model, t2, a2, m2, p)
    m3 = axpy(half, n2, m)
    k3 = angular_velocity(m3, p)
    n3 = momentum_rate(bare, model, t2, turn(bare, a, scale(half, k2)), m3, p)
    m4 = axpy(h, n3, m)
    k4 = angular_velocity(m4, p)
    a4 = turn(bare, a2, scale(h, axpy(F(-0.5), k1, k3)))
    n4 = momentum_rate(bare, model, given(model, t + h, p, h), a4, m4, p)
    # exp(h/12 (3, 2, 2, −1)) exp(h/12 (−1, 2, 2, 3))
    twelfth = F(1.0 / 12.0) * h
    middle = scale(F(2.0), add(k2, k3))
    u = scale(twelfth, add(axpy(F(3.0), k1, middle), neg(k4)))
    v = scale(twelfth, add(axpy(F(3.0), k4, middle), neg(k1)))
    d = scale(F(1.0 / 6.0) * h, add(axpy(F(2.0), add(n2, n3), n1), n4))
    end = turn(rep, turn(rep, attitude_of(rep, x), u), v)
    z = F(4.0) * larger(dot(u, u), dot(v, v))
    return end + gain_vector(rep, momentum_of(rep, x), d), z


METHOD = lie_method(
    CF4(),
    step,
    body=body_step,
    name="cf4",
    order=4,
    rate_calls=2,
    exponentials=2,
    limit=2.2,
    body_limit=1.9,
    damping_limit=1.7,
    summary="two exponentials of sums of rates, no commutator; reversible",
    source="Celledoni, Marthinsen, Owren, Future Gen. Comp. Syst. 19 (2003) 341",
)
