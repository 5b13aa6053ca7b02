"""Free motion of a rigid body in closed form: constants once, then attitude and momentum at any t.

Jacobi's solution (1849) as arranged by van Zon and Schofield, *Journal of Computational Physics*
225 (2007), and Celledoni, Fassò, Säfström and Zanna, *SIAM Journal on Scientific Computing* 30
(2008), on axes such that the momentum m circles the third: I1 < I2 < I3 or I1 > I2 > I3, m1 = a1
cn, m2 = a2 sn, m3 = a3 dn. The phase, an integral of the third kind, is not computed separately:
with the quotient B/A of a theta pair,

    L + m3 : L − m3 = |A|² : |B|²,    m1 + i m2 ~ i B A*,
    (q0 + i q3) : (q1 + i q2) = A : B, both with a phase linear in time.

The attitude therefore maps m(t) to the same inertial vector as m(0), to rounding, for any t.
"""

from __future__ import annotations

import math

from fastatt._jit import kernel
from fastatt.kernels import quat, vec3
from fastatt.kernels.elliptic import cubic, first_kind_pair, theta_pair, theta_pair_at, weighted
from fastatt.kernels.trig import sincos

# numbers with twice the digits, as a high and a low part: |high| ≤ 1


@kernel
def split_product(a, b):
    """a b as (high, low) for ``|a|``, ``|b|`` ≤ 1, with an error of 1e-32 (float64).

    Dekker's product (*Numerische Mathematik* 18, 1971) with roundings by additions only: a
    multiplication may be fused here, which would break the usual splitting by 2²⁷ + 1.
    """
    F = type(a)
    cut = F(201326592.0)
    a1 = (a + cut) - cut
    b1 = (b + cut) - cut
    a2 = a - a1
    b2 = b - b1
    high = (a * b + F(3.0)) - F(3.0)
    low = (((a1 * b1 - high) + a1 * b2) + a2 * b1) + a2 * b2
    total = high + low
    return total, low - (total - high)


@kernel
def split_difference(a, b):
    """a − b as (high, low), without error (Knuth)."""
    high = a - b
    c = high - a
    return high, (a - (high - c)) - (b + c)


@kernel
def split_multiply(a, b):
    """Product of two numbers (high, low) of size at most 1, with an error of 1e-31 (float64)."""
    high, low = split_product(a[0], b[0])
    low = low + (a[0] * b[1] + a[1] * b[0])
    total = high + low
    return total, low - (total - high)


#: the smallest normal number of float64; 0 in float32
TINY = 2.0**-1022


@kernel
def least_scaled(tiny):
    """``TINY``, or the smallest normal number of float32, where it would be 0."""
    F = type(tiny)
    return tiny if tiny > F(0.0) else F(2.0**-126)


@kernel
def scale(x):
    """A power of two s with 3/8 ≤ s x < 1, and 1/s, for normal x ≤ 1e290; 1 for smaller x."""
    F = type(x)
    tiny = F(TINY)
    shift = F(2.0**52) if tiny > F(0.0) else F(2.0**23)
    # x is the last bit of the sum: rounded to one bit. Fusing changes nothing here
    bit = F(0.5) if x < least_scaled(tiny) else (x * shift + x) - x * shift
    return F(0.5) / bit, F(2.0) * bit


@kernel
def scaled(v):
    """(s v, 1/s), where a power of two s brings the largest magnitude to 3/8 to 1."""
    F = type(v[0])
    x = vec3.largest(v)
    # a subnormal number has no s that is finite: two factors
    up = F(2.0**52) if x < least_scaled(F(TINY)) else F(1.0)
    s, unit = scale(up * x)
    return (s * (up * v[0]), s * (up * v[1]), s * (up * v[2])), unit / up


# axes


@kernel
def exchange(a, b, swap):
    """(b, a) for two tuples of four if swap > 0, else (a, b)."""
    F = type(swap)
    s = swap > F(0.0)
    return (
        (b[0] if s else a[0], b[1] if s else a[1], b[2] if s else a[2], b[3] if s else a[3]),
        (a[0] if s else b[0], a[1] if s else b[1], a[2] if s else b[2], a[3] if s else b[3]),
    )


@kernel
def order(m, low, inertia):
    """The three axes, that which the momentum m + low circles last, and I1 I3 ``|L² − 2T I2|``.

    An axis is (moment, momentum, its low part, index 0, 1 or 2); moments ascend or descend.
    """
    F = type(m[0])
    a = (inertia[0], m[0], low[0], F(0.0))
    b = (inertia[1], m[1], low[1], F(1.0))
    c = (inertia[2], m[2], low[2], F(2.0))
    a, b = exchange(a, b, a[0] - b[0])
    b, c = exchange(b, c, b[0] - c[0])
    a, b = exchange(a, b, a[0] - b[0])

    # D = I1 (I3 − I2) m3² − I3 (I2 − I1) m1² keeps its digits near the separatrix; also near the
    # intermediate axis, where both momenta are small, since a power of two is factored out
    s, unit = scale(abs(a[1]) if abs(a[1]) > abs(c[1]) else abs(c[1]))
    x = (s * c[1], s * c[2])
    y = (s * a[1], s * a[2])
    u = split_multiply(split_difference(c[0], b[0]), (a[0], F(0.0)))
    v = split_multiply(split_difference(b[0], a[0]), (c[0], F(0.0)))
    x = split_multiply(split_multiply(x, x), u)
    y = split_multiply(split_multiply(y, y), v)
    gap = (x[0] - y[0]) + (x[1] - y[1])
    # on the separatrix either order is right, except for symmetric bodies
    flat = b[0] - a[0] >= c[0] - b[0]
    a, c = exchange(a, c, (F(1.0) if flat else F(-1.0)) if gap == F(0.0) else -gap)
    return a, b, c, abs(gap) * unit * unit


@kernel
def handed(a, b, c):
    """(index1, index2, s1, s2, s3) of ordered axes, with signs that make a right-handed frame.

    m1 and m3 are not negative in it.
    """
    F = type(a[0])
    s1 = F(-1.0) if a[1] < F(0.0) else F(1.0)
    s3 = F(-1.0) if c[1] < F(0.0) else F(1.0)
    step = b[3] - a[3]
    cyclic = step == (F(1.0) if step > F(0.0) else F(-2.0))
    return a[3], b[3], s1, (s1 * s3 if cyclic else -s1 * s3), s3


@kernel
def to_body(v, axes):
    """Body components of a vector given along the axes of ``handed``."""
    F = type(v[0])
    x = axes[2] * v[0]
    y = axes[3] * v[1]
    z = axes[4] * v[2]
    return (
        x if axes[0] == F(0.0) else (y if axes[1] == F(0.0) else z),
        x if axes[0] == F(1.0) else (y if axes[1] == F(1.0) else z),
        x if axes[0] == F(2.0) else (y if axes[1] == F(2.0) else z),
    )


# the solution


@kernel
def pair(g, s):
    """A and B as (Re A, Re B, Im B, Im A), 1/√(``|A|² + |B|²``) and χ of ``theta_pair_at``.

    ``g`` are the constants of the theta pair, with B weighted so that ``|A|² : |B|²`` = L + m3 : L
    − m3.
    """
    F = type(s)
    ar, ai, br, bi, chi = theta_pair_at(g, s)
    square = (ar * ar + ai * ai) + (br * br + bi * bi)
    return (ar, br, bi, ai), F(1.0) / math.sqrt(square), chi


@kernel
def turned(x, n, angle):
    """n exp(iθ) A and n exp(iθ) B."""
    s, c = sincos(angle)
    s = n * s
    c = n * c
    return c * x[0] - s * x[3], c * x[1] - s * x[2], c * x[2] + s * x[1], c * x[3] + s * x[0]


@kernel
def amplitudes(J, m, gap):
    """(a1, a2, a3), the least m3, k', k, a2/a1, and the square of k a3/a1.

    Moments and momentum are along ordered axes, and ``gap`` is that of ``order``. Equal moments
    give a circle, k = 0, or rest.
    """
    F = type(m[0])
    zero = F(0.0)
    one = F(1.0)
    d21 = abs(J[1] - J[0])
    d32 = abs(J[2] - J[1])
    d31 = abs(J[2] - J[0])
    sphere = d32 == zero
    d32 = one if sphere else d32
    above = one / (J[0] * d32)
    below = zero if sphere else one / (J[1] * d31)
    r21 = one if sphere else math.sqrt(d31 * J[1] * above)
    r31 = d21 * J[2] * above
    square = m[1] * m[1]
    a1 = math.sqrt(m[0] * m[0] + (square if sphere else J[0] * d32 * below * square))
    a3 = math.sqrt(m[2] * m[2] + d21 * J[2] * below * square)
    least = math.sqrt(gap * above)
    least = m[2] if d21 == zero else least
    least = least if least < a3 else a3
    circle = a3 == zero if d21 != zero else d21 == zero
    inverse = one / (one if circle else a3)
    k = zero if circle else math.sqrt(r31) * a1 * inverse
    kc = one if circle else least * inverse
    return (a1, r21 * a1, a3), least, kc, k if k < one else one, r21, r31


@kernel
def begin(q, m, low, inertia, size, f):
    """Constants of a motion as in ``setup``, from scaled momentum m + low and inertia.

    All numbers are at most 1. ``size`` is the unit of momentum and ``f`` that of rates.
    """
    F = type(m[0])
    zero = F(0.0)
    one = F(1.0)
    x, y, z, gap = order(m, low, inertia)
    axes = handed(x, y, z)
    J = (x[0], y[0], z[0])
    m = (abs(x[1]), axes[3] * y[1], abs(z[1]))
    a, least, kc, k, r21, r31 = amplitudes(J, m, gap)
    length = math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
    rest = length == zero

    # the start of the motion: cot am u = (a2/a1) m1/m2, and sin am(c, k') = a1/a2
    side = abs(m[1])
    cot = r21 * m[0] / (side if side > zero else one)
    u, K, c, Kc = first_kind_pair(cot, kc, math.sqrt(r31), k)
    u = u if side > zero else zero
    u = -u if m[1] < zero else u
    g = theta_pair(K, Kc, c)
    start = g[16] * u

    # the weight of B from a point with known m: m1 = 0, or m2 = 0 since K may be infinite
    even = cubic(g[0:4], one)
    odd = cubic(g[12:16], one)
    wide = g[20] > F(0.5)
    above = a[0] * even if wide else a[1] * cubic(g[0:4], -one)
    below = (length + a[2]) * (-odd if odd < zero else one)
    below = below if wide else (length + least) * cubic(g[8:12], -one)
    weight = above / below
    weight = zero if rest else weight

    # the phase advances by (2T + L m3/I3)/(L + m3); its part outside of the pair is the same at any
    # time, and is evaluated at u = 0
    i = (one / J[0], one / J[1], one / J[2])
    rate = g[16] * a[2] * math.sqrt((J[2] - J[1]) * (J[2] - J[0]) * i[0] * i[1]) * i[2]
    rate = rate if J[2] > J[0] else -rate
    energy = m[0] * m[0] * i[0] + m[1] * m[1] * i[1] + m[2] * m[2] * i[2]
    whole = (energy + length * a[2] * i[2]) / (one if rest else length + a[2])
    phase = F(0.5) * whole - rate * (g[19] + cubic(g[4:8], one) / even)
    # rotation about the intermediate axis is an equilibrium
    rate = (zero if m[2] == zero else rate) if m[0] == zero else rate

    g = g[0:8] + weighted(g[8:16], weight, one) + g[16:21]
    x, n, chi = pair(g, start)
    v = to_body((-n * x[1], -n * x[2], -n * x[3]), axes)
    p = quat.mul(q, (n * x[0], v[0], v[1], v[2]))
    twice = length + length
    least = zero if rest else least / twice
    return p + axes + (f * phase, f * rate, start, chi, twice * size, least, r31) + g


@kernel
def setup(q, m, inertia):
    """Constants of the motion of a free body that starts with a given angular momentum.

    Moments and momentum are at most 1e290 (float64).
    """
    F = type(m[0])
    m, unit = scaled(m)
    inertia, of_inertia = scaled(inertia)
    return begin(q, m, (F(0.0), F(0.0), F(0.0)), inertia, unit, unit / of_inertia)


@kernel
def setup_rate(q, w, inertia):
    """Constants of the motion of a free body that starts with a given angular velocity.

    The products I w keep their low parts: within 1e-12 of the separatrix, the rounding of m
    alone would move the next flip by 1e-4 of its time.
    """
    w, rate = scaled(w)
    inertia, unit = scaled(inertia)
    x = split_product(w[0], inertia[0])
    y = split_product(w[1], inertia[1])
    z = split_product(w[2], inertia[2])
    high = (x[0], y[0], z[0])
    low = (x[1], y[1], z[1])
    return begin(q, high, low, inertia, rate * unit, rate)


@kernel
def evaluate(constants, t):
    """Attitude and angular momentum of a free body at a time.

    Returns (q, m): the unit quaternion, and the angular momentum along principal axes, N·m·s. The
    error of q is at most 1e-15 (1 + ``|w| t``), and that of m as much relative to ``|m|``
    (float64), on either side of the separatrix and on it, and for symmetric bodies. After
    :func:`setup`, m is taken as exact.
    """
    g = constants
    x, n, chi = pair(g[16:37], g[11] + g[10] * t)
    # (m1, m2, m3)/2L, also small ones with all digits
    y1 = n * n * (x[1] * x[3] - x[2] * x[0])
    y2 = n * n * (x[1] * x[0] + x[2] * x[3])
    x = turned(x, n, g[9] * t + (chi - g[12]))
    y3 = math.sqrt(g[14] * g[14] + g[15] * y1 * y1)
    v = to_body((x[1], x[2], x[3]), g[4:9])
    q = quat.mul(g[0:4], (x[0], v[0], v[1], v[2]))
    return q, to_body((g[13] * y1, g[13] * y2, g[13] * y3), g[4:9])
