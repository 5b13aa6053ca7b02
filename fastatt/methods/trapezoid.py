"""Trapezoid: the mean of the rates at both ends of an interval."""

from fastatt._jit import helper
from fastatt.kernels.vec3 import add, scale
from fastatt.methods.sampled import sampled_method
from fastatt.methods.windows import Window


@helper
def rates(v, h):
    F = type(v[0])
    return scale(F(0.5) * h[0], add(v[:3], v[3:6]))


METHOD = sampled_method(
    Window(history=0, span=1, rates=rates),
    name="trapezoid",
    order=2,
    of_rates=0.6,
    summary="mean of two samples, the usual choice of logging software",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), §5",
)
