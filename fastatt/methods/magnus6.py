"""Magnus-6: one exponential, three Gauss nodes, nested commutators."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.kernels.vec3 import add, axpy, cross, dot, scale, sub
from fastatt.methods.method import larger, lie_method
from fastatt.rates import rate
from fastatt.representations import turn


class Magnus6(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    w1 = rate(model, t + F(0.1127016653792583) * h, p, h)
    w2 = rate(model, t + F(0.5) * h, p, h)
    w3 = rate(model, t + F(0.8872983346207417) * h, p, h)
    a1 = scale(h, w2)
    a2 = scale(F(1.2909944487358056) * h, sub(w3, w1))
    a3 = scale(F(10.0 / 3.0) * h, axpy(F(-2.0), w2, add(w1, w3)))
    # the bracket of right multiplication is [x, y] = −x×y
    c1 = cross(a2, a1)
    c2 = scale(F(1.0 / 60.0), cross(a1, axpy(F(2.0), a3, c1)))
    left = axpy(F(-20.0), a1, sub(c1, a3))
    u = axpy(F(1.0 / 240.0), cross(add(a2, c2), left), axpy(F(1.0 / 12.0), a3, a1))
    # u alone shrinks again where the series fails
    return turn(rep, x, u), larger(dot(u, u), h * h * dot(w1, w1))


METHOD = lie_method(
    Magnus6(),
    step,
    name="magnus6",
    order=6,
    rate_calls=3,
    exponentials=1,
    limit=3.0,
    summary="three Gauss nodes and nested commutators; for tight tolerances, reversible",
    source="Blanes, Casas, Oteo, Ros, Phys. Rep. 470 (2009), eq. 257",
)
