"""Inertia: its checks, and its principal axes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import dcm_to_quat, normalised, quat_multiply, quat_rotate_inverse

_SHAPES = "(3,), (3, 3), (N, 3) or (N, 3, 3)"
# two moments are equal if they differ by less than this share of the largest
EQUAL = 1e-12
# moments of a tensor below this share of the largest are its rounding
_ROUNDING = 4e-15
# off-diagonal pairs may differ by this share of the largest, by the rounding of computed tensors
_ASYMMETRY = 1e-9
# A body's largest moment is at most the sum of the others. Moments in use violate that: estimates
# from flight by some per cent, the test body (2, 1, 2/3) of the literature by 20 %.
TRIANGLE = 1.25
# kg·m²; beyond it, products of moments and momenta overflow
_SMALLEST, _LARGEST = 1e-100, 1e100


class Principal(NamedTuple):
    """Principal moments (3,) or (N, 3), kg·m², and the directions of their axes.

    ``axes`` is None if the body axes are principal. Otherwise it is unit quaternions p, (4,) or
    (N, 4), with v_body = p∘v_principal∘p*.
    """

    moments: NDArray[np.float64]
    axes: NDArray[np.float64] | None


def principal(inertia: ArrayLike, *, allow_unphysical: bool = False) -> Principal:
    """Principal moments and axes of inertia that is given as moments or tensors.

    Raises ``ValueError`` for shapes other than (3,), (3, 3), (N, 3) and (N, 3, 3), as ``is_tensor``
    does, and for inertia that no body has: moments not above 0, a largest moment above 1.25 times
    the sum of the others, tensors that are not symmetric. ``allow_unphysical`` accepts these,
    except moments of 0; the symmetric part of a tensor is used.
    """
    tensor = checks.array("inertia", inertia, _SHAPES).astype(np.float64)
    if max(tensor.max(), -tensor.min()) > _LARGEST:
        raise ValueError(f"inertia: found {np.abs(tensor).max():.6g}; accepted: up to {_LARGEST:g}")
    if not is_tensor(tensor):
        _check_moments(tensor, allow_unphysical)
        return Principal(tensor, None)
    gap = np.atleast_1d(_asymmetry(tensor))
    if gap.any() and not allow_unphysical:
        b = int(np.argmax(gap > 0.0))
        raise ValueError(
            f"inertia{[b] if tensor.ndim == 3 else ''}: the tensor is not symmetric, elements "
            f"differ by {gap[b]:.3g}; accepted: a symmetric tensor, or allow_unphysical=True for "
            "its symmetric part"
        )
    tensor = 0.5 * (tensor + np.swapaxes(tensor, -1, -2))
    if not tensor[..., [0, 0, 1], [1, 2, 2]].any():
        moments, axes = np.ascontiguousarray(np.diagonal(tensor, axis1=-2, axis2=-1)), None
    else:
        moments, columns = np.linalg.eigh(tensor)
        columns[..., 0] *= np.linalg.det(columns)[..., None]  # right-handed
        axes = dcm_to_quat(columns)
        # a moment of 0 is one of either sign, to the rounding of the tensor
        least = _ROUNDING * np.abs(moments).max(axis=-1, keepdims=True)
        moments = np.where(np.abs(moments) < least, 0.0, moments)
    _check_moments(moments, allow_unphysical)
    return Principal(moments, axes)


def is_tensor(array: NDArray[Any]) -> bool:
    """Whether arrays of shape (3,), (3, 3), (N, 3) or (N, 3, 3) are tensors; a (3, 3) array is one.

    Raises ``ValueError`` for a (3, 3) array that may be the moments of three bodies: all elements
    are above 0, and its rows are moments that bodies have or the matrix is not symmetric. No body's
    tensor is refused by it: moments that bodies have mean λ ≤ 5/9 of the trace, so that the
    elements off the diagonal of their tensor add up to at most 2/3 of the trace, while rows that
    bodies have mean at least 4/5 of it.
    """
    one = array.shape == (3, 3)
    rows_may_be = one and (_asymmetry(array) > 0.0 or not _past_triangle(*array.T).any())
    if rows_may_be and (array > 0.0).all():
        raise ValueError(
            "inertia: a (3, 3) array is one tensor, and the rows of this one may be moments of "
            "three bodies; accepted: a symmetric tensor; moments of three bodies as (3, 3, 3), "
            "moments[:, :, None] * np.eye(3); a tensor of no body as (1, 3, 3), with "
            "allow_unphysical=True"
        )
    return array.shape[-2:] == (3, 3)


def sort_axes(body: Principal) -> Principal:
    """The body with its intermediate moment on axis 2."""
    m = body.moments
    if is_sorted(m):
        return body
    order = axis_order(m)
    turn = dcm_to_quat(np.swapaxes(np.eye(3)[order], -1, -2))
    axes = turn if body.axes is None else quat_multiply(body.axes, turn)
    return Principal(np.take_along_axis(m, order, axis=-1), axes)


def axis_order(moments: NDArray[Any]) -> NDArray[np.intp]:
    """Which of the moments (..., 3) ``sort_axes`` puts on axes 1, 2 and 3: (..., 3).

    The order is cyclic and computed for each body alone.
    """
    middle = np.where(_sorted(moments), 1, np.argsort(moments, axis=-1)[..., 1])
    return np.asarray((middle[..., None] + np.arange(-1, 2)) % 3)


def about_arm(body: Principal, arm: NDArray[Any]) -> tuple[Principal, NDArray[np.float64]]:
    """The bodies with their axis of symmetry third, and the component of an arm along it.

    ``arm`` is (3,) or (N, 3), m, along body axes. Raises ``ValueError``, with the index of the
    body, if the moments about two axes normal to the arm are not equal.
    """
    inside = arm if body.axes is None else quat_rotate_inverse(body.axes, arm)
    m, inside = np.broadcast_arrays(body.moments, inside)
    with np.errstate(over="ignore"):
        size = np.linalg.norm(inside, axis=-1)[..., None]
    first, second = np.array([1, 2, 0]), np.array([2, 0, 1])
    most = m.max(axis=-1, keepdims=True)
    even = np.abs(m[..., first] - m[..., second]) <= EQUAL * most
    off = np.hypot(inside[..., first], inside[..., second])
    # the difference of the moment about the arm; the directions of a sphere are arbitrary
    gap = np.maximum(np.abs(m[..., first] - m), np.abs(m[..., second] - m))
    fits = even & (off * gap <= EQUAL * size * most)
    bad = np.atleast_1d(~fits.any(axis=-1))
    if bad.any():
        b = int(np.argmax(bad))
        where = f"[{b}]" if m.ndim == 2 else ""
        rows = (", ".join(f"{x:.6g}" for x in x.reshape(-1, 3)[b]) for x in (m, inside))
        raise ValueError(
            "inertia{0} is ({1}) with arm{0} ({2}) along principal axes; accepted by the closed "
            "form of a heavy top: an arm along the axis of two equal moments".format(where, *rows)
        )
    axis = 2 - np.argmax(np.where(fits, np.abs(inside), -1.0)[..., ::-1], axis=-1)
    place = axis[..., None]
    # the direction of the arm, upwards along that axis
    side = np.copysign(size, np.take_along_axis(inside, place, axis=-1))
    oblique = np.take_along_axis(off, place, axis=-1) > 0.0
    n = np.where(oblique, inside / np.where(oblique, side, 1.0), np.eye(3)[axis])
    reach = np.asarray((inside * n).sum(axis=-1))
    if (n == np.eye(3)[2]).all():
        return body, reach
    turn = np.stack([1.0 + n[..., 2], -n[..., 1], n[..., 0], 0.0 * n[..., 0]], axis=-1)
    turn = normalised(turn)
    axes = turn if body.axes is None else quat_multiply(body.axes, turn)
    order = (place + np.array([1, 2, 0])) % 3
    return Principal(np.take_along_axis(m, order, axis=-1), axes), reach


def is_sorted(moments: NDArray[Any]) -> bool:
    """Whether the second of the moments (..., 3) is the intermediate one, for every body."""
    return bool(_sorted(moments).all())


def _sorted(moments: NDArray[Any]) -> NDArray[np.bool_]:
    a, b, c = np.moveaxis(moments, -1, 0)
    return np.asarray(((a <= b) & (b <= c)) | ((a >= b) & (b >= c)))


def is_symmetric(moments: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether two of the moments (..., 3) are equal, to 1e-12 of the largest."""
    a, b, c = np.moveaxis(moments, -1, 0)
    gap = np.minimum(np.minimum(np.abs(a - b), np.abs(b - c)), np.abs(c - a))
    return np.asarray(gap <= EQUAL * np.maximum(np.maximum(a, b), c))


def is_spherical(moments: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether all moments (..., 3) are equal, to 1e-12 of the largest."""
    a, b, c = np.moveaxis(moments, -1, 0)  # NumPy reduces short rows slowly
    most = np.maximum(np.maximum(a, b), c)
    return np.asarray(most - np.minimum(np.minimum(a, b), c) <= EQUAL * most)


def _asymmetry(tensor: NDArray[Any]) -> NDArray[Any]:
    """Largest difference across the diagonal of tensors (..., 3, 3), 0 where it is rounding."""
    gap = np.abs(tensor - np.swapaxes(tensor, -1, -2)).max(axis=(-2, -1))
    return np.where(gap > _ASYMMETRY * np.abs(tensor).max(axis=(-2, -1)), gap, 0.0)


def _past_triangle(a: Any, b: Any, c: Any) -> Any:
    """Whether one moment exceeds the sum of the others by more than ``TRIANGLE`` allows."""
    largest = np.maximum(np.maximum(a, b), c)
    return largest > TRIANGLE * (a + b + c - largest)


def _check_moments(moments: NDArray[Any], allow_unphysical: bool) -> None:
    a, b, c = moments.reshape(-1, 3).T
    insist = "or allow_unphysical=True"
    if moments.min() < _SMALLEST:
        tiny = [(x != 0.0) & (np.abs(x) < _SMALLEST) for x in (a, b, c)]
        refuse(moments, tiny[0] | tiny[1] | tiny[2], "too small", f"from {_SMALLEST:g} kg·m² on")
        if allow_unphysical:
            bad = (a == 0.0) | (b == 0.0) | (c == 0.0)
            refuse(moments, bad, "a principal moment is 0", "any other")
        else:
            bad = (a <= 0.0) | (b <= 0.0) | (c <= 0.0)
            reason = "a principal moment is not above 0"
            refuse(moments, bad, reason, f"moments above 0, {insist}")
    if allow_unphysical:
        return
    refuse(
        moments,
        _past_triangle(a, b, c),
        f"no body has one moment above the sum of the others, here by more than {TRIANGLE - 1:.0%}",
        f"moments that a body can have, {insist}",
    )


def refuse(moments: NDArray[Any], bad: Any, reason: str, accepted: str) -> None:
    """Raise ``ValueError`` for the first bad body, (...) of moments (..., 3)."""
    bad = np.atleast_1d(bad)
    if bad.any():
        b = int(np.argmax(bad))
        where = f"[{b}]" if moments.ndim == 2 else ""
        numbers = ", ".join(f"{x:.6g}" for x in moments.reshape(-1, 3)[b])
        raise ValueError(f"inertia{where} is ({numbers}): {reason}; accepted: {accepted}")
