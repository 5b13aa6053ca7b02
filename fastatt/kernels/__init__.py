"""Scalar kernels on floats and tuples, for Python, for jitted code and for the compiled loops.

Every kernel is a pure function from tuples to tuples, without allocation and branches, and keeps
float64 or float32. The modules ``compensated``, ``elliptic`` and ``moser_veselov``, and the
functions of ``free_body``, ``heavy_top`` and ``trig`` that these do not list in ``__all__``, are
building blocks of the others.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from fastatt import checks

if TYPE_CHECKING:
    from fastatt.kernels import (
        axis_angle,
        compensated,
        coning,
        dcm,
        elliptic,
        error_state,
        euler313,
        free_body,
        heavy_top,
        moser_veselov,
        mrp,
        quat,
        rigid,
        so3,
        sym3,
        trig,
        two_rows,
        vec3,
    )

__all__ = [
    "axis_angle", "compensated", "coning", "dcm", "elliptic", "error_state", "euler313",
    "free_body", "heavy_top", "moser_veselov", "mrp", "quat", "rigid", "so3", "sym3", "trig",
    "two_rows", "vec3",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """A module of kernels, imported when it is first used."""
    if name not in __all__:
        found = checks.nearest(name, __all__)
        raise AttributeError(f"module 'fastatt.kernels' has no attribute {name!r}{found}")
    return importlib.import_module(f"fastatt.kernels.{name}")


def __dir__() -> list[str]:
    return list(__all__)
