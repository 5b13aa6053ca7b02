"""Kernels over the rows of arrays: conversions, angles, products, for one attitude or many."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt._jit import driver
from fastatt.kernels import dcm, euler313, quat


@driver
def _quat_to_dcm(q, out):
    for i in range(q.shape[0]):
        c = dcm.from_quat((q[i, 0], q[i, 1], q[i, 2], q[i, 3]))
        for k in range(9):
            out[i, k] = c[k]


@driver
def _dcm_to_quat(c, out):
    for i in range(c.shape[0]):
        q = dcm.to_quat(
            (c[i, 0], c[i, 1], c[i, 2], c[i, 3], c[i, 4], c[i, 5], c[i, 6], c[i, 7], c[i, 8])
        )
        for k in range(4):
            out[i, k] = q[k]


@driver
def _euler313_to_quat(a, out):
    for i in range(a.shape[0]):
        q = euler313.to_quat((a[i, 0], a[i, 1], a[i, 2]))
        for k in range(4):
            out[i, k] = q[k]


@driver
def _quat_to_euler313(q, out):
    for i in range(q.shape[0]):
        a = euler313.from_quat((q[i, 0], q[i, 1], q[i, 2], q[i, 3]))
        for k in range(3):
            out[i, k] = a[k]


@driver
def _rotation_vector_to_quat(u, out):
    for i in range(u.shape[0]):
        q = quat.exp((u[i, 0], u[i, 1], u[i, 2]))
        for k in range(4):
            out[i, k] = q[k]


@driver
def _quat_to_rotation_vector(q, out):
    for i in range(q.shape[0]):
        u = quat.log((q[i, 0], q[i, 1], q[i, 2], q[i, 3]))
        for k in range(3):
            out[i, k] = u[k]


@driver
def _angle(p, q, out):
    for i in range(out.shape[0]):
        out[i] = quat.angle(
            quat.normalise((p[i, 0], p[i, 1], p[i, 2], p[i, 3])),
            quat.normalise((q[i, 0], q[i, 1], q[i, 2], q[i, 3])),
        )


def _rows(
    loop: Any, value: NDArray[Any], before: tuple[int, ...], after: tuple[int, ...]
) -> NDArray[Any]:
    """Run a loop over the rows of ``value``, (..., *before) to (..., *after)."""
    lead = value.shape[: value.ndim - len(before)]
    out = np.empty((int(np.prod(lead)), int(np.prod(after))), dtype=value.dtype)
    loop(np.ascontiguousarray(value).reshape(-1, int(np.prod(before))), out)
    return out.reshape(lead + after)


def _floats(name: str, value: ArrayLike, tail: tuple[int, ...]) -> NDArray[Any]:
    found = np.asarray(value)
    if found.dtype != np.float32:
        try:
            found = found.astype(np.float64)
        except (TypeError, ValueError):
            raise TypeError(f"{name}: found {value!r}; accepted: real numbers") from None
    if found.shape[found.ndim - len(tail) :] != tail:
        accepted = ", ".join(map(str, tail))
        raise ValueError(f"{name}: has shape {found.shape}; accepted: (..., {accepted})")
    return found


def quat_to_dcm(q: ArrayLike) -> NDArray[Any]:
    """Direction cosine matrices (..., 3, 3) of unit quaternions (..., 4)."""
    return _rows(_quat_to_dcm, _floats("q", q, (4,)), (4,), (3, 3))


def dcm_to_quat(C: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) with q0 ≥ 0 of rotations (..., 3, 3), by Shepperd's method."""
    return _rows(_dcm_to_quat, _floats("C", C, (3, 3)), (3, 3), (4,))


def euler313_to_quat(angles: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) of 3-1-3 angles (φ, θ, ψ), rad, (..., 3)."""
    return _rows(_euler313_to_quat, _floats("angles", angles, (3,)), (3,), (4,))


def quat_to_euler313(q: ArrayLike) -> NDArray[Any]:
    """3-1-3 angles (φ, θ, ψ), rad, (..., 3), θ in [0, π], of unit quaternions (..., 4)."""
    return _rows(_quat_to_euler313, _floats("q", q, (4,)), (4,), (3,))


def rotation_vector_to_quat(u: ArrayLike) -> NDArray[Any]:
    """Unit quaternions (..., 4) of rotation vectors (..., 3), rad, any angle."""
    return _rows(_rotation_vector_to_quat, _floats("u", u, (3,)), (3,), (4,))


def quat_to_rotation_vector(q: ArrayLike) -> NDArray[Any]:
    """Rotation vectors (..., 3), rad, of at most π, of quaternions (..., 4)."""
    return _rows(_quat_to_rotation_vector, _floats("q", q, (4,)), (4,), (3,))


def angle_between(a: ArrayLike, b: ArrayLike) -> Any:
    """Geodesic angle between attitudes, rad in [0, π]; correct below 1e-8 and near π.

    ``a`` and ``b`` are quaternions (..., 4), of any length but zero, or rotations (..., 3, 3), and
    broadcast against each other. Absolute error at most 1e-15 rad between quaternions; between
    matrices the entries' own rounding, some 2e-16, counts on top. Gives (...), or a float for one
    pair.

    Raises ``ValueError`` for other shapes, ``TypeError`` for something that is not numbers.
    """
    p, q = (_as_quat(name, value) for name, value in (("a", a), ("b", b)))
    try:
        p, q = np.broadcast_arrays(p, q)
    except ValueError:
        raise ValueError(
            f"b: has shape {np.shape(b)}, a {np.shape(a)}; accepted: shapes that broadcast"
        ) from None
    out = np.empty(p.size // 4, dtype=np.result_type(p, q))
    _angle(np.ascontiguousarray(p).reshape(-1, 4), np.ascontiguousarray(q).reshape(-1, 4), out)
    return out.reshape(p.shape[:-1]) if p.ndim > 1 else float(out[0])


def _as_quat(name: str, value: ArrayLike) -> NDArray[Any]:
    shape = np.shape(value)
    if len(shape) >= 2 and shape[-2:] == (3, 3):
        return dcm_to_quat(value)
    if not shape or shape[-1] != 4:
        raise ValueError(f"{name}: has shape {shape}; accepted: (..., 4) and (..., 3, 3)")
    return _floats(name, value, (4,))
