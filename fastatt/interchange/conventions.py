"""Attitudes in the conventions of other packages: order of numbers, direction, sense.

Here q is scalar first, Hamilton, body to inertial; every function takes any leading axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt.arrays import floats, mrp_to_quat, quat_rotate, quat_rotate_inverse, quat_to_mrp

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


def to_scalar_last(q: ArrayLike) -> NDArray[Any]:
    """(x, y, z, w) of scalar-first q (..., 4): what SciPy, ROS and Eigen's ``coeffs()`` hold."""
    return np.roll(floats("q", q, (4,)), -1, axis=-1)


def from_scalar_last(q: ArrayLike) -> NDArray[Any]:
    """Scalar-first q of (x, y, z, w), (..., 4)."""
    return np.roll(floats("q", q, (4,)), 1, axis=-1)


def to_scipy(q: ArrayLike) -> Rotation:
    """SciPy's ``Rotation`` of q (..., 4): its ``apply`` takes body to inertial components.

    Histories (S, N, 4) need SciPy 1.17, the first whose rotations have more than one axis.

    Raises ``ImportError`` without SciPy.
    """
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(to_scalar_last(q))


def from_scipy(rotation: Rotation) -> NDArray[np.float64]:
    """q (..., 4) of SciPy's ``Rotation`` from body to inertial components.

    Raises ``TypeError`` for something else, such as its ``as_quat()``: see ``from_scalar_last``.
    """
    if not hasattr(rotation, "as_quat"):
        raise TypeError(
            f"rotation: found {type(rotation).__name__}; accepted: scipy.spatial.transform."
            "Rotation; for its numbers in scalar-last order, from_scalar_last"
        )
    return from_scalar_last(rotation.as_quat())


def to_jpl(q: ArrayLike) -> NDArray[Any]:
    """JPL quaternions (x, y, z, w), inertial to body, of q (..., 4).

    The left-handed product and the opposite direction cancel: the numbers are q's own, scalar last.
    JPL products are in the opposite order, (p∘q) there being q∘p here. Trawny and Roumeliotis,
    "Indirect Kalman filter for 3D attitude estimation" (2005), §1; Solà, arXiv:1711.02508, §1.2.
    """
    return to_scalar_last(q)


def from_jpl(q: ArrayLike) -> NDArray[Any]:
    """q of JPL quaternions (x, y, z, w), inertial to body, (..., 4)."""
    return from_scalar_last(q)


def to_passive(q: ArrayLike) -> NDArray[Any]:
    """q*: the same attitude as a Hamilton quaternion from inertial to body components, and back."""
    return floats("q", q, (4,)) * np.array([1.0, -1.0, -1.0, -1.0], dtype=np.float32)


def to_mrp(q: ArrayLike) -> NDArray[Any]:
    """Modified Rodrigues parameters of q (..., 4), Basilisk's ``sigma_BN``: ``fa.quat_to_mrp``."""
    return quat_to_mrp(q)


def from_mrp(sigma: ArrayLike) -> NDArray[Any]:
    """Unit q (..., 4) of modified Rodrigues parameters (..., 3): ``fa.mrp_to_quat``."""
    return mrp_to_quat(sigma)


def rates_to_body(q: ArrayLike, w: ArrayLike) -> NDArray[Any]:
    """Body-axes angular velocity (..., 3) of one along inertial axes, at q (..., 4)."""
    return quat_rotate_inverse(q, w)


def rates_to_inertial(q: ArrayLike, w: ArrayLike) -> NDArray[Any]:
    """Inertial-axes angular velocity (..., 3) of one along body axes, at q (..., 4)."""
    return quat_rotate(q, w)
