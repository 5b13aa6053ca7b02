"""Hostile values, of one seed."""

from __future__ import annotations

import datetime as dt
import math
import random
from collections.abc import Callable, Iterable
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fastatt as fa

ONE = (1.0, 0.0, 0.0, 0.0)
SPECIAL = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 1e-310, 1e-300, 1e-160, 1e-154,
    1e154, 1e160, 1e300, 1e308, -1e308, 1.7976931348623157e308, 1e38, 1e39, 1e-38, 1e-45, 1e16,
    2.0**53, 2.0**63, math.pi, 2.0 * math.pi, 1e6,
)  # fmt: skip


class Anything:
    """No number, no array."""


class Indexed:
    """A whole number by its own word."""

    def __index__(self) -> int:
        return 3


class Sparse:
    """Two-dimensional by its shape alone, as sparse matrices are."""

    shape = (2, 4)
    ndim = 2

    def toarray(self) -> NDArray[np.float64]:
        return np.ones((2, 4))


ODD: tuple[Any, ...] = (
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
WORDS: tuple[Any, ...] = (
    "", "RK4", "rk4 ", "rk4\n", "magnus4", "quat", "dcm", "output", "body", "hold", "exact",
    "\u2028", "x" * 5000, b"rk4", 4, None, ("rk4",), ["rk4"], True, Anything, {}, np.str_("rk4"),
)  # fmt: skip


NO_METHODS = [w for w in WORDS if not (w is None or (isinstance(w, str) and w in fa.METHODS))]


class Draw:
    """Hostile values, of one seed."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.random = random.Random(seed)

    def one(self, values: Iterable[Any]) -> Any:
        return self.random.choice(list(values))

    def chance(self, p: float) -> bool:
        return self.random.random() < p

    def numbers(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Floats of a shape: tame, of wild sizes, or with a special number among them."""
        x = np.asarray(self.rng.standard_normal(shape))
        kind = self.random.random()
        if kind < 0.15:
            x *= 10.0 ** self.rng.uniform(-308, 307)
        elif kind < 0.25:
            x *= 10.0 ** self.rng.integers(-300, 300, size=shape)
        elif kind < 0.5 and x.size:
            for _ in range(self.one((1, 1, 2, x.size))):
                x.flat[self.random.randrange(x.size)] = self.one(SPECIAL)
        elif kind < 0.55:
            x[...] = self.one(SPECIAL)
        elif kind < 0.6:
            x = np.asarray(np.round(x))
        return x

    def shape(self, shapes: Iterable[tuple[int, ...]]) -> tuple[int, ...]:
        """One of the shapes, or one with an axis more, less, longer or empty."""
        shape = list(self.one(shapes))
        if self.chance(0.12):
            how = self.random.randrange(5)
            at = self.random.randrange(len(shape) + 1)
            if how == 0:
                shape.insert(at, self.one((0, 1, 2, 3)))
            elif how == 1 and shape:
                shape.pop(at - 1)
            elif how == 2 and shape:
                shape[at - 1] += 1
            elif how == 3 and shape:
                shape[at - 1] = 0
            else:
                shape.reverse()
        return tuple(shape)

    def array(self, *shapes: tuple[int, ...]) -> Any:
        """Numbers of about one of these shapes, in any dress, or something that is none."""
        if self.chance(0.06):
            return self.one(ODD)
        return self.dressed(self.numbers(self.shape(shapes)))

    def dressed(self, x: NDArray[np.float64]) -> Any:
        dress = self.random.randrange(40)
        with np.errstate(all="ignore"):
            if dress < 12:
                return x
            if dress < 20:
                return x.tolist()
            if dress in _DRESSES:
                return _DRESSES[dress](x)
        if dress == 36 and x.ndim and x.size:
            ragged = x.tolist()
            ragged[self.random.randrange(len(ragged))] = self.one(([], None, "x", [1.0]))
            return ragged
        if dress == 37:
            return np.ma.array(x, mask=self.rng.random(x.shape) < 0.5)
        return x

    def real(self, tame: float = 0.1) -> Any:
        """A number of about the size of ``tame``, or not."""
        kind = self.random.random()
        if kind < 0.55:
            return tame * self.random.uniform(0.1, 3.0)
        if kind < 0.7:
            return self.one(SPECIAL)
        if kind < 0.8:
            return self.random.choice((-1, 1)) * 10.0 ** self.random.uniform(-308, 308)
        if kind < 0.9:
            return self.one((np.float32, np.float64, np.float16, Decimal, str, np.array))(tame)
        return self.one(ODD)

    def whole(self, most: int = 5) -> Any:
        """A whole number of at most ``most``, or not a number."""
        if self.chance(0.8):
            return self.one((int, int, np.int64, np.uint8))(self.random.randrange(1, most + 1))
        return self.one((0, -1, -(2**70), 2.0, 1.5, "3", None, True, math.nan, Indexed(), 1j, [1]))

    def word(self, *words: str) -> Any:
        return self.one(words) if self.chance(0.9) else self.one(WORDS)


_DRESSES: dict[int, Callable[[NDArray[Any]], Any]] = {
    20: lambda x: x.astype(np.float32),
    21: lambda x: x.astype(np.float16),
    22: lambda x: x.astype(np.longdouble),
    23: lambda x: x.astype(">f8"),
    24: lambda x: x.astype(">f4"),
    25: lambda x: np.asfortranarray(x),
    26: lambda x: np.repeat(x, 2, axis=-1)[..., ::2] if x.ndim else x,
    27: lambda x: x[::-1] if x.ndim else x,
    28: lambda x: _read_only(x),
    29: lambda x: np.nan_to_num(x, posinf=9, neginf=-9).clip(-9, 9).astype(np.int64),
    30: lambda x: x.astype(object),
    31: lambda x: x.astype(complex),
    32: lambda x: x > 0,
    33: lambda x: x.astype(str),
    34: lambda x: tuple(x) if x.ndim else x,
    35: lambda x: np.nan_to_num(x).clip(0, 9).astype("M8[s]"),
    38: lambda x: x.astype(np.longdouble) * np.longdouble("1e4000"),
    39: lambda x: np.broadcast_to(x, (2, *x.shape)),
}


def _read_only(x: NDArray[Any]) -> NDArray[Any]:
    x.flags.writeable = False
    return x
