"""Lie midpoint: one exponential of the rate at the middle of the step."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.kernels.vec3 import dot, scale
from fastatt.methods.method import lie_method
from fastatt.rates import rate
from fastatt.representations import turn


class LieMidpoint(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    u = scale(h, rate(model, t + F(0.5) * h, p, h))
    return turn(rep, x, u), dot(u, u)


METHOD = lie_method(
    LieMidpoint(),
    step,
    name="lie_midpoint",
    order=2,
    rate_calls=1,
    exponentials=1,
    limit=0.7,
    summary="exponential of the rate at the middle; exact for a constant rate, reversible",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), §5",
)
