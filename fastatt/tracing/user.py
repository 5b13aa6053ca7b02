"""User-defined rates, torques, forces, potentials and events: traced if possible, else called.

A traced function is compared with its results in Python at a few points before it is used. A
function that can't be traced is compiled by Numba and called for each body (``UserFunction.reason``
says why). So is a traced function with very many operations, since each evaluation in a step would
repeat them in the machine code.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.tracing import functions, graph, source
from fastatt.tracing.arrays import numbers_of
from fastatt.tracing.called import (
    ENTRY,
    are_numbers,
    compiled,
    floats,
    in_a_row,
    interpreted,
    nested,
    points,
)
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Graph, Number
from fastatt.tracing.mathematics import RANDOM
from fastatt.tracing.nodes import Recorded, TraceError, composed_of
from fastatt.tracing.references import called_as, opened, signature_of, snapshot
from fastatt.tracing.trace import traceable

# tolerance of a component, relative to its largest value; a wrong formula differs by far more
_TOLERANCE = 1e-9
#: operations of a function in all its evaluations of a step, up to which they are part of the step;
#: LLVM compiles that many in some 8 s
MOST_OPERATIONS = 60_000


class Signature(NamedTuple):
    """A function's arguments before its parameters (0: a number, n: a tuple), and its results.

    ``results`` 0 means as many as there are parameters, −1 as many as states that are not those of
    the function. A function that ``carries`` states returns two tuples, the second with their time
    derivatives; ``results`` are then the numbers of both.
    """

    call: str
    before: tuple[int, ...]
    results: int
    unit: str
    carries: bool = False
    states: int = 0

    def with_states(self, n: int, own: int | None = None) -> Signature:
        """The signature of a function that also takes n states, before its parameters.

        ``own`` is how many of them it carries itself, all or none by default.
        """
        if not n:
            return self
        if own is None:
            own = n if self.carries else 0
        call = self.call.replace(", p)", ", s, p)")
        results = (n - own if self.results < 0 else self.results) + own
        return self._replace(call=call, before=(*self.before, n), results=results, states=own)


FORMS = {
    "rate": Signature("rate(t, p)", (0,), 3, "rad/s", carries=True),
    "torque": Signature("torque(t, q, w, p)", (0, 4, 3), 3, "N·m", carries=True),
    "torque at position": Signature(
        "torque(t, q, w, v, r, p)", (0, 4, 3, 3, 3), 3, "N·m", carries=True
    ),
    "command": Signature("command(t, q, w, p)", (0, 4, 3), -1, "N·m"),
    "force": Signature("force(t, q, w, v, p)", (0, 4, 3, 3), 3, "N"),
    "force at position": Signature("force(t, q, w, v, r, p)", (0, 4, 3, 3, 3), 3, "N"),
    "potential": Signature("potential(t, q, p)", (0, 4), 1, "J"),
    "potential at position": Signature("potential(t, q, r, p)", (0, 4, 3), 1, "J"),
    "event": Signature("event(t, q, w, p)", (0, 4, 3), 1, "a number"),
    "event at position": Signature("event(t, q, w, v, r, p)", (0, 4, 3, 3, 3), 1, "a number"),
}

# user-defined functions with the values of their names for which they were made
_KNOWN: weakref.WeakKeyDictionary[Any, dict[Any, tuple[Any, UserFunction]]] = (
    weakref.WeakKeyDictionary()
)


def user_function(
    function: Callable[..., Any],
    form: str,
    n_params: int,
    params: NDArray[np.float64] | None = None,
    states: int = 0,
    own: int | None = None,
) -> UserFunction:
    """A user-defined function, made once for a number of parameters and its names' values.

    ``form`` is a key of ``FORMS``. ``params``, (P,) or (N, P), are parameters with which the
    function is tried, ``states`` is the number of states that it takes, and ``own`` how many of
    them it carries itself, all or none by default. Raises ``TypeError`` if it is not a function,
    does not compile, or does not return the right number of results.
    """
    inner = opened(function)[0]
    if not isinstance(getattr(inner, "py_func", inner), FunctionType):
        raise TypeError(
            f"{form.partition(' ')[0]}: found {checks.brief(function)}; accepted: a function "
            f"{FORMS[form].with_states(states).call}"
        )
    try:
        made = _KNOWN.setdefault(function, {})
    except TypeError:  # an object without a hash or weak references
        made = {}
    key, now = (form, n_params, states, own), snapshot(function)
    before, found = made.get(key, (None, None))
    if found is None or before != now:
        found = UserFunction(function, form, n_params, params, states, own)
        made[key] = now, found
    return found


class UserFunction:
    """A user-defined function in traced formulas.

    ``straight`` says whether it is traced, and ``reason`` why it is not. A function that is not
    traced is in a graph as ``("opaque", self, ...)`` and is called at ``address``, as
    ``void(double* arguments, double* results)``. A traced one is so if its operations in all
    evaluations of a step (``Graph.evaluations``) are more than ``MOST_OPERATIONS``, and Numba
    compiles it.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        form: str,
        n_params: int,
        params: NDArray[np.float64] | None = None,
        states: int = 0,
        own: int | None = None,
    ) -> None:
        form_of = FORMS[form].with_states(states, own)
        self.form = form_of if form_of.results else form_of._replace(results=n_params)
        self.argument = form.partition(" ")[0]
        self.n_params = n_params
        inner = opened(function)[0]
        self.name = getattr(function, "__name__", getattr(inner, "__name__", self.argument))
        self.reason = ""
        self._check_arguments(function, form)
        #: arrays of the tables that it reads, and the time interval of their samples
        self.tables: dict[Any, NDArray[np.float64]] = {}
        self.span = 0.0, 10.0
        self._formula: Callable[..., Any] | None = None
        #: operations of one evaluation, if it is traced
        self.operations = 0
        # a cached object must not keep the function alive
        self._function = _reference(function)
        try:
            self._formula = self._checked(function, params)
        except (TraceError, RecursionError) as error:
            deep = "an expression that is nested too deeply, or has too many terms"
            self.reason = str(error) if isinstance(error, TraceError) else deep
            if self.reason.startswith(RANDOM):
                found = f"{self.argument}: found {self.described} with {self.reason}"
                raise TypeError(found) from None
            _ = self.address

    def _check_arguments(self, function: Callable[..., Any], form: str) -> None:
        """Refuse a function with another number of arguments, and say how to declare them."""
        signature, states = signature_of(function), self.form.states
        try:
            if signature is not None:
                signature.bind(*[None] * len(self.sizes))
        except TypeError:
            accepted = [self.form.call]
            if self.form.carries and not states:
                accepted.append(f"with states=n {self.form.with_states(1).call}")
            if f"{form} at position" in FORMS:
                placed = FORMS[f"{form} at position"].with_states(states)
                accepted.append(f"with uses_position=True {placed.call}")
            raise TypeError(
                f"{self.argument}: found {called_as(function)}; accepted: {', or '.join(accepted)}"
            ) from None

    def __repr__(self) -> str:
        how = "traced" if self.straight else f"called ({self.reason})"
        return f"<{self.argument} {self.name}: {how}>"

    @property
    def straight(self) -> bool:
        """Whether it is traced."""
        return self._formula is not None

    @property
    def address(self) -> int:
        """Address of the compiled function."""
        return int(self._compiled.address)

    @cached_property
    def _compiled(self) -> Any:
        return compiled(self._function(), self)

    @cached_property
    def _compiles(self) -> bool:
        """Whether a traced function can be compiled by Numba too, with the results of Python."""
        if self._function() is None:
            return False
        try:
            return _agree(self._asked, np.array([self(*point) for point in self._points]))
        except TypeError:
            return False

    def _is_inlined(self, numbers: Sequence[Any]) -> bool:
        """Whether its operations become part of a graph; those for derivatives always do."""
        if self._formula is None:
            return False
        recorder = next((x.graph for x in numbers if isinstance(x, Number)), None)
        if recorder is None or composed_of(*numbers) is not None:
            return True
        return self.operations * recorder.evaluations <= MOST_OPERATIONS or not self._compiles

    @property
    def sizes(self) -> tuple[int, ...]:
        """For each argument 0 for a number, n for a tuple of n."""
        return (*self.form.before, self.n_params)

    @property
    def described(self) -> str:
        """Its name in messages: ``spin(t, p)``."""
        return self.form.call.replace(self.argument, self.name, 1)

    def call(self, *args: Any) -> Any:
        """Its result for traced numbers: 3 numbers, or one for a potential.

        The time derivatives of its states follow, if it has states. A function that is called
        computes in double precision.
        """
        args = tuple(tuple(x) if isinstance(x, (tuple, list)) else x for x in args)
        numbers = graph.flattened(list(args))
        like = next((x for x in numbers if isinstance(x, Recorded)), None)
        if self._is_inlined(numbers):
            assert self._formula is not None
            try:
                return self._formula(*args)
            except TraceError:
                if not isinstance(like, Number):
                    raise
                # Python evaluates operations of known numbers, and refuses 1/0 and the root of −1
                made = [
                    x if isinstance(x, Recorded) else graph.number(like.graph, x, like.kind)
                    for x in numbers
                ]
                return self._formula(*nested(made, self.sizes))
        if like is None:
            found = self(*numbers)
        else:
            found = functions.opaque(self, self.form.results, numbers, like)  # type: ignore[arg-type]
        return found if self.form.results > 1 else found[0]

    def given(self, *args: Any) -> Any:
        """``call`` with as many of the arguments as it takes, parameters last."""
        *before, p = args
        return self.call(*before[: len(self.form.before)], p)

    def __call__(self, *numbers: float) -> tuple[float, ...]:
        """The result of the compiled function, for all its arguments' numbers in a row."""
        given = (ctypes.c_double * max(1, len(numbers)))(*numbers)
        made = (ctypes.c_double * self.form.results)()
        ENTRY(self.address)(given, made)
        return tuple(made)

    def _checked(
        self, function: Callable[..., Any], params: NDArray[np.float64] | None
    ) -> Callable[..., Any]:
        """The traced function; raises ``TraceError`` if it can't be traced or is wrong."""
        recorded = _strict(traceable(function))

        def formula(*args: Any) -> Any:
            return in_a_row(recorded(*args), self.form)

        recorder = Graph()
        numbers = recorder.inputs("double", "x", sum(max(n, 1) for n in self.form.before))
        p = recorder.inputs("double", "p", self.n_params)
        result = numbers_of(formula(*nested((*numbers, *p), self.sizes)))
        values = result if isinstance(result, tuple) else (result,)
        if isinstance(result, tuple) != (self.form.results > 1) or not are_numbers(
            values, self.form.results
        ):
            raise TraceError(f"what it gives is not {self.form.results} numbers")
        flat = Flat(recorder, values, "double")
        found_in = {node.args[0]: None for node in flat.nodes if node.op == "gather"}
        if found_in:
            self.tables = {table: table.data for table in found_in}
            spans = np.array([table.span for table in found_in])
            start, end = sorted((float(spans[:, 0].max()), float(spans[:, 1].min())))
            self.span = start, end
        places = [k + (len(numbers) if group == "p" else 0) for group, k in flat.inputs()]
        self.operations = flat.operations
        traced = source.function(flat, tables=self.tables)
        in_python = interpreted(function)
        asked, found, tried = [], [], []
        for point in points(self.sizes, params, self.span):
            try:
                with np.errstate(all="ignore"):
                    result = in_python(*nested(point, self.sizes))
                    asked.append(floats(in_a_row(result, self.form)))
            except Exception:  # noqa: BLE001  # whatever the user's function raises there
                continue
            found.append(traced(*(point[k] for k in places)))
            tried.append(point)
        if not asked:
            raise TraceError("an error in Python at every point where it was tried")
        self._points, self._asked = tried, np.array(asked)
        if not _agree(self._asked, np.array(found)):
            raise TraceError("other values in Python than as it was traced")
        return formula


def _reference(function: Any) -> Callable[[], Any]:
    """A weak reference, or a strong one to an object that has none."""
    try:
        return weakref.ref(function)
    except TypeError:
        return lambda: function


def _strict(formula: Callable[..., Any]) -> Callable[..., Any]:
    """The formula with Python's arithmetic for user-defined functions, where numbers may be NaN."""

    def call(*args: Any) -> Any:
        found = (x.graph for x in graph.flattened(list(args)) if isinstance(x, Number))
        recorder = next(found, None)
        if recorder is None or recorder.strict:
            return numbers_of(formula(*args))
        recorder.strict = True
        try:
            return numbers_of(formula(*args))
        finally:
            recorder.strict = False

    return call


def _agree(asked: NDArray[np.float64], found: NDArray[np.float64]) -> bool:
    """Whether values (points, results) are equal to rounding."""
    if ((np.isnan(asked) != np.isnan(found)) | (np.isinf(asked) != np.isinf(found))).any():
        return False
    size = np.abs(np.where(np.isfinite(asked), asked, 0.0)).max(axis=0)
    # a component that is 0 to rounding, while others are not
    bound = _TOLERANCE * size + 16 * np.finfo(np.float64).eps * size.max()
    finite = np.isfinite(asked)
    gap = np.abs(np.where(finite, found, 0.0) - np.where(finite, asked, 0.0))
    same_side = finite | np.isnan(asked) | (asked == found)
    return bool(((gap <= bound) & same_side).all())
