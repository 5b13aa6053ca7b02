"""Elliptic integrals and theta functions of the free rigid body, as straight-line code.

A modulus k is given as its complement k' = √(1 − k²), which near k = 1 keeps what k has lost. The
theta functions are those of a doubled period, quarter periods K and 2iK': a free body's attitude
and momentum are quotients of two of them, without an integral of the third kind (compare Klein and
Sommerfeld, *The Theory of the Top*, 1897-1910, where the Cayley-Klein parameters are such
quotients). Their series run in powers of the nome Q = exp(−2πK'/K) where K ≤ 2K', and by Jacobi's
imaginary transformation in powers of exp(−πK/2K') elsewhere: at most exp(−π) = 0.043 on either
side. Theta functions as in DLMF §20.2; sn, cn, dn as in DLMF §22.2.
"""

from __future__ import annotations

import math

import numpy as np

from fastatt._jit import kernel
from fastatt.kernels.trig import atan2, is_odd, power_of_two, reduce_powers, sincos, sinhcosh_short


@kernel
def sinhcosh(x):
    """(sinh x, cosh x) for |x| ≤ 88, beyond which x counts as ±88.

    Relative error at most 5e-16 of either (float64).
    """
    F = type(x)
    x = F(88.0) if x > F(88.0) else x
    x = F(-88.0) if x < F(-88.0) else x
    k, r = reduce_powers(x)
    s, c = sinhcosh_short(r)
    p = power_of_two(abs(k))
    up = F(0.5) * p
    down = F(0.5) / p
    sh = up - down
    sh = -sh if k < F(0.0) else sh
    ch = up + down
    return s * ch + c * sh, c * ch + s * sh


@kernel
def landen_step(y, a, b, turns):
    """One descending Landen transformation of the integral ``first_kind``, all doubled.

    Bulirsch, "Numerical calculation of elliptic integrals", Numer. Math. 7 (1965), el1; ``turns``
    counts the half turns of the amplitude, whose cotangent is y/a.
    """
    F = type(y)
    p = a * b
    turns = turns + turns
    turns = turns + F(1.0) if y < F(0.0) else turns
    y = y if y != F(0.0) else F(1e-20) * p
    return y - p / y, a + b, F(2.0) * math.sqrt(p), turns


@kernel
def landen_steps(y, a, b, turns):
    """Four of ``landen_step``."""
    y, a, b, turns = landen_step(y, a, b, turns)
    y, a, b, turns = landen_step(y, a, b, turns)
    y, a, b, turns = landen_step(y, a, b, turns)
    return landen_step(y, a, b, turns)


@kernel
def first_kind(y, kc):
    """(F(φ, k), K(k)) of y = cot φ ≥ 0, 0 ≤ φ ≤ π/2, and the complementary modulus k' ≤ 1.

    Relative error at most 8e-16 (float64) for k' ≥ 1e-150; less counts as 1e-150, where K is 346.
    """
    F = type(y)
    low = F(1e-150)
    low = low if low > F(0.0) else F(1e-18)
    y, a, b, turns = landen_steps(y, F(1.0), kc if kc > low else low, F(0.0))
    y, a, b, turns = landen_steps(y, a, b, turns)
    y, a, b, turns = landen_steps(y, a, b, turns)
    return (atan2(a, y) + F(math.pi) * turns) / a, F(2048.0 * math.pi) / a


@kernel
def first_kind_short(y, kc):
    """``first_kind`` for k' ≥ 0.7."""
    F = type(y)
    y, a, _, turns = landen_steps(y, F(1.0), kc, F(0.0))
    return (atan2(a, y) + F(math.pi) * turns) / a, F(8.0 * math.pi) / a


@kernel
def first_kind_pair(y, kc, yc, k):
    """(F(φ, k), K, F(ψ, k'), K') of y = cot φ and yc = cot ψ: one of the two series is short.

    Ranges and errors are those of ``first_kind``, for k' and k.
    """
    swap = k < kc
    long, whole = first_kind(yc if swap else y, k if swap else kc)
    short, part = first_kind_short(y if swap else yc, kc if swap else k)
    return (
        short if swap else long,
        part if swap else whole,
        long if swap else short,
        whole if swap else part,
    )


@kernel
def cosine_sum(w0, w1, w2, w3):
    """Σ wₙ cos (2n+1)v / cos v, n = 0 to 3, as a polynomial in cos 2v, constant term first.

    The same serves for hyperbolic cosines.
    """
    F = type(w0)
    return (
        w0 - w1 - w2 + w3,
        F(2.0) * (w1 - w2) - F(4.0) * w3,
        F(4.0) * (w2 - w3),
        F(8.0) * w3,
    )


@kernel
def sine_sum(w0, w1, w2, w3):
    """Σ wₙ sin (2n+1)v / sin v, n = 0 to 3, as a polynomial in cos 2v, constant term first.

    The same serves for hyperbolic sines.
    """
    F = type(w0)
    return (
        w0 + w1 - w2 - w3,
        F(2.0) * (w1 + w2) - F(4.0) * w3,
        F(4.0) * (w2 + w3),
        F(8.0) * w3,
    )


@kernel
def cubic(p, x):
    """p0 + p1 x + p2 x² + p3 x³."""
    return ((p[3] * x + p[2]) * x + p[1]) * x + p[0]


@kernel
def theta_pair(K, Kc, c):
    """Constants of ``theta_pair_at`` for quarter periods K, K' and a parameter 0 ≤ c ≤ K'.

    Four cubics (even real, even imaginary, odd real, odd imaginary part), then: units of the
    argument per u, the period (of u it is 2K) and its inverse, 0 where K > 300 counts as infinite
    (float32: 40); the phase per unit of argument within a period; 1 for the hyperbolic series, 0
    for the trigonometric one. K' more than 48 counts as 48, where K − π/2 is below 1e-39 (float32:
    14, 1e-11; exp(6K') is a number there).
    """
    F = type(K)
    most = F(48.0) if F(1e-150) > F(0.0) else F(14.0)
    Kc = most if Kc > most else Kc
    c = c if c < Kc else Kc
    wide = F(2.0) * Kc < K
    # the nome of the series: the fourth power of e, or e
    x = F(0.5 * math.pi) * (K / Kc if wide else Kc / K)
    x = x if x < F(80.0) else F(80.0)
    sh, ch = sinhcosh(x)
    e = F(1.0) / (sh + ch)
    nome = e if wide else (e * e) * (e * e)
    q1 = nome * nome
    q2 = q1 * q1 * q1
    q3 = q2 * q2
    # cos (2n+1)γ and sin (2n+1)γ, or cosh and sinh of (2n+1)γ over cosh γ, from those of 2γ
    gamma = F(0.5 * math.pi) * c / (F(2.0) * Kc if wide else K)
    sc, cc = sincos(gamma)
    sh, ch = sinhcosh(gamma)
    double = F(1.0) - F(2.0) * sc * sc if wide else F(1.0) + F(2.0) * sh * sh
    double_sine = F(2.0) * sh * ch
    c0 = cc if wide else F(1.0)
    s0 = sc if wide else sh / ch
    even = F(4.0) * double * double - F(1.0)
    odd = F(2.0) * double
    c1 = c0 * q1 * (odd - F(1.0))
    s1 = s0 * q1 * (odd + F(1.0))
    c2 = c0 * q2 * (even - odd)
    s2 = s0 * q2 * (even + odd)
    cubed = F(2.0) * double * even - odd
    c3 = c0 * q3 * (cubed - even)
    s3 = s0 * q3 * (cubed + even)
    odd_real = sine_sum(c0, -c1, c2, -c3)
    odd_imaginary = cosine_sum(-s0, s1, -s2, s3)
    even_real = cosine_sum(c0, c1, c2, c3)
    even_imaginary = sine_sum(-s0, -s1, -s2, -s3)
    # the even series of the other kind: cos 2nv, n = 0 to 3
    w1 = F(-2.0) * nome
    w2 = F(2.0) * q1 * q1
    w3 = F(-2.0) * q1 * q2 * nome
    a1 = w1 * double
    a2 = w2 * (F(2.0) * double * double - F(1.0))
    a3 = w3 * double * (even - F(2.0))
    b1 = w1 * double_sine
    b2 = w2 * double_sine * odd
    b3 = w3 * double_sine * even
    infinite = (F(300.0) if F(1e-150) > F(0.0) else F(40.0)) < K
    period = F(0.5 * math.pi) * K / Kc if wide else F(math.pi)
    inverse = F(1.0) / period if wide else F(0.0)
    return (
        even_real[0] if wide else F(1.0) - a2,
        even_real[1] if wide else a1 - F(3.0) * a3,
        even_real[2] if wide else F(2.0) * a2,
        even_real[3] if wide else F(4.0) * a3,
        even_imaginary[0] if wide else F(2.0) * (b1 - b3),
        even_imaginary[1] if wide else F(4.0) * b2,
        even_imaginary[2] if wide else F(8.0) * b3,
        even_imaginary[3] if wide else F(0.0),
        odd_real[0],
        odd_real[1],
        odd_real[2],
        odd_real[3],
        odd_imaginary[0],
        odd_imaginary[1],
        odd_imaginary[2],
        odd_imaginary[3],
        F(0.5 * math.pi) / (F(2.0) * Kc if wide else K),
        period,
        F(0.0) if infinite else inverse,
        F(0.0) if infinite else (c / K if wide else F(0.0)),
        F(1.0) if wide else F(0.0),
    )


@kernel
def theta_pair_at(g, s):
    """(Re A, Im A, Re B, Im B, χ): a common phase exp(iχ) times A and B, at the argument s.

    exp(iχ) A and exp(iχ) B are θ4(z) and θ1(z), z = π(u − ic)/2K, of the nome exp(−2πK'/K), up to
    a positive factor of both that depends on u and one of each that depends on c. ``g`` are the
    constants of ``theta_pair``; s is u in their units.
    """
    F = type(s)
    n = np.rint(s * g[18])
    r = s - n * g[17]
    sine, cosine = sincos(r)
    # where the period is longer, A and B have met their limits (in float32 sooner)
    far = F(40.0) if F(1e-150) > F(0.0) else F(10.0)
    x = far if r > far else r
    x = -far if r < -far else x
    sh, ch = sinhcosh(x)
    wide = g[20] > F(0.5)
    S = sh if wide else sine
    C = ch if wide else cosine
    x = F(2.0) * S * S
    x = F(1.0) + x if wide else F(1.0) - x
    ar = cubic(g[0:4], x) * (C if wide else F(1.0))
    ai = cubic(g[4:8], x) * (S if wide else S * C)
    flip = F(1.0) - F(2.0) * is_odd(n)
    S = S * flip
    C = C * flip
    return ar, ai, cubic(g[8:12], x) * S, cubic(g[12:16], x) * C, g[19] * r


@kernel
def jacobi(u, kc):
    """(sn, cn, dn)(u, k) of the complementary modulus 0 ≤ k' ≤ 1, any real u.

    The theta pair of c = K', whose quotient has modulus 1: exp(i am u). Absolute error at most
    1e-15 + 3e-16 |u| (float64).
    """
    F = type(u)
    k = math.sqrt((F(1.0) - kc) * (F(1.0) + kc))
    _, K, _, Kc = first_kind_pair(F(0.0), kc, F(0.0), k)
    g = theta_pair(K, Kc, Kc)
    ar, ai, br, bi, _ = theta_pair_at(g, g[16] * u)
    cn = br * ai - bi * ar
    sn = br * ar + bi * ai
    size = math.sqrt(cn * cn + sn * sn)
    cn = cn / size
    return sn / size, cn, math.sqrt(kc * kc + k * k * cn * cn)
