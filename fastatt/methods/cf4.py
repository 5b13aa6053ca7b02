"""CF4: commutator-free, two exponentials."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.kernels.vec3 import axpy, dot, scale
from fastatt.methods.method import lie_method
from fastatt.rates import rate
from fastatt.representations import turn


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
    z = dot(u, u)
    y = dot(v, v)
    return turn(rep, turn(rep, x, u), v), z if z > y else y


METHOD = lie_method(
    CF4(),
    step,
    name="cf4",
    order=4,
    rate_calls=2,
    exponentials=2,
    summary="two exponentials of sums of rates, no commutator; reversible",
    source="Celledoni, Marthinsen, Owren, Future Gen. Comp. Syst. 19 (2003) 341",
)
