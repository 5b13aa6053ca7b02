"""Scalar kernels on floats and tuples, for Python, for jitted code and for the compiled loops.

Every kernel is a pure function from tuples to tuples, without allocation and branches, and keeps
float64 or float32. The modules ``quat``, ``dcm``, ``so3``, ``vec3``, ``rigid`` and ``euler313``
are for users; the others are the library's own.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from fastatt import checks

if TYPE_CHECKING:
    from fastatt.kernels import dcm, euler313, quat, rigid, so3, vec3

__all__ = ["dcm", "euler313", "quat", "rigid", "so3", "vec3"]


def __getattr__(name: str) -> Any:
    """A module of kernels, imported when it is first used."""
    if name not in __all__:
        near = checks.nearest(name, __all__)
        raise AttributeError(f"module 'fastatt.kernels' has no attribute {name!r}{near}")
    return importlib.import_module(f"fastatt.kernels.{name}")


def __dir__() -> list[str]:
    return list(__all__)
