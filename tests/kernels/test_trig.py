"""The elementary functions against mpmath, with the figures that their docstrings claim."""

import math

import mpmath as mp
import numpy as np
import pytest
from oracle import EPS, powers, uniform

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
