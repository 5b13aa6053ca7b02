"""``math``, ``numpy`` and Python's builtins as frozen functions find them."""

from __future__ import annotations

import builtins
import functools
import itertools
import math
import operator
import types
from collections.abc import Callable
from typing import Any

import numpy as np

from fastatt.tracing import frozen
from fastatt.tracing.graph import Recorded
from fastatt.tracing.nodes import COMPARISONS, TraceError
from fastatt.tracing.operations import FUNCTIONS, OPERATIONS
from fastatt.tracing.unknown import Unknown, is_whole, whole

#: NumPy's functions that multiply, add, ask, or move elements
_PASSED = frozenset((
    "append column_stack concatenate cross diag diagonal dot flip hstack inner matmul mean outer "
    "prod ravel reshape roll stack sum trace transpose vdot vstack copy atleast_1d squeeze cumsum "
    "any all argmax argmin sort kron tile ndim shape size"
).split())  # fmt: skip


def unknown_in(*values: Any) -> Any:
    """The first number that records among values, elements of sequences and of arrays."""
    for x in values:
        if isinstance(x, (Unknown, Recorded)):
            return x
        parts = x.flat if isinstance(x, np.ndarray) and x.dtype == object else x
        if isinstance(parts, (tuple, list, np.flatiter)):
            inner = unknown_in(*parts)
            if inner is not None:
                return inner
    return None


def each(f: Callable[..., Any], *values: Any) -> Any:
    """A function of numbers, applied to arrays that broadcast."""
    boxes = np.broadcast_arrays(*map(objects, values))
    results = np.empty(boxes[0].shape, dtype=object)
    for k in np.ndindex(results.shape):
        results[k] = f(*(box[k] for box in boxes))
    if results.size and all(isinstance(x, bool) for x in results.flat):
        results = results.astype(bool)
    return results[()]


def objects(x: Any) -> Any:
    """Numbers as an array that can hold unknown ones."""
    return np.array(x, dtype=object)


def _of_numbers(
    op: str, known: Callable[..., Any], *, stays_whole: bool = False
) -> Callable[..., Any]:
    """An operation of numbers, by Python if they are known."""

    def call(*values: Any) -> Any:
        like, stays = unknown_in(*values), stays_whole and all(map(is_whole, values))
        return known(*values) if like is None else like.recorder.unknown(op, *values, whole=stays)

    return call


def _norm(x: Any) -> Any:
    values = objects(x)
    if values.ndim != 1:
        raise TraceError("norm of more than a vector")
    return _of_numbers("sqrt", math.sqrt)(sum(y * y for y in values))


def _clip(x: Any, low: Any, high: Any) -> Any:
    x = x if low is None else each(_of_numbers("maximum", np.maximum), x, low)
    return x if high is None else each(_of_numbers("minimum", np.minimum), x, high)


def _reduced(op: str) -> Callable[..., Any]:
    one = _of_numbers(op, getattr(np, op))
    return lambda x: functools.reduce(one, np.ravel(objects(x)))


def _array(x: Any, dtype: Any = None) -> Any:
    if dtype not in (None, to_float, np.float64, "float"):
        raise TraceError("an array of another type than float")
    return objects(x)


def _asarray(x: Any, dtype: Any = None) -> Any:
    return x if isinstance(x, np.ndarray) and x.dtype == object else _array(x, dtype)


def _interp(x: Any, xs: Any, ys: Any) -> Any:
    """np.interp, by a search in halves."""
    if np.ndim(x) or unknown_in(xs, ys) is not None:
        raise TraceError("interp of tables that are not known")
    xs, ys = (np.asarray(v, float) for v in (xs, ys))
    if xs.ndim != 1 or len(xs) != len(ys) or len(xs) < 2 or not (np.diff(xs) > 0.0).all():
        raise TraceError("interp of a table whose arguments do not increase")
    recorder, last = x.recorder, float(len(xs) - 2)
    k: Any = recorder.choose("<", x, math.inf, 0.0, 0.0)
    for step in (2.0**n for n in reversed(range(int(last + 1).bit_length()))):
        further = recorder.choose("<=", k + step, last, k + step, k)
        k = recorder.choose(">=", x, recorder.gather(xs, further), further, k)
    slope = recorder.gather(np.append(np.diff(ys) / np.diff(xs), 0.0), k)
    within = slope * (x - recorder.gather(xs, k)) + recorder.gather(ys, k)
    above = recorder.choose("<", x, xs[0], ys[0], within)
    return recorder.choose(">=", x, xs[-1], ys[-1], above)


def _select(tests: Any, values: Any, default: Any = 0) -> Any:
    for test, value in reversed([*zip(tests, values, strict=True)]):
        default = _where(test, value, default)
    return default


def _where(test: Any, yes: Any, no: Any) -> Any:
    return each(lambda c, a, b: a if c else b, test, yes, no)


_BOTH: dict[str, Callable[..., Any]] = {
    "isnan": lambda x: each(lambda y: bool(y != y), x),  # noqa: PLR0124
    "isinf": lambda x: each(lambda y: bool(abs(y) == math.inf), x),
    "isfinite": lambda x: each(lambda y: bool(abs(y) < math.inf), x),
    "radians": lambda x: each(lambda y: y * (math.pi / 180.0), x),
    "degrees": lambda x: each(lambda y: y * (180.0 / math.pi), x),
    "pow": lambda x, n: each(operator.pow, x, n), "fsum": lambda x: sum(x),
}  # fmt: skip
_OF_NUMPY: dict[str, Callable[..., Any]] = _BOTH | {
    "norm": _norm, "clip": _clip, "array": _array, "asarray": _asarray, "interp": _interp,
    "where": _where,
    "max": _reduced("maximum"), "min": _reduced("minimum"), "power": _BOTH["pow"],
    "square": lambda x: each(lambda y: y * y, x), "reciprocal": lambda x: 1.0 / x,
    "float64": lambda x: x, "select": _select,
    "deg2rad": _BOTH["radians"], "rad2deg": _BOTH["degrees"],
}  # fmt: skip
_OF_MATH: dict[str, Callable[..., Any]] = _BOTH | {
    "floor": lambda x: whole("floor", x), "ceil": lambda x: -whole("floor", -x),
    "trunc": lambda x: whole("trunc", x),
    "hypot": lambda *x: _norm(x) if len(x) != 2 else _of_numbers("hypot", math.hypot)(*x),
}  # fmt: skip


class Library:
    """Replaces ``math`` or ``numpy``."""

    def __init__(self, module: types.ModuleType) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._module, name)
        if isinstance(value, types.ModuleType):
            return Library(value)
        is_class = isinstance(value, type) and name != "float64"
        return functools.partial(self._call, name) if callable(value) and not is_class else value

    def _call(self, name: str, *args: Any, **named: Any) -> Any:
        value, of_math = getattr(self._module, name), self._module is math
        like = unknown_in(*args, *named.values())
        if like is None:
            return _known(value, args, named)
        full = f"{self._module.__name__}.{name} of numbers that are not known beforehand"
        op = FUNCTIONS.get(value, "")
        of = None if named or op in COMPARISONS else OPERATIONS.get(op)
        if isinstance(like, Recorded):
            if of is None or of.traced is None:
                raise TraceError(full)
            return of.traced(*args)
        special = (_OF_MATH if of_math else _OF_NUMPY).get(name)
        if special is not None:
            return special(*args, **named)
        if not of_math and name in _PASSED:
            joins = name.endswith(("stack", "concatenate"))
            rows = (tuple, list) if not joins else ()
            return value(*(objects(x) if isinstance(x, rows) else x for x in args), **named)
        if of is None or of.traced is None or len(args) != of.arity:
            raise TraceError(full)
        return like.recorder.unknown(op, *args) if of_math else each(_of_numbers(op, value), *args)


def _known(value: Callable[..., Any], args: Any, named: Any) -> Any:
    """A function of known numbers: NumPy's own result, as an array that can hold unknown ones."""
    with np.errstate(all="ignore"):
        result = value(*map(_python, args), **{k: _python(x) for k, x in named.items()})
    is_array = isinstance(result, np.ndarray) and result.dtype == np.float64
    return result.astype(object) if is_array else result


def _python(x: Any) -> Any:
    """What Python has in place of a replaced class, or of an array of known numbers."""
    if isinstance(x, np.ndarray):
        return x.astype(float) if x.dtype == object else x
    return _CLASSES.get(x, x) if callable(x) else x


# Python's builtins


def _extreme(op: str, known: Callable[..., Any]) -> Callable[..., Any]:
    better = _of_numbers(op, known, stays_whole=True)

    def call(*args: Any, **named: Any) -> Any:
        values = list(args[0]) if len(args) == 1 else args
        is_known = named or unknown_in(*values) is None
        return known(*args, **named) if is_known else functools.reduce(better, values)

    return call


def to_float(x: Any = 0.0) -> Any:
    """``float``."""
    x = x.flat[0] if isinstance(x, np.ndarray) and x.size == 1 else x
    return x.recorder.at(x.at) if isinstance(x, Unknown) else float(x)


def _to_int(x: Any = 0, *base: Any) -> Any:
    return whole("trunc", x) if isinstance(x, Unknown) else int(x, *base)


_CLASSES: dict[Any, Any] = {to_float: float, _to_int: int}


def _type(x: Any) -> Any:
    if isinstance(x, Unknown):
        return _to_int if x.whole else to_float
    return next((ours for ours, cls in _CLASSES.items() if type(x) is cls), type(x))


BUILTINS = {k: frozen.unknown(x) for k, x in vars(builtins).items() if callable(x)} | {
    **frozen.ALLOWED, "float": to_float, "int": _to_int, "min": _extreme("min", min),
    "max": _extreme("max", max), "round": lambda x, *n: round(x, *n), "pow": lambda x, n: x**n,
    "__import__": lambda name, *_: Library(builtins.__import__(name)), "type": _type, "str": str,
}  # fmt: skip


#: functions of Python and of libraries by identity, since attributes of users' objects may raise
_BUILTINS = {id(x): BUILTINS[k] for k, x in vars(builtins).items() if callable(x)}
_MODULES = {x.__name__: x for x in (np.linalg, np, math)}
NAMES = {
    id(x): (module, name) for module, of in _MODULES.items() for name, x in vars(of).items()
    if callable(x)
}  # fmt: skip


#: by identity too: they call operators of their arguments, and nothing else
_AS_THEY_ARE = {
    id(functools.reduce), *(id(x) for x in vars(itertools).values() if isinstance(x, type)),
    *(id(x) for x in vars(operator).values() if isinstance(x, types.BuiltinFunctionType)),
} - {id(operator.is_), id(operator.is_not)}  # fmt: skip


# arrays from outside, and what replaces values of libraries


class _Array(np.ndarray[Any, Any]):
    """An array from outside the function: it is read at an unknown place too, and not written."""

    def __getitem__(self, index: Any) -> Any:
        first, *rest = index if isinstance(index, tuple) and index else (index,)
        if not isinstance(first, Unknown):
            return super().__getitem__(index)
        if not first.whole:
            raise IndexError("only integers are valid indices")
        if self.dtype.kind not in "fiu" or unknown_in(*rest) is not None:
            raise TraceError("an index that is not known beforehand")
        n = len(self)
        first.recorder.guard(">=", first, -n, IndexError)
        first.recorder.guard("<", first, n, IndexError)
        place = first.recorder.choose("<", first, 0.0, first + n, first)  # type: ignore[operator]
        is_whole = self.dtype.kind in "iu"
        columns = np.asarray(self)[(slice(None), *rest)]
        numbers = np.empty(columns.shape[1:], dtype=object)
        for k in np.ndindex(numbers.shape):
            column = columns[(slice(None), *k)]
            numbers[k] = first.recorder.gather(column, place, whole=is_whole)
        return numbers[()]

    def copy(self, *_: Any) -> Any:
        return objects(self) if self.dtype == float else np.array(self)


def replaced(value: Any) -> Any:
    """The replacement of arrays and of what libraries have; None of anything else."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            raise TraceError(f"an array of {value.dtype}")
        array = value.copy().view(_Array)
        array.flags.writeable = False
        return array
    if hasattr(type(value), "traced_at") or id(value) in _AS_THEY_ARE:
        return value
    if value is math or value is np or value is np.linalg:
        return Library(value)
    module, name = NAMES.get(id(value), ("builtins", ""))
    if name and not isinstance(value, type):
        return getattr(Library(_MODULES[module]), name)
    return _BUILTINS.get(id(value))


def known_names(scope: dict[str, Any]) -> frozenset[str]:
    """Names, among a function's globals, of modules and of functions of numbers alone."""
    owners = [vars(module) for module in (math, np, np.linalg)]
    return frozenset({"abs", "float", "pow", "divmod", "min", "max"} - scope.keys()) | {
        k for k, x in scope.items()
        if x is math or x is np or any(owner.get(k, owners) is x for owner in owners)
    }  # fmt: skip
