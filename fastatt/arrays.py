"""Kernels over the rows of arrays: conversions, angles, products, for one attitude or many."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._jit import driver, hook
from fastatt.columns import unpack
from fastatt.kernels import dcm, euler313, quat


class QuatToDcm(NamedTuple):
    """Tag."""


class DcmToQuat(NamedTuple):
    """Tag."""


class Euler313ToQuat(NamedTuple):
    """Tag."""


class QuatToEuler313(NamedTuple):
    """Tag."""


class RotationVectorToQuat(NamedTuple):
    """Tag."""


class QuatToRotationVector(NamedTuple):
    """Tag."""


class Multiply(NamedTuple):
    """Tag."""


class Rotate(NamedTuple):
    """Tag."""


# tag: its kernel and the lengths of a row before and after
_CONVERSIONS: dict[type, tuple[Any, int, int]] = {
    QuatToDcm: (dcm.from_quat, 4, 9),
    DcmToQuat: (dcm.to_quat, 9, 4),
    Euler313ToQuat: (euler313.to_quat, 3, 4),
    QuatToEuler313: (euler313.from_quat, 4, 3),
    RotationVectorToQuat: (quat.exp, 3, 4),
    QuatToRotationVector: (quat.log, 4, 3),
}

_PRODUCTS: dict[type, Any] = {Multiply: quat.mul, Rotate: quat.rotate}


def convert(conversion: Any, row: Any) -> Any:
    """The kernel of a conversion, on a row of an array."""
    raise NotImplementedError(conversion)


@hook(convert)
def _convert(conversion: types.BaseNamedTuple, row: types.Array) -> Any:
    kernel, before, _ = _CONVERSIONS[conversion.instance_class]
    shape = (0.0,) * before
    return lambda conversion, row: kernel(unpack(row, shape))


@driver
def _convert_rows(conversion, rows, out):
    for i in range(rows.shape[0]):
        x = convert(conversion, rows[i])
        for k in range(out.shape[1]):
            out[i, k] = x[k]


def combine(product: Any, p: Any, row: Any) -> Any:
    """The kernel of a product of a quaternion and a row of an array."""
    raise NotImplementedError(product)


@hook(combine)
def _combine(product: types.BaseNamedTuple, p: types.UniTuple, row: types.Array) -> Any:
    kernel = _PRODUCTS[product.instance_class]
    shape = (0.0,) * (4 if product.instance_class is Multiply else 3)
    return lambda product, p, row: kernel(p, unpack(row, shape))


@driver
def _combine_rows(product, p, rows, out):
    for i in range(out.shape[0]):
        x = combine(product, (p[i, 0], p[i, 1], p[i, 2], p[i, 3]), rows[i])
        for k in range(out.shape[1]):
            out[i, k] = x[k]


@driver
def _angle(p, q, out):
    for i in range(out.shape[0]):
        a = (p[i, 0], p[i, 1], p[i, 2], p[i, 3])
        b = (q[i, 0], q[i, 1], q[i, 2], q[i, 3])
        out[i] = quat.angle(quat.normalise(a), quat.normalise(b))


def _rows(conversion: Any, value: NDArray[Any], axes: int, after: tuple[int, ...]) -> NDArray[Any]:
    """Convert rows that span the last ``axes`` axes: (..., *before) to (..., *after)."""
    _, n, m = _CONVERSIONS[type(conversion)]
    lead = value.shape[: value.ndim - axes]
    out = np.empty((math.prod(lead), m), dtype=value.dtype)
    _convert_rows(conversion, _compiled_for(value).reshape(-1, n), out)
    return out.reshape(lead + after)


def _compiled_for(value: NDArray[Any]) -> NDArray[Any]:
    """Contiguous and writable, though only read: a read-only array is compiled for anew."""
    return np.require(value, requirements=["C", "W"])


def floats(name: str, value: ArrayLike, tail: tuple[int, ...]) -> NDArray[Any]:
    """Float32 or float64 numbers whose last axes are ``tail``.

    Raises ``TypeError`` for something else than real numbers, ``ValueError`` for other shapes.
    """
    found = checks.numbers(name, value, "real numbers")
    if found.shape[found.ndim - len(tail) :] != tail:
        accepted = ", ".join(map(str, tail))
        raise ValueError(f"{name}: has shape {found.shape}; accepted: (..., {accepted})")
    return found


def quat_to_dcm(q: ArrayLike) -> NDArray[Any]:
    """Direction cosine matrices (..., 3, 3) of unit quaternions (..., 4)."""
    return _rows(QuatToDcm(), floats("q", q, (4,)), 1, (3, 3))


def dcm_to_quat(C: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) with q0 ≥ 0 of rotations (..., 3, 3), by Shepperd's method."""
    return _rows(DcmToQuat(), floats("C", C, (3, 3)), 2, (4,))


def euler313_to_quat(angles: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) of 3-1-3 angles (φ, θ, ψ), rad, (..., 3)."""
    return _rows(Euler313ToQuat(), floats("angles", angles, (3,)), 1, (4,))


def quat_to_euler313(q: ArrayLike) -> NDArray[Any]:
    """3-1-3 angles (φ, θ, ψ), rad, (..., 3), θ in [0, π], of unit quaternions (..., 4)."""
    return _rows(QuatToEuler313(), floats("q", q, (4,)), 1, (3,))


def rotation_vector_to_quat(u: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) of rotation vectors (..., 3), rad, any angle."""
    return _rows(RotationVectorToQuat(), floats("u", u, (3,)), 1, (4,))


def quat_to_rotation_vector(q: ArrayLike) -> NDArray[Any]:
    """Rotation vectors (..., 3), rad, of at most π, of quaternions (..., 4)."""
    return _rows(QuatToRotationVector(), floats("q", q, (4,)), 1, (3,))


def normalised(q: NDArray[Any]) -> NDArray[Any]:
    """Unit quaternions of q (..., 4), of any length but zero."""
    scaled = q / np.abs(q).max(axis=-1, keepdims=True)
    return np.asarray(scaled / np.linalg.norm(scaled, axis=-1, keepdims=True))


def quat_multiply(p: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    """Hamilton products p∘q of quaternions (..., 4) that broadcast against each other."""
    return _product(Multiply(), "p", p, "q", q, 4)


def rotate(q: ArrayLike, v: ArrayLike) -> NDArray[Any]:
    """v_i = q∘v_b∘q*: vectors (..., 3) of the body along inertial axes, by unit q (..., 4)."""
    return _product(Rotate(), "q", q, "v", v, 3)


def rotate_inverse(q: ArrayLike, v: ArrayLike) -> NDArray[Any]:
    """v_b = q*∘v_i∘q: inertial vectors (..., 3) along body axes, by unit q (..., 4)."""
    return rotate(floats("q", q, (4,)) * (1.0, -1.0, -1.0, -1.0), v)


def _product(
    product: Any, p_name: str, p: ArrayLike, name: str, value: ArrayLike, length: int
) -> NDArray[Any]:
    left, right = floats(p_name, p, (4,)), floats(name, value, (length,))
    lead, left, right = _aligned(p_name, left, name, right)
    out = np.empty((math.prod(lead), length), dtype=np.result_type(left, right))
    _combine_rows(product, left, right, out)
    return out.reshape(*lead, length)


def _aligned(
    p_name: str, left: NDArray[Any], name: str, right: NDArray[Any]
) -> tuple[tuple[int, ...], NDArray[Any], NDArray[Any]]:
    """The leading axes of two arrays broadcast against each other, and the rows of both."""
    try:
        lead = np.broadcast_shapes(left.shape[:-1], right.shape[:-1])
    except ValueError:
        raise ValueError(
            f"{name}: has shape {right.shape}, {p_name} {left.shape}; accepted: shapes that "
            "broadcast"
        ) from None
    left, right = (
        x if x.shape[:-1] == lead else np.broadcast_to(x, (*lead, x.shape[-1]))
        for x in (left, right)
    )
    left, right = (_compiled_for(x).reshape(-1, x.shape[-1]) for x in (left, right))
    return lead, left, right


def angle_between(a: ArrayLike, b: ArrayLike) -> Any:
    """Geodesic angle between attitudes, rad in [0, π]; correct below 1e-8 and near π.

    ``a`` and ``b`` are quaternions (..., 4), of any length but zero, or rotations (..., 3, 3), and
    broadcast against each other. Absolute error at most 1e-15 rad between quaternions; between
    matrices the entries' own rounding, some 2e-16, counts on top. Gives (...), or a float for one
    pair.

    Raises ``ValueError`` for other shapes, ``TypeError`` for something that is not numbers.
    """
    lead, p, q = _aligned("a", _as_quat("a", a), "b", _as_quat("b", b))
    out = np.empty(math.prod(lead), dtype=np.result_type(p, q))
    _angle(p, q, out)
    return out.reshape(lead) if lead else float(out[0])


def _as_quat(name: str, value: ArrayLike) -> NDArray[Any]:
    found = checks.numbers(name, value, "real numbers")
    if found.shape[-2:] == (3, 3):
        return _rows(DcmToQuat(), found, 2, (4,))
    if found.shape[-1:] != (4,):
        raise ValueError(f"{name}: has shape {found.shape}; accepted: (..., 4) and (..., 3, 3)")
    return found
