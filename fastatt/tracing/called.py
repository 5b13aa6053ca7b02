"""Functions of users that are not followed: frozen, compiled by Numba, and called by address.

Indices, division, whole numbers and rounds of loops are checked, and an error is NaN. ``math`` in a
called function has the library's sines, which vectorise and do not depend on the platform.
"""

from __future__ import annotations

import ctypes
import marshal
import math
import re
import types as python
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numba import cfunc, types

from fastatt._jit import checked
from fastatt.tracing import frozen
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.replacements import NAMES
from fastatt.tracing.signature import Signature

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # colour sequences of terminals
_DOUBLES = ctypes.POINTER(ctypes.c_double)
#: the C type of a function at an address
ENTRY = ctypes.CFUNCTYPE(None, _DOUBLES, _DOUBLES)


def portable(value: Any, within: tuple[Any, ...] = ()) -> Any:
    """A value as tuples that compare and that another process reads.

    ``within`` are the functions around it. Raises ``TraceError`` for what Numba does not know.
    """
    # subclasses may have operators of their own
    if value is None or type(value) in (bool, int, float, str):
        return value
    if type(value) is np.ndarray or isinstance(value, np.generic):
        return "array", value.shape, value.dtype.str, value.tobytes()
    if type(value) in (tuple, list):
        return "tuple", *(portable(x, within) for x in value)
    if value is math or value is np or value is np.linalg:
        return "module", value.__name__
    if id(value) in NAMES:
        return "module", *NAMES[id(value)]
    plain = frozen.plain(value)
    if not isinstance(plain, python.FunctionType):
        raise TraceError(f"a {type(value).__name__}, which numba.njit does not compile")
    if plain is not value and plain.__module__.startswith("fastatt."):
        return "module", plain.__module__, plain.__name__
    if any(plain is x for x in within):
        raise TraceError(f"{plain.__name__} refers to itself")
    frozen.check(plain, texts=True)
    code, scope, within = plain.__code__, plain.__globals__, (*within, plain)
    n, named = code.co_argcount, plain.__kwdefaults__ or {}
    names = code.co_varnames[n : n + code.co_kwonlyargcount]
    if named.keys() != {*names}:
        raise TraceError(f"arguments of {plain.__name__} by name alone that have no default")
    if names:  # Numba has none
        code = code.replace(co_argcount=n + len(names), co_kwonlyargcount=0)
    used = sorted(frozen.names_of(code))
    values = ((k, portable(scope[k], within)) for k in used if k in scope)
    cells = (portable(x.cell_contents, within) for x in plain.__closure__ or ())
    defaults = portable((*(plain.__defaults__ or ()), *map(named.get, names)) or None, within)
    # without references among its objects, whose form depends on who else holds them
    return "function", marshal.dumps(code, 2), tuple(values), tuple(cells), defaults


def _with_compiled(value: Any) -> Any:
    """What ``portable`` gives, with compiled functions."""
    match value:
        case ("tuple", *values):
            return tuple(map(_with_compiled, values))
        case ("array", shape, dtype, data):
            return np.frombuffer(data, dtype).reshape(shape)[()]
        case ("module", name, *attribute):
            module: Any = _mathematics() if name == "math" else import_module(name)
            return getattr(module, attribute[0]) if attribute else module
        case ("function", code, values, cells, defaults):
            read = marshal.loads(code)
            scope = {"int": _whole(int), "round": _whole(round), "sum": checked(_total)}
            scope |= {"__builtins__": __builtins__, **{k: _with_compiled(x) for k, x in values}}
            inner = tuple(python.CellType(_with_compiled(x)) for x in cells)
            values = _with_compiled(defaults)
            return checked(python.FunctionType(read, scope, read.co_name, values, inner))
    return value


def _whole(convert: Callable[..., Any]) -> Any:
    @checked
    def whole(x, *digits):  # type: ignore[no-untyped-def]
        if not abs(x) < 9e18:
            raise ValueError
        return convert(x, *digits)

    return whole


def _total(values, start=0):  # type: ignore[no-untyped-def]
    total = sum(values, start)
    # within Numba's own code whole numbers are not checked
    if abs(total - sum(values, 1.0 * start)) >= 1e18:
        raise OverflowError
    return total


def _mathematics() -> Any:
    """``math`` with the library's sines, and whole numbers of finite ones only."""
    from fastatt.kernels import trig

    module, sincos, atan2 = python.ModuleType("math"), trig.sincos, trig.atan2
    module.__dict__.update({k: x for k, x in vars(math).items() if not k.startswith("__")})
    module.__dict__.update({k: _whole(getattr(math, k)) for k in ("floor", "ceil", "trunc")})
    module.__dict__.update(
        sin=checked(lambda x: sincos(float(x))[0] if abs(x) < 2.0**50 else math.nan),
        cos=checked(lambda x: sincos(float(x))[1] if abs(x) < 2.0**50 else math.nan),
        atan2=checked(lambda y, x: atan2(float(y), float(x))),
    )
    return module


def compiled(code: Any, signature: Signature) -> Any:
    """A function compiled by Numba, which takes the addresses of its arguments and results."""
    pointer = types.CPointer(types.float64)
    scope = {"inner": _with_compiled(code), "nan": math.nan}
    # one number may be in a tuple
    for is_number in (True, False) if signature.results == 1 else (False,):
        exec(_wrapper(signature, is_number=is_number), scope)
        try:
            return cfunc(types.void(pointer, pointer))(scope["entry"])
        except Exception as error:  # noqa: BLE001  # Numba's traceback shows Numba's code
            place = getattr(error, "loc", None)
            where = "" if place is None else f" ({place.filename}:{place.line})"
            words = f"{words_of(error)}{where}"
    raise TraceError(words)


def _wrapper(signature: Signature, *, is_number: bool) -> str:
    """Text of a function that calls ``inner`` with numbers from memory and stores its results."""
    args = [
        f"({''.join(f'{x}, ' for x in part)})" if isinstance(part, tuple) else part
        for part in signature.nested([f"numbers[{k}]" for k in range(signature.size)])
    ]
    n, states = signature.results, signature.states
    parts = [("result[0]", n - states), ("result[1]", states)] if states else [("result", n)]
    lengths, items = [], ["result"]
    if not is_number:
        lengths = [f"len({name}) != {size}" for name, size in parts]
        items = [f"{name}[{k}]" for name, size in parts for k in range(size)]
    lines = [
        "def entry(numbers, results):",
        "    try:",
        f"        result = inner({', '.join(args)})",
        *(f"        if {test}: raise ValueError" for test in lengths),
        *(f"        results[{k}] = {item}" for k, item in enumerate(items)),
        # no error may leave a function in the loop: NaN sets the body's status
        "    except Exception:",
        *(f"        results[{k}] = nan" for k in range(n)),
    ]
    return "\n".join(lines)


def words_of(error: Exception) -> str:
    """Numba's reason in one line, without colours: the first that is not about its steps."""
    lines = _COLOUR.sub("", str(error)).splitlines()
    said = [x.strip() for x in lines if x.strip() and not x.startswith(("Failed in ", "During: "))]
    return " ".join(said[:3]) or type(error).__name__
