"""Magnus-4: one exponential, two Gauss nodes and one commutator."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.kernels.vec3 import add, axpy, cross, dot, scale, sub
from fastatt.methods.method import larger, lie_method
from fastatt.rates import rate
from fastatt.representations import turn


class Magnus4(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    a = rate(model, t + F(0.21132486540518713) * h, p, h)
    b = rate(model, t + F(0.7886751345948129) * h, p, h)
    # u = h (a + b)/2 + (√3/12) h² a×b; with b − a the bracket of a constant rate is exactly 0
    bracket = cross(a, sub(b, a))
    u = scale(h, axpy(F(0.14433756729740643) * h, bracket, scale(F(0.5), add(a, b))))
    # u alone shrinks again where the series fails
    return turn(rep, x, u), larger(dot(u, u), h * h * dot(a, a))


METHOD = lie_method(
    Magnus4(),
    step,
    name="magnus4",
    order=4,
    rate_calls=2,
    exponentials=1,
    limit=1.8,
    summary="Gauss nodes and one commutator; the cheapest order 4 here, reversible",
    source="Iserles and Nørsett, Phil. Trans. R. Soc. A 357 (1999) 983",
)
