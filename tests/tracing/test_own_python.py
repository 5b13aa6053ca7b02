"""Functions of users beside the users' own functions, whatever their values are."""

import dataclasses

import numpy as np
import pytest
from numba import njit

from fastatt.tracing.user import user_function

POINTS = [(0.7, (0.5, -0.5, 0.5, 0.5), (x, -0.4, 0.9), ()) for x in (0.3, 60.0)]


class Vector(tuple):
    __slots__ = ()

    def __add__(self, other):
        return Vector(a + b for a, b in zip(self, other, strict=True))


class Matrix(np.ndarray):
    """As ``np.matrix``."""

    def __mul__(self, other):
        return self @ other


class Scaled:
    """Numba's dispatchers are not alone in having such an attribute."""

    def __init__(self, function):
        self.py_func = function

    def __call__(self, t, q, w, p):
        return [0.05 * x for x in self.py_func(t, q, w, p)]


@dataclasses.dataclass
class Mode:
    name: str = "a"


@njit
def same(x):
    return x


def halved(x):
    """Called: a loop whose end is not known."""
    while x > 1.0:
        x *= 0.5
    return x


MATRIX = np.array([[0.1, 0.5], [0.3, 0.2]]).view(Matrix)
VECTOR, MODES = Vector((0.1, 0.2, 0.3)), (Mode(), Mode())


def of_matrix(t, q, w, p):
    k = MATRIX * MATRIX
    return k[0, 0] * w[0], 0.0, 0.0


def of_vector(t, q, w, p):
    return (VECTOR + VECTOR)[0] * w[0], 0.0, 0.0


def of_vector_now_and_then(t, q, w, p):
    k = (VECTOR + VECTOR)[0] if abs(w[0]) > 50.0 else 1.0
    return halved(abs(w[0])) * k, 0.0, 0.0


def of_equals(t, q, w, p):
    return same(-0.3 if MODES[0] == MODES[1] else 9.0) * w[0], 0.0, 0.0


@pytest.mark.parametrize(
    "function",
    [
        *(of_matrix, of_vector, of_vector_now_and_then, of_equals),
        Scaled(lambda t, q, w, p: [-2.0 * x for x in w]),
    ],
)
def test_a_scene_computes_what_the_users_function_does(function):
    """Or it refuses the function."""
    try:
        made = user_function(function, "torque", 0)
    except TypeError as error:
        assert "not compiled" in str(error)  # noqa: PT017
        return
    for point in POINTS:
        np.testing.assert_allclose(made.call(*point), function(*point), rtol=1e-12)


# what Python has and machine code has not: whole numbers of any size, and Ctrl-C


def factorial(n):
    k = 1
    for i in range(1, n + 1):
        k *= i
    return k


def fibonacci(n):
    a, b = 0, 1
    for _ in range(n):
        a, b = b, a + b
    return a


def below(n):
    k = 0
    for i in range(n):
        k -= i**9
    return k


def shifted(n):
    k = 1
    for _ in range(n):
        k = (k << 1) | 1
    return k


def drawn(n):
    """No number beyond 64 bits."""
    k = 1
    for _ in range(n):
        k = (k * 1103515245 + 12345) % 2**31
    return k


def inverse(n):
    return 1000 * 2**-n


def rounded(n):
    return round(1e16 * n) + round(0.12345 * n, 3)


@pytest.mark.parametrize(
    "whole",
    [factorial, fibonacci, below, shifted, drawn, inverse, rounded],
    ids=lambda f: f.__name__,
)
def test_whole_numbers_are_pythons_or_nan(whole):
    def torque(t, q, w, p):
        return (whole(int(halved(t) + t)) % 1000003) * 1.0, 0.0, 0.0

    try:
        made = user_function(torque, "torque", 0)
    except TypeError as error:
        assert "other values than in Python" in str(error)  # noqa: PT017
        return
    assert not made.followed
    few, many = made.call(2.0, *POINTS[0][1:])[0], made.call(1000.0, *POINTS[0][1:])[0]
    assert few == torque(2.0, *POINTS[0][1:])[0]
    assert np.isnan(many) or many == torque(1000.0, *POINTS[0][1:])[0]


def test_a_loop_without_an_end_is_no_number():
    def torque(t, q, w, p):
        while t > 5.0:
            t += 1.0
        return t, 0.0, 0.0

    made = user_function(torque, "torque", 0)
    assert made.call(4.0, *POINTS[0][1:])[0] == 4.0
    assert np.isnan(made.call(6.0, *POINTS[0][1:])).all()
