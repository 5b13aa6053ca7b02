"""Dual numbers in compiled code: every operation's derivative against its definition."""

import math

import mpmath as mp
import numpy as np
import pytest
from numba import njit, types
from oracle import EPS

from fastatt.dual import Dual, constant, derivatives, seed, value
from fastatt.kernels import quat, so3

X, Y = 0.7, -1.3
# of two numbers, as a user writes them and as mpmath does
TERMS = [
    (lambda x, y: (2.0 - x + (y - 1)) * y * 3 + x / y + 1.0 / x, None),
    (lambda x, y: -(+x) * abs(y) + abs(x) - y / 2.0, None),
    (lambda x, y: x**3 + x**0.5 + x**y, None),
    (lambda x, y: min(x, y) * max(x, y) + max(x, 0.1) + min(2.0, y), None),
    (
        lambda x, y: math.sqrt(x) + math.sin(y) * math.cos(x) + math.tan(y),
        lambda x, y: mp.sqrt(x) + mp.sin(y) * mp.cos(x) + mp.tan(y),
    ),
    (
        lambda x, y: np.exp(y) * math.log(x) + np.tanh(x) - np.arctan(y) * math.atan2(y, x),
        lambda x, y: mp.exp(y) * mp.log(x) + mp.tanh(x) - mp.atan(y) * mp.atan2(y, x),
    ),
    (
        lambda x, y: (x if x < 1 else y) * (y if y >= x else x * y) + np.rint(3 * x) + np.floor(y),
        lambda x, y: x * x * y,
    ),
]


def compiled(function):
    inner = njit(function)

    @njit
    def user(x, y):
        a, b = seed((x, y), 2, 0, -1)
        z = constant(inner(a, b), a)
        return value(z), derivatives(z)

    return user


@pytest.mark.parametrize("k", range(len(TERMS)))
def test_operations(k):
    function, in_mp = TERMS[k]
    x, y = mp.mpf(X), mp.mpf(Y)
    whole = in_mp or function
    found, slopes = compiled(function)(X, Y)
    assert found == pytest.approx(function(X, Y), rel=4 * EPS)
    true = [mp.diff(lambda t: whole(t, y), x), mp.diff(lambda t: whole(x, t), y)]
    for slope, exact in zip(slopes, true, strict=True):
        assert abs(slope - exact) <= 8 * EPS * max(1, abs(exact))


def test_single_precision_and_plain_numbers_stay():
    @njit
    def user(x):
        F = type(x)
        (a,) = seed((x,), 1, 0, -1)
        G = type(a)
        half = G(0.5)
        b = a if x > F(2.0) else F(3.0)  # a number counts as constant
        return half, derivatives(half * G(a) * a), derivatives(b)

    half, (slope,), (none,) = user(np.float32(1.5))
    half_type, *_ = user.nopython_signatures[0].return_type
    assert half_type == types.float32
    assert (half, slope, none) == (0.5, 1.5, 0.0)


def test_masked_seeds():
    @njit
    def user(p):
        a = seed(p, 4, 1, 5)  # the first and the third
        return derivatives(a[0] * a[1]), derivatives(a[2])

    assert user((2.0, 3.0, 4.0)) == ((0.0, 3.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))


@pytest.mark.parametrize("theta", [0.0, 1e-160, 1e-8, 0.5, 3.0, 3.3, 6.28, 6.3, 40.0])
def test_of_an_exponential_it_is_the_right_jacobian(theta):
    u = tuple(theta * c for c in (2 / 3, -1 / 3, 2 / 3))
    columns = np.array(rows(u))
    true = np.reshape(so3.right_jacobian(u), (3, 3))
    assert np.abs(columns - true).max() <= 4 * EPS


@njit
def rows(u):
    d = quat.exp(seed(u, 3, 0, -1))
    q = (value(d[0]), value(d[1]), value(d[2]), value(d[3]))
    r = quat.mul(quat.conj(q), d)
    return derivatives(2.0 * r[1]), derivatives(2.0 * r[2]), derivatives(2.0 * r[3])


def test_two_sizes_do_not_mix():
    @njit
    def user(x):
        (a,) = seed((x,), 1, 0, -1)
        (b,) = seed((x,), 2, 0, -1)
        return value(a * b)

    with pytest.raises(Exception, match="Dual"):
        user(1.0)
    assert Dual(types.float64, 2) == Dual(types.float64, 2) != Dual(types.float64, 3)
