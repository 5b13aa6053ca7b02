"""Direction cosine matrices as tuples of nine numbers, row by row: v_i = C v_b.

The rows of C are the inertial axes in body components; each satisfies Poisson's equation ṙ = r×w.
Shuster, "A survey of attitude representations", *Journal of the Astronautical Sciences* 41 (1993).
"""

import math

from fastatt._jit import kernel
from fastatt.kernels import quat, so3, vec3
from fastatt.kernels.vec3 import cross, dot, rotate_axes_first, rotate_axes_third

__all__ = [
    "derivative", "derivative_row", "exp", "from_quat", "log", "mul", "norm_error",
    "orthonormalise", "rate", "rotate", "rotate_inverse", "to_quat", "transpose",
]  # fmt: skip


@kernel
def mul(a, b):
    """Matrix product a b.

    Parameters
    ----------
    a, b : tuple of 9 float
        Matrix, row by row.

    Returns
    -------
    tuple of 9 float
        The product.
    """
    columns = transpose(b)
    return rotate(columns, a[:3]) + rotate(columns, a[3:6]) + rotate(columns, a[6:])


@kernel
def add(a, b):
    """Sum a + b of two matrices."""
    return vec3.add(a[:3], b[:3]) + vec3.add(a[3:6], b[3:6]) + vec3.add(a[6:], b[6:])


@kernel
def scale(k, a):
    """Multiple k a of a matrix."""
    return k * a[0], k * a[1], k * a[2], k * a[3], k * a[4], k * a[5], k * a[6], k * a[7], k * a[8]


@kernel
def transpose(a):
    """Transpose, the inverse of a rotation.

    Parameters
    ----------
    a : tuple of 9 float
        Matrix, row by row.

    Returns
    -------
    tuple of 9 float
        The transpose.
    """
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@kernel
def rotate(c, v):
    """Rotate a vector from body axes to inertial axes, v_i = C v.

    Parameters
    ----------
    c : tuple of 9 float
        Rotation matrix, body to inertial.
    v : tuple of 3 float
        Vector along body axes.

    Returns
    -------
    tuple of 3 float
        The vector along inertial axes.
    """
    return dot(c[:3], v), dot(c[3:6], v), dot(c[6:], v)


@kernel
def rotate_inverse(c, v):
    """Rotate a vector from inertial axes to body axes, v_b = Cᵀ v.

    Parameters
    ----------
    c : tuple of 9 float
        Rotation matrix, body to inertial.
    v : tuple of 3 float
        Vector along inertial axes.

    Returns
    -------
    tuple of 3 float
        The vector along body axes.
    """
    return rotate(transpose(c), v)


@kernel
def from_quat(q):
    """Matrix of a unit quaternion.

    Parameters
    ----------
    q : tuple of 4 float
        Unit quaternion.

    Returns
    -------
    tuple of 9 float
        Rotation matrix.

    Notes
    -----
    An error e of the norm of q contributes 4e².
    """
    F = type(q[0])
    # 2/|q|² to first order, since the norm of a rounded q is the largest error of the matrix
    f = F(4.0) - F(2.0) * quat.dot(q, q)
    x = f * q[1]
    y = f * q[2]
    z = f * q[3]
    xx = x * q[1]
    yy = y * q[2]
    zz = z * q[3]
    xy = x * q[2]
    xz = x * q[3]
    yz = y * q[3]
    wx = x * q[0]
    wy = y * q[0]
    wz = z * q[0]
    return (
        F(1.0) - (yy + zz), xy - wz, xz + wy,
        xy + wz, F(1.0) - (xx + zz), yz - wx,
        xz - wy, yz + wx, F(1.0) - (xx + yy),
    )  # fmt: skip


@kernel
def to_quat(c):
    """Quaternion of a rotation matrix, by the best conditioned of Shepperd's four rows.

    Parameters
    ----------
    c : tuple of 9 float
        Rotation matrix, body to inertial.

    Returns
    -------
    tuple of 4 float
        Unit quaternion with q0 ≥ 0.

    Notes
    -----
    The error is at most 5e-16 (float64) at any angle.

    References
    ----------
    Shepperd, *Journal of Guidance and Control* 1 (1978) 223.
    """
    F = type(c[0])
    t = c[0] + c[4] + c[8]
    # rows of 4 q qᵀ
    w = (F(1.0) + t, c[7] - c[5], c[2] - c[6], c[3] - c[1])
    x = (w[1], F(1.0) + (c[0] - c[4] - c[8]), c[1] + c[3], c[2] + c[6])
    y = (w[2], x[2], F(1.0) + (c[4] - c[0] - c[8]), c[5] + c[7])
    z = (w[3], x[3], y[3], F(1.0) + (c[8] - c[0] - c[4]))
    zy = c[8] > c[4]
    p0 = z[0] if zy else y[0]
    p1 = z[1] if zy else y[1]
    p2 = z[2] if zy else y[2]
    p3 = z[3] if zy else y[3]
    top = c[8] if zy else c[4]
    wx = t > c[0]
    r0 = w[0] if wx else x[0]
    r1 = w[1] if wx else x[1]
    r2 = w[2] if wx else x[2]
    r3 = w[3] if wx else x[3]
    best = t if wx else c[0]
    second = top > best
    r0 = p0 if second else r0
    r1 = p1 if second else r1
    r2 = p2 if second else r2
    r3 = p3 if second else r3
    n = math.sqrt(r0 * r0 + r1 * r1 + r2 * r2 + r3 * r3)
    n = -n if r0 < F(0.0) else n
    return r0 / n, r1 / n, r2 / n, r3 / n


@kernel
def rotate_first(a, c, s):
    """Rotate an attitude about body axis 1."""
    F = type(c)
    C = F(1.0) - F(2.0) * s * s
    S = F(2.0) * s * c
    x, y, z = a[:3], a[3:6], a[6:]
    return rotate_axes_first(x, C, S) + rotate_axes_first(y, C, S) + rotate_axes_first(z, C, S)


@kernel
def rotate_third(a, c, s):
    """Rotate an attitude about body axis 3."""
    F = type(c)
    C = F(1.0) - F(2.0) * s * s
    S = F(2.0) * s * c
    x, y, z = a[:3], a[3:6], a[6:]
    return rotate_axes_third(x, C, S) + rotate_axes_third(y, C, S) + rotate_axes_third(z, C, S)


@kernel
def exp_short(u):
    """Matrix of a rotation vector of at most π rad.

    Beyond π the result is meaningless. See :func:`exp` for any angle and for the error.
    """
    return from_quat(quat.exp_short(u))


@kernel
def exp(u):
    """Matrix of a rotation vector of any length.

    Parameters
    ----------
    u : tuple of 3 float
        Rotation vector, rad.

    Returns
    -------
    tuple of 9 float
        Rotation matrix exp [u×].

    Notes
    -----
    The error of an element is at most 1e-15 (float64) for ``|u|`` ≤ π; beyond, see
    :func:`quat.exp`.
    """
    return from_quat(quat.exp(u))


@kernel
def log(c):
    """Rotation vector of a rotation matrix.

    Parameters
    ----------
    c : tuple of 9 float
        Rotation matrix, body to inertial.

    Returns
    -------
    tuple of 3 float
        Rotation vector, rad, of length at most π.

    Notes
    -----
    The accuracy is full also near π, since the vector is computed by :func:`to_quat`.
    """
    return quat.log(to_quat(c))


@kernel
def derivative_row(r, w):
    """Derivative of a row, ṙ = r×w: a fixed inertial direction seen from the body.

    Parameters
    ----------
    r : tuple of 3 float
        Row of C.
    w : tuple of 3 float
        Angular velocity along body axes, rad/s.

    Returns
    -------
    tuple of 3 float
        ṙ, 1/s.
    """
    return cross(r, w)


@kernel
def derivative(c, w):
    """Derivative Ċ = C [w×] (Poisson's equation).

    Parameters
    ----------
    c : tuple of 9 float
        Rotation matrix, body to inertial.
    w : tuple of 3 float
        Angular velocity along body axes, rad/s.

    Returns
    -------
    tuple of 9 float
        Ċ, 1/s.
    """
    return derivative_row(c[:3], w) + derivative_row(c[3:6], w) + derivative_row(c[6:], w)


@kernel
def rate(c, cdot):
    """Angular velocity along body axes from a derivative, [w×] = CᵀĊ.

    Parameters
    ----------
    c : tuple of 9 float
        Rotation matrix, body to inertial.
    cdot : tuple of 9 float
        Time derivative of C, 1/s.

    Returns
    -------
    tuple of 3 float
        Angular velocity, rad/s.
    """
    return so3.vee(mul(transpose(c), cdot))


@kernel
def gram(c):
    """Upper triangle of C Cᵀ.

    (11, 12, 13, 22, 23, 33).
    """
    a, b, d = c[:3], c[3:6], c[6:]
    return dot(a, a), dot(a, b), dot(a, d), dot(b, b), dot(b, d), dot(d, d)


@kernel
def norm_error(c):
    """Orthogonality error, the Frobenius norm of C Cᵀ − 1.

    Parameters
    ----------
    c : tuple of 9 float
        Matrix.

    Returns
    -------
    float
        The error.
    """
    F = type(c[0])
    g = gram(c)
    diagonal = (g[0] - F(1.0), g[3] - F(1.0), g[5] - F(1.0))
    off = (g[1], g[2], g[4])
    return math.sqrt(dot(diagonal, diagonal) + F(2.0) * dot(off, off))


@kernel
def orthonormalise(c):
    """One Newton step to the nearest rotation, (3 − C Cᵀ) C/2.

    Parameters
    ----------
    c : tuple of 9 float
        Nearly orthogonal matrix.

    Returns
    -------
    tuple of 9 float
        The matrix.

    Notes
    -----
    An orthogonality error e becomes 3e²/8.
    """
    F = type(c[0])
    g = gram(c)
    h = F(-0.5)
    d = (F(1.5) + h * g[0], h * g[1], h * g[2], F(1.5) + h * g[3], h * g[4], F(1.5) + h * g[5])
    return mul((d[0], d[1], d[2], d[1], d[3], d[4], d[2], d[4], d[5]), c)


@kernel
def close_rows(a, b):
    """Matrix of two orthonormal rows, the third being their cross product."""
    return a + b + cross(a, b)


@kernel
def orthonormalise_rows(a, b):
    """Orthonormalise two nearly orthonormal rows, to second order.

    Half of a·b is removed from each row, and the rows are scaled. Premerlani and Bizard,
    "Direction cosine matrix IMU: theory" (2009), equations 18 to 21.
    """
    F = type(a[0])
    e = F(0.5) * dot(a, b)
    p = (a[0] - e * b[0], a[1] - e * b[1], a[2] - e * b[2])
    r = (b[0] - e * a[0], b[1] - e * a[1], b[2] - e * a[2])
    f = F(1.5) - F(0.5) * dot(p, p)
    g = F(1.5) - F(0.5) * dot(r, r)
    return vec3.scale(f, p), vec3.scale(g, r)
