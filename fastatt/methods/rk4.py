"""RK4: the classical method on the numbers of the representation."""

from __future__ import annotations

import math
from typing import NamedTuple

from fastatt.columns import axpy
from fastatt.methods.method import BODIES, Kernels, Method, register
from fastatt.motion import field, given, turning


class RK4(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    half = F(0.5) * h
    start = given(model, t, p, h)
    middle = given(model, t + half, p, h)
    k1 = field(rep, model, start, x, p)
    k2 = field(rep, model, middle, axpy(half, k1, x), p)
    k3 = field(rep, model, middle, axpy(half, k2, x), p)
    k4 = field(rep, model, given(model, t + h, p, h), axpy(h, k3, x), p)
    k = axpy(F(2.0), k2, k1)
    k = axpy(F(2.0), k3, k)
    k = axpy(F(1.0), k4, k)
    return axpy(F(1.0 / 6.0) * h, k, x), h * h * turning(rep, model, start, k1, x, p)


register(RK4, Kernels(rate=step, body=step))

METHOD = Method(
    tag=RK4(),
    name="rk4",
    order=4,
    scenes=("rate", *BODIES),
    representations=("quat", "dcm", "dcm_rows", "euler313", "rotation_vector"),
    conserves=(),
    rate_calls=3,
    exponentials=0,
    # edge of the stability region on the imaginary axis, 2√2: a quaternion turns at w/2, a matrix
    # at w; the angles' rates grow without bound near their poles
    limits={
        "quat": 4.0 * math.sqrt(2.0),
        "dcm": 2.0 * math.sqrt(2.0),
        "dcm_rows": 2.0 * math.sqrt(2.0),
        "direction": 2.0 * math.sqrt(2.0),
        "euler313": 0.3,
        "rotation_vector": 0.3,
    },
    summary="the baseline; the norm drifts, the attitude's direction does not",
    source="Kutta, Z. Math. Phys. 46 (1901) 435; norm: Boyle, Adv. Appl. Clifford Alg. 27 (2017)",
)
