"""NumPy arrays of traced numbers, and NumPy's functions of them: arrays of objects, elementwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fastatt.tracing.graph import apply, flattened
from fastatt.tracing.nodes import Recorded, boxed

# NumPy's functions that only multiply and add, or move elements
_PASSED = frozenset({
    "array", "asarray", "append", "column_stack", "concatenate", "cross", "diag", "diagonal", "dot",
    "flip", "hstack", "inner", "matmul", "mean", "outer", "prod", "ravel", "reshape", "roll",
    "stack", "sum", "trace", "transpose", "vdot", "vstack",
})  # fmt: skip
# NumPy's functions that make arrays whose elements may become traced numbers
_MAKING = frozenset({"empty", "eye", "full", "identity", "ones", "zeros"})


def is_array(x: Any) -> bool:
    """Whether x is an array that may hold traced numbers."""
    return isinstance(x, np.ndarray) and x.dtype == object


def made_of(name: str, function: Callable[..., Any], args: Any, named: Any) -> Any:
    """The result of a NumPy function for arrays of traced numbers; None for an unknown function."""
    if name == "norm" and len(args) == 1 and not named and np.ndim(boxed(args[0])) == 1:
        return apply("sqrt", sum((x * x for x in flattened(tuple(boxed(args[0])))), 0.0))
    if name in ("array", "asarray"):  # the dtype is ignored, since traced numbers have a precision
        return np.array(args[0], dtype=object)
    if name in _PASSED:
        return function(*(np.array(x, dtype=object) if _holds(x) else x for x in args), **named)
    return None


def _holds(x: Any) -> bool:
    return isinstance(x, (tuple, list)) and any(isinstance(y, Recorded) for y in flattened(x))


def new(name: str, found: Any) -> Any:
    """An array that NumPy makes of known numbers, of a type that can hold traced ones."""
    return found.astype(object) if name in _MAKING and found.dtype == np.float64 else found


def numbers_of(result: Any) -> Any:
    """The result of a user-defined function, with a list or an array of one axis as a tuple."""
    one_axis = isinstance(result, np.ndarray) and result.ndim == 1
    return tuple(result) if one_axis or isinstance(result, list) else result
