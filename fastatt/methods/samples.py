"""Methods for gyro samples with a formula for the rotation vectors of a window."""

from __future__ import annotations

import math
from typing import Any

from fastatt._jit import helper
from fastatt.kernels.coning import (
    increments_linear,
    rates_quadratic,
    rotation_vector_linear,
    rotation_vector_quadratic,
)
from fastatt.kernels.vec3 import add, scale, sub
from fastatt.methods.method import Method
from fastatt.methods.windows import Window


def sampled_method(
    window: Window,
    *,
    order: int,
    of_rates: float = math.inf,
    of_increments: float = math.inf,
    **others: Any,
) -> Method:
    """Record of a method for samples, with its largest angle over an interval, rad."""
    kinds = {"sampled rates": False, "increments": True}
    return Method(
        window=window,
        order=order,
        scenes=tuple(name for name, increments in kinds.items() if window.takes(increments)),
        conserves=("norm",),
        rate_calls=1,
        exponentials=1,
        limits={"rates": of_rates, "increments": of_increments},
        **others,
    )


@helper
def hold_rates(v, h):
    return scale(h[0], v[:3])


@helper
def hold_increments(v, h):
    return v[0], v[1], v[2]


HOLD = sampled_method(
    Window(history=0, span=1, rates=hold_rates, increments=hold_increments),
    name="hold",
    order=1,
    orders={"increments": 2},
    of_rates=0.1,
    of_increments=0.8,
    summary="constant rate or increment (order 2) in each interval, without coning correction",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), eq. 2.4",
)


@helper
def trapezoid_rates(v, h):
    F = type(v[0])
    return scale(F(0.5) * h[0], add(v[:3], v[3:6]))


TRAPEZOID = sampled_method(
    Window(history=0, span=1, rates=trapezoid_rates),
    name="trapezoid",
    order=2,
    of_rates=0.6,
    summary="mean of two samples, the usual choice of logging software",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), §5",
)


# an interval and the one before it give a causal coning correction
@helper
def previous_rates(v, h):
    now = v[3:6]
    a, b, c = rates_quadratic(now, v[6:9], v[:3], h[1], -h[0])
    return rotation_vector_quadratic(a, b, c, h[1])


@helper
def previous_increments(v, h):
    a, b = increments_linear(v[:3], v[3:6], h[0], h[1])
    return rotation_vector_linear(a, b, h[1])


PREVIOUS = sampled_method(
    Window(history=1, span=1, rates=previous_rates, increments=previous_increments),
    name="previous",
    order=3,
    of_rates=1.0,
    of_increments=1.1,
    summary="coning correction from the previous interval; causal, an attitude at every sample",
    source="Ignagni, J. Guidance 13 (1990) 363; Savage, J. Guidance 21 (1998) 19",
)


# the two-sample coning algorithm, over two intervals at a time
@helper
def coning2_rates(v, h):
    t = h[0] + h[1]
    a, b, c = rates_quadratic(v[:3], v[3:6], v[6:9], h[0], t)
    return rotation_vector_quadratic(a, b, c, h[0]) + rotation_vector_quadratic(a, b, c, t)


@helper
def coning2_increments(v, h):
    # a straight line about the time between the two intervals, moved to the start of the first
    a, b = increments_linear(v[:3], v[3:6], h[0], h[1])
    a = sub(a, scale(h[0], b))
    return rotation_vector_linear(a, b, h[0]) + rotation_vector_linear(a, b, h[0] + h[1])


CONING2 = sampled_method(
    Window(history=0, span=2, rates=coning2_rates, increments=coning2_increments),
    name="coning2",
    order=4,
    of_rates=0.9,
    of_increments=1.0,
    summary="two intervals per rotation, coning correction (2/3) θ1×θ2",
    source="Bortz, IEEE Trans. AES 7 (1971); Savage, J. Guidance 21 (1998) 19",
)
