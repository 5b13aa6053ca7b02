"""Lie midpoint: one exponential of the rate at the middle of the step."""

from __future__ import annotations

from typing import NamedTuple

from fastatt.methods.method import lie_method, one_exponential


class LieMidpoint(NamedTuple):
    """Tag."""


METHOD = lie_method(
    LieMidpoint(),
    one_exponential,
    name="lie_midpoint",
    order=2,
    rate_calls=1,
    exponentials=1,
    limit=0.7,
    summary="exponential of the rate at the middle; exact for a constant rate, reversible",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), §5",
)
