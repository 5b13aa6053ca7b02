"""Hold: each sample's rate kept over the interval that follows; increments taken as they are."""

from __future__ import annotations

from typing import NamedTuple

from fastatt._jit import kernel
from fastatt.kernels.vec3 import scale
from fastatt.methods.sampled import Window, exponential, sampled_method


class Hold(NamedTuple):
    """Tag."""


@kernel
def rates(rep, v, h):
    return exponential(rep, scale(h[0], (v[0], v[1], v[2])))


@kernel
def increments(rep, v, h):
    return exponential(rep, (v[0], v[1], v[2]))


METHOD = sampled_method(
    Hold(),
    Window(history=0, span=1, rates=rates, increments=increments),
    name="hold",
    order=1,
    orders={"increments": 2},
    exponentials=1,
    of_rates=0.1,
    of_increments=0.8,
    summary="the rate held, or one increment a turn (then order 2); no coning correction",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), eq. 2.4",
)
