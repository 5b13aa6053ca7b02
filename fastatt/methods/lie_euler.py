"""Lie-Euler: one exponential of the rate at the start of the step."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.kernels.vec3 import dot, scale
from fastatt.methods.method import lie_method
from fastatt.rates import rate
from fastatt.representations import turn


class LieEuler(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    u = scale(h, rate(model, t, p, h))
    return turn(rep, x, u), dot(u, u)


METHOD = lie_method(
    LieEuler(),
    step,
    name="lie_euler",
    order=1,
    rate_calls=1,
    exponentials=1,
    limit=0.1,
    summary="exponential of the rate at the start; exact for a constant rate",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), eq. 2.4",
)
