"""Elliptic integrals and theta functions of the free rigid body, without branches.

A modulus k is given by its complement k' = √(1 − k²), which keeps the digits that k loses near 1.
The theta functions have a doubled period, with quarter periods K and 2iK': attitude and momentum of
a free body are quotients of two of them, without an integral of the third kind (compare Klein and
Sommerfeld, *The Theory of the Top*, 1897-1910, where the Cayley-Klein parameters are such
quotients). Their series are in powers of the nome Q = exp(−2πK'/K) if K ≤ 2K', and by Jacobi's
imaginary transformation in powers of exp(−πK/2K') otherwise, at most exp(−π) = 0.043 in both cases.
Theta functions as in DLMF §20.2; sn, cn and dn as in DLMF §22.2.
"""

from __future__ import annotations

import math

import numpy as np

from fastatt._jit import kernel
from fastatt.kernels.trig import (
    LN_2_HIGH,
    LN_2_LOW,
    TWO_PI_1,
    TWO_PI_2,
    TWO_PI_3,
    atan2,
    is_odd,
    log_ratio,
    powers_of_two,
    quarter_turns,
    reduce_powers,
    short_waves,
)


@kernel
def exp_minus(x):
    """exp(−x) for 0 ≤ x ≤ 80, with a relative error of 5e-16 (float64)."""
    k, r = reduce_powers(-x)
    s, c = short_waves(r, -r * r)
    p, _ = powers_of_two(k)
    return p * (c + s)


@kernel
def waves(x, wide):
    """(sinh x, cosh x) if ``wide`` > 1/2, with ``|x|`` limited to 60, else (sin x, cos x).

    One pair of polynomials in x² or −x² serves both. The relative error of sinh and cosh is at most
    5e-16, the absolute error of sin and cos at most 1.4e-16 (float64) for ``|x|`` ≤ 1e6, as in
    ``trig.sincos``.
    """
    F = type(x)
    w = wide > F(0.5)
    most = F(60.0) if w else F(1e30)
    x = most if x > most else x
    x = -most if x < -most else x
    k = np.rint(x * (F(1.4426950408889634) if w else F(2.0 / math.pi)))
    r = x - k * (F(LN_2_HIGH) if w else F(0.25 * TWO_PI_1))
    r = r - k * (F(LN_2_LOW) if w else F(0.25 * TWO_PI_2))
    r = r if w else r - k * F(0.25 * TWO_PI_3)
    r = F(0.79) if r > F(0.79) else r
    r = F(-0.79) if r < F(-0.79) else r
    z = r * r
    s, c = short_waves(r, -z if w else z)
    up, down = powers_of_two(k if w else F(0.0))
    C, S = quarter_turns(k)
    C = F(0.5) * (up + down) if w else C
    S = F(0.5) * (up - down) if w else S
    turned = s * S
    return s * C + c * S, c * C + (turned if w else -turned)


@kernel
def landen_step(u, v, a, b, half_turns):
    """One descending Landen transformation of the integral in ``first_kind_pair``, all doubled.

    Bulirsch, "Numerical calculation of elliptic integrals", *Numerische Mathematik* 7 (1965), el1,
    without his division: u/v is a times the cotangent of the amplitude; ``half_turns`` counts its
    multiples of π.
    """
    F = type(u)
    product = u * v
    product = product if product != F(0.0) else F(1e-20)
    half_turns = half_turns + half_turns
    half_turns = half_turns + F(1.0) if product < F(0.0) else half_turns
    return u * u - (a * b) * (v * v), product, half_turns


@kernel
def ascending_step(y, b):
    """One ascending Landen transformation of a cotangent y/a, which inverts ``landen_step``."""
    return y + math.sqrt(y * y + b * b)


@kernel
def first_kind_pair(y, kc, yc, k):
    """(F(φ, k), K, F(ψ, k'), K') from y = cot φ and yc = cot ψ, 0 ≤ φ, ψ ≤ π/2.

    Both moduli are given, k' ≥ 1e-150 and k as well; smaller ones count as 1e-150, for which the
    other K is 346. The relative error is at most 8e-16 (float64) while y and yc are at most 1e17.
    The integral of the smaller modulus descends to the angle of a circle, that of the larger one
    ascends to a logarithm, both along one arithmetic-geometric mean.
    """
    F = type(y)
    swap = k < kc
    b0 = k if swap else kc
    c0 = kc if swap else k
    least = F(1e-150)
    double = least > F(0.0)
    least = least if double else F(1e-18)
    b0 = b0 if b0 > least else least
    far = yc if swap else y
    near = y if swap else yc

    # (a, c) go to their mean; b is the root of a² − c²
    a1 = F(1.0) + c0
    c1 = F(2.0) * math.sqrt(c0)
    a2 = a1 + c1
    c2 = F(2.0) * math.sqrt(a1 * c1)
    a3 = a2 + c2
    c3 = F(2.0) * math.sqrt(a2 * c2)
    a4 = a3 + c3
    # the rounding of b would be too large compared with the smallest y
    seen = b0 * b0 > (F(1e-15) if double else F(1e-7))
    b1 = F(1.0) - c0 if seen else F(0.0)
    b2 = a1 - c1 if seen else F(0.0)
    b3 = a2 - c2 if seen else F(0.0)
    inverse = F(1.0) / a4

    # ∫ dt/√((t² + a²)(t² + b²)) from y on is invariant, apart from the doubling
    most = F(1e17)
    x = far if far < most else most
    x = ascending_step(ascending_step(x, b0), b1)
    x = ascending_step(ascending_step(x, b2), b3)
    root = math.sqrt(x * x + a4 * a4)
    long = F(16.0) * inverse * log_ratio(a4 + root, x, a4, root + x)

    # the nome of the smaller modulus (DLMF 19.5.5)
    whole = F(2.0) * a1 * a2
    part = b0 * b0
    e = part / whole
    e4 = (e * e) * (e * e)
    series = F(1.0) + e4 * (F(2.0) + e4 * (F(15.0) + e4 * F(150.0)))
    part = part * series
    long_whole = F(8.0) * inverse * log_ratio(whole, part, whole - part, whole + part)

    steep = near > F(1.0)
    u = F(1.0) if steep else near
    v = F(1.0) / near if steep else F(1.0)
    u, v, half_turns = landen_step(u, v, F(1.0), c0, F(0.0))
    u, v, half_turns = landen_step(u, v, a1, c1, half_turns)
    u, v, half_turns = landen_step(u, v, a2, c2, half_turns)
    u, v, half_turns = landen_step(u, v, a3, c3, half_turns)
    angle = atan2(a4 * abs(v), -u if v < F(0.0) else u)
    short = (angle + F(math.pi) * half_turns) * inverse
    short_whole = F(8.0 * math.pi) * inverse
    return (
        short if swap else long,
        short_whole if swap else long_whole,
        long if swap else short,
        long_whole if swap else short_whole,
    )


@kernel
def cosine_sum(w0, w1, w2, w3):
    """Σ wₙ cos (2n+1)v / cos v, n = 0 to 3, as a polynomial in cos 2v, constant term first.

    It serves hyperbolic cosines too.
    """
    F = type(w0)
    return (w0 - w1 - w2 + w3, F(2.0) * (w1 - w2) - F(4.0) * w3, F(4.0) * (w2 - w3), F(8.0) * w3)


@kernel
def sine_sum(w0, w1, w2, w3):
    """Σ wₙ sin (2n+1)v / sin v, n = 0 to 3, as a polynomial in cos 2v, constant term first.

    It serves hyperbolic sines too.
    """
    F = type(w0)
    return (w0 + w1 - w2 - w3, F(2.0) * (w1 + w2) - F(4.0) * w3, F(4.0) * (w2 + w3), F(8.0) * w3)


@kernel
def cubic(p, x):
    """p0 + p1 x + p2 x² + p3 x³."""
    return ((p[3] * x + p[2]) * x + p[1]) * x + p[0]


@kernel
def limited(Kc):
    """K', limited to 44, beyond which K − π/2 is below 1e-37."""
    F = type(Kc)
    return F(44.0) if Kc > F(44.0) else Kc


@kernel
def theta_terms(K, Kc, c):
    """Series of theta functions at π(u − ic)/2K, 0 ≤ c ≤ 2K', and the definition of their argument.

    Cubics, each with a real and an imaginary part: of θ1; of the cosine series of odd multiples; of
    that of even multiples. If K > 2K' they are hyperbolic: the second is then that of θ4 and the
    third that of θ2, otherwise the reverse. Then: units of the argument per u; the period (2K in u)
    and its inverse, which is 0 if K > 300 counts as infinite (float32: 40); the phase per unit of
    the argument within a period; 1 for hyperbolic series, 0 for trigonometric ones; their nome. K'
    is one of ``limited``.
    """
    F = type(K)
    wide = F(2.0) * Kc < K
    side = F(-1.0) if wide else F(1.0)
    unit = F(0.5 * math.pi) / (F(2.0) * Kc if wide else K)
    # the nome of the series: the fourth power of e, or e
    x = (F(2.0) * K if wide else Kc) * unit
    e = exp_minus(x if x < F(80.0) else F(80.0))
    nome = e if wide else (e * e) * (e * e)
    # cos (2n+1)γ and sin (2n+1)γ, or cosh and sinh of (2n+1)γ over cosh γ, from those of 2γ; the
    # powers of the nome are multiplied where they keep the products in range
    gamma = c * unit
    S, C = waves(gamma, side)
    d = F(2.0) * nome * (F(1.0) + F(2.0) * side * S * S)
    double_sine = F(4.0) * nome * (S * C)
    c0 = C if wide else F(1.0)
    s0 = S if wide else S / C
    q1 = nome * nome
    q2 = q1 * q1
    q3 = q2 * q2 * nome
    even = d * d - q1
    cubed = d * (even - q1)
    c1 = c0 * nome * (d - nome)
    s1 = s0 * nome * (d + nome)
    c2 = c0 * q2 * (even - nome * d)
    s2 = s0 * q2 * (even + nome * d)
    c3 = c0 * q3 * (cubed - nome * even)
    s3 = s0 * q3 * (cubed + nome * even)
    odd_real = sine_sum(c0, -c1, c2, -c3)
    odd_imaginary = cosine_sum(-s0, s1, -s2, s3)
    real = cosine_sum(c0, c1, c2, c3)
    imaginary = sine_sum(side * s0, side * s1, side * s2, side * s3)
    # cos 2nv, n = 0 to 3
    a2 = q1 * (d * d - F(2.0) * q1)
    a3 = -q1 * q2 * d * (d * d - F(3.0) * q1)
    b1 = -side * double_sine
    b2 = side * q1 * d * double_sine
    b3 = -side * q1 * q2 * even * double_sine
    infinite = (F(300.0) if F(1e-150) > F(0.0) else F(40.0)) < K
    period = x if wide else F(math.pi)
    inverse = F(1.0) / period if wide else F(0.0)
    inverse = F(0.0) if infinite else inverse
    return (
        odd_real + odd_imaginary,
        real + imaginary,
        (
            F(1.0) - a2, -d - F(3.0) * a3, F(2.0) * a2, F(4.0) * a3,
            F(2.0) * (b1 - b3), F(4.0) * b2, F(8.0) * b3, F(0.0),
        ),
        (unit, period, inverse, F(2.0) * gamma * inverse, F(1.0) if wide else F(0.0), nome),
    )  # fmt: skip


@kernel
def select(first, a, b):
    """a if ``first`` > 0, else b, for tuples of eight."""
    F = type(first)
    s = first > F(0.0)
    return (
        a[0] if s else b[0], a[1] if s else b[1], a[2] if s else b[2], a[3] if s else b[3],
        a[4] if s else b[4], a[5] if s else b[5], a[6] if s else b[6], a[7] if s else b[7],
    )  # fmt: skip


@kernel
def weighted(p, size, side):
    """A series or its conjugate (side −1), times ``size``."""
    other = side * size
    return (
        size * p[0], size * p[1], size * p[2], size * p[3],
        other * p[4], other * p[5], other * p[6], other * p[7],
    )  # fmt: skip


@kernel
def theta_pair(K, Kc, c):
    """Constants of ``theta_pair_at`` for quarter periods K and K' and a parameter 0 ≤ c ≤ K'.

    These are the cubics of θ4 and θ1, and the argument, of ``theta_terms``.
    """
    Kc = limited(Kc)
    odd, cosines, evens, argument = theta_terms(K, Kc, c if c < Kc else Kc)
    return select(argument[4], cosines, evens) + odd + argument[0:5]


@kernel
def theta_argument(a, s):
    """(1 or −1 for an even or odd number of periods, the rest r, S, C, x) of the argument s.

    ``a`` defines the argument as in ``theta_terms``. The series are in the sine and cosine of r, or
    the hyperbolic ones, S and C, and in that cosine of 2r, x.
    """
    F = type(s)
    n = np.rint(s * a[2])
    r = s - n * a[1]
    # for a longer period the quotients have reached their limits (in float32 earlier)
    far = F(40.0) if F(1e-150) > F(0.0) else F(20.0)
    half = F(0.5) * a[1] if a[2] > F(0.0) else far
    far = half if half < far else far
    wide = a[4] > F(0.5)
    far = far if wide else F(1e30)
    x = far if r > far else r
    x = -far if r < -far else x
    S, C = waves(x, a[4])
    x = F(2.0) * S * S
    return F(1.0) - F(2.0) * is_odd(n), r, S, C, (F(1.0) + x if wide else F(1.0) - x)


@kernel
def theta_pair_at(g, s):
    """(Re A, Im A, Re B, Im B, χ): A and B with the common phase exp(iχ), at the argument s.

    exp(iχ) A and exp(iχ) B are θ4(z) and θ1(z), z = π(u − ic)/2K, with the nome exp(−2πK'/K), up to
    a common positive factor that depends on u and one of each that depends on c. ``g`` are the
    constants of ``theta_pair``; s is u in their units.
    """
    flip, r, S, C, x = theta_argument(g[16:21], s)
    F = type(s)
    wide = g[20] > F(0.5)
    ar = cubic(g[0:4], x) * (C if wide else F(1.0))
    ai = cubic(g[4:8], x) * (S if wide else S * C)
    S = S * flip
    C = C * flip
    return ar, ai, cubic(g[8:12], x) * S, cubic(g[12:16], x) * C, g[19] * r
