"""Conversions, angles and products of attitudes, for one attitude or arrays of them."""

from __future__ import annotations

from decimal import Decimal, localcontext
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.codegen.rows import precision_of, rows
from fastatt.tracing.formulas import dcm, euler313, mrp, quat

# the largest error of an element of CᵀC
_NOT_ORTHOGONAL = 0.01
# rad, by bytes of a number; the rounding of larger angles is looked after
_NEAR = {8: 1e4, 4: 30.0}
# rad; with so many digits of π larger angles are not known to rounding
_FARTHEST = 1e50
_PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781640628620900")


def on_rows(formula: Any, *arrays: NDArray[Any], after: int | None) -> NDArray[Any]:
    """Apply a formula to rows (..., n) that broadcast: gives (..., after), or (...) for None."""
    inputs = {f"x{k}": x.shape[-1] for k, x in enumerate(arrays)}
    precision = precision_of(np.result_type(*arrays))
    return rows(formula, inputs, (after,), precision)(*arrays)[0]


def floats(name: str, value: ArrayLike, tail: tuple[int, ...]) -> NDArray[Any]:
    """Float32 or float64 numbers whose last axes are ``tail``."""
    array = checks.numbers(name, value, "real numbers")
    if array.shape[array.ndim - len(tail) :] != tail:
        accepted = ", ".join(map(str, tail))
        raise ValueError(f"{name}: has shape {array.shape}; accepted: (..., {accepted})")
    return array


def angles_of(name: str, value: ArrayLike, shorter: Any) -> NDArray[Any]:
    """Rows of three angles; ``shorter`` subtracts revolutions from long rows of decimals."""
    angles = floats(name, value, (3,))
    near = _NEAR[angles.itemsize]
    if -near <= angles.min(initial=0.0) and angles.max(initial=0.0) <= near:
        return angles
    too_far = np.isfinite(angles) & (np.abs(angles.astype(np.float64)) > _FARTHEST)
    checks.refuse(name, angles, too_far, f"up to {_FARTHEST:g} rad")
    size = np.abs(angles).max(axis=-1)
    far, angles = np.isfinite(size) & (size > near), np.array(angles)
    with localcontext() as context:
        context.prec = 160
        for k in np.argwhere(far):
            row = tuple(k)
            angles[row] = [float(x) for x in shorter([Decimal(float(x)) for x in angles[row]])]
    return angles


def each_shorter(angles: list[Decimal]) -> list[Decimal]:
    """Angles less multiples of 4π, after which a quaternion is the same."""
    return [x.remainder_near(4 * _PI) for x in angles]


def quat_to_dcm(q: ArrayLike) -> NDArray[Any]:
    """Convert quaternions to direction cosine matrices.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, body to inertial, scalar first, of any norm above zero.

    Returns
    -------
    ndarray of shape (..., 3, 3)
        Matrices C with v_i = C v_b.

    Raises
    ------
    ValueError
        If the shape is another one.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.quat_to_dcm([1.0, 0.0, 0.0, 1.0]).round(3) + 0.0
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    elements = on_rows(_of_unit(dcm.from_quat), floats("q", q, (4,)), after=9)
    return elements.reshape((*elements.shape[:-1], 3, 3))


@cache
def _of_unit(formula: Any) -> Any:
    """A formula of which the first argument, a quaternion, is normalised."""
    return lambda q, *more: formula(quat.normalise(q), *more)


def dcm_to_quat(C: ArrayLike) -> NDArray[Any]:
    """Convert direction cosine matrices to quaternions.

    Parameters
    ----------
    C : array_like of shape (..., 3, 3)
        Rotation matrices, body to inertial.

    Returns
    -------
    ndarray of shape (..., 4)
        Unit quaternions with q0 ≥ 0, so that those of a sequence may change their sign.

    Raises
    ------
    ValueError
        If a matrix is not a rotation: its axes are left-handed, or an element of CᵀC differs from
        that of the identity by more than 0.01.

    References
    ----------
    Shepperd, "Quaternion from rotation matrix", *Journal of Guidance and Control* 1 (1978) 223.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.dcm_to_quat([[1, 0, 0], [0, -1, 0], [0, 0, -1]]).tolist()
    [0.0, 1.0, 0.0, 0.0]
    """
    return quaternions_of(_rotations("C", C))


def _rotations(name: str, C: Any) -> NDArray[Any]:
    matrices = floats(name, C, (3, 3))
    with np.errstate(all="ignore"):  # matrices that are not finite give NaN
        x, y, z = (matrices[..., k] for k in range(3))
        size = (x * np.cross(y, z)).sum(axis=-1)
        gram = np.swapaxes(matrices, -1, -2) @ matrices
        error = np.abs(gram - np.eye(3)).max(axis=(-2, -1))
    wrong = (size <= 0.0) | (error > _NOT_ORTHOGONAL)
    if wrong.any():
        k = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise ValueError(
            f"{name}{list(k) or ''}: found the determinant {size[k]:.3g}, and CᵀC off the identity "
            f"by {error[k]:.3g}; accepted: rotations, of determinant 1, to {_NOT_ORTHOGONAL}"
        )
    return matrices


def quaternions_of(matrices: NDArray[Any]) -> NDArray[Any]:
    """Unit quaternions of matrices that may not be orthogonal after propagation."""
    return on_rows(dcm.to_quat, matrices.reshape((*matrices.shape[:-2], 9)), after=4)


def euler313_to_quat(angles: ArrayLike) -> NDArray[Any]:
    """Convert 3-1-3 Euler angles to quaternions.

    Parameters
    ----------
    angles : array_like of shape (..., 3)
        (φ, θ, ψ), rad, with C = Rz(φ) Rx(θ) Rz(ψ), each up to 1e50 rad.

    Returns
    -------
    ndarray of shape (..., 4)
        Unit quaternions, body to inertial, scalar first.

    Raises
    ------
    ValueError
        If the shape is another one, or an angle is larger.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.euler313_to_quat([0.0, 1.0, 0.0]).round(4).tolist()
    [0.8776, 0.4794, 0.0, 0.0]
    """
    return on_rows(euler313.to_quat, angles_of("angles", angles, each_shorter), after=4)


def quat_to_euler313(q: ArrayLike) -> NDArray[Any]:
    """Convert quaternions to 3-1-3 Euler angles.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, body to inertial, scalar first, of any norm above zero.

    Returns
    -------
    ndarray of shape (..., 3)
        (φ, θ, ψ), rad, with θ in [0, π].

    Raises
    ------
    ValueError
        If the shape is another one.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.quat_to_euler313([2.0, 2.0, 0.0, 0.0]).round(4).tolist()
    [0.0, 1.5708, 0.0]
    """
    return on_rows(_of_unit(euler313.from_quat), floats("q", q, (4,)), after=3)


def rotation_vector_to_quat(u: ArrayLike) -> NDArray[Any]:
    """Convert rotation vectors to quaternions.

    Parameters
    ----------
    u : array_like of shape (..., 3)
        Rotation vectors, rad, with components up to 1e50 rad.

    Returns
    -------
    ndarray of shape (..., 4)
        Unit quaternions exp(u), scalar first.

    Raises
    ------
    ValueError
        If the shape is another one, or a component is larger.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.rotation_vector_to_quat([0.0, 0.0, 1.0]).round(4).tolist()
    [0.8776, 0.0, 0.0, 0.4794]
    """
    return on_rows(quat.exp, angles_of("u", u, length_shorter), after=4)


def length_shorter(u: list[Decimal]) -> list[Decimal]:
    """A rotation vector whose length is less by a multiple of 4π."""
    length = sum((x * x for x in u), Decimal(0)).sqrt()
    return [x * length.remainder_near(4 * _PI) / length for x in u]


def quat_to_rotation_vector(q: ArrayLike) -> NDArray[Any]:
    """Convert quaternions to rotation vectors.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, scalar first, of any norm above zero.

    Returns
    -------
    ndarray of shape (..., 3)
        Rotation vectors, rad, of length at most π; NaN for zero quaternions.

    Raises
    ------
    ValueError
        If the shape is another one.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.quat_to_rotation_vector([1.0, 0.0, 0.0, 1.0]).round(4).tolist()
    [0.0, 0.0, 1.5708]
    """
    return on_rows(quat.log, floats("q", q, (4,)), after=3)


def mrp_to_quat(sigma: ArrayLike) -> NDArray[Any]:
    """Convert modified Rodrigues parameters to quaternions.

    Parameters
    ----------
    sigma : array_like of shape (..., 3)
        σ = e tan(φ/4), of any length.

    Returns
    -------
    ndarray of shape (..., 4)
        Unit quaternions, body to inertial, scalar first.

    Raises
    ------
    ValueError
        If the shape is another one.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.mrp_to_quat([0.0, 0.0, 1.0]).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    return on_rows(mrp.to_quat, floats("sigma", sigma, (3,)), after=4)


def quat_to_mrp(q: ArrayLike) -> NDArray[Any]:
    """Convert quaternions to modified Rodrigues parameters.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, body to inertial, scalar first, of any norm above zero.

    Returns
    -------
    ndarray of shape (..., 3)
        σ = e tan(φ/4) with ``|σ|`` ≤ 1. At a rotation angle of exactly π, the axis has the sign of
        the vector part.

    Raises
    ------
    ValueError
        If the shape is another one.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.quat_to_mrp([0.8, 0.0, 0.6, 0.0]).round(6).tolist()
    [0.0, 0.333333, 0.0]
    """
    return on_rows(_of_unit(mrp.from_quat), floats("q", q, (4,)), after=3)


def normalised(q: NDArray[Any]) -> NDArray[Any]:
    """Quaternions (..., 4) of any norm above zero, normalised."""
    scaled = q / np.abs(q).max(axis=-1, keepdims=True)
    return np.asarray(scaled / np.linalg.norm(scaled, axis=-1, keepdims=True))


def make_continuous(q: NDArray[Any]) -> NDArray[Any]:
    """The quaternions (S, ...), each changed to the sign that is nearer to the one before."""
    turns = np.einsum("...k,...k", q[1:], q[:-1]) < 0.0
    q[1:] *= np.cumprod(np.where(turns, -1, 1), axis=0)[..., None].astype(q.dtype)
    return q


def quat_multiply(p: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    """Hamilton product p∘q of quaternions.

    ``fastatt.kernels.quat.mul`` is the same product of two tuples of numbers, for jitted code and
    for user-defined functions of a scene.

    Parameters
    ----------
    p : array_like of shape (..., 4)
        Left factors, scalar first.
    q : array_like of shape (..., 4)
        Right factors; the leading axes broadcast against those of ``p``.

    Returns
    -------
    ndarray of shape (..., 4)
        The products, of the norm ``|p| |q|`` to rounding. Nothing is normalised: normalise the
        result of many products, and one that enters its own successor more than once, whose norm
        otherwise drifts ever faster from 1.

    Raises
    ------
    ValueError
        If the shapes do not broadcast.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.quat_multiply([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    return _product(quat.mul, "p", p, "q", q, 4)


def quat_rotate(q: ArrayLike, v: ArrayLike) -> NDArray[Any]:
    """Rotate vectors from body axes to inertial axes, v_i = q∘v_b∘q*/``|q|²``.

    Lengths stay the same, to rounding, whatever the norms of the quaternions.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, body to inertial, of any norm above zero.
    v : array_like of shape (..., 3)
        Vectors along body axes; the leading axes broadcast against those of ``q``.

    Returns
    -------
    ndarray of shape (..., 3)
        The vectors along inertial axes.

    Raises
    ------
    ValueError
        If the shapes do not broadcast.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.quat_rotate([1.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0]).round(6).tolist()
    [0.0, 1.0, 0.0]
    """
    return _product(_of_unit(quat.rotate), "q", q, "v", v, 3)


def quat_rotate_inverse(q: ArrayLike, v: ArrayLike) -> NDArray[Any]:
    """Rotate vectors from inertial axes to body axes, v_b = q*∘v_i∘q/``|q|²``.

    Lengths stay the same, to rounding, whatever the norms of the quaternions.

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Quaternions, body to inertial, of any norm above zero.
    v : array_like of shape (..., 3)
        Vectors along inertial axes; the leading axes broadcast against those of ``q``.

    Returns
    -------
    ndarray of shape (..., 3)
        The vectors along body axes.

    Raises
    ------
    ValueError
        If the shapes do not broadcast.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.quat_rotate_inverse([1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0]).round(6).tolist()
    [1.0, 0.0, 0.0]
    """
    return _product(_of_unit(quat.rotate_inverse), "q", q, "v", v, 3)


def _product(
    formula: Any, p_name: str, p: ArrayLike, name: str, value: ArrayLike, length: int
) -> NDArray[Any]:
    left, right = floats(p_name, p, (4,)), floats(name, value, (length,))
    check_broadcast(p_name, left, name, right)
    return on_rows(formula, left, right, after=length)


def check_broadcast(p_name: str, left: NDArray[Any], name: str, right: NDArray[Any]) -> None:
    """Refuse arrays whose leading axes do not broadcast."""
    try:
        np.broadcast_shapes(left.shape[:-1], right.shape[:-1])
    except ValueError:
        raise ValueError(
            f"{name}: has shape {right.shape}, {p_name} {left.shape}; accepted: shapes that "
            "broadcast"
        ) from None


def angle_between(a: ArrayLike, b: ArrayLike) -> Any:
    """Geodesic angle between attitudes.

    Parameters
    ----------
    a : array_like of shape (..., 4) or (..., 3, 3)
        Quaternions of any norm above zero, or rotation matrices.
    b : array_like of shape (..., 4) or (..., 3, 3)
        Attitudes that broadcast against ``a``, in either form.

    Returns
    -------
    float or ndarray of shape (...)
        The angle in [0, π], rad; a float for one pair.

    Raises
    ------
    ValueError
        If a shape is another one, or a matrix is not a rotation.
    TypeError
        If an argument does not consist of numbers.

    Notes
    -----
    The absolute error between quaternions is at most 1e-15 rad, also below 1e-8 rad and near π.
    Between matrices the rounding of their elements, some 2e-16, adds to it.

    Examples
    --------
    >>> import fastatt as fa
    >>> round(fa.angle_between([1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0]), 6)
    1.570796
    """
    p, q = as_quat("a", a), as_quat("b", b)
    check_broadcast("a", p, "b", q)
    angles = on_rows(_angle, p, q, after=None)
    return angles if angles.ndim else float(angles)


def _angle(p: Any, q: Any) -> Any:
    return quat.angle(quat.normalise(p), quat.normalise(q))


def as_quat(name: str, value: ArrayLike) -> NDArray[Any]:
    """Quaternions (..., 4) from quaternions or rotation matrices (..., 3, 3)."""
    array = checks.numbers(name, value, "real numbers")
    if array.shape[-2:] == (3, 3):
        return quaternions_of(_rotations(name, array))
    if array.shape[-1:] != (4,):
        raise ValueError(f"{name}: has shape {array.shape}; accepted: (..., 4) and (..., 3, 3)")
    return array
