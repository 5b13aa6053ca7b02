"""Checks of arguments. An error message names the argument, what was found and what is accepted."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Iterable
from contextlib import suppress
from datetime import timedelta
from difflib import get_close_matches
from functools import lru_cache, reduce
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.floating[Any]]
_Shapes = Iterable[tuple[int, ...]]

_PRECISIONS = _DOUBLE, _SINGLE = np.dtype(np.float64), np.dtype(np.float32)


def choice(name: str, value: object, accepted: Iterable[str]) -> str:
    """One of several words; the message for another one suggests the most similar word."""
    words = list(accepted)
    if not isinstance(value, str) or value not in words:
        raise ValueError(
            f"{name}: found {brief(value)}; accepted: {', '.join(words)}{nearest(value, words)}"
        )
    return value


def nearest(value: object, words: Iterable[str]) -> str:
    """The end of a message, which suggests the most similar word; empty if there is none.

    Otherwise the longest word that is the beginning of the value, such as "mul" of "multiply".
    """
    by_form = {word.casefold(): word for word in words}
    form = value.casefold()[:60] if isinstance(value, str) else ""
    begun = [word for word in by_form if len(word) > 2 and form.startswith(word)]
    close = get_close_matches(form, by_form, n=1) or sorted(begun, key=len)[-1:]
    return f" (nearest: {by_form[close[0]]})" if close else ""


def flag(name: str, value: Any) -> bool:
    """True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name}: found {brief(value)}; accepted: True or False")
    return bool(value)


def function(name: str, value: Any, accepted: str) -> Any:
    """Anything that can be called."""
    if not callable(value):
        raise TypeError(f"{name}: found {brief(value)}; accepted: {accepted}")
    return value


def path(name: str, value: Any, accepted: str = "a path") -> Path:
    """A file's path."""
    if not isinstance(value, (str, PathLike)) or "\0" in str(value):
        raise TypeError(f"{name}: found {brief(value)}; accepted: {accepted}")
    return Path(value)


def several(name: str, values: Any, accepted: str) -> list[Any]:
    """The elements of a list, a tuple, an array or another iterable that is not text."""
    with suppress(TypeError):
        if not isinstance(values, (str, bytes)):
            return list(values)
    raise TypeError(f"{name}: found {brief(values)}; accepted: a list of {accepted}")


def whole(name: str, value: Any, least: int) -> int:
    """A whole number of at least ``least`` that fits into 64 bits."""
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name}: found {brief(value)}; accepted: a whole number") from None
    if not least <= number < 2**63:
        wanted = f"of at least {least}" if number < least else "below 2**63"
        raise ValueError(f"{name}: found {brief(number)}; accepted: a whole number {wanted}")
    return number


def real(name: str, value: Any, *, zero: bool = True) -> float:
    """A finite number."""
    if type(value) is float and math.isfinite(value) and (zero or value):
        return value
    number = any_real(name, value, "a finite number")
    if not math.isfinite(number) or (number == 0.0 and not zero):
        accepted = "a finite number" if zero else "a finite number other than 0"
        raise ValueError(f"{name}: found {number}; accepted: {accepted}")
    return number


def above_zero(
    name: str, value: Any, accepted: str = "a number above 0", *, finite: bool = True
) -> float:
    """A number above 0, which need not be finite unless ``finite``."""
    number = real(name, value) if finite else any_real(name, value, accepted)
    if not number > 0.0:
        raise ValueError(f"{name}: found {number}; accepted: {accepted}")
    return number


def any_real(name: str, value: Any, accepted: str) -> float:
    """A number, finite or not."""
    try:
        # Python and NumPy convert text, booleans, times and arrays of one number to floats
        letter = np.asarray(value).dtype.kind
        if letter not in "fiuO" or np.ndim(value) or np.ma.is_masked(value):
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise _not_numbers(name, value, accepted) from None


def precision(dtype: Any, *arrays: Any) -> np.dtype[Any]:
    """float64 or float32: ``dtype`` if given, else float32 if all arrays have it."""
    if dtype is None:
        tables = [np.asarray(a).dtype for a in arrays if hasattr(a, "__array__") and np.ndim(a)]
        is_single = tables and all(x.kind == "f" and x.itemsize == 4 for x in tables)
        return _SINGLE if is_single else _DOUBLE
    with suppress(TypeError, ValueError):
        precise: np.dtype[Any] = np.dtype(dtype)
        if precise in _PRECISIONS:
            return precise
    raise TypeError(f"dtype: found {brief(dtype)}; accepted: float64, float32 or None")


def array(
    name: str, value: ArrayLike, shapes: str, tails: _Shapes | None = None, *, flag: bool = False
) -> Floats:
    """A float array of one of the shapes, such as "a number, (3,) or (N, 3)".

    ``tails`` are these shapes (−1: any length but 0) if the text does not give them. All numbers
    must be finite, unless ``flag``.
    """
    values = numbers(name, value, f"real numbers of shape {shapes}")
    for tail in tails or _tails(shapes):
        if _fits(values.shape, tail):
            if not flag:
                finite(name, values)
            return values
    raise ValueError(f"{name}: {shape(values)}; accepted: {shapes}")


def numbers(name: str, value: ArrayLike, accepted: str) -> Floats:
    """A float32 or float64 array of real numbers, contiguous; masked numbers become NaN.

    Sums over rows round otherwise in another order in memory.
    """
    if type(value) is np.ndarray and value.flags.c_contiguous and value.dtype in _PRECISIONS:
        return value
    try:
        values = np.asarray(value, order="C")
    except (TypeError, ValueError):
        values = np.asarray(None)
    if values.dtype.kind not in "fiu":
        raise _not_numbers(name, value, accepted)
    native = values.dtype.newbyteorder("=")
    with np.errstate(over="ignore"):
        values = values.astype(native if native in _PRECISIONS else np.float64, copy=False)
    if isinstance(value, np.ma.MaskedArray):
        values = np.where(np.ma.getmaskarray(value), values.dtype.type(np.nan), values)
    return values


def finite(name: str, value: Floats) -> None:
    """Refuse numbers that are not finite, naming the first."""
    if not all_finite(value):
        refuse(name, value, ~np.isfinite(value), "finite numbers")


def refuse(name: str, value: Floats, bad: Any, accepted: str) -> None:
    """Raise ``ValueError`` for the first bad number of an array, if there is one."""
    if np.any(bad):
        where = tuple(map(int, np.argwhere(bad)[0]))
        place = list(where) if where else ""
        raise ValueError(f"{name}{place} is {value[where]}; accepted: {accepted}")


def all_finite(*values: Floats) -> bool:
    """Whether all numbers are finite."""
    for value in values:
        # summing few numbers in Python takes less time than calling NumPy
        if value.size <= 16 and math.isfinite(sum(value.ravel().tolist())):
            continue
        if not np.isfinite(value).all():
            return False
    return True


def attitudes(
    name: str, value: ArrayLike, shapes: str = "(4,) or (N, 4)", *, flag: bool = False
) -> Floats:
    """Quaternions, finite and not zero unless ``flag``.

    A SciPy ``Rotation`` from body to inertial components is converted to quaternions.
    """
    if hasattr(value, "as_quat"):
        value = np.roll(value.as_quat(), 1, axis=-1)
    q = array(name, value, shapes, flag=flag)
    # four zeros at least; column by column: a third of the time of NumPy's any along rows of four
    has_zeros = not flag and np.count_nonzero(q) <= q.size - 4
    if has_zeros and not (nonzero := reduce(np.logical_or, q.T)).all():
        where = [int(i) for i in np.argwhere(~nonzero.T)[0]] or ""
        raise ValueError(f"{name}{where} is the zero quaternion; accepted: any other, unit or not")
    return q


@lru_cache(maxsize=256)
def _tails(shapes: str) -> list[tuple[int, ...]]:
    """The shapes in the text of a message; a letter is any length but 0."""
    tails: list[tuple[int, ...]] = [()] if shapes.startswith("a number") else []
    for written in re.findall(r"\(([^)]*)\)", shapes):
        lengths = [part.strip() for part in written.split(",") if part.strip()]
        tails.append(tuple(int(n) if n.isdigit() else -1 for n in lengths))
    return tails


@lru_cache(maxsize=1024)
def _fits(shape: tuple[int, ...], tail: tuple[int, ...]) -> bool:
    return len(shape) == len(tail) and not [
        n for n, m in zip(shape, tail, strict=True) if n != m and (m != -1 or n == 0)
    ]


def _not_numbers(name: str, value: object, accepted: str) -> TypeError:
    # the number of a duration has no known unit
    if isinstance(value, timedelta) or getattr(getattr(value, "dtype", None), "kind", "") == "m":
        accepted += ", of a duration in s: duration / np.timedelta64(1, 's')"
    return TypeError(f"{name}: found {brief(value)}; accepted: {accepted}")


def shape(array: NDArray[Any]) -> str:
    """An array's shape in the words of a message."""
    return f"has shape {array.shape}{'' if array.size else ' and is empty'}"


def optional(name: str, module: str, source: str) -> Any:
    """A module of an optional package; without it ``ImportError`` says what installs it."""
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise ImportError(
            f"{name}: needs {package}; install it with pip install '{source}'"
        ) from None


def brief(value: object) -> str:
    """A value as a message shows it, on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
