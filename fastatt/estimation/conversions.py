"""Arguments of single steps from Python: lists, integers and arrays that Numba does not compile."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import config

from fastatt import checks

_TIMES = ("t", "h", "s")
_FLOATS = float, np.float32
_KINDS = np.dtype(np.float64), np.dtype(np.float32)


def taken_from_python(dispatcher: Any, sizes: Callable[[str], int], in_place: str = "") -> Any:
    """The function, which converts arguments from Python for which it is not compiled.

    ``sizes`` gives the numbers of an argument by its name, and ``in_place`` names the array that
    the function changes. Calls from jitted code, and from Python with floats, tuples of floats and
    float arrays, do not come here.

    From Python the function raises ``TypeError`` or ``ValueError``, which name the argument.
    """
    plain = getattr(dispatcher, "py_func", dispatcher)
    signature = inspect.signature(plain)

    def converted(*args: Any, **named: Any) -> list[Any]:
        given = signature.bind(*args, **named).arguments
        return [
            _in_place(name, x, sizes(name)) if name == in_place else _converted(name, x, sizes)
            for name, x in given.items()
        ]

    if config.DISABLE_JIT:
        return functools.wraps(plain)(lambda *args, **named: plain(*converted(*args, **named)))
    compile_for_args = dispatcher._compile_for_args  # noqa: SLF001

    def compiled(*args: Any, **named: Any) -> Any:
        found = converted(*args, **named)
        if all(x is y for x, y in zip(found, args, strict=False)):
            return compile_for_args(*args, **named)
        # Numba calls what it gets with the arguments as they were
        return lambda *_, **__: dispatcher(*found)

    dispatcher._compile_for_args = compiled  # noqa: SLF001
    return dispatcher


def _converted(name: str, value: Any, sizes: Callable[[str], int]) -> Any:
    """A float, a tuple of floats or, for states and parameters, a float array."""
    if name in _TIMES:
        return value if isinstance(value, _FLOATS) else checks.real(name, value)
    is_array = isinstance(value, np.ndarray) and value.dtype in _KINDS and value.ndim == 1
    if is_array and name in ("x", "p"):
        return value
    size = sizes(name)
    found = checks.numbers(name, value, f"{size} numbers")
    if found.ndim != 1:
        raise ValueError(f"{name}: {checks.shape(found)}; accepted: ({size},)")
    if found.size != size:
        raise ValueError(f"{name}: found {found.size} numbers; accepted: {size}")
    if isinstance(value, tuple) and all(isinstance(x, _FLOATS) for x in value):
        return value
    return tuple(found) if found.dtype == np.float32 else tuple(found.tolist())


def _in_place(name: str, value: Any, size: int) -> Any:
    """An array that the function can write to."""
    accepted = f"a writable array of float64 or float32, of shape ({size},)"
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{name}: found {checks.brief(value)}; accepted: {accepted}")
    if value.dtype not in _KINDS or value.ndim != 1 or not value.flags.writeable:
        kind = "an array" if value.flags.writeable else "a read-only array"
        kind += f" of {value.dtype}, of shape {value.shape}"
        raise TypeError(f"{name}: found {kind}; accepted: {accepted}")
    return value
