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
