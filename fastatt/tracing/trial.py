"""Comparison of followed functions with Python, on both sides of each condition."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.tracing.kept import ARITHMETIC, Kept
from fastatt.tracing.nodes import TraceError, operands
from fastatt.tracing.paths import Followed
from fastatt.tracing.source import evaluated

Numbers = NDArray[np.float64]
#: the smallest and the largest value of a number
Range = tuple[float, float]
#: of a result, relative to the largest of its numbers; a wrong formula differs by far more
_TOLERANCE = 1e-9
_USUAL, _POINTS, _FIRST = 8, 512, 4
#: numbers beyond which no condition is tried
_LARGEST = 1e100
#: the smallest and the largest result of operations
_RANGES = {
    "sin": (-1.0, 1.0), "cos": (-1.0, 1.0), "atan2": (-math.pi, math.pi), "cosh": (1.0, math.inf),
    "asin": (-2.0, 2.0), "acos": (0.0, math.pi), "hypot": (0.0, math.inf), "sqrt": (0.0, math.inf),
}  # fmt: skip
#: operations whose extremes are at the ends of their arguments' ranges
_MONOTONE = (
    "+", "-", "*", "/", "//", "neg", "floor", "ceil", "trunc", "rint", "tanh", "sign", "atan",
    "exp", "min", "max", "minimum", "maximum", "fmin", "fmax",
)  # fmt: skip


class Arguments(NamedTuple):
    """How many numbers the arguments after the time have: a unit quaternion or none, others, p."""

    unit: int
    others: int
    params: int


def points(given: Arguments, params: Numbers | None, span: Any = (0.0, 10.0)) -> Numbers:
    """Arguments of usual sizes to try a function with, (n, numbers)."""
    rng, n = np.random.default_rng(8), _USUAL
    t = rng.uniform(span[0], span[1], (n, 1))
    t[0] = span[0]
    q, v = rng.normal(size=(n, given.unit)), rng.normal(size=(n, given.others))
    p = rng.uniform(0.5, 1.5, (n, given.params))
    if params is not None and params.size:
        p = np.atleast_2d(params)[np.arange(n) * len(np.atleast_2d(params)) // n]
    return np.concatenate([t, _unit(q), v, p], axis=1)


def _unit(q: Numbers) -> Any:
    return q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-300)


def _many(kept: Kept, given: Arguments, usual: Numbers) -> Numbers:
    """Arguments of many sizes, some of them numbers of the function: the usual ones, and others."""
    rng, n = np.random.default_rng(7), _POINTS
    q, p = slice(1, 1 + given.unit), slice(1 + given.unit + given.others, None)
    constants = {float(node.args[0]) for node in kept.nodes if node.op == "const"}
    tables = [x for data in kept.tables.values() for x in data[:2]]
    known = [x for x in (*constants, *tables) if np.isfinite(x) and abs(x) < 1e15]
    pool = np.array(sorted({0.0, 1.0, *known, *(-x for x in known)}))
    pool = np.concatenate([pool, 0.5 * (pool[1:] + pool[:-1])])  # and between them
    x = rng.normal(size=(n, usual.shape[1])) * 10.0 ** rng.uniform(-3.0, 3.5, (n, 1))
    x[3::4] *= x[3::4] ** 2  # far smaller and larger ones
    x[:, 0] = np.abs(x[:, 0])
    x[::7, 0] = np.floor(x[::7, 0])
    params = usual[rng.integers(0, len(usual), n), p]
    with np.errstate(over="ignore"):
        x[:, p] = np.where(np.arange(n)[:, None] < n // 2, params, params * x[:, p])
    drawn = rng.random(x.shape) < 0.12
    x[drawn] = rng.choice(pool, drawn.sum()) * rng.choice((1.0, 2.0), drawn.sum())
    x[5::29, q.stop : p.start] = 0.0
    x[:, q] = _unit(x[:, q])
    x[1::8, q] = _unit(np.rint(x[1::8, q]))
    x[:_USUAL] = usual
    return x


def check(
    followed: Followed,
    given: Arguments,
    usual: Numbers,
    in_python: Callable[[Sequence[float]], Sequence[float]],
) -> None:
    """Raise ``TraceError`` for a function with other values than Python, or an untried condition.

    ``in_python`` gives the results of a point, and raises what the user's function raises.
    """
    x = _many(followed.kept, given, usual)
    values = followed.kept.evaluate(x.T)
    columns = [np.broadcast_to(values[i], len(x)) for i in followed.kept.results]
    results = np.stack(columns, axis=-1).astype(float)
    sides = _sides(followed, values, len(x))
    with np.errstate(all="ignore"):
        possible = _possible(followed, given)
    if not all(sides[key].any() for key in possible):
        raise TraceError("a condition of which no trial met both sides")
    chosen = sorted({int(sides[key].argmax()) for key in possible}.union(range(_FIRST)))
    compared = [agrees(x[i], results[i], in_python) for i in chosen]
    # such as a division by a parameter that is given as 0
    others = range(_USUAL, len(x))
    if not any(compared) and not any(agrees(x[i], results[i], in_python) for i in others):
        raise TraceError("an error in Python at every point where it was tried")


def _ranges(followed: Followed, given: Arguments) -> dict[int, Range]:
    """The smallest and the largest value of each node that conditions depend on."""
    nodes, known = followed.kept.nodes, dict[int, Range]()
    needed = followed.chosen.union(at for path in followed.paths for at, _ in path)
    for k in reversed(range(len(nodes))):
        needed.update(operands(nodes[k]) if k in needed else ())
    for k in sorted(needed):
        node = nodes[k]
        of = [known[i] for i in operands(node)]
        found = _RANGES.get(node.op, (-math.inf, math.inf))
        if node.op == "in" and 0 < node.args[0] <= given.unit:
            found = -1.0, 1.0
        elif node.op == "gather":
            found = node.args[0].data.min(), node.args[0].data.max()
        elif node.op == "const" or node.op in _MONOTONE:
            ends = [float(evaluated(node, x)) for x in itertools.product(*of)]
            if node.op in ("*", "/"):  # of zero and infinity
                ends = [0.0 if math.isnan(x) else x for x in ends]
            ends = [x for x in ends if not math.isnan(x)] or [-math.inf, math.inf]
            found = min(ends), max(ends)
            if node.op == "*" and node.args[0] == node.args[1]:
                found = max(0.0, found[0]), found[1]
            elif node.op in ("/", "//") and of[1][0] <= 0.0 <= of[1][1]:
                found = -math.inf, math.inf
        elif node.op == "abs":
            found = max(0.0, of[0][0], -of[0][1]), max(-of[0][0], of[0][1])
        elif node.op == "select":
            found = min(of[1][0], of[2][0]), max(of[1][1], of[2][1])
        elif node.op in ("%", "fmod"):
            size = max(-of[1][0], of[1][1])
            found = (0.0 if node.op == "%" and of[1][0] > 0.0 else -size), size
        elif node.op == "pow" and nodes[node.args[1]].args[0] % 2 == 0.0:
            found = 0.0, math.inf
        most = math.inf if node.op == "const" else _LARGEST
        known[k] = max(found[0], -most), min(found[1], most)
    return known


def _possible(followed: Followed, given: Arguments) -> set[tuple[int, bool]]:
    """The sides of conditions that numbers can meet, from the ranges of what is compared.

    On a path the answers before a condition narrow the ranges.
    """
    nodes, known = followed.kept.nodes, _ranges(followed, given)
    paths = [*followed.paths, *([(at, x)] for at in followed.chosen for x in (True, False))]
    sides = set()
    for path in paths:
        here: dict[int, Range] = {}
        for at, answer in path:
            op, (i, j) = nodes[at].op, nodes[at].args
            a, b = here.get(i, known[i]), here.get(j, known[j])
            if answer not in _answers(op, a, b, same=i == j):
                break
            sides.add((at, answer))
            if (op in ("<", "<=")) == answer and op not in ("==", "!="):
                here[i], here[j] = (a[0], min(a[1], b[1])), (max(a[0], b[0]), b[1])
            elif op not in ("==", "!="):
                here[i], here[j] = (max(a[0], b[0]), a[1]), (b[0], min(a[1], b[1]))
    return {(at, answer) for at, answer in sides if at in followed.conditions}


def _answers(op: str, a: Range, b: Range, *, same: bool) -> set[bool]:
    """Whether two numbers of given ranges may compare so."""
    pairs = [(0.0, 0.0)] if same else itertools.product(a, b)
    ends = {bool(ARITHMETIC[op](*pair)) for pair in pairs}
    apart = a[1] < b[0] or b[1] < a[0] or same
    return ends if apart or op not in ("==", "!=") else {True, False}


def _sides(followed: Followed, values: Sequence[Any], n: int) -> dict[tuple[int, bool], Any]:
    """Where each side of each condition is met on the path that is taken."""
    asked = followed.chosen.union(at for path in followed.paths for at, _ in path)
    holds = {(at, True): np.broadcast_to(values[at], n) for at in asked}
    holds |= {(at, False): ~x for (at, _), x in holds.items()}
    found = {key: x if key[0] in followed.chosen else np.zeros(n, bool) for key, x in holds.items()}
    for path in followed.paths:
        here = np.ones(n, bool)
        for key in path:
            here = here & holds[key]
            found[key] = found[key] | here
    return found


def agrees(point: Numbers, found: Numbers, in_python: Any) -> bool:
    """Whether a point was compared; raises ``TraceError`` for other results than Python's."""

    def asked(factor: float) -> Numbers | None:
        try:
            with np.errstate(all="ignore"):
                return np.array(in_python((factor * point).tolist()), float)
        except TraceError:
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
    raise TraceError("other values than in Python")


def close(true: Numbers, found: Numbers, bound: float | None = None) -> bool:
    """Whether results are equal to rounding, or to a bound."""
    finite = np.isfinite(true)
    if bound is None or not bound < np.inf:
        bound = _TOLERANCE * np.abs(true[finite]).max(initial=0.0)
    other = (true == found) | (np.isnan(true) & np.isnan(found))
    return bool(np.where(finite, np.abs(true - found) <= bound, other).all())
