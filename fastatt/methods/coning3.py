"""The three-sample coning algorithms: polynomial, or optimal for pure coning."""

from fastatt._jit import helper
from fastatt.kernels.coning import (
    increments_quadratic,
    miller,
    rates_cubic,
    rotation_vector,
    rotation_vector_quadratic,
)
from fastatt.methods.sampled import sampled_method
from fastatt.methods.windows import Window


@helper
def rates(v, h):
    s = h[0] + h[1]
    t = s + h[2]
    a, b, c, d = rates_cubic(v[:3], v[3:6], v[6:9], v[9:12], h[0], s, t)
    return (
        rotation_vector(a, b, c, d, h[0])
        + rotation_vector(a, b, c, d, s)
        + rotation_vector(a, b, c, d, t)
    )


@helper
def increments(v, h):
    a, b, c = increments_quadratic(v[:3], v[3:6], v[6:9], h[0], h[1], h[2])
    s = h[0] + h[1]
    return (
        rotation_vector_quadratic(a, b, c, h[0])
        + rotation_vector_quadratic(a, b, c, s)
        + rotation_vector_quadratic(a, b, c, s + h[2])
    )


@helper
def increments_optimal(v, h):
    last = miller(v[:3], v[3:6], v[6:9])
    return increments(v, h)[:6] + last


POLYNOMIAL = sampled_method(
    Window(history=0, span=3, rates=rates, increments=increments),
    name="coning3",
    order=4,
    of_rates=0.7,
    of_increments=0.8,
    summary="three intervals per rotation, coning coefficients 33/80 and 57/80; on smooth motion "
    "coning2 has less error",
    source="Savage, J. Guidance 21 (1998) 19; coefficients by a parabola through three increments",
)
OPTIMAL = sampled_method(
    Window(history=0, span=3, increments=increments_optimal, even=True),
    name="coning3_optimal",
    order=4,
    of_increments=0.7,
    summary="coefficients 9/20 and 27/40 for equal intervals; 200 times less drift in small coning",
    source="Miller, J. Guidance 6 (1983) 287",
)
