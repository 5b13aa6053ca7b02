"""Elementary functions that vectorise: without calls, branches and tables.

Numba has no vector sine on a plain installation, so that one call of ``math.sin`` makes a whole
loop scalar. Polynomials are near-minimax fits in the squared argument (Chebyshev nodes, 50 digits)
with exact first coefficients, so that tiny arguments keep their digits. Reductions subtract 2π in
three parts, the first two of which are short enough (8 and 11 bits) for an exact product with the
multiples of 2π in float64 and in float32 (Cody and Waite, 1980).
"""

from __future__ import annotations

import math

import numpy as np

from fastatt._jit import kernel

TWO_PI_1 = 6.28125
TWO_PI_2 = 0.0019350051879882812
TWO_PI_3 = 3.019915981956753e-07
LN_2_HIGH = 0.693145751953125
LN_2_LOW = 1.4286068203094173e-06


@kernel
def reduce_turns(x):
    """The angle x less multiples of 2π, in [−π, π] to ulps of x, and their number as a float.

    The absolute error is at most 2.5e-16 (float64) for ``|x|`` ≤ 1e6 rad, and about 1 ulp of x
    beyond. If an ulp of x exceeds 2π the result is arbitrary but at most 3.15. NaN and infinity
    give NaN.
    """
    F = type(x)
    k = np.rint(x * F(0.5 / math.pi))
    r = ((x - k * F(TWO_PI_1)) - k * F(TWO_PI_2)) - k * F(TWO_PI_3)
    # not π: near an odd multiple of π the rounding of k gives a slightly larger angle
    r = F(3.15) if r > F(3.15) else r
    r = F(-3.15) if r < F(-3.15) else r
    return r, k


@kernel
def is_odd(k):
    """1 for an odd whole number k (a float), 0 for an even one."""
    F = type(k)
    return k - F(2.0) * np.floor(F(0.5) * k)


@kernel
def sincos(x):
    """Sine and cosine.

    The absolute error is at most 1.4e-16 (float64) for ``|x|`` ≤ 1e6; beyond, it is that of x
    moved by an ulp. Any x gives sine and cosine of one angle.
    """
    F = type(x)
    r, k = reduce_quarters(x)
    r = F(0.79) if r > F(0.79) else r
    r = F(-0.79) if r < F(-0.79) else r
    return sincos_short(r, k)


@kernel
def sincos_bounded(x):
    """Sine and cosine of bounded angles, in two operations less than :func:`sincos`.

    Up to 1e15 (float32: 1e6) the error is that of x moved by an ulp. A rotation by a larger
    angle changes lengths, so that the error is noticed.
    """
    r, k = reduce_quarters(x)
    return sincos_short(r, k)


@kernel
def reduce_quarters(x):
    """The angle x less multiples of π/2, in ±π/4 to ulps of x, and the number of quarters."""
    F = type(x)
    k = np.rint(x * F(2.0 / math.pi))
    r = x - k * F(0.25 * TWO_PI_1)
    r = r - k * F(0.25 * TWO_PI_2)
    r = r - k * F(0.25 * TWO_PI_3)
    return r, k


@kernel
def sincos_short(r, k):
    """(sin x, cos x) of the angle x = r + k π/2 with r in ±π/4 and a whole number k (a float)."""
    s, c = short_waves(r, r * r)
    C, S = quarter_turns(k)
    return s * C + c * S, c * C - s * S


@kernel
def quarter_turns(k):
    """(cos, sin) of π/2 times a whole number (a float), exactly."""
    F = type(k)
    return within_a_turn(k - F(4.0) * np.rint(F(0.25) * k))


@kernel
def within_a_turn(k):
    """(cos, sin) of k π/2 for k = −2, −1, 0, 1 or 2."""
    F = type(k)
    size = abs(k)
    return F(1.0) - size, k * (F(2.0) - size)


@kernel
def half_sinc_cos(z):
    """(sin(θ/2)/θ, cos(θ/2)) for 0 ≤ θ ≤ π, by polynomials in θ².

    The error is at most 1.2e-16, and that of the first at most 2e-16 relative to it (float64).
    """
    F = type(z)
    s = F(2.0839269767657467e-20)
    s = s * z + F(-2.3327546071772985e-17)
    s = s * z + F(1.9603243789629012e-14)
    s = s * z + F(-1.2232474422361417e-11)
    s = s * z + F(5.382288909992819e-09)
    s = s * z + F(-1.5500992063480449e-06)
    s = s * z + F(0.0002604166666666661)
    s = s * z + F(-0.020833333333333332)
    s = s * z + F(0.5)
    c = F(7.061273170498919e-19)
    c = c * z + F(-6.997491385327166e-16)
    c = c * z + F(5.096833707866942e-13)
    c = c * z + F(-2.6911443132148953e-10)
    c = c * z + F(9.688120036111802e-08)
    c = c * z + F(-2.1701388888844858e-05)
    c = c * z + F(0.002604166666666646)
    c = c * z + F(-0.125)
    c = c * z + F(1.0)
    return s, c


@kernel
def half_sinc_cos_wide(z):
    """(sin(θ/2)/θ, cos(θ/2)) for any θ."""
    F = type(z)
    theta = math.sqrt(z)
    r, k = reduce_turns(theta)
    past = z > F(math.pi * math.pi)
    sign = F(1.0) - F(2.0) * is_odd(k)
    s, c = half_sinc_cos(r * r if past else z)
    s = s * sign * (r / theta) if past else s
    c = c * sign if past else c
    return s, c


@kernel
def sin_remainder(z):
    """(θ − sin θ)/θ³ from z = θ², 0 ≤ θ ≤ π; the plain formula would lose all digits near 0.

    The relative error is at most 2.5e-16 (float64).
    """
    F = type(z)
    g = F(-1.775165055612406e-20)
    g = g * z + F(8.183034366062202e-18)
    g = g * z + F(-2.811024030605762e-15)
    g = g * z + F(7.647133470817639e-13)
    g = g * z + F(-1.6059042526461696e-10)
    g = g * z + F(2.5052108350866163e-08)
    g = g * z + F(-2.755731922346156e-06)
    g = g * z + F(0.00019841269841265803)
    g = g * z + F(-0.008333333333333321)
    g = g * z + F(0.16666666666666666)
    return g


@kernel
def sin_second_remainder(z):
    """(θ³/6 − θ + sin θ)/θ⁵ from z = θ², 0 ≤ θ ≤ π; the plain formula would lose all digits near 0.

    The relative error is at most 3e-16 (float64).
    """
    F = type(z)
    g = F(1.8103850818789028e-20)
    g = g * z + F(-8.197373496893103e-18)
    g = g * z + F(2.8112641847069227e-15)
    g = g * z + F(-7.647154830515165e-13)
    g = g * z + F(1.605904361365561e-10)
    g = g * z + F(-2.5052108382691778e-08)
    g = g * z + F(2.7557319223972975e-06)
    g = g * z + F(-0.0001984126984126983)
    g = g * z + F(0.008333333333333333)
    return g


@kernel
def cot_remainder(z):
    """(1 − (θ/2) cot(θ/2))/θ² from z = θ², 0 ≤ θ ≤ π; the pole at 2π is divided out of the fit.

    The relative error is at most 4e-16 (float64).
    """
    F = type(z)
    c = F(-3.385472847881499e-20)
    c = c * z + F(-3.679997072461782e-18)
    c = c * z + F(-6.175664225356326e-16)
    c = c * z + F(-9.763052264473038e-14)
    c = c * z + F(-1.5610565448598213e-11)
    c = c * z + F(-2.5382459223582704e-09)
    c = c * z + F(-4.312023776634757e-07)
    c = c * z + F(-8.338566123132389e-05)
    c = c * z + F(-0.028502197771725857)
    c = c * z + F(3.289868133696453)
    return c / (F(39.47841760435743) - z)


@kernel
def atan2(y, x):
    """The angle of the point (x, y) in (−π, π].

    The relative error is at most 4e-16 (float64) while ``|x| + |y|`` is finite. The sign of a
    zero y is ignored.
    """
    F = type(y)
    ay = abs(y)
    ax = abs(x)
    steep = ay > ax
    low = ax if steep else ay
    high = ay if steep else ax
    high = F(1.0) if high == F(0.0) else high
    # above tan(π/8): atan t = π/4 + atan((t − 1)/(t + 1)), also with one division
    past = low > F(0.41421356237309503) * high
    above = low - high if past else low
    below = low + high if past else high
    t = above / below
    z = t * t
    a = F(-0.019175404711104935)
    a = a * z + F(0.03923044778479309)
    a = a * z + F(-0.050854078345894844)
    a = a * z + F(0.05858140904866328)
    a = a * z + F(-0.06664510525508936)
    a = a * z + F(0.07692183125376892)
    a = a * z + F(-0.0909090457530649)
    a = a * z + F(0.11111111015187018)
    a = a * z + F(-0.14285714284665682)
    a = a * z + F(0.19999999999995516)
    a = a * z + F(-0.3333333333333333)
    a = a * z * t + t
    a = F(0.7853981633974483) + a if past else a
    a = F(1.5707963267948966) - a if steep else a
    a = F(3.141592653589793) - a if x < F(0.0) else a
    return -a if y < F(0.0) else a


@kernel
def reduce_powers(x):
    """(k, x − k ln 2) with a remainder in ±0.35 for ``|x|`` ≤ 88; k is a float.

    Cody and Waite (1980): ln 2 in two parts, the first of 13 bits, so that its product is exact.
    """
    F = type(x)
    k = np.rint(x * F(1.4426950408889634))
    r = x - k * F(LN_2_HIGH)
    return k, r - k * F(LN_2_LOW)


@kernel
def short_waves(r, z):
    """(sin r, cos r) for z = r², ``|r|`` ≤ π/4; (sinh r, cosh r) for z = −r², ``|r|`` ≤ 0.35.

    One pair of polynomials serves both, fitted from z = −0.121 to 0.618. The absolute error is at
    most 1.4e-16, the relative error of sinh and cosh at most 3e-16 (float64).
    """
    F = type(r)
    s = F(1.5945514185115612e-10)
    s = s * z + F(-2.5051560354320427e-08)
    s = s * z + F(2.755731844280705e-06)
    s = s * z + F(-0.00019841269841900413)
    s = s * z + F(0.008333333333334607)
    s = s * z + F(-0.16666666666666666)
    s = s * z * r + r
    c = F(-1.1399760405283362e-11)
    c = c * z + F(2.087641427989201e-09)
    c = c * z + F(-2.755731873543572e-07)
    c = c * z + F(2.4801587301981616e-05)
    c = c * z + F(-0.0013888888888889685)
    c = c * z + F(0.041666666666666664)
    c = c * z + F(-0.5)
    return s, c * z + F(1.0)


@kernel
def power_of_two(n):
    """2ⁿ for a whole number 0 ≤ n ≤ 127 (a float), bit by bit."""
    F = type(n)
    p = F(1.8446744073709552e19) if n >= F(64.0) else F(1.0)
    n = n - F(64.0) if n >= F(64.0) else n
    p = p * F(4294967296.0) if n >= F(32.0) else p
    n = n - F(32.0) if n >= F(32.0) else n
    p = p * F(65536.0) if n >= F(16.0) else p
    n = n - F(16.0) if n >= F(16.0) else n
    p = p * F(256.0) if n >= F(8.0) else p
    n = n - F(8.0) if n >= F(8.0) else n
    p = p * F(16.0) if n >= F(4.0) else p
    n = n - F(4.0) if n >= F(4.0) else n
    p = p * F(4.0) if n >= F(2.0) else p
    n = n - F(2.0) if n >= F(2.0) else n
    p = p * F(2.0) if n >= F(1.0) else p
    return p


@kernel
def powers_of_two(k):
    """(2ᵏ, 2⁻ᵏ) for a whole number k (a float) in ±127."""
    F = type(k)
    p = power_of_two(abs(k))
    q = F(1.0) / p
    below = k < F(0.0)
    return q if below else p, p if below else q


@kernel
def octave(n, a, b, count, power):
    """(n + ``count``, b ``power``) if that product is no larger than a, else (n, b)."""
    more = power * b <= a
    return n + count if more else n, power * b if more else b


@kernel
def octaves(a, b):
    """A whole number n (a float) and 2ⁿ b, with a > 0 more than half and less than twice that.

    0 < b ≤ a, and a/b is below 2¹⁰²⁴ (float32: 2¹²⁷).
    """
    F = type(a)
    n, b = octave(F(0.0), a, b, F(512.0), F(2.0**512))
    n, b = octave(n, a, b, F(256.0), F(2.0**256))
    n, b = octave(n, a, b, F(128.0), F(2.0**128))
    n, b = octave(n, a, b, F(64.0), F(2.0**64))
    n, b = octave(n, a, b, F(32.0), F(2.0**32))
    n, b = octave(n, a, b, F(16.0), F(2.0**16))
    n, b = octave(n, a, b, F(8.0), F(2.0**8))
    n, b = octave(n, a, b, F(4.0), F(2.0**4))
    n, b = octave(n, a, b, F(2.0), F(2.0**2))
    return octave(n, a, b, F(1.0), F(2.0))


@kernel
def log_ratio(a, b, over, under):
    """ln(a/b) for a ≥ b > 0, where over/under is the exact (a − b)/(a + b).

    The relative error is at most 5e-16 (float64) in addition to that of ``over`` and ``under``.
    """
    F = type(a)
    n, b = octaves(a, b)
    above = a > F(1.4142135623730951) * b
    below = a < F(0.7071067811865476) * b
    b = F(2.0) * b if above else (F(0.5) * b if below else b)
    n = n + F(1.0) if above else (n - F(1.0) if below else n)
    near = n == F(0.0)
    t = (over if near else a - b) / (under if near else a + b)
    z = t * t
    p = F(0.1461703754879165)
    p = p * z + F(0.1533167403016786)
    p = p * z + F(0.18182890556695602)
    p = p * z + F(0.2222221111514416)
    p = p * z + F(0.2857142862609589)
    p = p * z + F(0.3999999999989924)
    p = p * z + F(0.666666666666667)
    p = p * z * t + F(2.0) * t
    return n * F(LN_2_HIGH) + (n * F(LN_2_LOW) + p)
