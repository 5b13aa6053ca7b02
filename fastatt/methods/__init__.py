"""The list of methods. Each has one file, with its step and its record."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from fastatt.methods import (
    cf4,
    closed_form,
    coning2,
    crouch_grossman,
    dmv,
    gauss12,
    gbs16,
    hold,
    magnus4,
    magnus6,
    magnus8,
    picard,
    previous,
    rk4,
    rk8,
    rk9,
    rkmk4,
    strang,
    trapezoid,
)
from fastatt.methods.method import Method

_ALL = (
    crouch_grossman.LIE_EULER,
    crouch_grossman.LIE_MIDPOINT,
    rk4.METHOD,
    magnus4.METHOD,
    magnus6.METHOD,
    magnus8.METHOD,
    gauss12.METHOD,
    cf4.METHOD,
    rkmk4.METHOD,
    crouch_grossman.CG3,
    rk8.METHOD,
    rk9.METHOD,
    gbs16.METHOD,
    strang.STRANG2,
    strang.KAHAN_LI8,
    *dmv.METHODS,
    closed_form.METHOD,
    hold.METHOD,
    trapezoid.METHOD,
    previous.METHOD,
    coning2.METHOD,
    picard.METHOD,
)
METHODS: Mapping[str, Method] = MappingProxyType({m.name: m for m in _ALL})

__all__ = ["METHODS", "Method"]
