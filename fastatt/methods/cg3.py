"""CG3: Crouch-Grossman, three exponentials."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.kernels.vec3 import dot, scale
from fastatt.methods.method import larger, lie_method
from fastatt.rates import rate
from fastatt.representations import turn


class CG3(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    u = scale(F(13.0 / 51.0) * h, rate(model, t, p, h))
    v = scale(F(-2.0 / 3.0) * h, rate(model, t + F(0.75) * h, p, h))
    w = scale(F(24.0 / 17.0) * h, rate(model, t + F(17.0 / 24.0) * h, p, h))
    x = turn(rep, turn(rep, turn(rep, x, u), v), w)
    return x, larger(larger(dot(u, u), dot(v, v)), dot(w, w))


METHOD = lie_method(
    CG3(),
    step,
    name="cg3",
    order=3,
    rate_calls=3,
    exponentials=3,
    limit=1.8,  # of the last turn, 24/17 |w|h
    summary="exponentials of frozen rates, the historical alternative; magnus4 beats it in both",
    source="Crouch and Grossman, J. Nonlinear Sci. 3 (1993) 1",
)
