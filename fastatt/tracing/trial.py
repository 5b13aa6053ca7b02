"""Comparison of followed functions with Python, on both sides of each condition."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt._jit import MOST_ROUNDS
from fastatt.tracing.nodes import Node, RefusedError, TraceError, operands
from fastatt.tracing.operations import AT_ENDS, OPERATIONS
from fastatt.tracing.paths import Followed
from fastatt.tracing.recording import Recording
from fastatt.tracing.source import evaluated

Numbers = NDArray[np.float64]
#: the smallest and the largest value of a number
Range = tuple[float, float]
#: of a result, relative to the largest of its numbers; a wrong formula differs by far more
_TOLERANCE = 1e-9
_USUAL, _POINTS, _FIRST = 8, 512, 4
#: numbers beyond which no condition is tried
_LARGEST = 1e100


class Arguments(NamedTuple):
    """How many numbers the arguments after the time have: a unit quaternion or none, others, p."""

    unit: int
    others: int
    params: int


def points(arguments: Arguments, params: Numbers | None, span: Any = (0.0, 10.0)) -> Numbers:
    """Arguments of usual sizes to try a function with, (n, numbers)."""
    rng, n = np.random.default_rng(8), _USUAL
    t = rng.uniform(span[0], span[1], (n, 1))
    t[0] = span[0]
    q, v = rng.normal(size=(n, arguments.unit)), rng.normal(size=(n, arguments.others))
    p = rng.uniform(0.5, 1.5, (n, arguments.params))
    if params is not None and params.size:
        p = np.atleast_2d(params)[np.arange(n) * len(np.atleast_2d(params)) // n]
    return np.concatenate([t, _unit(q), v, p], axis=1)


def _unit(q: Numbers) -> Any:
    return q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-300)


def larger(arguments: Arguments, usual: Numbers) -> Numbers:
    """Arguments of sizes up to some thousands."""
    x = many(Recording((), ()), arguments, usual)
    return x[_USUAL : 5 * _USUAL][np.arange(4 * _USUAL) % 4 < 3]


def many(recording: Recording, arguments: Arguments, usual: Numbers) -> Numbers:
    """Arguments of many sizes, some of them numbers of the function: the usual ones, and others."""
    rng, n = np.random.default_rng(7), _POINTS
    q, p = slice(1, 1 + arguments.unit), slice(1 + arguments.unit + arguments.others, None)
    constants = {float(node.args[0]) for node in recording.nodes if node.op == "const"}
    tables = [x for data in recording.tables.values() for x in data[:2]]
    known = [x for x in (*constants, *tables) if np.isfinite(x) and abs(x) < 1e15]
    pool = np.array(sorted({0.0, 1.0, *known, *(-x for x in known)}))
    pool = np.concatenate([pool, 0.5 * (pool[1:] + pool[:-1])])  # and between them
    x = rng.normal(size=(n, usual.shape[1])) * 10.0 ** rng.uniform(-3.0, 3.5, (n, 1))
    x[3::4] *= x[3::4] ** 2  # far smaller and larger ones
    x[:, 0] = 10.0 ** rng.uniform(-3.0, 3.5, n)
    params = usual[rng.integers(0, len(usual), n), p]
    x[:, p] = np.where(np.arange(n)[:, None] < n // 2, params, params * x[:, p])
    drawn = rng.random(x.shape) < 0.12
    x[drawn] = rng.choice(pool, drawn.sum())
    x[1::8, q] = np.rint(_unit(x[1::8, q]))
    x[:, q] = _unit(x[:, q])
    x[:_USUAL] = usual
    return x


def check(
    followed: Followed,
    arguments: Arguments,
    usual: Numbers,
    in_python: Callable[[Sequence[float]], Sequence[float]],
) -> None:
    """Raise ``TraceError`` for a function with other values than Python, or an untried condition.

    ``in_python`` gives the results of a point, and raises what the user's function raises.
    """
    x = many(followed.recording, arguments, usual)
    values = followed.recording.evaluate(x.T)
    results = followed.recording.results_of(values, len(x))
    sides = _sides(followed, values, len(x))
    possible = _possible(followed, arguments)
    met = [np.flatnonzero(sides[key]) for key in possible]
    if not all(x.size for x in met):
        raise TraceError("a condition of which no trial met both sides")
    chosen = {*range(_FIRST), *(int(i) for x in met for i in (x[0], x[x.size // 2], x[-1]))}
    compared = [agrees(x[i], results[i], in_python) for i in sorted(chosen)]
    # such as a division by a parameter that is arguments as 0
    others = range(_USUAL, len(x))
    if not any(compared) and not any(agrees(x[i], results[i], in_python) for i in others):
        raise TraceError("an error in Python at every point where it was tried")


@np.errstate(all="ignore")
def _possible(followed: Followed, arguments: Arguments) -> set[tuple[int, bool]]:
    """The sides of conditions that numbers can meet, from the ranges of what is compared.

    On a path the answers before a condition narrow the ranges.
    """
    nodes, known, sides = followed.recording.nodes, dict[int, Range](), set()
    needed = {condition for path in followed.paths for condition, _ in path}
    for k in reversed(range(len(nodes))):
        needed.update(operands(nodes[k]) if k in needed else ())
    for k in sorted(needed):
        known[k] = _range(nodes[k], known, arguments)
    for path in followed.paths:
        ranges = dict(known)
        for condition, answer in path:
            op, _, numbers = nodes[condition]
            low, high = _range(nodes[condition], ranges, arguments)
            if not low <= answer <= high:
                break
            sides.add((condition, answer))
            if op not in ("==", "!="):
                is_less = (op in ("<", "<=")) == answer
                below, above = numbers if is_less else numbers[::-1]
                (low, most), (least, high) = ranges[below], ranges[above]
                ranges[below], ranges[above] = (low, min(most, high)), (max(low, least), high)
    return {key for key in sides if key[0] in followed.conditions}


def _range(node: Node, known: dict[int, Range], arguments: Arguments) -> Range:
    """The smallest and the largest value of an operation; 0 is no and 1 is yes."""
    of = [known[i] for i in operands(node)]
    if node.op == "in" and 0 < node.args[0] <= arguments.unit:
        return -1.0, 1.0
    if node.op in ("const", "gather"):
        data = getattr(node.args[0], "data", node.args[0])
        return np.min(data), np.max(data)
    if node.op in ("%", "fmod"):
        size = max(-of[1][0], of[1][1])
        return -size * (node.op == "fmod" or of[1][0] <= 0.0), size
    bounds = OPERATIONS[node.op].bounds if node.op in OPERATIONS else (-_LARGEST, _LARGEST)
    if bounds is not AT_ENDS:
        return max(bounds[0], -_LARGEST), min(bounds[1], _LARGEST)
    # the signs of zero give both ends of a quotient
    ends = [(*x, -0.0, 0.0) if x[0] <= 0.0 <= x[1] else x for x in of]
    is_same = len({*operands(node)}) == 1
    corners: Any = np.array([*(zip(*ends, strict=True) if is_same else itertools.product(*ends))])
    values = np.ravel(evaluated(node, corners.T))
    values = values[~np.isnan(values)] if not np.isnan(values).all() else np.zeros(1)
    return max(values.min(), -_LARGEST), min(values.max(), _LARGEST)


def _sides(followed: Followed, values: Sequence[Any], n: int) -> dict[tuple[int, bool], Any]:
    """Where each side of each condition is met on the path that is taken."""
    sides: dict[tuple[int, bool], Any] = {}
    for path in followed.paths:
        here = np.ones(n, bool)
        for key in path:
            here = here & (np.broadcast_to(values[key[0]], n) == key[1])
            sides[key] = sides.get(key, False) | here
    return sides


def ending(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which raises an error after ``MOST_ROUNDS`` lines of Python."""

    def call(*args: Any) -> Any:
        lines, before = itertools.count(), sys.gettrace()

        def count(*_: Any) -> Any:
            if next(lines) == MOST_ROUNDS:
                raise OverflowError
            return count

        sys.settrace(count)
        try:
            return function(*args)
        finally:
            sys.settrace(before)

    return call


@np.errstate(all="ignore")
def agrees(point: Numbers, found: Numbers, in_python: Any) -> bool:
    """Whether a point was compared; raises ``TraceError`` for other results than Python's."""

    def asked(factor: float) -> Numbers | None:
        try:
            return np.array(in_python((factor * point).tolist()), float)
        except (TraceError, RefusedError):
            raise
        except (ArithmeticError, ValueError):  # IEEE's rules go on
            return None
        except Exception:  # noqa: BLE001
            return np.full_like(found, np.nan)

    true = asked(1.0)
    if true is None or close(true, found):
        return true is not None
    for factor in (1.0 - 1e-13, 1.0 + 1e-13):
        moved = asked(factor)
        # rounding of numbers that nearly cancel, or a condition near its border
        if moved is None or not close(true, moved, 1e-3 * np.abs(true - found).max()):
            return False
    such_as = "those of np.float32, or of a class with operators of its own"
    such_as = "NaN for whole numbers beyond 64 bits" if np.isnan(found).all() else such_as
    raise TraceError(f"other values than in Python, such as {such_as}")


def same(a: Numbers, b: Numbers) -> bool:
    """Whether two arrays of results, (n, results), are equal to rounding."""
    return all(close(x, y) for x, y in zip(a, b, strict=True))


def close(true: Numbers, found: Numbers, bound: float | None = None) -> bool:
    """Whether results are equal to rounding, or to a bound."""
    finite = np.isfinite(true)
    if bound is None or not bound < np.inf:
        bound = _TOLERANCE * np.abs(true[finite]).max(initial=0.0)
    other = (true == found) | (np.isnan(true) & np.isnan(found))
    return bool(np.where(finite, np.abs(true - found) <= bound, other).all())
