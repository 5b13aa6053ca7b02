"""Kernels and methods of the package as formulas: called with traced numbers, they record a graph.

Names in a function are replaced: jitted functions by their Python ones; ``math``, ``numpy`` and
Python's builtins by those for traced numbers. ``a if c else b`` becomes a choice. Functions of
users go another way (``tracing.paths``).
"""

from __future__ import annotations

import builtins
import functools
import types
from collections.abc import Callable
from importlib import import_module
from typing import Any

from numba.extending import is_jitted

from fastatt.kernels import trig
from fastatt.tracing import graph, native
from fastatt.tracing.frozen import Freezer, check, guarded, plain
from fastatt.tracing.graph import Recorded
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.operations import KERNELS, OPERATIONS, own_type_of
from fastatt.tracing.replacements import replaced
from fastatt.tracing.rewriting import rewritten


def traceable(function: Any) -> Callable[..., Any]:
    """A function for traced numbers, with the values of its names of now.

    Raises ``TraceError`` when it is called, if the function can't be traced. The message says why,
    and in which line of which file.
    """
    if isinstance(function, functools.partial):
        named = function.keywords
        return functools.partial(traceable(function.func), *function.args, **named)
    if isinstance(function, types.MethodType):
        return types.MethodType(traceable(function.__func__), function.__self__)
    function = plain(function)
    if not isinstance(function, types.FunctionType):
        raise TraceError(f"{function!r}, which is no Python function")
    frozen = Freezer(stand_in, _SCOPE, _code).function(function)
    return lambda *args, **named: guarded(function, lambda: frozen(*args, **named))


def _code(function: types.FunctionType) -> types.CodeType:
    check(function, texts=False)
    return rewritten(function.__code__) or function.__code__


def stand_in(value: Any) -> Any:
    """The replacement of a value that a traced function refers to."""
    is_module, is_plain = isinstance(value, types.ModuleType), isinstance(value, types.FunctionType)
    if is_plain and value.__module__.startswith(("fastatt.tracing", "numba")):
        return value
    known = replaced(value) if is_module or callable(value) else None
    if known is not None:
        return known
    if is_module:
        return Traceable(value.__name__)
    return _lazily(value) if is_plain or is_jitted(value) else value


def _lazily(function: Any) -> Callable[..., Any]:
    formula = functools.cache(lambda: traceable(function))

    def call(*args: Any, **named: Any) -> Any:
        return formula()(*args, **named) if named else native.called(formula(), function, args)

    return call


class Traceable:
    """A module with its functions for traced numbers; it is imported when one is first used."""

    def __init__(self, module: str) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        value = self.__dict__[name] = stand_in(getattr(import_module(self._module), name))
        return value


def _choose(test: Any, yes: Callable[[], Any], no: Callable[[], Any]) -> Any:
    if not isinstance(test, (graph.Condition, Recorded)):
        return yes() if test else no()
    return graph.choose(test, yes(), no())


_EXTREMES = {op: OPERATIONS[op].traced for op in ("min", "max")}
_SCOPE = {
    "__builtins__": {**vars(builtins), "type": own_type_of, **_EXTREMES},
    "__choose__": _choose,
}


KERNELS.update((kernel.__name__, stand_in(kernel)) for kernel in (trig.sincos, trig.atan2))
