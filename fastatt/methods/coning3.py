"""Coning-3: three intervals at a time, polynomial or optimal for pure coning."""

from __future__ import annotations

from typing import NamedTuple

from fastatt._jit import kernel
from fastatt.kernels.coning import (
    increments_quadratic,
    miller,
    rates_cubic,
    rotation_vector,
    rotation_vector_quadratic,
)
from fastatt.methods.sampled import Window, exponential, sampled_method


class Coning3(NamedTuple):
    """Tag."""


class Coning3Optimal(NamedTuple):
    """Tag."""


@kernel
def _three(p, q, r):
    return p[0], p[1], p[2], p[3], q[0], q[1], q[2], q[3], r[0], r[1], r[2], r[3]


@kernel
def rates(rep, v, h):
    s = h[0] + h[1]
    t = s + h[2]
    a, b, c, d = rates_cubic(
        (v[0], v[1], v[2]), (v[3], v[4], v[5]), (v[6], v[7], v[8]), (v[9], v[10], v[11]), h[0], s, t
    )
    p = exponential(rep, rotation_vector(a, b, c, d, h[0]))
    q = exponential(rep, rotation_vector(a, b, c, d, s))
    return _three(p, q, exponential(rep, rotation_vector(a, b, c, d, t)))


@kernel
def increments(rep, v, h):
    a, b, c = increments_quadratic(
        (v[0], v[1], v[2]), (v[3], v[4], v[5]), (v[6], v[7], v[8]), h[0], h[1], h[2]
    )
    s = h[0] + h[1]
    p = exponential(rep, rotation_vector_quadratic(a, b, c, h[0]))
    q = exponential(rep, rotation_vector_quadratic(a, b, c, s))
    return _three(p, q, exponential(rep, rotation_vector_quadratic(a, b, c, s + h[2])))


@kernel
def increments_optimal(rep, v, h):
    f = increments(rep, v, h)
    r = exponential(rep, miller((v[0], v[1], v[2]), (v[3], v[4], v[5]), (v[6], v[7], v[8])))
    return _three((f[0], f[1], f[2], f[3]), (f[4], f[5], f[6], f[7]), r)


POLYNOMIAL = sampled_method(
    Coning3(),
    Window(history=0, span=3, rates=rates, increments=increments),
    name="coning3",
    order=4,
    exponentials=1,
    of_rates=0.7,
    of_increments=0.8,
    summary="three intervals at a time, 33/80 and 57/80 of increments: right for any smooth motion",
    source="Savage, J. Guidance 21 (1998) 19; coefficients by a parabola through three increments",
)
OPTIMAL = sampled_method(
    Coning3Optimal(),
    Window(history=0, span=3, increments=increments_optimal),
    name="coning3_optimal",
    order=4,
    exponentials=1,
    of_increments=0.7,
    summary="three equal intervals, 9/20 and 27/40: 200 times less drift in pure small coning",
    source="Miller, J. Guidance 6 (1983) 287",
)
