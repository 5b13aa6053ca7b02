"""The search for two crossings within a step."""

from __future__ import annotations

import numpy as np
from numba import njit

from fastatt.engine.brackets import (
    AT_HIGH,
    AT_LOW,
    BRACKET,
    EXTREMUM,
    HIGH,
    POINT,
    find_extremum,
    turns,
)


def cubic(x, middle, half, skew):
    return ((x - middle) ** 2 - half * half) * (1.0 + skew * (x - middle))


@njit
def searched(f, given):
    """What comes of the search, and the values at the ends of the bracket."""
    brackets = np.zeros(11)
    brackets[HIGH], brackets[POINT] = 1.0, 0.5
    brackets[AT_LOW], brackets[AT_HIGH] = f(0.0, *given), f(1.0, *given)
    doing, trials = EXTREMUM, 0
    while doing == EXTREMUM:
        x, trials = brackets[POINT], trials + 1
        doing = find_extremum(brackets, 1, 0, x, f(x, *given), 0, trials)
    return doing, brackets[AT_LOW], brackets[AT_HIGH]


def drawn(largest_skew):
    """Curves that are below zero over 1e-4 to 0.1 of a step, anywhere in it."""
    rng, n = np.random.default_rng(0), 20_000
    middle, skew = rng.random(n), rng.uniform(-largest_skew, largest_skew, n)
    half = 0.5 * 10.0 ** rng.uniform(-4, -1, n)
    inside = (half < middle) & (middle < 1.0 - half)
    return np.stack([middle, half, skew])[:, inside]


def test_a_step_with_two_crossings_is_searched():
    """Unless the curvature doubles within it."""
    curves = drawn(0.2)
    assert turns(*(cubic(x, *curves) for x in (-1.0, 0.0, 1.0))).all()


def test_crossings_anywhere_in_a_step_are_bracketed():
    """One in 5000 may be missed: where a vertex lies by chance on the point that gave it."""
    f = njit(cubic)
    found = [searched(f, tuple(numbers)) for numbers in drawn(0.1).T.tolist()]
    assert sum(doing != BRACKET for doing, _, _ in found) <= len(found) / 5000
    assert all(a * b <= 0.0 for doing, a, b in found if doing == BRACKET)
