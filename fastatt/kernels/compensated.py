"""Sums with compensation of rounding: a value with a low part, to which steps are added.

x = (x1, …, xk, e1, …, ek) represents xi + ei. Quaternions rotate by q∘(exp(u/2) − 1), whose terms
are as small as the step, with an exact u/2. Møller, *BIT* 5 (1965) 37; Knuth, *The Art of Computer
Programming* 2, §4.2.2; for integrators Hairer, McLachlan and Razakarivony, *BIT* 48 (2008) 231.
"""

import math

from fastatt._jit import kernel
from fastatt.kernels.quat import mul, mul_vector
from fastatt.kernels.trig import half_sinc_cos, half_sinc_cos_wide, sin_remainder
from fastatt.kernels.vec3 import dot, scale


@kernel
def two_sum(a, b):
    """(s, e): the rounded sum s = a + b and its exact rounding error e, for any a and b."""
    s = a + b
    c = s - a
    return s, (a - (s - c)) + (b - c)


@kernel
def add_vector(x, d):
    """x + d for a 3-vector x with its low part."""
    a, i = two_sum(x[0], d[0] + x[3])
    b, j = two_sum(x[1], d[1] + x[4])
    c, k = two_sum(x[2], d[2] + x[5])
    return a, b, c, i, j, k


@kernel
def add_quat(x, d):
    """x + d for a quaternion x with its low part, as vectors of four numbers."""
    a, i = two_sum(x[0], d[0] + x[4])
    b, j = two_sum(x[1], d[1] + x[5])
    c, k = two_sum(x[2], d[2] + x[6])
    f, l = two_sum(x[3], d[3] + x[7])  # noqa: E741
    return a, b, c, f, i, j, k, l


@kernel
def cosine_less_one(c, v):
    """cos − 1 for a unit quaternion (c, v), without cancellation."""
    F = type(c)
    near = c > F(0.0)
    return -dot(v, v) / (F(1.0) + c if near else F(1.0)) if near else c - F(1.0)


@kernel
def compose(x, r):
    """x∘r with a unit quaternion r."""
    w = cosine_less_one(r[0], r[1:])
    return add_quat(x, mul(x[:4], (w, r[1], r[2], r[3])))


@kernel
def rotate(x, u):
    """x∘exp(u/2) for a rotation vector u of any angle."""
    F = type(u[0])
    z = dot(u, u)
    past = z > F(math.pi * math.pi)
    s, c = half_sinc_cos_wide(z)
    f = F(-0.125) * z * sin_remainder(F(0.25) * (F(0.0) if past else z))
    f = s - F(0.5) if past else f
    return rotate_parts(x, u, s, c, f)


@kernel
def rotate_short(x, u):
    """``rotate`` for a rotation vector of at most π."""
    F = type(u[0])
    z = dot(u, u)
    s, c = half_sinc_cos(z)
    return rotate_parts(x, u, s, c, F(-0.125) * z * sin_remainder(F(0.25) * z))


@kernel
def rotate_parts(x, u, s, c, f):
    """x∘(c, s u). f is s − ½: s u of a small rotation is the exact u/2 plus a small term."""
    F = type(c)
    q = x[:4]
    a = mul_vector(q, scale(F(0.5), u))
    w = cosine_less_one(c, scale(s, u))
    b = mul(q, (w, f * u[0], f * u[1], f * u[2]))
    return add_quat(x, (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]))
