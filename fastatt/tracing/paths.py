"""Functions of users, followed: run once for each execution path with numbers that record.

A comparison of unknown numbers gives Python's own ``bool``, the answer of this path; the whole
function runs again on fresh arguments for the other answer. Writes in place, aliases, early returns
and containers are thereby Python's.
"""

from __future__ import annotations

import contextlib
import math
import operator
import types
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fastatt.tracing.frozen import Freezer, check, guarded
from fastatt.tracing.nodes import RefusedError, TraceError
from fastatt.tracing.operations import OPERATIONS
from fastatt.tracing.recording import Recording
from fastatt.tracing.replacements import BUILTINS, each, known_names, replaced, unknown_in
from fastatt.tracing.rewriting import rewritten
from fastatt.tracing.signature import Signature
from fastatt.tracing.unknown import Recorder, is_number, is_whole

MOST_PATHS = 512


class Followed(NamedTuple):
    """A function as operations."""

    recording: Recording
    #: conditions with their answers, of each execution path; one of a choice is by itself
    paths: list[list[tuple[int, bool]]]
    #: conditions of which both sides are tried
    conditions: set[int]


def follow(function: Any, signature: Signature) -> Followed:
    """Follow a function.

    Raises ``TraceError``, with the line, if it can't be followed, and ``RefusedError`` if it is no
    function that a scene accepts.
    """
    try:
        return _followed(function, signature, predicated=True)
    except (TraceError, RefusedError):
        return _followed(function, signature, predicated=False)


def _followed(function: Any, signature: Signature, *, predicated: bool) -> Followed:
    recorder, paths = Recorder(), list[list[tuple[int, bool]]]()
    raised: Any = (TypeError, AttributeError, RecursionError, MemoryError)
    # a name without a value is no error where it is only read to be kept
    raised = (*raised, NameError) if predicated else raised

    def code(function: types.FunctionType) -> types.CodeType:
        check(function, texts=False)
        code = function.__code__
        return (predicated and rewritten(code, known_names(function.__globals__))) or code

    frozen = guarded(function, lambda: Freezer(replaced, _SCOPE, code)(function))
    numbers = [recorder.at(recorder.add("in", k)) for k in range(signature.size)]
    inputs = signature.nested(numbers)

    def below(forced: list[bool]) -> list[Any]:
        """The results of the paths that begin with given answers."""
        if len(paths) >= MOST_PATHS:
            raise TraceError(f"more than {MOST_PATHS} execution paths")
        recorder.begin(forced)
        run = lambda: signature.in_a_row(frozen(*inputs))  # noqa: E731
        results = _path(run, recorder, signature.results, raised)
        taken = list(recorder.answers.items())
        paths.append(taken)
        for k in reversed(range(len(forced), len(taken))):
            pairs = zip(results, below([x for _, x in taken[:k]] + [False]), strict=True)
            results = [recorder.choice(taken[k][0], *pair) for pair in pairs]
        return results

    results = [*map(recorder.number, guarded(function, lambda: below([])))]
    recording = Recording(tuple(recorder.nodes), tuple(results))
    if {*results} == {recorder.number(math.nan)}:
        error = recorder.error
        text = f"{type(error).__name__}: {error}"
        raise TraceError(f"an error on every path, such as {text}") from error
    paths += [[(condition, answer)] for condition in recorder.chosen for answer in (True, False)]
    conditions = {condition for path in paths for condition, _ in path} - recorder.guards
    return Followed(recording, paths, conditions)


def _path(run: Callable[[], Any], recorder: Recorder, n_results: int, raised: Any) -> list[Any]:
    """The results of a path; NaN if it ends in an error that is not ``raised``."""
    try:
        results = list(run())
    except Exception as error:
        if isinstance(error, raised):
            raise
        if "read-only" in str(error):
            raise RefusedError("an array from outside the function that it changes") from error
        recorder.error = error
        return [math.nan] * n_results
    finally:
        for x, before in recorder.unchanged:
            if any(a is not b for a, b in zip(x.flat, before.flat, strict=True)):
                raise TraceError("a change of an array that may have other names")
    if recorder.texts:
        raise RefusedError("the text of a number")
    return results


# choices in place of paths (``tracing.rewriting``)


#: what changes no number
_NEUTRAL = {"iadd": 0.0, "isub": 0.0, "imul": 1.0, "itruediv": 1.0}


def _choose(op: str, a: Any, b: Any, yes: Callable[[], Any], no: Callable[[], Any]) -> Any:
    """``yes() if a op b else no()``; the choice of two numbers is no condition of the path."""
    with contextlib.suppress(Exception):
        return _either(op, a, b, yes, no)
    return yes() if OPERATIONS[op].traced(a, b) else no()


def _changed(op: str, a: Any, b: Any, change: str, old: Any, value: Callable[[], Any]) -> Any:
    """``old`` after ``if a op b: old change= value()``; else 0 is added, or 1 a factor."""
    in_place = getattr(operator, change)
    with contextlib.suppress(Exception):
        if type(old) is np.ndarray or (is_number(old) and not is_whole(old)):
            none = lambda: np.full(np.shape(value()), _NEUTRAL[change])[()]  # noqa: E731
            return in_place(old, _either(op, a, b, lambda: 1.0 * value(), none))
    return in_place(old, value()) if OPERATIONS[op].traced(a, b) else old


def _either(op: str, a: Any, b: Any, yes: Callable[[], Any], no: Callable[[], Any]) -> Any:
    """Both values as one. Raises an error unless they are numbers that ask nothing."""
    like = unknown_in(a, b)
    if like is None or np.ndim(a) or np.ndim(b):
        raise TraceError("a condition of known numbers, or of arrays")
    recorder = like.recorder
    test = recorder.add(op, recorder.number(a), recorder.number(b))
    if test in recorder.answers:
        raise TraceError("a condition of this path")
    recorder.silent += 1
    try:
        values = yes(), no()
    finally:
        recorder.silent -= 1

    def chosen(x: Any, y: Any) -> Any:
        if not (is_number(x) and is_number(y) and is_whole(x) == is_whole(y)):
            raise TraceError("a choice of other values than numbers")
        return recorder.choice(test, x, y)

    arrays = [x for x in values if isinstance(x, np.ndarray)]
    if arrays and (len(arrays) == 1 or arrays[0].shape != arrays[1].shape):
        raise TraceError("a choice of values of two shapes")
    choice = each(chosen, *values) if arrays else chosen(*values)
    if arrays:  # they may have other names
        recorder.unchanged += [(x, x.copy()) for x in (choice, *values) if x.dtype == object]
    recorder.chosen.add(test)
    return choice


_SCOPE: dict[str, Any] = {"__builtins__": BUILTINS, "__choose__": _choose, "__changed__": _changed}
