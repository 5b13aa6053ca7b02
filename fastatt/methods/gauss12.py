"""Gauss-12: the motion of the rate's polynomial through six Gauss nodes, by its power series.

The motion of the polynomial differs from that of the rate by O(h¹³) in a step, since the nodes are
Gauss nodes (Hairer, Lubich and Wanner, *Geometric Numerical Integration*, 2006, §II.1.2). The
attitude's equation is linear, so that one series about the middle of the step reaches both ends:
its radius is half the step, and terms of one parity cancel.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

from fastatt.attitudes.attitude import FAMILIES
from fastatt.methods.lie_group import asking, gauss_polynomial
from fastatt.methods.method import Method, Steps
from fastatt.tracing.formulas import Vector, dot, plus, quat, scale
from fastatt.tracing.graph import larger

_NODES = 6
#: terms after the first; with an odd number the next term cancels too. With two fewer the series,
#: not the polynomial, limits the error where the rate changes as fast as the body rotates.
_TERMS = 2 * _NODES + 1


def step(motion: Any, t: Any, h: Any, x: Vector) -> Any:
    rate, asked = asking(motion)
    # of half the rate, in powers of the distance from the middle over half the step
    powers = gauss_polynomial(rate, t, h, _NODES)
    halves = [scale(0.5 ** (j + 2), a) for j, a in enumerate(powers)]
    terms: list[Vector] = [(1.0, 0.0, 0.0, 0.0)]
    for k in range(_TERMS):
        slopes = [quat.mul_vector(terms[k - j], v) for j, v in enumerate(halves[: k + 1])]
        terms.append(scale(1.0 / (k + 1), plus(*slopes)))
    even, odd = (plus(*reversed(terms[k::2])) for k in (0, 1))
    # from one end to the other: (even − odd)*∘(even + odd)
    along = quat.mul(quat.conj(even), odd)
    turn = (dot(even, even) - dot(odd, odd), *scale(2.0, along[1:]))
    end = motion.attitude.compose(x, quat.renormalise(turn))
    return end, h * h * reduce(larger, (dot(w, w) for w in asked))


METHOD = Method(
    name="gauss12",
    order=2 * _NODES,
    scenes=("rate",),
    uses=("compose",),
    rate_calls=_NODES,
    limits=dict.fromkeys(FAMILIES, 3.0),
    steps=Steps(rate=step),
    reversible=("rate",),
    summary="collocation at six Gauss nodes by a power series; errors below 1e-9, reversible",
    source="Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), §II.1.2",
)
