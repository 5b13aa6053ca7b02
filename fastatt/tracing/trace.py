"""Functions as they stand, kernels and a user's own, made fit to be called with recorded numbers.

What can be chosen or merged is rewritten so (``tracing.rewriting``). Where Python still asks
whether a condition holds, the function is called again for each answer, and what the ways through
it give is chosen from: early returns, loops that end early, whatever it does there. What a function
refers to is replaced likewise: jitted functions by their Python ones, ``math``, ``numpy`` and
Python's own functions by those that know recorded numbers. Its globals have the values of the
moment when it is first made so, as with Numba.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numba.core.registry import CPUDispatcher

from fastatt.tracing import functions, graph
from fastatt.tracing.graph import Condition
from fastatt.tracing.mathematics import BUILTINS, Mathematics, kind_of, refused
from fastatt.tracing.nodes import NotStraight
from fastatt.tracing.recorded import Recorded
from fastatt.tracing.rewriting import UNSET, located, name_of, rewritten
from fastatt.tracing.standing import referred_to, standing

LONGEST = 64  # answers on one way through a function
WAYS = 256  # ways through it


class _Unset:
    """A name that has no value on this way."""

    def __bool__(self) -> bool:
        raise NotStraight("a name that has no value on one of the ways here")

    def __eq__(self, other: object) -> bool:
        return bool(self)

    __hash__ = None  # type: ignore[assignment]


_UNSET = _Unset()


def _truth(x: Any) -> Any:
    return x != 0.0 if isinstance(x, Recorded) else x


# what rewritten code calls


def _choose(test: Any, yes: Callable[[], Any], no: Callable[[], Any]) -> Any:
    test = _truth(test)
    if not isinstance(test, Condition):
        return yes() if test else no()
    return _chosen(test, yes(), no())


def _chosen(test: Condition, a: Any, b: Any) -> Any:
    """``a if test else b``; of what can't be chosen from, each on its own way."""
    try:
        return graph.choose(test, a, b)
    except NotStraight:
        return a if test else b


def _all_of(*parts: Callable[[], Any]) -> Any:
    """``a and b and ...``; what is no condition goes by Python's rule."""
    result: Any = True
    for k, part in enumerate(parts):
        value = part()
        if isinstance(value, (Condition, bool)):
            result = graph.both(result, value)
            if result is False:
                return False
        elif not value:
            return value if result is True else False
        elif k == len(parts) - 1:
            return value if result is True or bool(result) else False
    return result


def _any_of(*parts: Callable[[], Any]) -> Any:
    """``a or b or ...``."""
    result: Any = False
    for k, part in enumerate(parts):
        value = part()
        if isinstance(value, (Condition, bool)):
            result = graph.either(result, value)
            if result is True:
                return True
        elif value or k == len(parts) - 1:
            return True if result is not False and bool(result) else value
    return result


def _negation(x: Any) -> Any:
    return x == 0.0 if isinstance(x, Recorded) else graph.negated(x)


_COMPARE: dict[str, Callable[[Any, Any], Any]] = {
    "Lt": lambda a, b: a < b,
    "LtE": lambda a, b: a <= b,
    "Gt": lambda a, b: a > b,
    "GtE": lambda a, b: a >= b,
    "Eq": lambda a, b: a == b,
    "NotEq": lambda a, b: a != b,
}


def _chain(left: Any, *rest: Any) -> Any:
    """``a < b < c``."""
    result: Any = True
    for name, later in zip(rest[::2], rest[1::2], strict=True):
        right = later()
        result = graph.both(result, _COMPARE[name](left, right))
        if result is False:
            return False
        left = right
    return result


class _Branches:
    """An ``if`` whose branches assign names: both are taken where the condition is not known."""

    def __init__(self, test: Any, before: tuple[Any, ...]) -> None:
        self.test = _truth(test)
        self.unknown = isinstance(self.test, Condition)
        self.yes = self.unknown or bool(self.test)
        self.no = self.unknown or not self.yes
        self.before = self.kept = before

    def merged(self, after: tuple[Any, ...]) -> tuple[Any, ...]:
        """The names' values behind both."""
        if not self.unknown:
            return after
        return tuple(self._merged(a, b) for a, b in zip(self.kept, after, strict=True))

    def _merged(self, a: Any, b: Any) -> Any:
        # a name without a value on one way can only be used on the other
        if a is _UNSET or b is _UNSET:
            return a if b is _UNSET else b
        return a if a is b else _chosen(self.test, a, b)


_WORDS: dict[str, Any] = {
    "__and": _all_of,
    "__branches": _Branches,
    "__builtins__": BUILTINS,
    "__chain": _chain,
    "__choose": _choose,
    "__not": _negation,
    "__or": _any_of,
    UNSET: _UNSET,
}


# each way through a function


class _Way:
    """One way through a function: the answers it starts with, then yes."""

    def __init__(self, answers: Sequence[bool]) -> None:
        self.given = answers
        self.answers: dict[int, bool] = {}
        self.conditions: list[Condition] = []

    def decide(self, condition: Condition) -> bool:
        """Whether a condition holds on this way: the same whenever it is asked."""
        node = condition.graph.nodes[condition.at]
        if node.op == "not":
            return not self.decide(graph.negated(condition))
        at = condition.at
        if at not in self.answers:
            k = len(self.answers)
            if k == LONGEST:
                raise NotStraight(
                    f"a loop whose end is not known, or more than {LONGEST} branches in a row"
                )
            self.answers[at] = self.given[k] if k < len(self.given) else True
            self.conditions.append(condition)
        return self.answers[at]

    def follow(self, run: Callable[[], Any]) -> Any:
        """What the function gives on this way."""
        outside = graph.deciding.by
        graph.deciding.by = self.decide
        try:
            return run()
        finally:
            graph.deciding.by = outside


def each_way(run: Callable[[], Any]) -> Any:
    """What a function gives, chosen from what each way through it gives.

    Raises ``NotStraight`` where there are more than a few hundred.
    """
    count = 0

    def below(answers: list[bool]) -> Any:
        nonlocal count
        count += 1
        if count > WAYS:
            raise NotStraight(f"more than {WAYS} ways through a function")
        way = _Way(answers)
        result = way.follow(run)
        taken = list(way.answers.values())
        for k in reversed(range(len(answers), len(taken))):
            other = below([*taken[:k], False])
            result = graph.choose(way.conditions[k], result, other)
        return result

    return below([])


# functions


class Standing:
    """Stands for a module: what ``instead`` makes of each thing that it holds."""

    def __init__(self, module: types.ModuleType, instead: Callable[[Any], Any]) -> None:
        self._module, self._instead = module, instead

    def __getattr__(self, name: str) -> Any:
        value = self.__dict__[name] = self._instead(getattr(self._module, name))
        return value


def stand_in(value: Any) -> Any:
    """What takes the place of something that a traced function refers to."""
    if value is math or value is np:
        return Mathematics(value)
    if isinstance(value, CPUDispatcher):
        return _lazily(value)
    if isinstance(value, types.ModuleType):
        return Standing(value, stand_in)
    if (known := _mathematical(value)) is not None:
        return known
    if isinstance(value, types.FunctionType):
        return _lazily(value) if _is_formula(value) else value
    return _frozen(value)


def _mathematical(value: Any) -> Any:
    """Of a function of ``math`` or ``numpy``, or of Python's own, what stands for it; else None."""
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
    """A constant as it is now, which the traced function can't change."""
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
        # a list that was handed over would be changed once for each way through the function
        args = tuple(tuple(x) if isinstance(x, list) else x for x in args)
        nonlocal formula  # as it was when it was first called
        formula = formula or traceable(function)
        return formula(*args, **named) if named else functions.called(formula, function, args)

    return call


# formulas, and the values of a function's names for which they were made
_TRACED: WeakKeyDictionary[Any, tuple[Any, Callable[..., Any]]] = WeakKeyDictionary()


def traceable(function: Any) -> Callable[..., Any]:
    """The same function for recorded numbers.

    Raises ``NotStraight``, from here or when it is called, where the function can't be recorded:
    it says what can't, and in which line of which file.
    """
    plain = getattr(function, "py_func", function)
    if not isinstance(plain, types.FunctionType):
        raise NotStraight(f"{plain!r}, which is no Python function")
    now = standing(plain)
    before, found = _TRACED.get(plain, (None, None))
    if found is None or before != now:
        found = _traced(plain)
        _TRACED[plain] = now, found
    return found


def _traced(plain: types.FunctionType) -> Callable[..., Any]:
    code = rewritten(plain.__code__)
    scope = {name: stand_in(x) for name, x in referred_to(plain).items()} | _WORDS
    exec(code, scope)
    made = scope[name_of(plain.__code__)]
    if plain.__defaults__:
        made.__defaults__ = tuple(map(stand_in, plain.__defaults__))
    if plain.__kwdefaults__:
        made.__kwdefaults__ = {k: stand_in(x) for k, x in plain.__kwdefaults__.items()}

    # what is kept for a function must not keep the function
    place = plain.__code__.co_filename, plain.__code__.co_firstlineno

    def call(*args: Any, **named: Any) -> Any:
        try:
            return each_way(lambda: made(*args, **named))
        except NotStraight as error:
            if error.where:
                raise
            raise _located(error, str(error), place) from error
        except Exception as error:
            message = f"{type(error).__name__}: {error}"
            raise _located(error, message, place) from error

    return call


def _located(error: Exception, message: str, at: tuple[str, int]) -> NotStraight:
    """The error in the innermost line of a traced function."""
    step = error.__traceback__
    while step is not None:
        if "__choose" in step.tb_frame.f_globals:
            at = step.tb_frame.f_code.co_filename, step.tb_lineno
        step = step.tb_next
    return located(message, *at)


__all__ = ["each_way", "kind_of", "stand_in", "traceable"]
