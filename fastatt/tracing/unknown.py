"""Numbers that are not known, and the recorder of their operations."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from fastatt.tracing.graph import Graph
from fastatt.tracing.nodes import COMPARISONS, TraceError
from fastatt.tracing.operations import OPERATIONS
from fastatt.tracing.recording import Table

#: operations beyond which a function is called, since LLVM compiles more in minutes
MOST_OPERATIONS, MOST_ASKED = 5000, 200
#: about how many operations of a processor each takes
_COSTS = {op: x.cost for op, x in OPERATIONS.items()}
_COSTS |= {"const": 0, "in": 0, "item": 0, "look": 45, "gather": 1}


class Recorder:
    """Operations that are recorded, and the answers of the current path."""

    def __init__(self) -> None:
        self._graph, self._cost = Graph(), 0
        self.nodes = self._graph.nodes
        #: conditions that are not asked, since both branches are recorded
        self.chosen: set[int] = set()
        #: conditions without which Python raises an error
        self.guards: set[int] = set()
        #: the last error that ended a path
        self.error: Exception | None = None
        self.begin([])

    def begin(self, forced: list[bool]) -> None:
        """Begin a path whose first answers are given; further ones are yes."""
        self.answers: dict[int, bool] = {}
        self.forced, self.asked, self.texts = forced, 0, False
        #: choices within which no condition may be asked
        self.silent = 0
        #: arrays that were chosen, and what they held
        self.unchanged: list[tuple[Any, Any]] = []

    def add(self, op: str, *args: Any) -> int:
        """The number of an operation, which is added if it is new."""
        n, number = len(self.nodes), self._graph.add(op, "", *args)
        self._cost += _COSTS[op] * (len(self.nodes) - n)
        if self._cost > MOST_OPERATIONS:
            raise TraceError(f"more than {MOST_OPERATIONS} operations")
        return number

    def number(self, x: Any) -> int:
        """The number of the operation that gives x."""
        if isinstance(x, np.ndarray) and x.ndim == 0:
            x = x[()]
        if isinstance(x, Unknown):
            return x.at
        if not isinstance(x, (int, float, np.integer, np.floating, np.bool_)):
            raise TraceError(f"arithmetic with {type(x).__name__}")
        # functions with NaN must be equal to themselves
        is_nan = math.isnan(x)
        return self.unknown("-", math.inf, math.inf).at if is_nan else self.add("const", float(x))

    def decide(self, at: int) -> bool:
        """The answer of this path to a condition."""
        self.asked += 1
        if self.silent:
            raise TraceError("a condition within a choice")
        if self.asked > 20 * MOST_ASKED or len(self.answers) > MOST_ASKED:
            raise TraceError("a loop whose end is not known, or more than 200 branches in a row")
        if at not in self.answers:
            k = len(self.answers)
            self.answers[at] = self.forced[k] if k < len(self.forced) else True
        return self.answers[at]

    def guard(self, op: str, a: Any, b: Any, error: type[Exception]) -> None:
        """Raise an error, as Python does, unless a comparison holds."""
        condition = self.add(op, self.number(a), self.number(b))
        self.guards.add(condition)
        if not self.decide(condition):
            raise error

    def unknown(self, op: str, *args: Any, whole: bool = False) -> Unknown:
        """The number that an operation of numbers gives."""
        return self.at(self.add(op, *map(self.number, args)), whole=whole)

    def at(self, at: int, *, whole: bool = False) -> Unknown:
        """The number of an operation."""
        number = object.__new__(Unknown)
        number.recorder, number.at, number.whole = self, at, whole
        return number

    def choice(self, test: int, a: Any, b: Any) -> Unknown:
        """a if a condition holds, else b."""
        x, y = self.number(a), self.number(b)
        chosen = x if x == y else self.add("select", test, x, y)
        return self.at(chosen, whole=is_whole(a) and is_whole(b))

    def choose(self, op: str, a: Any, b: Any, yes: Any, no: Any) -> Unknown:
        """``yes`` if a comparison holds, else ``no``."""
        return self.choice(self.add(op, self.number(a), self.number(b)), yes, no)

    def gather(self, data: Any, place: Any, *, whole: bool = False) -> Unknown:
        """The number of an array at a place."""
        return self.at(self.add("gather", Table(data), self.number(place)), whole=whole)

    def look_up(self, table: Any, size: int, t: Any, row: Any) -> tuple[Unknown, ...]:
        """The numbers of a ``TimeSeries`` at t in a row."""
        look = self.add("look", table, self.number(t), self.number(row))
        return tuple(self.at(self.add("item", look, k)) for k in range(size))


def is_whole(x: Any) -> bool:
    """Whether Python has a number as a whole one."""
    return x.whole if isinstance(x, Unknown) else isinstance(x, (int, np.integer))


def is_number(x: Any) -> bool:
    """Whether a value is a number, unknown or not, and no truth value."""
    return isinstance(x, (Unknown, int, float, np.number)) and not isinstance(x, bool)


def _binary(op: str, *, turned: bool = False) -> Callable[[Any, Any], Any]:
    def operate(a: Unknown, b: Any) -> Any:
        if isinstance(b, np.ndarray):
            return NotImplemented
        pair = (b, a) if turned else (a, b)
        stays = op != "/" and a.whole and is_whole(b)
        if stays and op in ("//", "%"):
            a.recorder.guard("!=", pair[1], 0.0, ZeroDivisionError)
        return a.recorder.unknown(op, *pair, whole=stays)

    return operate


def _compare(op: str) -> Callable[[Any, Any], Any]:
    def compare(a: Unknown, b: Any) -> Any:
        if not isinstance(b, (Unknown, int, float, np.number)):
            return NotImplemented
        return a.recorder.decide(a.recorder.add(op, a.at, a.recorder.number(b)))

    return compare


def _wanted(what: str) -> Callable[..., NoReturn]:
    def no(*_: Any, **__: Any) -> NoReturn:
        raise TraceError(f"a number that is not known beforehand, where Python wants {what}")

    return no


def _text(x: Unknown, *_: Any) -> str:
    """The text of an unknown number: refused, but for that of an error."""
    x.recorder.texts = True
    return "?"


def whole(op: str, x: Unknown) -> Unknown:
    """A whole number of x; Python has none of NaN and infinity."""
    if x.whole:
        return x
    x.recorder.guard("<", abs(x), math.inf, OverflowError)
    return x.recorder.unknown(op, x, whole=True)


class Unknown:
    """A number that is not known: it has nothing but arithmetic and comparisons."""

    __slots__ = ("at", "recorder", "whole")
    at: int
    recorder: Recorder
    #: whether it is a whole number in Python
    whole: bool

    def __pow__(self, power: Any) -> Any:
        if isinstance(power, np.ndarray):
            return NotImplemented
        known = isinstance(power, (int, float, np.number)) and abs(float(power)) <= 64
        if not known or 2 * power != int(2 * power):
            raise TraceError("a power that is not known: a whole one or a half, up to 64")
        stays = self.whole and is_whole(power) and bool(float(power) >= 0.0)
        return self.recorder.unknown("pow", self, power, whole=stays)

    __rpow__ = _wanted("a known power")

    __neg__ = lambda self: self.recorder.unknown("neg", self, whole=self.whole)  # noqa: E731
    __abs__ = lambda self: self.recorder.unknown("abs", self, whole=self.whole)  # noqa: E731
    __divmod__ = lambda self, other: (self // other, self % other)  # noqa: E731
    __rdivmod__ = lambda self, other: (other // self, other % self)  # noqa: E731

    def __round__(self, digits: int | None = None) -> Any:
        if digits is not None:
            raise TraceError("round to some digits")
        return whole("rint", self)

    __hash__ = _wanted("a key of a dictionary or a set")
    __pos__ = lambda self: self  # noqa: E731
    __bool__ = lambda self: bool(self != 0.0)  # noqa: E731
    __floor__ = lambda self: whole("floor", self)  # noqa: E731
    __ceil__ = lambda self: -whole("floor", -self)  # noqa: E731
    __trunc__ = lambda self: whole("trunc", self)  # noqa: E731
    __float__ = __complex__ = _wanted("a float")
    __int__ = __index__ = _wanted("a whole one")
    __str__ = __repr__ = __format__ = _text
    __reduce_ex__ = _wanted("to copy it")


for _op in ("+", "-", "*", "/", "//", "%"):
    _name = OPERATIONS[_op].traced.__name__
    setattr(Unknown, f"__{_name}__", _binary(_op))
    setattr(Unknown, f"__r{_name}__", _binary(_op, turned=True))
for _op in COMPARISONS:
    setattr(Unknown, f"__{OPERATIONS[_op].traced.__name__}__", _compare(_op))
