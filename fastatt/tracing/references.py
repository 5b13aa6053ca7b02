"""The values that a function refers to; it is traced again if they have changed.

Another process that receives a function by value has no file to trace it from, and receives its
source.
"""

from __future__ import annotations

import functools
import inspect
import linecache
import math
import sys
from collections.abc import Callable, Iterable
from types import CodeType, FunctionType, MethodType
from typing import Any

import numpy as np

_LIBRARIES = ("fastatt", "numba", "numpy")
_NUMBERS = (bool, int, float, complex, np.generic)
_COMPARED = (*_NUMBERS, np.ndarray, tuple, list)


def opened(function: Any) -> tuple[Any, tuple[Any, ...], dict[str, Any]]:
    """(function, first and named arguments) of a partial, a method or an object with __call__."""
    if isinstance(function, functools.partial):
        inner, first, named = opened(function.func)
        return inner, (*first, *function.args), {**named, **function.keywords}
    if isinstance(function, MethodType):
        inner, first, named = opened(function.__func__)
        return inner, (*first, function.__self__), named
    call = (
        None
        if isinstance(function, type)
        else inspect.getattr_static(type(function), "__call__", None)
    )
    is_object = isinstance(call, FunctionType) and not hasattr(function, "py_func")
    return (call, (function,), {}) if is_object else (function, (), {})


def signature_of(function: Any) -> inspect.Signature | None:
    """The arguments of a function; None if it does not tell them."""
    try:
        return inspect.signature(getattr(function, "py_func", function))
    except (TypeError, ValueError):
        return None


def required_arguments(function: Any) -> tuple[str, ...]:
    """Names of the arguments without a default; () of a function that does not tell."""
    found = signature_of(function)
    given = () if found is None else found.parameters.items()
    return tuple(name for name, x in given if x.default is x.empty)


def called_as(function: Any) -> str:
    """The name of a function with its arguments, in messages."""
    name = getattr(function, "__name__", getattr(opened(function)[0], "__name__", "function"))
    found = signature_of(function)
    given = () if found is None else found.parameters.values()
    # defaults may have many lines
    return (
        f"{name}({', '.join(str(x.replace(default=x.empty, annotation=x.empty)) for x in given)})"
    )


def names_of(plain: FunctionType) -> set[str]:
    """Names of globals and of attributes in a function."""
    names: set[str] = set()
    todo = [plain.__code__]
    while todo:
        code = todo.pop()
        names.update(code.co_names)
        todo += [x for x in code.co_consts if isinstance(x, CodeType)]
    return names


def is_library(plain: FunctionType) -> bool:
    """Whether it is part of a library whose globals do not change."""
    return (plain.__module__ or "").partition(".")[0] in _LIBRARIES


def referred_to(plain: FunctionType) -> dict[str, Any]:
    """Values of a function's names that are not local variables: globals, then closures."""
    names = names_of(plain)
    found = {name: plain.__globals__[name] for name in names if name in plain.__globals__}
    for name, cell in zip(plain.__code__.co_freevars, plain.__closure__ or (), strict=True):
        try:
            found[name] = cell.cell_contents
        except ValueError:  # the name has no value yet
            continue
    return found


def _itself(value: Any) -> tuple[int, Any]:
    """A value that is equal for the same object only, and keeps it alive."""
    return id(value), value


def snapshot(function: Any, seen: set[Any] | None = None) -> Any:
    """Values to compare: numbers and arrays among globals and closures, also of called functions.

    For objects and modules these are the attributes whose names are in the function.
    """
    inner, first, named = opened(function)
    if inner is not function:
        names = names_of(inner) if isinstance(inner, FunctionType) else set()
        own = [_attributes(x, names, seen or set()) for x in (*first, *named.values())]
        return snapshot(inner, seen), own
    plain = getattr(function, "py_func", function)
    seen = set() if seen is None else seen
    if not isinstance(plain, FunctionType):
        return _itself(function)
    if plain in seen or is_library(plain):
        return plain.__qualname__
    seen.add(plain)
    names = names_of(plain)
    return plain.__code__, [(k, _value(x, names, seen)) for k, x in referred_to(plain).items()]


def _value(value: Any, names: set[str], seen: set[Any]) -> Any:
    if isinstance(value, _NUMBERS):
        return repr(value)  # equal for NaN
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if isinstance(value, (tuple, list)):
        return type(value), [_value(x, names, seen) for x in value]
    return snapshot(value, seen) if callable(value) else _attributes(value, names, seen)


def _attributes(value: Any, names: set[str], seen: set[Any]) -> Any:
    """An object's attributes with given names, and for comparable ones their values."""
    if isinstance(value, (*_NUMBERS, np.ndarray, tuple, list)):
        return _value(value, names, seen)
    held = {} if value in (math, np) else getattr(value, "__dict__", {})
    known = {k: held[k] for k in sorted(names & held.keys())}
    return _itself(value), [
        (k, _value(x, set(), seen)) for k, x in known.items() if type(x) in _COMPARED
    ]


def sources(functions: Iterable[Callable[..., Any]]) -> dict[str, str]:
    """Texts, by file, of functions and of those that they call, except importable ones."""
    found: dict[str, str] = {}
    seen: set[FunctionType] = set()
    todo: list[Any] = list(functions)
    while todo:
        function = opened(todo.pop())[0]
        plain = getattr(function, "py_func", function)
        if not isinstance(plain, FunctionType) or plain in seen or _imported(function, plain):
            continue
        seen.add(plain)
        todo += referred_to(plain).values()
        file = plain.__code__.co_filename
        found[file] = "".join(linecache.getlines(file))
    return found


def _imported(function: Any, plain: FunctionType) -> bool:
    """Whether another process finds a function by the name of its module."""
    if plain.__module__ == "__main__":
        return False
    held = getattr(sys.modules.get(plain.__module__), plain.__qualname__, None)
    return held is function or held is plain


def keep(texts: dict[str, str]) -> None:
    """Make texts available as those of their files, if these do not exist."""
    for file, text in texts.items():
        if text and not linecache.getlines(file):
            # as for a notebook's cell, without a file that is checked for changes
            linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
