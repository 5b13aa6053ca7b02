"""Hostile values in place of good ones, and what is wrong with what a call then gives.

A call passes when it gives back finite numbers and unit attitudes, of each body with status 0, or
refuses in one line that names an argument. Anything else is a finding: another exception, a warning
but ``StepWarning`` and that of a status, more than 5 s.
"""

import datetime as dt
import math
import random
import re
import time
import warnings
from decimal import Decimal
from fractions import Fraction

import numpy as np

import fastatt as fa

SLOW = 20.0  # s of the processor, in which a call of theirs returns or is refused on any machine
SPECIAL = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 1e-310, 1e-300, 1e-160, 1e-154,
    1e154, 1e160, 1e300, 1e308, -1e308, 1.7976931348623157e308, 1e38, 1e39, 1e-38, 1e-45, 1e16,
    2.0**53, 2.0**63, math.pi, 2.0 * math.pi, 1e6,
)  # fmt: skip


class Anything:
    """No number, no array."""


class Indexed:
    """A whole number by its own word."""

    def __index__(self):
        return 3


class Sparse:
    """Two-dimensional by its shape alone, as sparse matrices are."""

    shape = (2, 4)
    ndim = 2

    def toarray(self):
        return np.ones((2, 4))


ODD = (
    None, "", "1", "0.5", "nan", "north", b"\x00\xff", True, False, 1j, 1 + 0j, [], (), {}, {1: 2},
    set(), Ellipsis, NotImplemented, Anything, Anything(), Indexed(), Sparse(), len, np, range(4),
    10**400, -(10**400), 2**63, 2**64, Decimal("1.5"), Decimal("NaN"), Fraction(1, 3),
    dt.date(2020, 1, 1), dt.timedelta(1), np.datetime64("2020-01-01"),
    np.timedelta64(5, "s"), np.float16(2.0), np.longdouble(3.0), np.longdouble("1e4000"),
    np.int8(3), np.uint64(2**64 - 1), np.bool_(True), np.str_("x"), np.void(b"abcd"),
    np.array(0.1), np.array([0.1]), np.array([[0.1]]), np.array(None), np.array("x"),
    np.array([], dtype=float), np.zeros((0, 4)), np.zeros((0, 3)), np.ma.masked,
    np.array([(1.0, 2)], dtype=[("a", "f8"), ("b", "i4")]), [[1.0], [1.0, 2.0]], [1.0, None],
    ["a", "b", "c", "d"], [[[]]], [math.nan], np.eye(3).view(np.matrix), {"q": 1.0},
    slice(3), memoryview(b"12345678"), bytearray(8), frozenset({1}), "a\nb", Exception("x\ny"),
)  # fmt: skip
WHOLE = (0, -1, 1, 2, -(2**70), 2.0, 1.5, "3", None, True, math.nan, Indexed(), np.uint8(3), [1])
WORDS = (
    "", "RK4", "rk4 ", "rk4\n", "quat", "output", "body", "hold", "\u2028", "x" * 5000, b"rk4", 4,
    None, ("rk4",), ["rk4"], True, Anything, {}, np.str_("rk4"),
)  # fmt: skip
DRESSES = (
    lambda x: x.astype(np.float32),
    lambda x: x.astype(np.float16),
    lambda x: x.astype(np.longdouble),
    lambda x: x.astype(">f8"),
    lambda x: x.astype(">f4"),
    np.asfortranarray,
    lambda x: np.repeat(x, 2, axis=-1)[..., ::2] if x.ndim else x,
    lambda x: x[::-1] if x.ndim else x,
    lambda x: np.broadcast_to(x, (2, *x.shape)),
    lambda x: np.nan_to_num(x, posinf=9, neginf=-9).clip(-9, 9).astype(np.int64),
    lambda x: x.astype(object),
    lambda x: x.astype(complex),
    lambda x: x > 0,
    lambda x: x.astype(str),
    lambda x: tuple(x) if x.ndim else x,
    lambda x: np.nan_to_num(x).clip(0, 9).astype("M8[s]"),
    lambda x: x.astype(np.longdouble) * np.longdouble("1e4000"),
    lambda x: np.ma.array(x, mask=np.arange(x.size).reshape(x.shape) % 2),
    lambda x: [*x.tolist()[1:], [None]] if x.ndim else x,
)


class Draw:
    """Hostile values, of one seed."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.random = random.Random(seed)

    def one(self, values):
        return self.random.choice(values)

    def instead_of(self, good):
        """Something of about the kind of a good value, or of no kind."""
        if self.random.random() < 0.1:
            return self.one(ODD)
        if isinstance(good, str):
            return self.one(WORDS)
        if isinstance(good, int):
            return self.one(WHOLE)
        if isinstance(good, (float, list, tuple, np.ndarray)):
            return self.dressed(self.numbers(np.resize(good, self.shape(np.shape(good)))))
        return self.one(ODD)

    def shape(self, shape):
        """The same, or one with an axis more, less, longer, empty, or with a row for each body."""
        shape, how, axis = list(shape), self.random.randrange(30), self.random.randrange(3)
        if how == 0:
            shape.insert(axis, self.one((0, 1, 2, 3)))
        elif how == 1:
            shape = shape[1:]
        elif how < 4 and axis < len(shape):
            shape[axis] = 0 if how == 2 else shape[axis] + 1
        elif how < 8:
            shape.insert(0, 2)
        return shape

    def numbers(self, x):
        """The same floats, of wild sizes, or with special numbers among them."""
        x = np.array(x, float)
        kind = self.random.randrange(12)
        if kind == 0:
            x *= 10.0 ** self.rng.uniform(-308, 307)
        elif kind == 1:
            x *= 10.0 ** self.rng.integers(-300, 300, size=x.shape)
        elif kind < 6 and x.size:
            for _ in range(self.one((1, 1, 2, x.size))):
                x.flat[self.random.randrange(x.size)] = self.one(SPECIAL)
        elif kind == 6:
            x[...] = self.one(SPECIAL)
        elif kind == 7:
            x = np.array(self.rng.standard_normal(x.shape))
        return x

    def dressed(self, x):
        if self.random.random() < 0.5:
            return self.one((x, x.tolist()))
        return self.one(DRESSES)(x)


# what is wrong with a result, or None


def wrong_with(result, given):
    if isinstance(result, fa.Trajectory):
        return wrong_with_run(result, is_raw=given.get("normalise") == "never")
    if isinstance(result, fa.Scene):
        finite = np.isfinite(result.packed(None).params).all()
        return None if finite else "parameters not finite"
    if isinstance(result, tuple):  # a closed form's: squares of momenta overflow, and angles
        fastest, last = (float(np.abs(np.array(given[x], float)).max()) for x in ("w0", "t"))
        is_lost = fastest > 1e50 or fastest * last > 1e16
        return None if is_lost else wrong_with_attitudes(result[0])
    return wrong_with_attitudes(result)


def wrong_with_attitudes(q, tolerance=None):
    if not isinstance(q, np.ndarray) or q.shape[-1:] != (4,):
        return None
    if not np.isfinite(q).all():
        return "attitudes not finite"
    far = np.abs(np.linalg.norm(q.astype(np.float64), axis=-1) - 1.0).max(initial=0.0)
    allowed = tolerance or 64.0 * float(np.finfo(q.dtype).eps)
    return f"attitudes not unit, by {far:.0e}" if far > allowed else None


def wrong_with_run(run, *, is_raw):
    """Every body with status 0 is finite, and its attitudes are unit, but for ``raw`` ones."""
    fine = run.status == 0
    for name in ("q", *run.carried):
        x = getattr(run, name)
        x = x[:, None] if run.one_body else x
        if not np.isfinite(x[:, fine]).all():
            return f"status 0, {name} not finite"
    q = run.q[:, None] if run.one_body else run.q
    return wrong_with_attitudes(q[:, fine], 1e-2 if is_raw else None)


def wrong_with_refusal(error, names):
    text = str(error)
    if isinstance(error, OSError):
        return None
    if not isinstance(error, (TypeError, ValueError)):
        return f"{type(error).__name__}: {text[:110]!r}"
    if len(text.splitlines()) != 1:
        return f"{type(error).__name__} of several lines: {text[:10]!r}"
    if len(text) > 1500:
        return f"{type(error).__name__} of {len(text)} characters: {text[:10]!r}"
    if not re.search(rf"(?<!\w)({'|'.join(map(re.escape, names))})(?!\w)", text):
        return f"{type(error).__name__} names no argument: {text[:90]!r}"
    return None


def tried(function, given, names):
    """("returned" or "refused", what is wrong or None)."""
    began = time.process_time()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            result = function(**given)
        except (Exception, SystemExit) as error:  # noqa: BLE001
            outcome, wrong = "refused", wrong_with_refusal(error, names)
        else:
            outcome, wrong = "returned", wrong_with(result, given)
    took = time.process_time() - began
    for w in said:
        if not (issubclass(w.category, fa.StepWarning) or str(w.message).startswith("status: ")):
            wrong = wrong or f"{w.category.__name__}: {str(w.message)[:60]!r}"
    if took > SLOW:
        wrong = wrong or f"takes {took:.0f} s"
    return outcome, wrong
