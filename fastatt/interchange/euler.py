"""Euler angles of all 24 sequences, named as in SciPy: "zyx" fixed axes, "ZYX" body axes."""

from __future__ import annotations

import math
from functools import cache
from itertools import product
from typing import Any

from numpy.typing import ArrayLike, NDArray

from fastatt import arrays, checks
from fastatt.tracing.formulas import Vector, quat, trig
from fastatt.tracing.graph import apply, choose

#: sequences of axes in which no two neighbours are equal
SEQUENCES = tuple(
    "".join(axes)
    for letters in ("xyz", "XYZ")
    for axes in product(letters, repeat=3)
    if axes[0] != axes[1] != axes[2]
)


def euler_to_quat(angles: ArrayLike, sequence: str) -> NDArray[Any]:
    """Convert Euler angles of any of the 24 sequences to quaternions.

    Parameters
    ----------
    angles : array_like of shape (..., 3)
        Angles in the order of the sequence, rad, each up to 1e50 rad.
    sequence : str
        Three axes, as in SciPy's ``Rotation.from_euler``: lower case for rotations about fixed
        axes, such as "xyz", upper case for rotations about body axes, such as "ZYX". Neighbouring
        axes differ. "ZXZ" are the 3-1-3 angles (φ, θ, ψ), "ZYX" are yaw, pitch and roll.

    Returns
    -------
    ndarray of shape (..., 4)
        Unit quaternions, body to inertial, scalar first.

    Raises
    ------
    ValueError
        If the sequence or the shape is another one, or an angle is larger.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> fa.euler_to_quat(np.radians([90.0, 0.0, 0.0]), "ZYX").round(3)
    array([0.707, 0.   , 0.   , 0.707])
    """
    rows = arrays.angles_of("angles", angles, arrays.each_shorter)
    return arrays.on_rows(_to_quat(_known(sequence)), rows, after=4)


def quat_to_euler(q: ArrayLike, sequence: str) -> NDArray[Any]:
    """Convert quaternions to Euler angles of any of the 24 sequences.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, body to inertial, scalar first, of any norm above zero.
    sequence : str
        Three axes, as in :func:`euler_to_quat`.

    Returns
    -------
    ndarray of shape (..., 3)
        Angles in the order of the sequence, rad. The first and the third lie in [−π, π]. The second
        lies in [0, π] if the first axis is the third too, and in [−π/2, π/2] otherwise.

    Raises
    ------
    ValueError
        If the sequence or the shape is another one.

    Notes
    -----
    At gimbal lock, where the second angle is at an end of its range, only the sum or the difference
    of the other two is determined. Within 4e-15 rad of it (float32: 2e-6) the third angle is set to
    0, as in SciPy. Outside of this range the angles represent the attitude to rounding.

    References
    ----------
    Bernardes and Viollet, "Quaternion to Euler angles conversion: A direct, general and
    computationally efficient method", *PLoS ONE* 17 (2022) 11.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.quat_to_euler([1.0, 0.0, 0.0, 1.0], "ZYX").round(3)
    array([1.571, 0.   , 0.   ])
    """
    rows = arrays.floats("q", q, (4,))
    return arrays.on_rows(_from_quat(_known(sequence)), rows, after=3)


def _known(sequence: Any) -> str:
    if not isinstance(sequence, str) or sequence not in SEQUENCES:
        raise ValueError(
            f"sequence: found {checks.brief(sequence)}; accepted: three of x, y, z about fixed "
            "axes or of X, Y, Z about the body's own, none twice in a row, such as 'ZYX'"
        )
    return sequence


@cache
def _to_quat(sequence: str) -> Any:
    axes, is_intrinsic = _axes(sequence)

    def formula(angles: Vector) -> Any:
        a, b, c = (_about(axis, angle) for axis, angle in zip(axes, angles, strict=True))
        return quat.mul(quat.mul(a, b), c) if is_intrinsic else quat.mul(c, quat.mul(b, a))

    return formula


def _axes(sequence: str) -> tuple[list[int], bool]:
    """Indices of the axes, and whether they are body axes."""
    return ["xyz".index(letter) for letter in sequence.lower()], sequence.isupper()


def _about(axis: int, angle: Any) -> Vector:
    """The quaternion of a rotation about a coordinate axis."""
    s, c = trig.sincos(0.5 * angle)
    return (c, *(s if k == axis else 0.0 for k in range(3)))


@cache
def _from_quat(sequence: str) -> Any:
    axes, is_intrinsic = _axes(sequence)
    # rotations about body axes are rotations about fixed axes in the opposite order
    i, j, k = reversed(axes) if is_intrinsic else axes
    is_proper = i == k
    k = 3 - i - j
    sign = (i - j) * (j - k) * (k - i) / 2
    side = 1.0 if is_intrinsic else -1.0

    def formula(q: Vector) -> Any:
        unit = quat.normalise(q)
        w, x, y, z = unit[0], unit[1 + i], unit[1 + j], sign * unit[1 + k]
        a, b, c, d = (w, x, y, z) if is_proper else (w - y, x + z, y + w, z - x)
        cosine = apply("sqrt", a * a + b * b)
        sine = apply("sqrt", c * c + d * d)
        middle = 2.0 * trig.atan2(sine, cosine)
        half_sum, half_difference = trig.atan2(b, a), side * trig.atan2(d, c)
        # below eight ulps of the other
        at_least = cosine + 0.0625 * sine <= cosine
        at_most = sine + 0.0625 * cosine <= sine
        first, last = half_sum + half_difference, half_sum - half_difference
        first = choose(at_least, 2.0 * half_sum, choose(at_most, 2.0 * half_difference, first))
        last = choose(at_least, 0.0, choose(at_most, 0.0, last))
        if not is_proper:
            middle = middle - 0.5 * math.pi
            first, last = (sign * first, last) if is_intrinsic else (first, sign * last)
        return _wrapped(first), middle, _wrapped(last)

    return formula


def _wrapped(angle: Any) -> Any:
    """An angle of size at most 2π, wrapped to [−π, π]."""
    above = choose(angle > math.pi, angle - 2.0 * math.pi, angle)
    return choose(above < -math.pi, above + 2.0 * math.pi, above)
