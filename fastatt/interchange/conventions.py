"""Attitudes in the conventions of other packages: order of numbers, direction, product.

Here q is scalar first, Hamilton, body to inertial. Every function accepts any leading axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import floats

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


def to_scalar_last(q: ArrayLike) -> NDArray[Any]:
    """Reorder quaternions to scalar last, as SciPy, ROS and Eigen's ``coeffs()`` have them.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, scalar first.

    Returns
    -------
    ndarray of shape (..., 4)
        (x, y, z, w).

    Examples
    --------
    >>> from fastatt import interchange
    >>> interchange.to_scalar_last([1.0, 0.0, 0.0, 0.5]).tolist()
    [0.0, 0.0, 0.5, 1.0]
    """
    return np.roll(floats("q", q, (4,)), -1, axis=-1)


def from_scalar_last(q: ArrayLike) -> NDArray[Any]:
    """Reorder scalar-last quaternions to scalar first.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions (x, y, z, w).

    Returns
    -------
    ndarray of shape (..., 4)
        Quaternions, scalar first.

    Examples
    --------
    >>> from fastatt import interchange
    >>> interchange.from_scalar_last([0.0, 0.0, 0.5, 1.0]).tolist()
    [1.0, 0.0, 0.0, 0.5]
    """
    return np.roll(floats("q", q, (4,)), 1, axis=-1)


def to_scipy(q: ArrayLike) -> Rotation:
    """Convert quaternions to SciPy's ``Rotation``.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, body to inertial, scalar first. More than one leading axis needs SciPy 1.17.

    Returns
    -------
    scipy.spatial.transform.Rotation
        Rotations whose ``apply`` takes body to inertial components.

    Raises
    ------
    ImportError
        If SciPy is not installed.
    ValueError, TypeError
        If the shape is another one, or a quaternion is zero or not finite.

    Examples
    --------
    >>> from fastatt import interchange
    >>> interchange.to_scipy([1.0, 0.0, 0.0, 1.0]).apply([1.0, 0.0, 0.0]).round(6).tolist()
    [0.0, 1.0, 0.0]
    """
    transform = checks.optional("to_scipy", "scipy.spatial.transform", "scipy")
    rows = floats("q", q, (4,))
    checks.finite("q", rows)
    if not rows.any(axis=-1).all():
        raise ValueError("q: found a zero quaternion; accepted: of any other length")
    # by a power of 2, since SciPy takes denormal numbers for zero
    exponent = np.frexp(np.abs(rows).max(axis=-1, keepdims=True))[1]
    rotations: Rotation = transform.Rotation.from_quat(to_scalar_last(np.ldexp(rows, -exponent)))
    return rotations


def from_scipy(rotation: Rotation) -> NDArray[np.float64]:
    """Convert SciPy's ``Rotation`` to quaternions.

    Parameters
    ----------
    rotation : scipy.spatial.transform.Rotation
        Rotations from body to inertial components.

    Returns
    -------
    ndarray of shape (..., 4)
        Unit quaternions, scalar first.

    Raises
    ------
    TypeError
        If the argument is something else, such as the result of ``as_quat()``, for which
        :func:`fastatt.interchange.from_scalar_last` exists.

    Examples
    --------
    >>> from fastatt import interchange
    >>> interchange.from_scipy(interchange.to_scipy([0.6, 0.0, 0.0, 0.8])).tolist()
    [0.6, 0.0, 0.0, 0.8]
    """
    if not hasattr(rotation, "as_quat"):
        raise TypeError(
            f"rotation: found {type(rotation).__name__}; accepted: scipy.spatial.transform."
            "Rotation; for its numbers in scalar-last order, from_scalar_last"
        )
    return from_scalar_last(rotation.as_quat())


def to_jpl(q: ArrayLike) -> NDArray[Any]:
    """Convert quaternions to JPL quaternions (x, y, z, w) from inertial to body axes.

    The left-handed product and the opposite direction cancel each other, so that the numbers are
    the same, in scalar-last order. JPL products are in the opposite order: (p∘q) there is q∘p here.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, body to inertial, scalar first.

    Returns
    -------
    ndarray of shape (..., 4)
        JPL quaternions.

    References
    ----------
    Trawny and Roumeliotis, "Indirect Kalman filter for 3D attitude estimation" (2005), §1; Solà,
    arXiv:1711.02508, §1.2.

    Examples
    --------
    >>> from fastatt import interchange
    >>> interchange.to_jpl([0.8, 0.0, 0.6, 0.0]).tolist()
    [0.0, 0.6, 0.0, 0.8]
    """
    return to_scalar_last(q)


def from_jpl(q: ArrayLike) -> NDArray[Any]:
    """Convert JPL quaternions (x, y, z, w) from inertial to body axes.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        JPL quaternions.

    Returns
    -------
    ndarray of shape (..., 4)
        Quaternions, body to inertial, scalar first.

    Examples
    --------
    >>> from fastatt import interchange
    >>> interchange.from_jpl([0.0, 0.6, 0.0, 0.8]).tolist()
    [0.8, 0.0, 0.6, 0.0]
    """
    return from_scalar_last(q)
