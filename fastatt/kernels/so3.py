"""Rotation vectors: Jacobians of the exponential map, and the equation of the rotation vector.

φ is a rotation vector (rad), θ = ``|φ|``, and [φ] its cross-product matrix. Matrices are tuples of
nine numbers, row by row. Bortz, *IEEE Transactions on Aerospace and Electronic Systems* 7 (1971)
61; Chirikjian, *Stochastic Models* II (2012), §10.8.6; Iserles et al., "Lie-group methods", *Acta
Numerica* 9 (2000).
"""

import math

from fastatt._jit import kernel
from fastatt.kernels.trig import (
    cot_remainder,
    half_sinc_cos_wide,
    sin_remainder,
    sin_second_remainder,
    sincos,
)
from fastatt.kernels.vec3 import add, axpy, cross, dot, scale, sub

__all__ = [
    "axis_angle_derivative", "axis_angle_rate", "dexp", "dexpinv", "hat", "left_jacobian",
    "left_jacobian_inverse", "right_jacobian", "right_jacobian_inverse", "vee",
]  # fmt: skip


@kernel
def hat(v):
    """The matrix [v×] of the cross product.

    Parameters
    ----------
    v : tuple of 3 float
        Vector.

    Returns
    -------
    tuple of 9 float
        The matrix.
    """
    F = type(v[0])
    o = F(0.0)
    return o, -v[2], v[1], v[2], o, -v[0], -v[1], v[0], o


@kernel
def vee(a):
    """The vector of the skew-symmetric part of a matrix.

    Parameters
    ----------
    a : tuple of 9 float
        Matrix, row by row.

    Returns
    -------
    tuple of 3 float
        The vector.
    """
    F = type(a[0])
    return F(0.5) * (a[7] - a[5]), F(0.5) * (a[2] - a[6]), F(0.5) * (a[3] - a[1])


@kernel
def second_order(b, c, v):
    """The matrix 1 + b [v] + c [v]², the general isotropic function of v."""
    F = type(v[0])
    xy = c * v[0] * v[1]
    xz = c * v[0] * v[2]
    yz = c * v[1] * v[2]
    xx = c * v[0] * v[0]
    yy = c * v[1] * v[1]
    zz = c * v[2] * v[2]
    return (
        F(1.0) - (yy + zz), xy - b * v[2], xz + b * v[1],
        xy + b * v[2], F(1.0) - (xx + zz), yz - b * v[0],
        xz - b * v[1], yz + b * v[0], F(1.0) - (xx + yy),
    )  # fmt: skip


@kernel
def second_order_apply(b, c, v, x):
    """The vector x + b v×x + c v×(v×x), without the matrix."""
    p = cross(v, x)
    r = cross(v, p)
    return x[0] + b * p[0] + c * r[0], x[1] + b * p[1] + c * r[1], x[2] + b * p[2] + c * r[2]


@kernel
def jacobian_coefficients(z):
    """((1 − cos θ)/θ², (θ − sin θ)/θ³) for any θ, without cancellation.

    The relative error is at most 1e-15 (float64) for θ ≤ π.
    """
    F = type(z)
    s, c = half_sinc_cos_wide(z)
    past = z > F(math.pi * math.pi)
    near = sin_remainder(F(1.0) if past else z)
    far = (F(1.0) - F(2.0) * s * c) / (z if past else F(1.0))
    return F(2.0) * s * s, far if past else near


@kernel
def second_integral_coefficient(z):
    """(θ²/2 + cos θ − 1)/θ⁴ for any θ, without cancellation.

    It is computed as (1 + sin x/x) (x − sin x)/(8 x³) with x = θ/2. The relative error is at
    most 1e-15 (float64) for θ ≤ π.
    """
    F = type(z)
    quarter = F(0.25) * z
    s, _ = half_sinc_cos_wide(z)
    _, r = jacobian_coefficients(quarter)
    return F(0.125) * (F(1.0) + s + s) * r


@kernel
def square_integral_coefficient(z):
    """(θ³/3 − 2θ + 2 sin θ)/θ⁵ for any θ, without cancellation.

    ∫₀¹ Jr(sφ) Jr(sφ)ᵀ s² ds is 1/3 + this [φ]². The relative error is at most 1e-15 (float64).
    """
    F = type(z)
    past = z > F(math.pi * math.pi)
    near = sin_second_remainder(F(1.0) if past else z)
    _, r = jacobian_coefficients(z)
    far = (F(1.0 / 3.0) - (r + r)) / (z if past else F(1.0))
    return far if past else near + near


@kernel
def inverse_coefficient(z):
    """(1 − (θ/2) cot(θ/2))/θ² for any θ; infinite at multiples of 2π.

    The relative error is at most 1e-15 (float64) for θ ≤ π.
    """
    F = type(z)
    s, c = half_sinc_cos_wide(z)
    past = z > F(math.pi * math.pi)
    near = cot_remainder(F(1.0) if past else z)
    far = (F(1.0) - c / (s + s)) / (z if past else F(1.0))
    return far if past else near


@kernel
def right_jacobian(phi):
    """Right Jacobian Jr: exp(φ + δ) ≈ exp(φ) exp(Jr δ).

    Parameters
    ----------
    phi : tuple of 3 float
        Rotation vector φ, rad.

    Returns
    -------
    tuple of 9 float
        Jr = 1 − (1 − cos θ)/θ² [φ] + (θ − sin θ)/θ³ [φ]².
    """
    b, c = jacobian_coefficients(dot(phi, phi))
    return second_order(-b, c, phi)


@kernel
def left_jacobian(phi):
    """Left Jacobian Jl: exp(φ + δ) ≈ exp(Jl δ) exp(φ).

    Parameters
    ----------
    phi : tuple of 3 float
        Rotation vector φ, rad.

    Returns
    -------
    tuple of 9 float
        Jl = Jr(−φ) = Jrᵀ.
    """
    b, c = jacobian_coefficients(dot(phi, phi))
    return second_order(b, c, phi)


@kernel
def right_jacobian_inverse(phi):
    """Inverse of the right Jacobian; singular at θ = 2π.

    Parameters
    ----------
    phi : tuple of 3 float
        Rotation vector φ, rad.

    Returns
    -------
    tuple of 9 float
        Jr⁻¹ = 1 + ½ [φ] + (1 − (θ/2) cot(θ/2))/θ² [φ]².
    """
    F = type(phi[0])
    return second_order(F(0.5), inverse_coefficient(dot(phi, phi)), phi)


@kernel
def left_jacobian_inverse(phi):
    """Inverse of the left Jacobian; singular at θ = 2π.

    Parameters
    ----------
    phi : tuple of 3 float
        Rotation vector φ, rad.

    Returns
    -------
    tuple of 9 float
        Jl⁻¹ = 1 − ½ [φ] + (1 − (θ/2) cot(θ/2))/θ² [φ]².
    """
    F = type(phi[0])
    return second_order(F(-0.5), inverse_coefficient(dot(phi, phi)), phi)


@kernel
def dexpinv(phi, w):
    """Derivative of the rotation vector, φ̇ = Jr⁻¹ w; singular at θ = 2π.

    Parameters
    ----------
    phi : tuple of 3 float
        Rotation vector φ, rad.
    w : tuple of 3 float
        Angular velocity along body axes, rad/s.

    Returns
    -------
    tuple of 3 float
        φ̇ = w + ½ φ×w + (1 − (θ/2) cot(θ/2))/θ² φ×(φ×w), rad/s.

    Notes
    -----
    For w along inertial axes φ̇ = Jl⁻¹ w = −dexpinv(−φ, −w).

    References
    ----------
    Bortz (1971), equation 3.
    """
    F = type(w[0])
    return second_order_apply(F(0.5), inverse_coefficient(dot(phi, phi)), phi, w)


@kernel
def dexpinv_short(phi, w):
    """:func:`dexpinv` for a rotation vector of at most π, without a root.

    φ̇, rad/s; meaningless beyond π.
    """
    F = type(w[0])
    return second_order_apply(F(0.5), cot_remainder(dot(phi, phi)), phi, w)


@kernel
def dexp(phi, phidot):
    """Angular velocity of a changing rotation vector, w = Jr φ̇.

    Parameters
    ----------
    phi : tuple of 3 float
        Rotation vector φ, rad.
    phidot : tuple of 3 float
        Time derivative φ̇, rad/s.

    Returns
    -------
    tuple of 3 float
        Angular velocity along body axes, rad/s.
    """
    b, c = jacobian_coefficients(dot(phi, phi))
    return second_order_apply(-b, c, phi, phidot)


@kernel
def turned_integral(phi, f):
    """The integral ∫₀¹ exp(sφ) f ds = Jl(φ) f."""
    b, c = jacobian_coefficients(dot(phi, phi))
    return second_order_apply(b, c, phi, f)


@kernel
def turned_second_integral(phi, f):
    """The integral ∫₀¹ ∫₀ʳ exp(sφ) f ds dr.

    (½ + (θ − sin θ)/θ³ [φ] + (θ²/2 + cos θ − 1)/θ⁴ [φ]²) f.
    """
    F = type(phi[0])
    z = dot(phi, phi)
    _, b = jacobian_coefficients(z)
    g = second_order_apply(b + b, F(2.0) * second_integral_coefficient(z), phi, f)
    return scale(F(0.5), g)


@kernel
def axis_angle_rate(e, edot, phi, phidot):
    """Angular velocity of a rotation by φ about an axis e, w = e φ̇ + ė sin φ + (e×ė)(1 − cos φ).

    It is along inertial axes; for body axes change the signs of φ and of w. Lurie, *Analytical
    Mechanics* (2002), §2.12.

    Parameters
    ----------
    e : tuple of 3 float
        Axis, a unit vector.
    edot : tuple of 3 float
        Time derivative of the axis, 1/s.
    phi : float
        Angle, rad.
    phidot : float
        Time derivative of the angle, rad/s.

    Returns
    -------
    tuple of 3 float
        Angular velocity along inertial axes, rad/s.
    """
    F = type(phi)
    s, c = sincos(F(0.5) * phi)
    a = F(2.0) * s * c
    b = F(2.0) * s * s
    return add(axpy(phidot, e, scale(a, edot)), scale(b, cross(e, edot)))


@kernel
def axis_angle_derivative(e, phi, w):
    """Derivatives of axis and angle, φ̇ = e·w and ė = ½ (cot(φ/2) w⊥ − e×w).

    The inverse of :func:`axis_angle_rate`.

    Parameters
    ----------
    e : tuple of 3 float
        Axis, a unit vector.
    phi : float
        Angle, rad.
    w : tuple of 3 float
        Angular velocity along inertial axes, rad/s.

    Returns
    -------
    tuple
        (ė, φ̇), infinite at φ = 2πk.
    """
    F = type(phi)
    s, c = sincos(F(0.5) * phi)
    cot = c / s
    f = dot(e, w)
    across = sub(w, scale(f, e))
    return scale(F(0.5), sub(scale(cot, across), cross(e, w))), f
