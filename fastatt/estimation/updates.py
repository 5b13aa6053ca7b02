"""Multiplicative extended Kalman filter as kernels, with tuples as arguments and results.

The estimate is q, an auxiliary state y (K numbers; the bias b for an MEKF) and the covariance of
the error (δθ, δy): q_true = q∘exp(δθ), y_true = y + δy, δθ in body axes. The public kernels have K
= 3 and take a covariance as ``kernels.error_state`` does, (P11, P12, P22) with 6, 9 and 6
numbers. Internally a covariance is its rows. It is updated in Joseph's form and is symmetric by
construction. Lefferts, Markley and Shuster, *Journal of Guidance and Control* 5 (1982) 417; Markley
and Crassidis, *Fundamentals of Spacecraft Attitude Determination and Control* (2014), §6.2.

Updates by a vector and by an attitude are linearised about their result four times (an iterated
extended Kalman filter), with the prior covariance along the axes of a rotation from the prior
estimate. The rotation about a vector, which the vector does not determine, thus stays as uncertain
as it was (Barrau and Bonnabel, *IEEE Transactions on Automatic Control* 62 (2017) 1797).

NIS is νᵀ (H P Hᵀ + R)⁻¹ ν at the last linearisation, with ν = z − H d and the mean error d of the
prior. Where the iteration has settled, this is the least sum of the normalised squares of the
correction and of the residual. It has a χ² distribution also if P is so large that the first
linearisation is wrong. The residual of a vector consists of the arc from its expected direction, in
two components, and of the difference of the lengths, which does not depend on the attitude.
"""

from __future__ import annotations

import math
import sys
from functools import lru_cache, partial
from typing import Any

from fastatt.codegen.rows import RowFunction
from fastatt.codegen.scalar import scalar_function
from fastatt.estimation.amounts import NEGATIVE
from fastatt.kernels import dcm, error_state, quat, trig
from fastatt.kernels.vec3 import add, axpy, dot, scale
from fastatt.tracing.formulas import Vector

_formula = partial(scalar_function, rewritten=True)
#: linearisations of an update by vectors or attitudes, and the normalised square of the last
#: correction beyond which more would be needed, that of three deviations
PASSES, NEARLY_SETTLED = 4, 9.0


@_formula
def mekf_predict(q, b, P, gyro, h, angle_variance, bias_variance):
    """Propagate an MEKF over an interval with a gyro sample; exact for a constant rate.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude, body to inertial.
    b : tuple of 3 float
        Gyro bias, rad/s.
    P : tuple
        Covariance (P11, P12, P22) of (δθ, δb), tuples of 6, 9 and 6 numbers.
    gyro : tuple of 3 float
        Gyro sample, held over the interval, rad/s.
    h : float
        Interval, s.
    angle_variance : float
        σ_v², rad²/s, the square of the angle random walk.
    bias_variance : float
        σ_u², rad²/s³, the square of the rate random walk.

    Returns
    -------
    tuple
        (q, P) after the interval; b does not change.
    """
    u = (h * (gyro[0] - b[0]), h * (gyro[1] - b[1]), h * (gyro[2] - b[2]))
    noise = error_state.noise(u, h, angle_variance, bias_variance)
    return quat.mul(q, quat.exp(u)), error_state.predict(P, error_state.transition(u, h), noise)


@_formula
def mekf_update(q, b, P, z, H, R):
    """Update an MEKF with a linear measurement z = H δθ + noise.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude, body to inertial.
    b : tuple of 3 float
        Gyro bias, rad/s.
    P : tuple
        Covariance (P11, P12, P22) of (δθ, δb).
    z : tuple of 3 float
        Residual.
    H : tuple of 9 float
        Matrix, row by row.
    R : tuple of 6 float
        Covariance of the noise, in the order (11, 12, 13, 22, 23, 33).

    Returns
    -------
    tuple
        (q, b, P, NIS). NIS, the normalised innovation squared, has a χ² distribution with three
        degrees of freedom if the filter is consistent and R has full rank. The function applies no
        gate: the caller keeps the previous estimate if NIS is too large.

    Notes
    -----
    The function does not rotate P to the axes of the corrected attitude, which is accurate for
    corrections far below 1 rad.
    """
    o = type(q[0])(0.0)
    p, d, nis = _by_three(_rows_of(P), (o, o, o, o, o, o), z, H, R)
    return _corrected(q, d), add(b, d[3:]), _blocks_of(p), nis


@_formula
def mekf_update_vector(q, b, P, measured, reference, variance):
    """Update an MEKF with a measured vector, such as a direction to a star or a magnetic field.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude, body to inertial.
    b : tuple of 3 float
        Gyro bias, rad/s.
    P : tuple
        Covariance (P11, P12, P22) of (δθ, δb).
    measured : tuple of 3 float
        Vector along body axes.
    reference : tuple of 3 float
        The same vector along inertial axes.
    variance : float
        Variance of each component, in the unit of the vectors squared.

    Returns
    -------
    tuple
        (q, b, P, NIS).

    Notes
    -----
    The correction depends on the angle between the expected and the measured vector, and not on the
    difference of their lengths, whose rounding would give a spurious angle next to precise
    measurements. The difference of the lengths counts in NIS. If ``measured`` or ``reference`` is
    the zero vector, the results are NaN.
    """
    q, b, p, nis, _ = by_vector(q, b, _rows_of(P), measured, reference, variance)
    return q, b, _blocks_of(p), nis


@_formula
def mekf_update_attitude(q, b, P, measured, R):
    """Update an MEKF with a measured attitude, such as that of a star tracker.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude, body to inertial.
    b : tuple of 3 float
        Gyro bias, rad/s.
    P : tuple
        Covariance (P11, P12, P22) of (δθ, δb).
    measured : tuple of 4 float
        Measured attitude, a unit quaternion, body to inertial.
    R : tuple of 6 float
        Covariance of the rotation error about body axes, rad², in the
        order (11, 12, 13, 22, 23, 33).

    Returns
    -------
    tuple
        (q, b, P, NIS).
    """
    q, b, p, nis, _ = by_attitude(q, b, _rows_of(P), measured, R)
    return q, b, _blocks_of(p), nis


def _rows_of(P: Any) -> Any:
    return _split_rows(error_state.matrix(P), 6)


def _blocks_of(rows: Any) -> Any:
    return error_state.blocks(sum(rows, ()))


def _split_rows(P: Vector, size: int) -> tuple[Vector, ...]:
    """The rows of a matrix with so many columns."""
    return tuple(P[k : k + size] for k in range(0, len(P), size))


# updates of a covariance in rows


@_formula
def by_vector(q, y, P, measured, reference, variance):
    """(q, y, P, NIS, nonlinearity); the last is at most 1 for an update that can be trusted.

    It is the larger of the total loss of attitude variance, rad², and of the normalised square of
    the last correction, relative to that of three deviations.
    """
    F = type(q[0])
    o = F(0.0)
    a = q
    size, seen = _split(measured)
    length, known = _split(reference)
    for _ in range(PASSES):
        p, d = _seen_from(a, q, P)
        n = quat.rotate_inverse(a, known)
        x, y_axis = _perpendicular(n)
        u = dot(x, seen)
        v = dot(y_axis, seen)
        sine = math.sqrt(u * u + v * v)
        # from the orthogonal components to the angle; of an opposite vector any axis is right
        arc = length * trig.atan2(sine, dot(n, seen))
        u = u / sine if sine > o else F(1.0)
        v = v / sine if sine > o else o
        p, d, n0 = _joseph(p, d, arc * u, scale(-length, y_axis), variance)
        p, d, n1 = _joseph(p, d, arc * v, scale(length, x), variance)
        a = _corrected(a, d)
    nis = n0 + n1 + (size - length) * (size - length) / variance
    lost = P[0][0] + P[1][1] + P[2][2] - (p[0][0] + p[1][1] + p[2][2])
    last = _normalised_square(p, d) / F(NEARLY_SETTLED)
    return a, _plus(y, d[3:]), p, nis, lost if lost > last else last


@_formula
def by_attitude(q, y, P, measured, R):
    """(q, y, P, NIS, 0), as ``by_vector``."""
    F = type(q[0])
    o = F(0.0)
    i = F(1.0)
    a = q
    for _ in range(PASSES):
        p, d = _seen_from(a, q, P)
        z = quat.log(quat.mul(quat.conj(a), measured))
        p, d, nis = _by_three(p, d, z, (i, o, o, o, i, o, o, o, i), R)
        a = _corrected(a, d)
    return a, _plus(y, d[3:]), p, nis, o


def _split(v: Any) -> Any:
    """The length of a vector, and its direction: NaN for the zero vector."""
    length = math.sqrt(dot(v, v))
    return length, scale(type(v[0])(1.0) / length, v)


def _plus(x: Any, y: Any) -> Any:
    return tuple(a + b for a, b in zip(x, y, strict=True))


def _joseph(P: Any, d: Any, z: Any, h: Any, r: Any) -> Any:
    """(P, d, NIS) after one number z = h·δθ + noise of variance r, with the correction d so far.

    Joseph's form, (1 − K h) P (1 − K h)ᵀ + K r Kᵀ, is positive whatever the rounding of the gain.
    """
    n = range(len(P))
    c = [dot(h, row) for row in P]
    inverse = type(r)(1.0) / (dot(h, c) + r)
    gain = [inverse * x for x in c]
    left = [[P[i][j] - gain[i] * c[j] for j in n] for i in n]
    rest = [r * gain[i] - dot(h, left[i]) for i in n]
    upper = {(i, j): left[i][j] + rest[i] * gain[j] for i in n for j in n if i <= j}
    x = z - dot(h, d)
    updated = tuple(tuple(upper[min(i, j), max(i, j)] for j in n) for i in n)
    return updated, tuple(a + x * k for a, k in zip(d, gain, strict=True)), inverse * x * x


def _by_three(P: Any, d: Any, z: Any, H: Any, R: Any) -> Any:
    """(P, d, NIS) after three numbers z = H δθ + noise of covariance R, one after the other.

    R = L D Lᵀ is factorised, so that no matrix is inverted that a precise direction makes singular.
    """
    l1, l2, l3, r1, r2 = _ldl(R)
    h1 = axpy(-l1, H[:3], H[3:6])
    h2 = axpy(-l3, h1, axpy(-l2, H[:3], H[6:]))
    z1 = z[1] - l1 * z[0]
    P, d, n0 = _joseph(P, d, z[0], H[:3], R[0])
    P, d, n1 = _joseph(P, d, z1, h1, r1)
    P, d, n2 = _joseph(P, d, z[2] - l2 * z[0] - l3 * z1, h2, r2)
    return P, d, n0 + n1 + n2


def _ldl(R: Any) -> Any:
    """(l1, l2, l3, r1, r2) of R = L D Lᵀ, L = [1 0 0; l1 1 0; l2 l3 1], D = diag(R11, r1, r2)."""
    o = type(R[0])(0.0)
    l1 = R[1] / R[0] if R[0] > o else o
    l2 = R[2] / R[0] if R[0] > o else o
    r1 = R[3] - l1 * R[1]
    m = R[4] - l1 * R[2]
    l3 = m / r1 if r1 > o else o
    return l1, l2, l3, r1, R[5] - l2 * R[2] - l3 * m


def _normalised_square(P: Any, d: Any) -> Any:
    """δθᵀ P11⁻¹ δθ, 0 along directions without variance."""
    o = type(d[0])(0.0)
    l1, l2, l3, s1, s2 = _ldl((*P[0][:3], *P[1][1:3], P[2][2]))
    x = d[1] - l1 * d[0]
    y = d[2] - l2 * d[0] - l3 * x
    first = d[0] * d[0] / P[0][0] if P[0][0] > o else o
    second = x * x / s1 if s1 > o else o
    third = y * y / s2 if s2 > o else o
    return first + second + third


def _corrected(q: Any, d: Any) -> Any:
    """q corrected by the δθ of an error (δθ, δy)."""
    return quat.renormalise(quat.mul(q, quat.exp(d[:3])))


def _seen_from(a: Any, q: Any, P: Any) -> Any:
    """(P, d): the covariance about q and the mean error (δθ, δy) of q, along the axes of a."""
    o = type(a[0])(0.0)
    r = quat.mul(quat.conj(a), q)
    c = dcm.from_quat(r)
    return _rotated(c, _rotated(c, P)), (*quat.log(r), *(o for _ in P[3:]))


def _rotated(c: Any, P: Any) -> Any:
    """P Eᵀ of a symmetric P with the rotation E, c, of δθ; applied twice it gives E P Eᵀ."""
    return tuple((*dcm.rotate(c, column[:3]), *column[3:]) for column in zip(*P, strict=True))


def _perpendicular(n: Any) -> Any:
    """Two axes orthogonal to a unit vector (Duff et al., *J. Comput. Graph. Tech.* 6 (2017) 1)."""
    F = type(n[0])
    one = F(1.0)
    s = one if n[2] >= F(0.0) else -one
    a = -one / (s + n[2])
    m = n[0] * n[1] * a
    return (one + s * n[0] * n[0] * a, s * m, -s * n[0]), (m, s + n[1] * n[1] * a, -n[1])


# points of an unscented filter

#: largest angle of a point from the estimate, rad, since errors of π are ambiguous
FARTHEST = 0.5 * math.pi


@_formula
def _sigma_points(q, y, P, axes, shared):
    """Attitudes and auxiliary states of the points, L, and their distances in columns of it.

    P = L Lᵀ, along the principal axes of the attitude's covariance, columns of a matrix. The points
    lie at the usual distance or, to move for some seconds at rates in y, at FARTHEST at most.
    """
    inverse = dcm.transpose(axes)
    rows = _rotated(inverse, _rotated(inverse, _split_rows(P, 3 + len(y))))
    sides = [
        (*dcm.rotate(axes, column[:3]), *column[3:]) for column in zip(*_lower(rows), strict=True)
    ]
    distances = [_distance(side[:3], side[3:6], *shared) for side in sides]
    turns = [tuple(k * x for x in side) for k, side in zip(distances, sides, strict=True)]
    turns += [tuple(-x for x in turn) for turn in turns]
    attitudes = q, *(quat.mul(q, quat.exp(turn[:3])) for turn in turns)
    states = y, *(_plus(y, turn[3:]) for turn in turns)
    return sum(attitudes, ()), sum(states, ()), sum(zip(*sides, strict=True), ()), tuple(distances)


@_formula
def _distance(turn, rate, usual, seconds):
    F = type(usual)
    away = math.sqrt(dot(turn, turn)) + seconds * math.sqrt(sum(x * x for x in rate))
    least = F(FARTHEST) / usual
    nearer = F(FARTHEST) / (away if away > least else least)
    return nearer if nearer < usual else usual


def _lower(P: Any) -> Any:
    """Rows of the lower triangular L of P = L Lᵀ; without variance a column is 0, below 0 NaN."""
    F, size = type(P[0][0]), len(P)
    lower = [[F(0.0)] * size for _ in range(size)]
    for k in range(size):
        column = [
            row[k] - sum(x * y for x, y in zip(of_row[:k], lower[k][:k], strict=True))
            for row, of_row in zip(P, lower, strict=True)
        ]
        factor = _inverse_root(column[k], P[k][k], F(16.0 * size * sys.float_info.epsilon))
        for i in range(k, size):
            lower[i][k] = factor * column[i]
    return lower


@_formula
def _inverse_root(x, whole, least):
    """1/√x, or 0 if x is no more than rounding of ``whole``; NaN of negative variances."""
    F = type(x)
    share = x / whole if whole > F(0.0) else x
    root = F(1.0) / math.sqrt(x)
    root = F(0.0) if share <= least else root
    return root if share >= F(NEGATIVE) else F(math.nan)


@lru_cache
def spreading(numbers: int) -> RowFunction:
    """``_sigma_points`` of filters with some auxiliary numbers, one distance and one time."""
    size = 3 + numbers
    points = 2 * size + 1
    inputs = {"q": 4, "y": numbers, "P": size**2, "axes": 9, "shared": 2}
    return RowFunction(_sigma_points, inputs, (4 * points, numbers * points, size**2, size))


# ensembles: formulas for the numbers of one filter


@_formula
def _predicted(q, b, P, gyro, shared):
    q, p = mekf_predict(q, b, error_state.blocks(P), gyro, *shared)
    return q, b, error_state.matrix(p)


def _by_vector(q: Vector, y: Vector, P: Vector, pair: Vector, shared: Vector) -> Any:
    rows = _split_rows(P, 3 + len(y))
    return _updated((q, y, rows), by_vector(q, y, rows, pair[:3], pair[3:], shared[1]), shared)


def _by_attitude(q: Vector, y: Vector, P: Vector, measured: Vector, shared: Vector) -> Any:
    rows = _split_rows(P, 3 + len(y))
    return _updated((q, y, rows), by_attitude(q, y, rows, measured, shared[1:]), shared)


def _updated(before: Any, after: Any, shared: Vector) -> Any:
    return (*_gated(before, after[:3], after[3], shared[0]), *after[3:])


@_formula
def _gated(before, after, nis, gate):
    """The updated estimate, or the previous one if NIS is above the gate or NaN."""
    return after if nis <= gate else before


_OPERATIONS: dict[str, Any] = {
    "predict": (_predicted, 3, 3, ()),
    "vector": (_by_vector, 6, 2, (None, None)),
    "attitude": (_by_attitude, 4, 7, (None, None)),
}


@lru_cache
def operation(name: str, numbers: int) -> RowFunction:
    """An operation on filters with some auxiliary numbers: q, y, P, and two results of updates.

    ``each`` are the numbers of each filter: a gyro sample, a vector and its reference, or an
    attitude; ``shared`` those of all filters: the interval and variances, or the gate and
    variances.
    """
    formula, each, shared, figures = _OPERATIONS[name]
    state = {"q": 4, "y": numbers, "P": (3 + numbers) ** 2}
    inputs = {**state, "each": each, "shared": shared}
    return RowFunction(formula, inputs, (*state.values(), *figures))
