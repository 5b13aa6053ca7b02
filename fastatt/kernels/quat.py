"""Unit quaternions (Rodrigues-Hamilton parameters) as 4-tuples, scalar first, Hamilton product.

``q`` maps body components to inertial ones: v_i = q∘v_b∘q*. Whittaker, *Analytical Dynamics*
(1937), §9; Shuster, "A survey of attitude representations", J. Astronaut. Sci. 41 (1993).
"""

import math

from fastatt._jit import kernel
from fastatt.kernels.trig import atan2, half_sinc_cos, half_sinc_cos_wide
from fastatt.kernels.vec3 import cross


@kernel
def mul(p, q):
    """Hamilton product p∘q; of attitudes: first q, then p."""
    # what a small rotation q adds comes first: fused, each number is then rounded once at its size
    return (
        p[0] * q[0] - (p[1] * q[1] + p[2] * q[2] + p[3] * q[3]),
        p[1] * q[0] + (p[0] * q[1] + p[2] * q[3] - p[3] * q[2]),
        p[2] * q[0] + (p[0] * q[2] - p[1] * q[3] + p[3] * q[1]),
        p[3] * q[0] + (p[0] * q[3] + p[1] * q[2] - p[2] * q[1]),
    )


@kernel
def conj(q):
    """Conjugate q*; of a unit quaternion the inverse rotation."""
    return q[0], -q[1], -q[2], -q[3]


@kernel
def dot(p, q):
    """Scalar product of two quaternions as 4-vectors."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]


@kernel
def rotate(q, v):
    """v_i = q∘v∘q* of a unit q: body components v to inertial ones.

    v + 2 q0 (u×v) + 2 u×(u×v), u the vector part: 30 flops instead of two products.
    """
    F = type(q[0])
    u = (q[1], q[2], q[3])
    # twice v and not twice the product: of a vector that stays it is taken once
    t = cross(u, (F(2.0) * v[0], F(2.0) * v[1], F(2.0) * v[2]))
    c = cross(u, t)
    return v[0] + q[0] * t[0] + c[0], v[1] + q[0] * t[1] + c[1], v[2] + q[0] * t[2] + c[2]


@kernel
def rotate_inverse(q, v):
    """v_b = q*∘v∘q of a unit q: inertial components v to body ones."""
    return rotate(conj(q), v)


@kernel
def turn_first(q, c, s):
    """q∘(c, s, 0, 0): turned about body axis 1, c and s cosine and sine of half the angle."""
    return c * q[0] - s * q[1], c * q[1] + s * q[0], c * q[2] + s * q[3], c * q[3] - s * q[2]


@kernel
def turn_third(q, c, s):
    """q∘(c, 0, 0, s): turned about body axis 3, c and s cosine and sine of half the angle."""
    return c * q[0] - s * q[3], c * q[1] + s * q[2], c * q[2] - s * q[1], c * q[3] + s * q[0]


@kernel
def exp_short(u):
    """exp(u/2) for a rotation vector u of at most π rad; beyond, meaningless. See ``exp``."""
    s, c = half_sinc_cos(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    return c, s * u[0], s * u[1], s * u[2]


@kernel
def exp(u):
    """Unit quaternion of the rotation vector u (rad), any angle: (cos θ/2, sin(θ/2) u/θ), θ = |u|.

    Error at most 4e-16 as a 4-vector and in relation to the vector part (float64) for θ ≤ π;
    beyond, that of θ moved by 1.5 ulps, of length 1 to 5e-16: where an ulp exceeds 2π, some
    rotation about the right axis.
    """
    F = type(u[0])
    z = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
    # past 1e17 rad only the axis counts: any angle that keeps θ² finite will do
    f = F(1e-30) if z > F(1e34) else F(1.0)
    f = F(1e-160) if z > F(1e300) else f
    v = (f * u[0], f * u[1], f * u[2])
    s, c = half_sinc_cos_wide(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return c, s * v[0], s * v[1], s * v[2]


@kernel
def log(q):
    """Rotation vector (rad) of q, the shorter way round: 2 atan2(|v|, |q0|) v/|v| sgn q0.

    q need not be a unit quaternion. Relative error at most 1e-15 (float64) from the smallest
    number to π; at exactly π the axis keeps the sign of the vector part.
    """
    F = type(q[0])
    ax = abs(q[1])
    ay = abs(q[2])
    az = abs(q[3])
    m = ax if ax > ay else ay
    m = az if az > m else m
    m = m if m != F(0.0) else F(1.0)
    x = q[1] / m
    y = q[2] / m
    z = q[3] / m
    r = math.sqrt(x * x + y * y + z * z)
    # in relation to the largest number: m r of subnormal ones would lose its digits
    most = abs(q[0]) if abs(q[0]) > m else m
    half = atan2(m / most * r, abs(q[0]) / most)
    f = F(2.0) * half / (r if r != F(0.0) else F(1.0))
    f = -f if q[0] < F(0.0) else f
    return f * x, f * y, f * z


@kernel
def normalise(q):
    """q/|q| of any finite non-zero q, from the smallest to the largest floats; of 0, NaN.

    Error at most 4e-16 per component (float64).
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
    """q(3 − |q|²)/2: one Newton step to unit length; of |q| = 1 + e leaves 1 − 3e²/2."""
    F = type(q[0])
    f = F(1.5) - F(0.5) * dot(q, q)
    return f * q[0], f * q[1], f * q[2], f * q[3]


@kernel
def mul_vector(q, v):
    """q∘(0, v): the derivative of q at the angular velocity 2v in body axes."""
    return (
        -q[1] * v[0] - q[2] * v[1] - q[3] * v[2],
        q[0] * v[0] + q[2] * v[2] - q[3] * v[1],
        q[0] * v[1] - q[1] * v[2] + q[3] * v[0],
        q[0] * v[2] + q[1] * v[1] - q[2] * v[0],
    )


@kernel
def derivative(q, w):
    """q̇ = ½ q∘w, w the angular velocity in body axes, rad/s."""
    F = type(q[0])
    return mul_vector(q, (F(0.5) * w[0], F(0.5) * w[1], F(0.5) * w[2]))


@kernel
def derivative_inertial(q, w):
    """q̇ = ½ w∘q, w the angular velocity in inertial axes, rad/s."""
    return conj(derivative(conj(q), (-w[0], -w[1], -w[2])))


@kernel
def rate(q, qdot):
    """Angular velocity in body axes, w = 2 q*∘q̇, rad/s, of a unit q and its derivative."""
    r = mul(conj(q), qdot)
    return r[1] + r[1], r[2] + r[2], r[3] + r[3]


@kernel
def rate_inertial(q, qdot):
    """Angular velocity in inertial axes, w = 2 q̇∘q*, rad/s, of a unit q and its derivative."""
    r = mul(qdot, conj(q))
    return r[1] + r[1], r[2] + r[2], r[3] + r[3]


@kernel
def slerp(p, q, s):
    """Attitude a share s of the way from p to q along the shorter arc, both of unit length."""
    u = log(mul(conj(p), q))
    return mul(p, exp((s * u[0], s * u[1], s * u[2])))


@kernel
def angle(p, q):
    """Geodesic angle between two unit attitudes, rad in [0, π]: 4 atan2(|p ∓ q|, |p ± q|).

    Relative error at most 5e-16 (float64) from 1e-8 to π, where an arc cosine keeps half the
    digits near either end; below 1e-8, absolute error at most 1e-16, the rounding of |p| and |q|.
    """
    F = type(p[0])
    minus = (p[0] - q[0], p[1] - q[1], p[2] - q[2], p[3] - q[3])
    plus = (p[0] + q[0], p[1] + q[1], p[2] + q[2], p[3] + q[3])
    a = dot(minus, minus)
    b = dot(plus, plus)
    near = a if a < b else b
    far = b if a < b else a
    return F(4.0) * atan2(math.sqrt(near), math.sqrt(far))
