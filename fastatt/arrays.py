"""Formulas over the rows of arrays: conversions, angles, products, for one attitude or many."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.codegen.rows import kind_of, rows
from fastatt.tracing.formulas import dcm, euler313, mrp, quat

# by how much an element of CᵀC may be off
_NOT_ORTHOGONAL = 0.01


def on_rows(formula: Any, *given: NDArray[Any], after: int | None) -> NDArray[Any]:
    """A formula on rows (..., n) that broadcast: (..., after), or (...) where it gives a number."""
    inputs = {f"x{k}": x.shape[-1] for k, x in enumerate(given)}
    kind = kind_of(np.result_type(*given))
    return rows(formula, inputs, (after,), kind)(*given)[0]


@cache
def _of_unit(formula: Any) -> Any:
    """A formula whose first argument is a quaternion, of its unit quaternion."""
    return lambda q, *more: formula(quat.normalise(q), *more)


def floats(name: str, value: ArrayLike, tail: tuple[int, ...]) -> NDArray[Any]:
    """Float32 or float64 numbers whose last axes are ``tail``."""
    found = checks.numbers(name, value, "real numbers")
    if found.shape[found.ndim - len(tail) :] != tail:
        accepted = ", ".join(map(str, tail))
        raise ValueError(f"{name}: has shape {found.shape}; accepted: (..., {accepted})")
    return found


def quat_to_dcm(q: ArrayLike) -> NDArray[Any]:
    """Direction cosine matrices (..., 3, 3) of quaternions (..., 4), of any length but zero."""
    found = on_rows(_of_unit(dcm.from_quat), floats("q", q, (4,)), after=9)
    return found.reshape((*found.shape[:-1], 3, 3))


def dcm_to_quat(C: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) with q0 ≥ 0 of rotations (..., 3, 3), by Shepperd's method.

    Raises ``ValueError`` for matrices of no rotation: of left-handed axes, or where an element of
    CᵀC differs from that of the identity by more than 0.01.
    """
    return quaternions_of(_rotations("C", C))


def _rotations(name: str, C: Any) -> NDArray[Any]:
    found = floats(name, C, (3, 3))
    with np.errstate(all="ignore"):  # a matrix that is not finite gives such a quaternion
        size = (found[..., 0] * np.cross(found[..., 1], found[..., 2])).sum(axis=-1)
        gram = np.swapaxes(found, -1, -2) @ found
        error = np.abs(gram - np.eye(3)).max(axis=(-2, -1))
    wrong = (size <= 0.0) | (error > _NOT_ORTHOGONAL)
    if wrong.any():
        k = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise ValueError(
            f"{name}{list(k) or ''}: found the determinant {size[k]:.3g}, and CᵀC off the identity "
            f"by {error[k]:.3g}; accepted: rotations, of determinant 1, to {_NOT_ORTHOGONAL}"
        )
    return found


def quaternions_of(found: NDArray[Any]) -> NDArray[Any]:
    """Unit quaternions of matrices that propagation may have left without orthogonality."""
    return on_rows(dcm.to_quat, found.reshape((*found.shape[:-2], 9)), after=4)


def euler313_to_quat(angles: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) of 3-1-3 angles (φ, θ, ψ), rad, (..., 3)."""
    return on_rows(euler313.to_quat, floats("angles", angles, (3,)), after=4)


def quat_to_euler313(q: ArrayLike) -> NDArray[Any]:
    """3-1-3 angles (φ, θ, ψ), rad, (..., 3), θ in [0, π], of quaternions (..., 4) not 0.

    Quaternions are normalised first: their length does not count.
    """
    return on_rows(_of_unit(euler313.from_quat), floats("q", q, (4,)), after=3)


def rotation_vector_to_quat(u: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) of rotation vectors (..., 3), rad, any angle."""
    return on_rows(quat.exp, floats("u", u, (3,)), after=4)


def quat_to_rotation_vector(q: ArrayLike) -> NDArray[Any]:
    """Rotation vectors (..., 3), rad, of at most π, of quaternions (..., 4)."""
    return on_rows(quat.log, floats("q", q, (4,)), after=3)


def mrp_to_quat(sigma: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) of modified Rodrigues parameters (..., 3) of any length."""
    return on_rows(mrp.to_quat, floats("sigma", sigma, (3,)), after=4)


def quat_to_mrp(q: ArrayLike) -> NDArray[Any]:
    """Modified Rodrigues parameters e tan(φ/4), |σ| ≤ 1, (..., 3), of quaternions (..., 4) not 0.

    At exactly half a turn, |σ| = 1, the axis keeps the sign of the vector part.
    """
    return on_rows(_of_unit(mrp.from_quat), floats("q", q, (4,)), after=3)


def normalised(q: NDArray[Any]) -> NDArray[Any]:
    """Unit quaternions of q (..., 4), of any length but zero."""
    scaled = q / np.abs(q).max(axis=-1, keepdims=True)
    return np.asarray(scaled / np.linalg.norm(scaled, axis=-1, keepdims=True))


def quat_multiply(p: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    """Hamilton products p∘q of quaternions (..., 4) that broadcast against each other."""
    return _product(quat.mul, "p", p, "q", q, 4)


def quat_rotate(q: ArrayLike, v: ArrayLike) -> NDArray[Any]:
    """v_i = q∘v_b∘q*/|q|²: vectors (..., 3) of the body along inertial axes, q (..., 4) not 0."""
    return _product(_of_unit(quat.rotate), "q", q, "v", v, 3)


def quat_rotate_inverse(q: ArrayLike, v: ArrayLike) -> NDArray[Any]:
    """v_b = q*∘v_i∘q/|q|²: inertial vectors (..., 3) along body axes, q (..., 4) not 0."""
    return _product(_of_unit(quat.rotate_inverse), "q", q, "v", v, 3)


def _product(
    formula: Any, p_name: str, p: ArrayLike, name: str, value: ArrayLike, length: int
) -> NDArray[Any]:
    left, right = floats(p_name, p, (4,)), floats(name, value, (length,))
    _check_broadcast(p_name, left, name, right)
    return on_rows(formula, left, right, after=length)


def _check_broadcast(p_name: str, left: NDArray[Any], name: str, right: NDArray[Any]) -> None:
    try:
        np.broadcast_shapes(left.shape[:-1], right.shape[:-1])
    except ValueError:
        raise ValueError(
            f"{name}: has shape {right.shape}, {p_name} {left.shape}; accepted: shapes that "
            "broadcast"
        ) from None


def angle_between(a: ArrayLike, b: ArrayLike) -> Any:
    """Geodesic angle between attitudes, rad in [0, π]; correct below 1e-8 and near π.

    ``a`` and ``b`` are quaternions (..., 4), of any length but zero, or rotations (..., 3, 3), and
    broadcast against each other. Absolute error at most 1e-15 rad between quaternions; between
    matrices the entries' own rounding, some 2e-16, counts on top. Gives (...), or a float for one
    pair.

    Raises ``ValueError`` for other shapes and for matrices of no rotation, ``TypeError`` for other
    things than numbers.
    """
    p, q = as_quat("a", a), as_quat("b", b)
    _check_broadcast("a", p, "b", q)
    found = on_rows(_angle, p, q, after=None)
    return found if found.ndim else float(found)


def _angle(p: Any, q: Any) -> Any:
    return quat.angle(quat.normalise(p), quat.normalise(q))


def as_quat(name: str, value: ArrayLike) -> NDArray[Any]:
    """Quaternions (..., 4) of quaternions or of rotations (..., 3, 3)."""
    found = checks.numbers(name, value, "real numbers")
    if found.shape[-2:] == (3, 3):
        return quaternions_of(_rotations(name, found))
    if found.shape[-1:] != (4,):
        raise ValueError(f"{name}: has shape {found.shape}; accepted: (..., 4) and (..., 3, 3)")
    return found
