"""RK4: the classical method on the numbers of the representation."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.columns import axpy, largest, plus, scale
from fastatt.methods.method import BODIES, Kernels, Method, register
from fastatt.motion import advanced, base, field, given, turning
from fastatt.representations import plain


class RK4(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    half = F(0.5) * h
    start = given(model, t, p, h)
    middle = given(model, t + half, p, h)
    bare = plain(rep)
    y = base(rep, model, x)
    k1 = field(bare, model, start, y, p)
    k2 = field(bare, model, middle, axpy(half, k1, y), p)
    k3 = field(bare, model, middle, axpy(half, k2, y), p)
    k4 = field(bare, model, given(model, t + h, p, h), axpy(h, k3, y), p)
    k = axpy(F(2.0), k2, k1)
    k = axpy(F(2.0), k3, k)
    d = scale(F(1.0 / 6.0) * h, plus(k, k4))
    # of coordinates, which a stage may bring nearer to their pole than the start is
    most = largest(largest(k1, k2), largest(k3, k4))
    z = h * h * turning(bare, model, start, most, y, p)
    return advanced(rep, model, x, d), z


register(RK4, Kernels(rate=step, body=step, at_times=True))

METHOD = Method(
    tag=RK4(),
    name="rk4",
    order=4,
    scenes=("rate", *BODIES),
    representations=("quat", "dcm", "dcm_rows", "euler313", "rotation_vector"),
    conserves=(),
    rate_calls=3,
    exponentials=0,
    compensates=True,
    # stable up to 4√2 on quaternions and 2√2 on matrices, but wrong long before; the angles' rates
    # grow without bound near their poles
    limits={
        "quat": 1.7,
        "dcm": 1.5,
        "dcm_rows": 1.5,
        "direction": 1.5,
        "euler313": 0.3,
        "rotation_vector": 0.3,
    },
    damping_limit=1.7,
    summary="the baseline; the norm drifts, the attitude's direction does not",
    source="Kutta, Z. Math. Phys. 46 (1901) 435; norm: Boyle, Adv. Appl. Clifford Alg. 27 (2017)",
)
