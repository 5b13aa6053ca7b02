"""Hold: each rate is kept over the next interval; increments are used as rotation vectors."""

from fastatt._jit import helper
from fastatt.kernels.vec3 import scale
from fastatt.methods.sampled import sampled_method
from fastatt.methods.windows import Window


@helper
def rates(v, h):
    return scale(h[0], v[:3])


@helper
def increments(v, h):
    return v[0], v[1], v[2]


METHOD = sampled_method(
    Window(history=0, span=1, rates=rates, increments=increments),
    name="hold",
    order=1,
    orders={"increments": 2},
    of_rates=0.1,
    of_increments=0.8,
    summary="constant rate or increment (order 2) in each interval, without coning correction",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), eq. 2.4",
)
