"""Trapezoid: the mean of the rates at both ends of an interval."""

from __future__ import annotations

from typing import NamedTuple

from fastatt._jit import kernel
from fastatt.kernels.vec3 import add, scale
from fastatt.methods.sampled import Window, exponential, sampled_method


class Trapezoid(NamedTuple):
    """Tag."""


@kernel
def rates(rep, v, h):
    F = type(h[0])
    return exponential(rep, scale(F(0.5) * h[0], add((v[0], v[1], v[2]), (v[3], v[4], v[5]))))


METHOD = sampled_method(
    Trapezoid(),
    Window(history=0, span=1, rates=rates),
    name="trapezoid",
    order=2,
    exponentials=1,
    of_rates=0.6,
    summary="the mean of two samples; what most loggers' software does",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), §5",
)
