"""The elementary functions against mpmath, with the figures that their docstrings claim."""

import math

import mpmath as mp
import numpy as np
import pytest
from each import each
from oracle import EPS, coefficients, inverse_coefficient, powers, relative, uniform

from fastatt.kernels import trig

SQUARES = [0.0, 1e-320, 1e-300, 1e-16, *uniform(0.0, math.pi**2, 1000), math.pi**2]
WIDE = uniform(-1e6, 1e6, 1000)


def neighbours(x, n=3):
    """x and n floats on either side."""
    return [x + k * math.ulp(x) for k in range(-n, n + 1)]


# where the number of turns or quarter turns is about to change
ODD_PI = [y for k in uniform(0, 159154, 200) for y in neighbours((2 * int(k) + 1) * math.pi)]
QUARTERS = [y for k in range(-40, 41) for y in neighbours(k * math.pi / 4)]


def turned(x):
    """The exact remainder of x after the kernel's number of turns, its remainder and the number."""
    r, k = trig.reduce_turns(x)
    assert k == math.floor(k)
    return mp.mpf(x) - 2 * mp.pi * mp.mpf(k), r, k


@pytest.mark.parametrize("xs", [WIDE, QUARTERS, ODD_PI], ids=["wide", "quarters", "odd pi"])
def test_reduce_turns(xs):
    for x in xs:
        exact, r, _ = turned(x)
        assert abs(exact - r) <= 2.5e-16
        assert abs(r) <= math.pi + 2.0 * math.ulp(x)


def test_reduce_turns_beyond_its_range():
    for x in powers(6, 15, 300):
        exact, r, _ = turned(x)
        assert abs(exact - r) <= math.ulp(x)
    for x in (1e16, 1e17, 1e100, 1.7e308, -1e300):
        assert abs(trig.reduce_turns(x)[0]) <= 3.15
    for x in (math.inf, -math.inf, math.nan):
        assert math.isnan(trig.reduce_turns(x)[0])


def test_is_odd():
    for k in (0, 1, 2, 3, -1, -2, -7, 12345, 2**52, 2**52 + 1, 2**53 - 1):
        assert trig.is_odd(float(k)) == k % 2
    assert trig.is_odd(1e300) == 0.0


@pytest.mark.parametrize("xs", [WIDE, QUARTERS, ODD_PI], ids=["wide", "quarters", "odd pi"])
def test_sincos(xs):
    for x in xs:
        s, c = trig.sincos(x)
        assert abs(s - mp.sin(x)) <= 1.4e-16
        assert abs(c - mp.cos(x)) <= 1.4e-16


def test_sine_of_tiny_angles_is_the_angle():
    for x in (0.0, 5e-324, 1e-300, -1e-200, 1e-9):
        assert trig.sincos(x) == (x, 1.0)


def test_sincos_beyond_its_range():
    for x in powers(6, 15, 300):
        s, c = trig.sincos(x)
        assert abs(s - mp.sin(x)) <= 1.4e-16 + math.ulp(x)
        assert abs(c - mp.cos(x)) <= 1.4e-16 + math.ulp(x)
    for x in (1e16, 1e17, 1e100, -1.7e308):
        assert math.hypot(*trig.sincos(x)) == pytest.approx(1.0, abs=2 * EPS)
    for x in (math.inf, math.nan):
        assert np.isnan(trig.sincos(x)).all()


def test_bounded_sincos_is_sincos_and_beyond_its_range_shows():
    for x in (*WIDE, *QUARTERS, *ODD_PI, *powers(6, 13, 300)):
        assert trig.sincos_bounded(x) == trig.sincos(x)
    for x in (1e18, -1e20, 1e100, math.inf, math.nan):
        assert not math.hypot(*trig.sincos_bounded(x)) <= 1.0 + 1e-3


def half(z):
    """sin(θ/2)/θ and cos(θ/2) of θ² = z."""
    theta = mp.sqrt(mp.mpf(z))
    return mp.sin(theta / 2) / theta if z else mp.mpf(0.5), mp.cos(theta / 2)


def test_half_sinc_cos():
    for z in SQUARES:
        s, c = trig.half_sinc_cos(z)
        sinc, cos = half(z)
        assert abs(s - sinc) <= 1.2e-16
        assert relative(s, sinc) <= 2e-16
        assert abs(c - cos) <= 1.2e-16
    assert trig.half_sinc_cos(0.0) == (0.5, 1.0)


def test_half_sinc_cos_wide_is_the_short_one_up_to_pi():
    for z in [*SQUARES, *neighbours(math.pi**2)[:4]]:
        assert trig.half_sinc_cos_wide(z) == trig.half_sinc_cos(z)


def test_half_sinc_cos_wide_beyond_pi():
    """The root rounds θ by half an ulp and θ/2 by half of that; the rest as up to π."""
    for theta in powers(0.5, 6, 500) + [abs(x) for x in ODD_PI]:
        z = max(theta * theta, np.nextafter(math.pi**2, 10.0))
        s, c = trig.half_sinc_cos_wide(z)
        sinc, cos = half(z)
        root = mp.sqrt(mp.mpf(z))
        allowed = 0.25 * math.ulp(theta) + 5e-16
        assert abs(s - sinc) * root <= allowed
        assert abs(c - cos) <= allowed


def test_remainders():
    for z in SQUARES:
        assert relative(trig.sin_remainder(z), coefficients(z)[2]) <= 2.5e-16
        assert relative(trig.cot_remainder(z), inverse_coefficient(z)) <= 4e-16


def test_atan2():
    around, size = uniform(-math.pi, math.pi, 2000), powers(-290, 290, 2000, 1)
    points = [(r * math.sin(a), r * math.cos(a)) for a, r in zip(around, size, strict=True)]
    points += [(y, x) for y in powers(-300, 300, 500, 2) for x in (1.0, -1.0)]
    for y, x in points:
        assert relative(trig.atan2(y, x), mp.atan2(y, x)) <= 4e-16


@each("y", [0.0, 1.0, -1.0, 5e-324, -1e300])
@each("x", [0.0, 1.0, -1.0, 5e-324, -1e300])
def test_atan2_on_axes_and_diagonals(y, x):
    assert trig.atan2(y, x) == pytest.approx(math.atan2(y, x), rel=4e-16, abs=0)
