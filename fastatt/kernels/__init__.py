"""Scalar kernels on floats and tuples: from Python, from ``@njit`` code and in the tile loop.

Every kernel is pure: tuples in, tuples out, no allocation, no branch, float64 or float32 kept.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

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
        vec3,
    )

__all__ = [
    "axis_angle", "compensated", "coning", "dcm", "elliptic", "error_state", "euler313",
    "free_body", "heavy_top", "moser_veselov", "mrp", "quat", "rigid", "so3", "sym3", "trig",
    "vec3",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """A module of kernels, imported when it is first asked for."""
    if name not in __all__:
        raise AttributeError(f"module 'fastatt.kernels' has no attribute {name!r}")
    return importlib.import_module(f"fastatt.kernels.{name}")


def __dir__() -> list[str]:
    return list(__all__)
