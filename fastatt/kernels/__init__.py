"""Scalar kernels on floats and tuples: from Python, from ``@njit`` code and in the tile loop.

Every kernel is pure: tuples in, tuples out, no allocation, no branch, float64 or float32 kept.
"""

from fastatt.kernels import (
    axis_angle,
    compensated,
    coning,
    dcm,
    elliptic,
    error_state,
    euler313,
    free_body,
    moser_veselov,
    newton,
    quat,
    rigid,
    so3,
    sym3,
    trig,
    vec3,
)

__all__ = [
    "axis_angle",
    "compensated",
    "coning",
    "dcm",
    "elliptic",
    "error_state",
    "euler313",
    "free_body",
    "moser_veselov",
    "newton",
    "quat",
    "rigid",
    "so3",
    "sym3",
    "trig",
    "vec3",
]
