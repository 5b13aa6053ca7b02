"""User-defined functions that can't be traced: compiled by Numba.

Also functions to try them in Python: arguments at a few points, and helpers that are not compiled.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import re
from collections.abc import Callable, Sequence
from operator import itemgetter
from traceback import extract_tb
from types import CellType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import cfunc, types
from numba.core.registry import CPUDispatcher
from numpy.typing import NDArray

from fastatt._jit import recompile, with_options_of
from fastatt.tracing.arrays import numbers_of
from fastatt.tracing.nodes import Recorded
from fastatt.tracing.references import is_library, opened, referred_to
from fastatt.tracing.trace import ModuleProxy

if TYPE_CHECKING:
    from fastatt.tracing.user import Signature, UserFunction

POINTS = 8


def nested(numbers: Sequence[Any], sizes: Sequence[int]) -> tuple[Any, ...]:
    """Successive numbers as arguments: a number for size 0, else a tuple; the last is a tuple."""
    found: list[Any] = []
    at = 0
    for k, n in enumerate(sizes):
        is_tuple = n > 0 or k == len(sizes) - 1
        found.append(tuple(numbers[at : at + n]) if is_tuple else numbers[at])
        at += n if is_tuple else 1
    return tuple(found)


def are_numbers(values: tuple[Any, ...], n: int) -> bool:
    """Whether values are n numbers, known or traced."""
    return len(values) == n and all(
        isinstance(x, (Recorded, float, int, np.number)) and not isinstance(x, bool) for x in values
    )


def in_a_row(result: Any, form: Signature) -> Any:
    """The result of a function as a number or one tuple; () if states are missing."""
    states = form.states
    if not states:
        found = numbers_of(result)
        is_one = form.results == 1 and isinstance(found, tuple) and len(found) == 1
        return found[0] if is_one else found
    if not (isinstance(result, (tuple, list)) and len(result) == 2):
        return ()
    parts = map(numbers_of, result)
    acting, slopes = (x if isinstance(x, tuple) else (x,) for x in parts)
    return (*acting, *slopes) if len(slopes) == states else ()


def floats(result: Any) -> list[float]:
    """A function's result, a number, a tuple, a list or an array, as a list."""
    result = numbers_of(result)
    return [float(x) for x in (result if isinstance(result, tuple) else (result,))]


def points(
    sizes: tuple[int, ...],
    params: NDArray[np.float64] | None,
    span: tuple[float, float] = (0.0, 10.0),
) -> list[list[float]]:
    """Arguments to try a function with; the first are at the start of a time interval."""
    rng = np.random.default_rng(8)
    found = []
    for k in range(POINTS):
        point = [span[0] if k == 0 else float(rng.uniform(*span))]
        for n in sizes[1:-1]:
            v = rng.normal(size=n)
            point += (v / np.linalg.norm(v) if n == 4 else v).tolist()
        if params is not None and params.size:
            rows = np.atleast_2d(params)
            point += rows[k * len(rows) // POINTS].tolist()
        else:
            point += rng.uniform(0.5, 1.5, sizes[-1]).tolist()
        found.append(point)
    return found


def interpreted(function: Any) -> Callable[..., Any]:
    """A function as Python runs it, with the jitted functions that it calls in Python too."""
    inner, first, named = opened(function)
    if inner is not function:
        plain = interpreted(inner)
        return lambda *args: plain(*first, *args, **named)
    plain = getattr(function, "py_func", function)
    return _with(plain, {name: _in_python(x) for name, x in referred_to(plain).items()})


def _with(plain: FunctionType, found: dict[str, Any]) -> FunctionType:
    """The function with other values of the names in it."""
    scope = plain.__globals__ | found
    closure = tuple(
        CellType(found[name]) if name in found else CellType()
        for name in plain.__code__.co_freevars
    )
    made = FunctionType(plain.__code__, scope, plain.__name__, plain.__defaults__, closure)
    made.__kwdefaults__ = plain.__kwdefaults__
    return made


def _renewed(function: Any, within: tuple[Any, ...] = ()) -> Any:
    """The function, with the functions that it calls compiled anew when they are called.

    Plain ones too; and Numba keeps the globals of the time when it first compiled a jitted one.
    """
    plain = getattr(function, "py_func", function)
    within = (*within, plain)
    found = referred_to(plain)
    others = {}
    for name, x in found.items():
        called = getattr(x, "py_func", x)
        if not isinstance(called, FunctionType) or called in within or is_library(called):
            continue
        renewed = _renewed(x, within)
        others[name] = recompile(renewed) if called is x else with_options_of(x, renewed)
    return _with(plain, found | others) if others else plain


def _in_python(value: Any) -> Any:
    if isinstance(value, CPUDispatcher):
        return lambda *args, **named: interpreted(value)(*args, **named)
    if isinstance(value, ModuleType) and value not in (math, np):
        return ModuleProxy(value, _in_python)
    return value


# compiled by Numba

# colour sequences of terminals
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_REAL = types.Float, types.Integer
_DOUBLES = ctypes.POINTER(ctypes.c_double)
#: the C type of a function at an address
ENTRY = ctypes.CFUNCTYPE(None, _DOUBLES, _DOUBLES)


def _result(function: Callable[..., Any], user: UserFunction) -> Any:
    """What it returns in Python at the first point without an error; refused if there is none."""
    failed = Exception()
    for point in points(user.sizes, None):
        try:
            return function(*nested(point, user.sizes))
        except Exception as error:  # noqa: BLE001  # it may be fine elsewhere
            failed = error
    place = extract_tb(failed.__traceback__)[-1]
    raise TypeError(
        f"{user.argument}: {user.described} raises {type(failed).__name__}: {failed} "
        f"({place.filename}:{place.lineno}); accepted is a function of floats, with "
        f"{_params_of(user)}"
    ) from None


def _params_of(user: UserFunction) -> str:
    """What p is, in a message."""
    if user.n_params == 0:
        return "p empty, since the scene has no params"
    return f"p a tuple of {user.n_params} floats"


def compiled(function: Callable[..., Any], user: UserFunction) -> Any:
    """The function compiled by Numba, with pointers as arguments."""
    f8 = types.float64
    *before, last = user.sizes
    signature = (*(types.UniTuple(f8, n) if n else f8 for n in before), types.UniTuple(f8, last))
    outer, first, named = opened(function)
    plain: Any = getattr(outer, "py_func", outer)
    inner = recompile(_renewed(outer))
    if outer is not function:
        inner = recompile(_with_constants(inner, len(before) + 1, first, named))
    try:
        inner.compile(signature)
    except Exception as error:  # noqa: BLE001  # Numba's traceback is of its own code
        raise TypeError(
            f"{user.argument}: {user.described} does not compile for floats, with "
            f"{_params_of(user)} ({_place_of(error, plain)}); accepted is a function that "
            f"numba.njit compiles, or that is traced: this is not, for {user.reason}. Numba says: "
            f"{_words_of(error)}"
        ) from None
    returned = inner.overloads[signature].signature.return_type
    items, lengths = _items(inner, user, returned)
    if not items:
        _result(interpreted(function), user)
        raise _wrong(user, str(returned)) from None
    pointer = types.CPointer(f8)
    scope = {"inner": inner, "nan": math.nan}
    exec(_wrapper(user, items, lengths), scope)
    return cfunc(types.void(pointer, pointer))(scope["entry"])


def _items(inner: Any, user: UserFunction, returned: Any) -> tuple[list[str], list[str]]:
    """How the numbers of ``result`` are read, none for another form; and checks of lengths."""
    form, lengths = user.form, []

    def numbers(kind: Any, n: int, name: str, part: Callable[[Any], Any]) -> list[str]:
        if n == 1 and isinstance(kind, _REAL):
            return [name]
        if isinstance(kind, types.BaseTuple):
            fits = len(kind) == n and all(isinstance(t, _REAL) for t in kind)
        else:
            fits = _is_row(kind) and _lengths(inner, user, part) == {n}
            lengths.append(f"        if len({name}) != {n}: raise ValueError")
        return [f"{name}[{k}]" for k in range(n)] if fits else []

    if not form.states:
        return numbers(returned, form.results, "result", lambda x: x), lengths
    if not (isinstance(returned, types.BaseTuple) and len(returned) == 2):
        return [], lengths
    acting = numbers(returned[0], form.results - form.states, "result[0]", itemgetter(0))
    slopes = numbers(returned[1], form.states, "result[1]", itemgetter(1))
    return (acting + slopes if acting and slopes else []), lengths


def _with_constants(
    inner: Any, n: int, first: tuple[Any, ...], named: dict[str, Any]
) -> FunctionType:
    """The function of its last n arguments, with the others as constants."""
    scope = {"inner": inner} | {f"c{k}": x for k, x in enumerate((*first, *named.values()))}
    free = [f"x{k}" for k in range(n)]
    fixed = [f"c{k}" for k in range(len(first))]
    options = [f"{name}=c{len(first) + k}" for k, name in enumerate(named)]
    exec(f"def call({', '.join(free)}): return inner({', '.join(fixed + free + options)})", scope)
    return scope["call"]  # type: ignore[no-any-return]


def _is_row(returned: Any) -> bool:
    """Whether it is a list or an array of one axis, of numbers."""
    if isinstance(returned, types.Array) and returned.ndim != 1:
        return False
    return isinstance(returned, (types.Array, types.List)) and isinstance(returned.dtype, _REAL)


def _lengths(inner: Any, user: UserFunction, part: Callable[[Any], Any]) -> set[int]:
    """The lengths of a part of the function's results where it is tried without an error."""
    found = set()
    for point in points(user.sizes, None):
        with contextlib.suppress(Exception):
            found.add(len(part(inner(*nested(point, user.sizes)))))
    return found


def _wrapper(user: UserFunction, items: Sequence[str], lengths: Sequence[str]) -> str:
    """Text of a function that calls ``inner`` with numbers from memory and stores its results."""
    count = sum(max(k, 1) for k in user.form.before) + user.n_params
    numbers = [f"given[{k}]" for k in range(count)]
    args = [
        f"({''.join(f'{x}, ' for x in part)})" if isinstance(part, tuple) else part
        for part in nested(numbers, user.sizes)
    ]
    lines = [
        "def entry(given, made):",
        "    try:",
        f"        result = inner({', '.join(args)})",
        *lengths,
        *(f"        made[{k}] = {item}" for k, item in enumerate(items)),
        # no error may leave a function in the loop: NaN sets the body's status
        "    except Exception:",
        *(f"        made[{k}] = nan" for k in range(len(items))),
    ]
    return "\n".join(lines)


def _wrong(user: UserFunction, found: str) -> TypeError:
    states = user.form.states
    n = user.form.results - states
    accepted = "a float" if n == 1 else f"a tuple of {'three' if n == 3 else n} floats"
    more = f", and a tuple of {states}, the time derivatives of s" if states else ""
    return TypeError(
        f"{user.argument}: {user.described} returns {found}; accepted is {accepted}, "
        f"{user.form.unit}{more}"
    )


def _words_of(error: Exception) -> str:
    """Numba's reason in one line, without colours: the first that is not about its steps."""
    skipped = ("Failed in ", "During: ")
    text = _COLOUR.sub("", str(error))
    lines = [x.strip() for x in text.splitlines() if not x.startswith(skipped)]
    said: list[str] = []
    for line in lines:
        if not line and said:
            break
        if line:
            said.append(line)
    return " ".join(said[:3]) or type(error).__name__


def _place_of(error: Exception, plain: Any) -> str:
    place = getattr(error, "loc", None)
    if place is not None:
        return f"{place.filename}:{place.line}"
    return f"{plain.__code__.co_filename}:{plain.__code__.co_firstlineno}"
