"""The heavy symmetric top in closed form: constants once, then attitude and w at any t.

Lagrange's top as Klein and Sommerfeld, *The Theory of the Top* (1897-1910), solve it: each of its
Cayley-Klein parameters is one quotient of theta functions. On axes whose third is that of symmetry
(moments A, A, C), with the inertial third axis along the pull and the cosine z between them,

    z = z1 + (z2 − z1) sn²(u, k),    u = u0 + ½ √(β (z3 − z1)) t,    β = 2 |pull|/A,
    q0 + i q3 = P ~ exp(i λ t) θ1(π(u − ic)/2K),    q1 + i q2 = Q ~ exp(i μ t) θ2(π(u − id)/2K),

both divided by θ4(πu/2K), which cancels when ``|P|² + |Q|²`` = 1 is restored. z1 ≤ z2 ≤ 1 ≤ z3 are
the roots of the cubic ż²(z); c and d are where 1 + z and 1 − z vanish.
"""

from __future__ import annotations

import math

from fastatt._jit import kernel
from fastatt.kernels import quat, vec3
from fastatt.kernels.elliptic import (
    cubic,
    first_kind_pair,
    limited,
    select,
    theta_argument,
    theta_terms,
    weighted,
)
from fastatt.kernels.free_body import scale, scaled
from fastatt.kernels.trig import atan2, sincos

# complex numbers (real, imaginary)


@kernel
def times(a, b):
    """a b."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


@kernel
def times_conj(a, b):
    """a b*."""
    return a[0] * b[0] + a[1] * b[1], a[1] * b[0] - a[0] * b[1]


@kernel
def direction(a):
    """a/``|a|``; 1 for a = 0."""
    F = type(a[0])
    square = a[0] * a[0] + a[1] * a[1]
    none = square == F(0.0)
    n = F(1.0) / math.sqrt(F(1.0) if none else square)
    return F(1.0) if none else n * a[0], n * a[1]


@kernel
def seen(a):
    """a, or 0 if ``|a|²`` is below 1e-290 (float32: 1e-30)."""
    F = type(a[0])
    least = F(1e-290)
    least = least if least > F(0.0) else F(1e-30)
    none = a[0] * a[0] + a[1] * a[1] < least
    return F(0.0) if none else a[0], F(0.0) if none else a[1]


@kernel
def slope(p, x):
    """The derivative of ``cubic``."""
    F = type(x)
    return (F(3.0) * p[3] * x + F(2.0) * p[2]) * x + p[1]


@kernel
def upright(v):
    """A quaternion that rotates the third axis to a vector v; the identity for v = 0."""
    F = type(v[0])
    (x, y, z), unit = scaled(v)
    size = math.sqrt(x * x + y * y + z * z)
    none = size == F(0.0)
    far = size + abs(z)
    far = F(1.0) if none else far
    n = F(1.0) / math.sqrt(far * far + x * x + y * y)
    far = n * far
    x = n * x
    y = n * y
    down = z < F(0.0)
    turn = (-y if down else far, far if down else -y, F(0.0) if down else x, x if down else F(0.0))
    return turn, size * unit


@kernel
def roots(x0, y0, v, a, beta, S, plus, minus):
    """(z0 − z1, z2 − z0, 1 + z1, 1 + z2, 1 − z1, 1 − z2, β(z3 − 1)) of the cubic ż²(z).

    1 ± z0 are x0 and y0, v = w1² + w2², S = (b − a z0, ż), and plus and minus are b + a and b − a.
    Small numbers are computed from small numbers: two roots close to z0 from a quadratic about z0,
    those close to ±1 from the products of all three.
    """
    F = type(v)
    zero = F(0.0)
    z0 = F(0.5) * (x0 - y0)
    square = S[1] * S[1]
    # in κ = β (z − z0): κ³ − f2 κ² + β f1 κ + β² ż²
    f1 = F(2.0) * (a * S[0] - z0 * v) - beta * x0 * y0
    f2 = v + a * a - F(2.0) * beta * z0
    m = f2 / F(3.0)
    n = F(0.5) * (beta * (f1 * m + beta * square))
    h2 = m * m - beta * f1 / F(3.0)
    h2 = h2 if h2 > zero else zero
    h = math.sqrt(h2)
    r = m * m * m - n
    sine = h2 * h2 * h2 - r * r
    angle = atan2(math.sqrt(sine if sine > zero else zero), r) / F(3.0)
    s, c = sincos(angle)
    high = m + F(2.0) * h * c
    # z1 and z2 closer to each other than z2 and z3: from a quadratic; else z1 is simple
    close = s < F(0.5)
    some = high > zero
    N = square / (high if some else F(1.0))
    m1 = (f1 + beta * N) / (high if some else F(1.0))
    big = F(0.5) * (abs(m1) + math.sqrt(m1 * m1 + F(4.0) * N))
    small = N / (big if big > zero else F(1.0))
    low = small if m1 > zero else big
    up = big if m1 > zero else small
    simple = h * (c + F(1.7320508075688772) * s) - m
    simple = (simple if simple > zero else zero) / (F(1.0) if close else beta)
    low = low if close else simple
    # product and difference of β(z3 − 1) and 1 − z2, β times, in numbers that are small with them
    y1 = y0 + low
    inverse = F(1.0) / (y1 if y1 > zero else F(1.0))
    product = inverse * minus * minus
    half = inverse * (v - beta * y0 - a * minus - F(0.5) * product)
    larger = abs(half) + math.sqrt(half * half + beta * product)
    other = product / (larger if larger > zero else F(1.0))
    ahead = half > zero
    excess = larger if ahead else beta * other
    y2 = other if ahead else larger / (beta if beta > zero else F(1.0))
    # the root far from z0; the other follows from their product
    rest = y0 - y2
    rest = rest if rest > zero else zero
    third = excess + beta * y0
    N = square / (third if third > zero else F(1.0))
    nearer = low > rest
    other = low if nearer else rest
    other = N / (other if other > zero else F(1.0))
    up = up if close else (other if nearer else rest)
    low = low if close else (low if nearer else other)
    x2 = x0 + up
    total = x2 * (excess + F(2.0) * beta)
    x1 = plus * plus / total if total > zero else x0
    return low, up, x1, x2, y0 + low, y2, excess


@kernel
def ratio(a, b):
    """√(a/b) for a, b ≥ 0; 1 if b is 0."""
    F = type(a)
    none = b == F(0.0)
    return F(1.0) if none else math.sqrt(a / (F(1.0) if none else b))


@kernel
def middle(series):
    """Size of a series of cosines at 0, and the rate of its phase there."""
    F = type(series[0])
    size = cubic(series[0:4], F(1.0))
    return size, cubic(series[4:8], F(1.0)) / size


@kernel
def parts(g, pace, t):
    """(P, Q, W): the attitude P + Q i and w1 + i w2, up to constant factors; see ``evaluate``.

    ``g`` are the cubics of P and of Q and their argument: as in ``theta_terms`` for P, then the
    phase per unit of the argument for Q. ``pace`` are λ, μ, the rate and the start of the argument,
    and the rate of the common phase of P and Q.
    """
    F = type(t)
    p = g[0:8]
    q = g[8:16]
    rate = pace[2]
    flip, r, S, C, x = theta_argument(g[16:21], pace[3] + rate * t)
    wide = g[20] > F(0.5)
    side = F(1.0) if wide else F(-1.0)
    up = F(2.0) * (x + F(1.0))
    down = F(2.0) * (x - F(1.0))

    # P: odd series. Q: series of cosines of odd multiples or, if hyperbolic, of even multiples
    a = cubic(p[0:4], x)
    b = cubic(p[4:8], x)
    P = (S * a, C * b)
    dP = (C * (a + down * slope(p[0:4], x)), side * S * (b + up * slope(p[4:8], x)))
    a = cubic(q[0:4], x)
    b = cubic(q[4:8], x)
    da = slope(q[0:4], x)
    db = slope(q[4:8], x)
    Q = (a if wide else C * a, S * C * b if wide else S * b)
    dQ = (
        F(4.0) * S * C * da if wide else -S * (a + up * da),
        x * b + (x * x - F(1.0)) * db if wide else C * (b + down * db),
    )

    # W = 2 (P* dQ/dt − Q dP*/dt)
    turning = pace[4]
    product = times_conj(Q, P)
    one = times_conj(dQ, P)
    two = times_conj(Q, dP)
    W = (
        rate * (one[0] - two[0]) - turning * product[1],
        rate * (one[1] - two[1]) + turning * product[0],
    )
    square = (P[0] * P[0] + P[1] * P[1]) + (Q[0] * Q[0] + Q[1] * Q[1])
    n = flip / math.sqrt(square)
    s1, c1 = sincos(pace[0] * t + g[19] * r)
    s2, c2 = sincos(pace[1] * t + g[21] * r)
    P = times((n * c1, n * s1), P)
    Q = times((n * c2, n * s2), Q)
    n = F(2.0) / square
    return P, Q, times(times_conj((n * c2, n * s2), (c1, s1)), W)


@kernel
def series(r, beta, plus, minus):
    """(cubics of P, of Q, argument, (its rate, |its start|), phase rates) of the motion.

    The motion is between ``roots`` r. The argument is that of ``parts``; phase rates are phases per
    unit of it, for P at z = z2 and for Q at z = z1.
    """
    F = type(beta)
    zero = F(0.0)
    one = F(1.0)
    half = F(0.5)
    low, high, x1, x2, y1, y2, excess = r
    span = low + high
    speed = excess + beta * y1
    whole = speed if speed > zero else one
    k = math.sqrt(beta * span / whole)
    kc = math.sqrt((excess + beta * y2) / whole) if speed > zero else one
    k = k if k < one else one
    kc = kc if kc < one else one
    cot = ratio(high, low)
    u, K, c, Kc = first_kind_pair(cot, kc, ratio(span, x1), k)
    _, _, d, _ = first_kind_pair(cot, kc, ratio(span * excess, y2 * whole), k)
    u = zero if low == zero else u
    c = zero if x1 == zero else c
    d = zero if y2 == zero else d
    Kc = limited(half * Kc)
    most = F(2.0) * Kc
    odd, cosines, evens, p = theta_terms(K, Kc, c if c < most else most)
    size_p, turn_p = middle(select(p[4], evens, cosines))
    _, cosines, evens, q = theta_terms(K, Kc, d if d < most else most)
    even = select(p[4], evens, cosines)
    size_q, turn_q = middle(even)

    # 1 + z2 = 2 |P|² at u = K, 1 − z1 = 2 |Q|² at 0, with θ4 in the ratio θ3 : θ4 of a nome
    e = p[5]
    e2 = e * e
    e4 = e2 * e2
    e9 = e4 * e4 * e
    third = one + F(2.0) * (e + e4 + e9)
    fourth = one + e2 + e4 * e2 if p[4] > zero else one - F(2.0) * (e - e4 + e9)
    side_p = -one if plus < zero else one
    side_q = -one if minus < zero else one
    return (
        weighted(odd, math.sqrt(x2) * third / size_p, side_p),
        weighted(even, math.sqrt(y1) * fourth / size_q, side_q),
        (p[0], p[1], p[2], side_p * p[3], p[4], side_q * q[3]),
        (half * math.sqrt(speed) * p[0], u * p[0]),
        (side_p * (p[3] + turn_p), side_q * (q[3] + turn_q)),
    )


@kernel
def matched(P0, Q0, W0, P, Q, W):
    """(α, β) of modulus 1 such that P0 = αP, Q0 = βQ and W0 = α*βW for the same attitude.

    The larger of P and Q determines its factor, the other one also depends on W.
    """
    start = times_conj(Q0, P0)
    now = times_conj(Q, P)
    x = times_conj(start, now)
    y = times_conj(W0, W)
    between = direction((x[0] + y[0], x[1] + y[1]))
    larger = P0[0] * P0[0] + P0[1] * P0[1] > Q0[0] * Q0[0] + Q0[1] * Q0[1]
    x = times_conj(P0, P)
    y = times_conj(Q0, Q)
    main = direction((x[0] if larger else y[0], x[1] if larger else y[1]))
    ahead = times(main, between)
    back = times_conj(main, between)
    return (
        (main[0] if larger else back[0], main[1] if larger else back[1]),
        (ahead[0] if larger else main[0], ahead[1] if larger else main[1]),
    )


@kernel
def setup(q, w, moments, pull):
    """Constants of the motion of a heavy symmetric top.

    The potential energy is e3·Cᵀpull. Zero weight, zero spin and a top at rest are handled.
    """
    F = type(w[0])
    zero = F(0.0)
    one = F(1.0)
    half = F(0.5)
    up, size = upright(pull)
    q = quat.mul(quat.conj(up), q)
    P0 = seen((q[0], q[3]))
    Q0 = seen((q[1], q[2]))
    A = half * moments[0] + half * moments[1]
    a = w[2] * (moments[2] / A)
    root = math.sqrt(F(2.0) * (size / A))
    # the unit of time makes all rates at most 1
    f = vec3.largest((w[0], w[1], a))
    f, unit = scale(root if root > f else f)
    W0 = seen((f * w[0], f * w[1]))
    a = f * a
    root = f * root
    beta = root * root
    v = W0[0] * W0[0] + W0[1] * W0[1]
    x0 = F(2.0) * (P0[0] * P0[0] + P0[1] * P0[1])
    y0 = F(2.0) * (Q0[0] * Q0[0] + Q0[1] * Q0[1])
    # b − a z + i ż = −2i W P Q*
    S = times(W0, times_conj(P0, Q0))
    S = (F(2.0) * S[1], F(-2.0) * S[0])
    plus = S[0] + a * x0
    minus = S[0] - a * y0
    r = roots(x0, y0, v, a, beta, S, plus, minus)
    cubics_p, cubics_q, argument, begin, phase_rates = series(r, beta, plus, minus)
    start = -begin[1] if S[1] < zero else begin[1]
    # an upright top at rest remains at rest
    still = (begin[0] if x0 > zero else zero) if y0 > zero else zero
    rate = begin[0] if v > zero else still
    spin = f * w[2] - a
    x2 = r[3] if r[3] > zero else one
    y1 = r[4] if r[4] > zero else one
    phase_p = half * plus / x2 - rate * phase_rates[0]
    phase_q = half * minus / y1 - rate * phase_rates[1]
    # without the spin, which cancels in the sum and may be large
    sum_of = phase_p + phase_q + rate * (argument[3] + argument[5])
    phase_p = phase_p + half * spin
    phase_q = phase_q - half * spin
    g = cubics_p + cubics_q + argument
    P, Q, W = parts(g, (phase_p, phase_q, rate, start, sum_of), zero)
    P, Q = matched(P0, Q0, W0, P, Q, W)
    pace = (unit * phase_p, unit * phase_q, unit * rate, start, unit * sum_of)
    return up + P + Q + pace + (w[2],) + g


@kernel
def evaluate(constants, t):
    """Attitude and angular velocity of a heavy symmetric top at a time.

    Returns (q, w): the unit quaternion, and the angular velocity along body axes, rad/s. With W² =
    ``|w|²`` + 4 ``|pull|``/A at the start, the error of q is at most 1e-15 (1 + W t) and that
    of w as much relative to W (float64), in addition to the effect of the rounding of q and w
    on the motion.
    """
    g = constants
    P, Q, W = parts(g[14:36], g[8:13], t)
    W = times(times_conj(g[6:8], g[4:6]), W)
    P = times(g[4:6], P)
    Q = times(g[6:8], Q)
    return quat.mul(g[0:4], (P[0], Q[0], Q[1], P[1])), (W[0], W[1], g[13])
