"""The two-sample coning algorithm, over two intervals at a time."""

from fastatt._jit import helper
from fastatt.kernels.coning import (
    increments_linear,
    rates_quadratic,
    rotation_vector_linear,
    rotation_vector_quadratic,
)
from fastatt.kernels.vec3 import scale, sub
from fastatt.methods.sampled import sampled_method
from fastatt.methods.windows import Window


@helper
def rates(v, h):
    t = h[0] + h[1]
    a, b, c = rates_quadratic(v[:3], v[3:6], v[6:9], h[0], t)
    return rotation_vector_quadratic(a, b, c, h[0]) + rotation_vector_quadratic(a, b, c, t)


@helper
def increments(v, h):
    # a straight line about the time between the two intervals, moved to the start of the first
    a, b = increments_linear(v[:3], v[3:6], h[0], h[1])
    a = sub(a, scale(h[0], b))
    return rotation_vector_linear(a, b, h[0]) + rotation_vector_linear(a, b, h[0] + h[1])


METHOD = sampled_method(
    Window(history=0, span=2, rates=rates, increments=increments),
    name="coning2",
    order=4,
    of_rates=0.9,
    of_increments=1.0,
    summary="two intervals per rotation, coning correction (2/3) θ1×θ2",
    source="Bortz, IEEE Trans. AES 7 (1971); Savage, J. Guidance 21 (1998) 19",
)
