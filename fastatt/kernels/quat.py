"""Unit quaternions (Rodrigues-Hamilton parameters) as tuples of four numbers, scalar first.

Products are Hamilton's. ``q`` maps body components to inertial ones: v_i = q∘v_b∘q*. Whittaker,
*Analytical Dynamics* (1937), §9; Shuster, "A survey of attitude representations", *Journal of the
Astronautical Sciences* 41 (1993).
"""

import math

from fastatt._jit import kernel
from fastatt.kernels.trig import atan2, half_sinc_cos, half_sinc_cos_wide
from fastatt.kernels.vec3 import cross

__all__ = [
    "angle", "conj", "derivative", "derivative_inertial", "exp", "log", "mul", "normalise",
    "rate", "rate_inertial", "renormalise", "rotate", "rotate_inverse", "slerp",
]  # fmt: skip


@kernel
def mul(p, q):
    """Hamilton product p∘q; as rotations, first q, then p.

    Parameters
    ----------
    p, q : tuple of 4 float
        Left and right factor.

    Returns
    -------
    tuple of 4 float
        The product.
    """
    # the contribution of a small rotation q comes first: when fused, each sum is rounded once
    return (
        p[0] * q[0] - (p[1] * q[1] + p[2] * q[2] + p[3] * q[3]),
        p[1] * q[0] + (p[0] * q[1] + p[2] * q[3] - p[3] * q[2]),
        p[2] * q[0] + (p[0] * q[2] - p[1] * q[3] + p[3] * q[1]),
        p[3] * q[0] + (p[0] * q[3] + p[1] * q[2] - p[2] * q[1]),
    )


@kernel
def conj(q):
    """Conjugate q*, the inverse rotation of a unit quaternion.

    Parameters
    ----------
    q : tuple of 4 float
        Quaternion.

    Returns
    -------
    tuple of 4 float
        The conjugate.
    """
    return q[0], -q[1], -q[2], -q[3]


@kernel
def dot(p, q):
    """Scalar product of two quaternions as vectors of four numbers."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]


@kernel
def rotate(q, v):
    """Rotate a vector from body axes to inertial axes, v_i = q∘v∘q*.

    Parameters
    ----------
    q : tuple of 4 float
        Unit quaternion, body to inertial.
    v : tuple of 3 float
        Vector along body axes.

    Returns
    -------
    tuple of 3 float
        The vector along inertial axes.

    Notes
    -----
    It is computed as v + 2 q0 (u×v) + 2 u×(u×v) with the vector part u, which takes 30 operations.
    """
    F = type(q[0])
    u = (q[1], q[2], q[3])
    # twice v, not twice the product: for a constant vector it is computed once
    t = cross(u, (F(2.0) * v[0], F(2.0) * v[1], F(2.0) * v[2]))
    c = cross(u, t)
    return v[0] + q[0] * t[0] + c[0], v[1] + q[0] * t[1] + c[1], v[2] + q[0] * t[2] + c[2]


@kernel
def rotate_inverse(q, v):
    """Rotate a vector from inertial axes to body axes, v_b = q*∘v∘q.

    Parameters
    ----------
    q : tuple of 4 float
        Unit quaternion, body to inertial.
    v : tuple of 3 float
        Vector along inertial axes.

    Returns
    -------
    tuple of 3 float
        The vector along body axes.
    """
    return rotate(conj(q), v)


@kernel
def rotate_first(q, c, s):
    """Rotate an attitude about body axis 1, q∘(c, s, 0, 0)."""
    return c * q[0] - s * q[1], c * q[1] + s * q[0], c * q[2] + s * q[3], c * q[3] - s * q[2]


@kernel
def rotate_third(q, c, s):
    """Rotate an attitude about body axis 3, q∘(c, 0, 0, s)."""
    return c * q[0] - s * q[3], c * q[1] + s * q[2], c * q[2] - s * q[1], c * q[3] + s * q[0]


@kernel
def exp_short(u):
    """Quaternion of a rotation vector of at most π rad.

    Beyond π the result is meaningless. See :func:`exp` for any angle and the error.
    """
    s, c = half_sinc_cos(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    return c, s * u[0], s * u[1], s * u[2]


@kernel
def exp(u):
    """Quaternion of a rotation vector of any length.

    Parameters
    ----------
    u : tuple of 3 float
        Rotation vector, rad.

    Returns
    -------
    tuple of 4 float
        Unit quaternion (cos(θ/2), sin(θ/2) u/θ), θ = ``|u|``.

    Notes
    -----
    For θ ≤ π the error is at most 4e-16 (float64), absolute and relative to the vector part.
    Beyond, the error is that of θ moved by 1.5 ulps, and the norm is 1 to 5e-16. Where an ulp
    exceeds 2π, the result is some rotation about the right axis.
    """
    F = type(u[0])
    z = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
    # beyond 1e17 rad only the axis matters: any angle with a finite θ² is right
    f = F(1e-30) if z > F(1e34) else F(1.0)
    f = F(1e-160) if z > F(1e300) else f
    v = (f * u[0], f * u[1], f * u[2])
    s, c = half_sinc_cos_wide(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return c, s * v[0], s * v[1], s * v[2]


@kernel
def log(q):
    """Rotation vector of a quaternion, 2 atan2(``|v|``, ``|q0|``) v/``|v|`` sgn q0.

    Parameters
    ----------
    q : tuple of 4 float
        Quaternion of any norm above zero.

    Returns
    -------
    tuple of 3 float
        Rotation vector, rad, of length at most π; NaN for q = 0.

    Notes
    -----
    The relative error is at most 1e-15 (float64) from the smallest number to π. At exactly π the
    axis has the sign of the vector part v.
    """
    F = type(q[0])
    ax = abs(q[1])
    ay = abs(q[2])
    az = abs(q[3])
    m = ax if ax > ay else ay
    m = az if az > m else m
    # relative to the largest number, since m r of subnormal numbers would lose digits
    most = abs(q[0]) if abs(q[0]) > m else m
    size = m if m != F(0.0) else F(1.0)
    x = q[1] / size
    y = q[2] / size
    z = q[3] / size
    r = math.sqrt(x * x + y * y + z * z)
    half = atan2(m / most * r, abs(q[0]) / most)
    f = F(2.0) * half / (r if r != F(0.0) else F(1.0))
    f = -f if q[0] < F(0.0) else f
    return f * x, f * y, f * z


@kernel
def normalise(q):
    """Normalise a quaternion, q/``|q|``.

    Parameters
    ----------
    q : tuple of 4 float
        Finite quaternion, from the smallest to the largest floats.

    Returns
    -------
    tuple of 4 float
        Unit quaternion; NaN for q = 0.

    Notes
    -----
    The error is at most 4e-16 in each component (float64).
    """
    m = abs(q[0])
    m = abs(q[1]) if abs(q[1]) > m else m
    m = abs(q[2]) if abs(q[2]) > m else m
    m = abs(q[3]) if abs(q[3]) > m else m
    w = q[0] / m
    x = q[1] / m
    y = q[2] / m
    z = q[3] / m
    n = math.sqrt(w * w + x * x + y * y + z * z)
    return w / n, x / n, y / n, z / n


@kernel
def renormalise(q):
    """One Newton step to unit norm, q (3 − ``|q|²``)/2: a norm of 1 + e becomes 1 − 3e²/2.

    Parameters
    ----------
    q : tuple of 4 float
        Quaternion of nearly unit norm.

    Returns
    -------
    tuple of 4 float
        The quaternion.
    """
    F = type(q[0])
    f = F(1.5) - F(0.5) * dot(q, q)
    return f * q[0], f * q[1], f * q[2], f * q[3]


@kernel
def mul_vector(q, v):
    """Product q∘(0, v), the derivative of q at the angular velocity 2v along body axes."""
    return (
        -q[1] * v[0] - q[2] * v[1] - q[3] * v[2],
        q[0] * v[0] + q[2] * v[2] - q[3] * v[1],
        q[0] * v[1] - q[1] * v[2] + q[3] * v[0],
        q[0] * v[2] + q[1] * v[1] - q[2] * v[0],
    )


@kernel
def derivative(q, w):
    """Derivative q̇ = ½ q∘w.

    Parameters
    ----------
    q : tuple of 4 float
        Unit quaternion, body to inertial.
    w : tuple of 3 float
        Angular velocity along body axes, rad/s.

    Returns
    -------
    tuple of 4 float
        q̇, 1/s.
    """
    F = type(q[0])
    return mul_vector(q, (F(0.5) * w[0], F(0.5) * w[1], F(0.5) * w[2]))


@kernel
def derivative_inertial(q, w):
    """Derivative q̇ = ½ w∘q.

    Parameters
    ----------
    q : tuple of 4 float
        Unit quaternion, body to inertial.
    w : tuple of 3 float
        Angular velocity along inertial axes, rad/s.

    Returns
    -------
    tuple of 4 float
        q̇, 1/s.
    """
    return conj(derivative(conj(q), (-w[0], -w[1], -w[2])))


@kernel
def rate(q, qdot):
    """Angular velocity along body axes from a derivative, w = 2 q*∘q̇.

    Parameters
    ----------
    q : tuple of 4 float
        Unit quaternion, body to inertial.
    qdot : tuple of 4 float
        Time derivative of q, 1/s.

    Returns
    -------
    tuple of 3 float
        Angular velocity, rad/s.
    """
    r = mul(conj(q), qdot)
    return r[1] + r[1], r[2] + r[2], r[3] + r[3]


@kernel
def rate_inertial(q, qdot):
    """Angular velocity along inertial axes from a derivative, w = 2 q̇∘q*.

    Parameters
    ----------
    q : tuple of 4 float
        Unit quaternion, body to inertial.
    qdot : tuple of 4 float
        Time derivative of q, 1/s.

    Returns
    -------
    tuple of 3 float
        Angular velocity, rad/s.
    """
    r = mul(qdot, conj(q))
    return r[1] + r[1], r[2] + r[2], r[3] + r[3]


@kernel
def slerp(p, q, s):
    """Interpolate between two attitudes along the shorter arc.

    Parameters
    ----------
    p : tuple of 4 float
        Unit quaternion at s = 0.
    q : tuple of 4 float
        Unit quaternion at s = 1.
    s : float
        Share of the way from p to q.

    Returns
    -------
    tuple of 4 float
        Unit quaternion.
    """
    u = log(mul(conj(p), q))
    return mul(p, exp((s * u[0], s * u[1], s * u[2])))


@kernel
def angle(p, q):
    """Geodesic angle between two attitudes, 4 atan2(``|p ∓ q|``, ``|p ± q|``).

    Parameters
    ----------
    p, q : tuple of 4 float
        Unit quaternion.

    Returns
    -------
    float
        The angle in [0, π], rad.

    Notes
    -----
    The relative error is at most 5e-16 (float64) from 1e-8 to π, where an arc cosine would lose
    half of the digits near both ends. Below 1e-8 the absolute error is at most 1e-16, the rounding
    of the norms.
    """
    F = type(p[0])
    minus = (p[0] - q[0], p[1] - q[1], p[2] - q[2], p[3] - q[3])
    plus = (p[0] + q[0], p[1] + q[1], p[2] + q[2], p[3] + q[3])
    a = dot(minus, minus)
    b = dot(plus, plus)
    near = a if a < b else b
    far = b if a < b else a
    return F(4.0) * atan2(math.sqrt(near), math.sqrt(far))
