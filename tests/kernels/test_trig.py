"""The elementary functions against mpmath, with the figures that their docstrings claim."""

import math

import mpmath as mp
import numpy as np
import pytest
from each import each
from oracle import EPS, powers, relative, uniform

from fastatt.kernels import trig

WIDE = uniform(-1e6, 1e6, 1000)


def neighbours(x, n=3):
    """x and n floats on either side."""
    return [x + k * math.ulp(x) for k in range(-n, n + 1)]


# where the number of turns or quarter turns is about to change
ODD_PI = [y for k in uniform(0, 159154, 200) for y in neighbours((2 * int(k) + 1) * math.pi)]
QUARTERS = [y for k in range(-40, 41) for y in neighbours(k * math.pi / 4)]


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
