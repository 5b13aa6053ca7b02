"""Coning-2: two intervals at a time."""

from __future__ import annotations

from typing import NamedTuple

from fastatt._jit import kernel
from fastatt.kernels.coning import (
    increments_linear,
    rates_quadratic,
    rotation_vector_linear,
    rotation_vector_quadratic,
)
from fastatt.methods.sampled import Window, exponential, sampled_method


class Coning2(NamedTuple):
    """Tag."""


@kernel
def rates(rep, v, h):
    t = h[0] + h[1]
    a, b, c = rates_quadratic((v[0], v[1], v[2]), (v[3], v[4], v[5]), (v[6], v[7], v[8]), h[0], t)
    p = exponential(rep, rotation_vector_quadratic(a, b, c, h[0]))
    q = exponential(rep, rotation_vector_quadratic(a, b, c, t))
    return p[0], p[1], p[2], p[3], q[0], q[1], q[2], q[3]


@kernel
def increments(rep, v, h):
    # a line whose time 0 lies between the two intervals, moved to the start of the first
    a, b = increments_linear((v[0], v[1], v[2]), (v[3], v[4], v[5]), h[0], h[1])
    a = (a[0] - h[0] * b[0], a[1] - h[0] * b[1], a[2] - h[0] * b[2])
    p = exponential(rep, rotation_vector_linear(a, b, h[0]))
    q = exponential(rep, rotation_vector_linear(a, b, h[0] + h[1]))
    return p[0], p[1], p[2], p[3], q[0], q[1], q[2], q[3]


METHOD = sampled_method(
    Coning2(),
    Window(history=0, span=2, rates=rates, increments=increments),
    name="coning2",
    order=4,
    exponentials=1,
    of_rates=0.9,
    of_increments=1.0,
    summary="two intervals at a time, (2/3) θ1×θ2 of increments",
    source="Bortz, IEEE Trans. AES 7 (1971); Savage, J. Guidance 21 (1998) 19",
)
