"""Functions of users beside the users' own functions, whatever their values are."""

import dataclasses
import enum
import functools
import itertools
import operator
import time
import types
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from fastatt.tracing import frozen
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


def test_a_sum_of_whole_numbers_is_pythons_or_nan():
    """Numba sums in code of its own; no trial has numbers as large."""

    def torque(t, q, w, p):
        n = int(1e12 * t + 0.0 * halved(t))
        return float(sum([n, n])), sum((t, 1, w[0])), 0.0

    made, rest = user_function(torque, "torque", 0), POINTS[0][1:]
    assert not made.followed
    assert made.call(4e6, *rest) == torque(4e6, *rest)
    assert np.isnan(made.call(6e6, *rest)).all()


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


# attributes that functions of the user's give


class Colour(enum.Enum):
    RED = 2.0
    BLUE = 0.5

    def doubled(self):
        return 2.0 * self.value

    def now(self):
        return time.time()


class Level(enum.IntEnum):
    LOW = 1
    HIGH = 3

    def now(self):
        return time.time()


class Access(enum.Flag):
    READ, WRITE, RUN = 1, 2, 4


class Bits(enum.IntFlag):
    LOW, HIGH = 1, 2


DRAWN = [iter((1.0, 2.0))]


def drawn():
    return next(DRAWN[0])


def scaled(x):
    return scaled.gain * x


scaled.gain, scaled.clock, scaled.drawn = 0.5, time.time, drawn


def after_the_attribute(again):
    return lambda: scaled(1.0) + again()


class Row(NamedTuple):
    a: float
    b: float

    @property
    def total(self):
        return self.a + self.b

    def now(self):
        return time.time()


class Gain(float):
    def now(self):
        return time.time()


class Clock:
    def __get__(self, owner, cls):
        return time.time()


class Twice:
    def __get__(self, owner, cls):
        return 2.0 * cls.k


class Box:
    k, now, twice = 0.25, Clock(), Twice()
    power = staticmethod(functools.partial(pow, 2.0))

    def __getattr__(self, name):
        return {"gain": 3.0}[name]


class Late:
    def __getattr__(self, name):
        return time.time()


class Computed:
    def __getattribute__(self, name):
        return time.time()


COLOUR, LEVEL, ROW, GAIN = Colour.RED, Level.HIGH, Row(1.0, 2.0), Gain(4.0)
ACCESS, BITS = Access.READ | Access.RUN, Bits.LOW | Bits.HIGH
BOX, LATE, COMPUTED = Box(), Late(), Computed()
NUMBERS, PART = range(3), slice(0, 2)
LAZY = types.ModuleType("lazy")
LAZY.k, LAZY.__getattr__ = 3.0, lambda name: time.time()


@pytest.mark.parametrize(
    "value",
    [
        lambda: (COLOUR is Colour.RED) * COLOUR.value + 3.0 * (COLOUR == Colour.BLUE),
        lambda: {Colour.RED: 0.1, Colour.BLUE: 0.2}[COLOUR] + (COLOUR in {Colour.RED, Colour.BLUE}),
        lambda: Colour["BLUE"].doubled() + len(COLOUR.name),
        lambda: LEVEL * 0.5 + (LEVEL > Level.LOW) + LEVEL.value,
        lambda: ROW.total + ROW[0] * ROW.b + sum(ROW),
        lambda: 2.0 * GAIN + BOX.gain + BOX.k + BOX.twice + Box.twice + BOX.power(3.0),
        lambda: LAZY.k + sum(NUMBERS) + sum(ROW[PART]),
        lambda: 0.1 * bool(ACCESS & Access.READ) + (Access.WRITE in ACCESS) + (~ACCESS).value,
        lambda: (ACCESS == Access.READ | Access.RUN) + (BITS & Bits.HIGH) + (~BITS).value,
        lambda: scaled(3.0) + scaled.gain,
    ],
)
def test_values_with_functions_are_followed(value):
    made = user_function(lambda t, q, w, p: (value() * w[0], 0.0, 0.0), "torque", 0)
    assert made.followed, made
    assert made.call(*POINTS[0])[0] == pytest.approx(value() * POINTS[0][2][0], rel=1e-15)


@pytest.mark.parametrize(
    "value",
    [
        *(lambda: COLOUR.now(), lambda: LEVEL.now(), lambda: ROW.now(), lambda: GAIN.now()),
        *(lambda: scaled.clock(), lambda: halved(scaled.clock())),
        after_the_attribute(drawn),
        *(lambda: BOX.now, lambda: Box.now, lambda: LATE.time, lambda: COMPUTED.k, lambda: LAZY.t),
        *(lambda: Row(1.0, 2.0).now(), lambda: halved(BOX.now), lambda: halved(LEVEL.now())),
    ],
)
def test_no_clock_is_read_once(value):
    refused = r"may differ from call to call|; and not compiled: (a (type|Computed|module)|scaled)"
    with pytest.raises(TypeError, match=refused):
        user_function(lambda t, q, w, p: (1e-10 * value() - w[0], 0.0, 0.0), "torque", 0)


class Refuses:
    """Raises whatever it is asked for."""

    def __init__(self, error):
        self.__dict__["error"] = error

    def __getattr__(self, name):
        raise self.error

    def __call__(self, t, q, w, p):
        return -0.2 * w[0], 0.0, 0.0


@pytest.mark.parametrize("error", [KeyError("x"), AttributeError("x"), RuntimeError("x")])
def test_an_object_may_raise_anything(error):
    thing = Refuses(error)
    assert user_function(thing, "torque", 0).call(*POINTS[0])[0] == pytest.approx(-0.06)
    with pytest.raises(TypeError, match=r"^torque: .*; and not compiled: a Refuses"):
        user_function(lambda t, q, w, p: (thing.k, 0.0, 0.0), "torque", 0)


# libraries, dictionaries and arguments by name


TABLE = {0: 1.0, 1: 2.0, 2: 4.0}
SINGLE, SINGLES = np.float32(0.1), np.array([0.1, 0.2, 0.3], dtype=np.float32)


def by_name(x, *, k=2.0):
    return k * x


@pytest.mark.parametrize(
    "torque",
    [
        lambda t, q, w, p: (np.select([t < 1.0, w[0] < 9.0], [w[1], 2.0], 3.0), np.array(t), 0.0),
        lambda t, q, w, p: np.select([np.array(w) < 0.0, np.array(w) > 1.0], [t, w], 0.5),
        lambda t, q, w, p: (functools.reduce(lambda a, b: a * b, w), sum(itertools.chain(w)), 0.0),
        lambda t, q, w, p: (functools.reduce(operator.add, w, t), operator.neg(t), 0.0),
        lambda t, q, w, p: (TABLE[int(t) % 3], TABLE.get(int(t) % 5, 7.0), float(int(t) in TABLE)),
        lambda t, q, w, p, *, k=0.5: (k * w[0], by_name(t), by_name(t, k=k)),
        lambda t, q, w, p, *, k=0.5: (halved(t) * k, by_name(t), by_name(t, k=k)),
        lambda t, q, w, p: ({0: 1.0, 1: 2.0}[int(t) % 2], 0.0, 0.0),
        lambda t, q, w, p: (float(SINGLE) * t, 0.0, 0.0),
        lambda t, q, w, p: np.diag(SINGLES) @ np.array(w),
    ],
)
def test_what_libraries_and_dictionaries_give(torque):
    made = user_function(torque, "torque", 0)
    for t in (0.5, 1.5, 2.5, 6.5):
        point = (t, *POINTS[0][1:])
        np.testing.assert_allclose(made.call(*point), np.array([float(x) for x in torque(*point)]))


@pytest.mark.parametrize(
    ("torque", "message"),
    [
        (lambda t, q, w, p: (SINGLE * t, 0.0, 0.0), "other values than in Python, .* np.float32"),
        (lambda t, q, w, p: (SINGLES[0] * t, 0.0, 0.0), "than in Python, .* np.float32"),
        (lambda t, q, w, p: ("a", 0.0, 0.0), "a result that is tuple of 3 with str; accepted: 3"),
        (lambda t, q, w, p: np.ones((3, 1)), r"is ndarray of \(3, 1\) with ndarray; acc"),
        (lambda t, q, w, p: (BOX + t, 0.0, 0.0), "TypeError: a Box has no __add__"),
        (lambda t, q, w, p: {t: 1.0}[t], "not known beforehand, where Python wants a key"),
    ],
)
def test_messages_are_in_the_users_words(torque, message):
    with pytest.raises(TypeError, match=message):
        user_function(torque, "torque", 0)


def test_an_attribute_of_a_globals_name_is_no_global():
    box = Box()
    box.time = 3.0
    assert user_function(lambda t, q, w, p: (box.time * t, 0.0, 0.0), "torque", 0).followed


def test_instructions_of_a_newer_python_are_refused(monkeypatch):
    monkeypatch.setattr(frozen, "_NEWEST", (3, 10))
    with pytest.raises(TypeError, match=r"instructions of Python 3.*; accepted: Python 3.11 to 3"):
        user_function(lambda t, q, w, p: w, "torque", 0)
