"""Kernels and user-defined functions as formulas: called with traced numbers, they record a graph.

Choices are rewritten as operations (``tracing.rewriting``). Where Python still asks whether a
condition holds, the function is called again for each answer, and its result is chosen from those
of all execution paths, such as early returns and loops that end early. Names in a function are
replaced: jitted functions by their Python ones; ``math``, ``numpy`` and Python's builtins by those
for traced numbers. Globals have their values of the time when the formula is made, as with Numba.
"""

from __future__ import annotations

import functools
import math
import random
import types
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numba.core.registry import CPUDispatcher

from fastatt import checks
from fastatt.tracing import functions, graph
from fastatt.tracing.graph import Condition
from fastatt.tracing.mathematics import BUILTINS, RANDOM, Mathematics, refused
from fastatt.tracing.nodes import Recorded, TraceError
from fastatt.tracing.references import opened, referred_to, snapshot
from fastatt.tracing.rewriting import UNSET, located, name_of, rewritten

_GENERATORS = np.random.Generator, np.random.RandomState, random.Random
MAX_ANSWERS = 64  # conditions on one execution path through a function
MAX_PATHS = 256


class _Unset:
    """A name that has no value on this execution path."""

    def __bool__(self) -> bool:
        raise TraceError("a name that has no value on one of the execution paths here")

    def __eq__(self, other: object) -> bool:
        return bool(self)

    __hash__ = None  # type: ignore[assignment]


_UNSET = _Unset()


def _truth(x: Any) -> Any:
    return x != 0.0 if isinstance(x, Recorded) else x


# functions that rewritten code calls, by their names there


def _choose(test: Any, yes: Callable[[], Any], no: Callable[[], Any]) -> Any:
    test = _truth(test)
    if not isinstance(test, Condition):
        return yes() if test else no()
    return _chosen(test, yes(), no())


def _chosen(test: Condition, a: Any, b: Any) -> Any:
    """``a if test else b``; values that can't be chosen from take an execution path each."""
    try:
        return graph.choose(test, a, b)
    except TraceError:
        return a if test else b


def _and(a: Any, b: Callable[[], Any]) -> Any:
    """``a and b``."""
    return _choose(a, b, lambda: a)


def _or(a: Any, b: Callable[[], Any]) -> Any:
    """``a or b``."""
    return _choose(a, lambda: a, b)


def _negation(x: Any) -> Any:
    return x == 0.0 if isinstance(x, Recorded) else graph.negated(x)


def _branch(test: Any, yes: Callable[[], Any], no: Callable[[], Any]) -> Any:
    """Values of the names that an ``if`` assigns; both branches run for an unknown condition."""
    test = _truth(test)
    if not isinstance(test, Condition):
        return yes() if test else no()
    return tuple(_merged(test, a, b) for a, b in zip(yes(), no(), strict=True))


def _merged(test: Condition, a: Any, b: Any) -> Any:
    # a name without a value in one branch can only be used after the other branch
    if a is _UNSET or b is _UNSET:
        return a if b is _UNSET else b
    return a if a is b else _chosen(test, a, b)


_CALLED: dict[str, Any] = {
    "__and": _and,
    "__branch": _branch,
    "__builtins__": BUILTINS,
    "__choose": _choose,
    "__not": _negation,
    "__or": _or,
    UNSET: _UNSET,
}


def all_paths(run: Callable[[], Any]) -> Any:
    """The result of a function, chosen from those of all execution paths.

    Raises ``TraceError`` if there are more than a few hundred.
    """
    count = 0

    def below(known: list[bool]) -> Any:
        """The result of the paths that begin with given answers; later answers are yes first."""
        nonlocal count
        count += 1
        if count > MAX_PATHS:
            raise TraceError(f"more than {MAX_PATHS} execution paths through a function")
        answers: dict[int, bool] = {}
        conditions: list[Condition] = []

        def decide(condition: Condition) -> bool:
            """Whether a condition holds on this path; the answer is the same each time."""
            node, at = condition.graph.nodes[condition.at], condition.at
            if node.op == "not":
                return not decide(graph.negated(condition))
            if at not in answers:
                k = len(answers)
                if k == MAX_ANSWERS:
                    raise TraceError(
                        f"a loop whose end is not known, or more than {k} branches in a row"
                    )
                answers[at] = known[k] if k < len(known) else True
                conditions.append(condition)
            return answers[at]

        outside, graph.deciding.by = graph.deciding.by, decide
        try:
            result = run()
        finally:
            graph.deciding.by = outside
        taken = list(answers.values())
        for k in reversed(range(len(known), len(taken))):
            result = graph.choose(conditions[k], result, below([*taken[:k], False]))
        return result

    return below([])


# functions


class ModuleProxy:
    """Replaces a module; ``instead`` replaces each of its values."""

    def __init__(self, module: types.ModuleType, instead: Callable[[Any], Any]) -> None:
        self._module, self._instead = module, instead

    def __getattr__(self, name: str) -> Any:
        value = self.__dict__[name] = self._instead(getattr(self._module, name))
        return value


class _Generator:
    """Replaces a generator of random numbers and its methods: it can be referred to, but not used.

    NumPy's generators, and those of ``random``, whose functions are methods of one of them.
    """

    def __getattr__(self, name: str) -> Any:
        raise TraceError(RANDOM)

    def __call__(self, *_: Any, **__: Any) -> Any:
        raise TraceError(RANDOM)


class ObjectProxy(ModuleProxy):
    """Replaces the object whose method is traced: it can be read, but not changed."""

    def __init__(self, held: Any) -> None:
        self.__dict__.update(_module=held, _instead=stand_in)

    def __setattr__(self, name: str, value: Any) -> None:
        raise TraceError(f"the attribute {name}, which is assigned to")


def stand_in(value: Any) -> Any:
    """The replacement of a value that a traced function refers to."""
    if value is math or value is np:
        return Mathematics(value)
    if isinstance(value, _GENERATORS) or isinstance(getattr(value, "__self__", 0), _GENERATORS):
        return _Generator()
    if isinstance(value, CPUDispatcher):
        return _lazily(value)
    if isinstance(value, types.ModuleType):
        return ModuleProxy(value, stand_in)
    if (known := _mathematical(value)) is not None:
        return known
    inner = opened(value)[0] if isinstance(value, (functools.partial, types.MethodType)) else value
    if isinstance(inner, types.FunctionType):
        return _lazily(value) if _is_formula(inner) else value
    return _frozen(value)


def _mathematical(value: Any) -> Any:
    """The replacement of a function of ``math``, ``numpy`` or Python; None for another value."""
    name = getattr(value, "__name__", None)
    if not callable(value) or not isinstance(name, str):
        return None
    for module in (math, np):
        if getattr(module, name, None) is value:
            return getattr(Mathematics(module), name)
    if isinstance(value, np.ufunc):
        return refused(name)
    return None


def _frozen(value: Any) -> Any:
    """A copy of a constant, which the traced function can't change."""
    if isinstance(value, np.ndarray):
        copy = value.copy()
        copy.flags.writeable = False
        return copy
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (tuple, list)):
        made = [stand_in(x) for x in value]
        return type(value)(*made) if hasattr(value, "_fields") else tuple(made)
    if isinstance(value, dict):
        return types.MappingProxyType({k: stand_in(x) for k, x in value.items()})
    return value


def _is_formula(function: types.FunctionType) -> bool:
    module = function.__module__ or ""
    return not module.startswith(("fastatt.tracing", "numpy", "numba"))


def _lazily(function: Any) -> Callable[..., Any]:
    formula: Callable[..., Any] | None = None

    def call(*args: Any, **named: Any) -> Any:
        # a list would be changed on each execution path
        args = tuple(tuple(x) if isinstance(x, list) else x for x in args)
        nonlocal formula  # the formula at the first call
        formula = formula or traceable(function)
        return formula(*args, **named) if named else functions.called(formula, function, args)

    return call


# formulas, with the values of a function's names for which they were made
_TRACED: WeakKeyDictionary[Any, tuple[Any, Callable[..., Any]]] = WeakKeyDictionary()


def traceable(function: Any) -> Callable[..., Any]:
    """A function for traced numbers.

    Raises ``TraceError``, from here or when it is called, if the function can't be traced. The
    message says why, and in which line of which file.
    """
    inner, first, named = opened(function)
    if inner is not function:
        return _with_arguments(traceable(inner), first, named)
    plain = getattr(function, "py_func", function)
    if not isinstance(plain, types.FunctionType):
        raise TraceError(f"{plain!r}, which is no Python function")
    now = snapshot(plain)
    before, found = _TRACED.get(plain, (None, None))
    if found is None or before != now:
        found = _traced(plain)
        _TRACED[plain] = now, found
    return found


def _with_arguments(
    formula: Callable[..., Any], first: tuple[Any, ...], named: dict[str, Any]
) -> Callable[..., Any]:
    """A formula with its first arguments and some named ones fixed: numbers, arrays, an object."""
    given = tuple(map(_argument, first))
    known = {name: _argument(x) for name, x in named.items()}
    return lambda *args, **more: formula(*given, *args, **known, **more)


def _argument(value: Any) -> Any:
    is_object = hasattr(value, "__dict__") and not isinstance(
        value, (np.ndarray, type, types.FunctionType, types.MethodType, types.ModuleType)
    )
    return ObjectProxy(value) if is_object else stand_in(value)


def _traced(plain: types.FunctionType) -> Callable[..., Any]:
    code = rewritten(plain.__code__)
    scope = {name: stand_in(x) for name, x in referred_to(plain).items()} | _CALLED
    exec(code, scope)
    made = scope[name_of(plain.__code__)]
    if plain.__defaults__:
        made.__defaults__ = tuple(map(stand_in, plain.__defaults__))
    if plain.__kwdefaults__:
        made.__kwdefaults__ = {k: stand_in(x) for k, x in plain.__kwdefaults__.items()}

    # the cached formula must not keep the function alive
    place = plain.__code__.co_filename, plain.__code__.co_firstlineno

    def call(*args: Any, **named: Any) -> Any:
        try:
            return all_paths(lambda: made(*args, **named))
        except TraceError as error:
            if error.where:
                raise
            raise _located(error, str(error), place) from error
        except Exception as error:
            message = f"{type(error).__name__}: {error}"
            if isinstance(error, AttributeError):
                message += checks.nearest(error.name, dir(error.obj))
            raise _located(error, message, place) from error

    return call


def _located(error: Exception, message: str, at: tuple[str, int]) -> TraceError:
    """The error in the innermost line of a traced function."""
    step = error.__traceback__
    while step is not None:
        if "__choose" in step.tb_frame.f_globals:
            at = step.tb_frame.f_code.co_filename, step.tb_lineno
        step = step.tb_next
    return located(message, *at)
