"""Previous: an interval and the one before it give a causal coning correction."""

from fastatt._jit import helper
from fastatt.kernels.coning import (
    increments_linear,
    rates_quadratic,
    rotation_vector_linear,
    rotation_vector_quadratic,
)
from fastatt.methods.sampled import sampled_method
from fastatt.methods.windows import Window


@helper
def rates(v, h):
    now = v[3:6]
    a, b, c = rates_quadratic(now, v[6:9], v[:3], h[1], -h[0])
    return rotation_vector_quadratic(a, b, c, h[1])


@helper
def increments(v, h):
    a, b = increments_linear(v[:3], v[3:6], h[0], h[1])
    return rotation_vector_linear(a, b, h[1])


METHOD = sampled_method(
    Window(history=1, span=1, rates=rates, increments=increments),
    name="previous",
    order=3,
    of_rates=1.0,
    of_increments=1.1,
    summary="coning correction from the previous interval; causal, an attitude at every sample",
    source="Ignagni, J. Guidance 13 (1990) 363; Savage, J. Guidance 21 (1998) 19",
)
