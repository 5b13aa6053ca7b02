"""Functions of users: rates, torques, forces, potentials and events, frozen when they are given.

A function is followed (``tracing.paths``) and compared with Python (``tracing.trial``), else
compiled by Numba and called for each body (``tracing.called``), else refused.
"""

from __future__ import annotations

import ctypes
import hashlib
import types as python
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fastatt.tracing.trace  # noqa: F401  # the kernels of some operations
from fastatt import checks
from fastatt._cached import cached_property
from fastatt.tracing import frozen, graph, trial
from fastatt.tracing.called import ENTRY, compiled, portable
from fastatt.tracing.graph import Recorded
from fastatt.tracing.nodes import RefusedError, TraceError
from fastatt.tracing.paths import follow
from fastatt.tracing.recording import Recording
from fastatt.tracing.signature import SIGNATURES

#: further names of arguments
_MEANINGS = {
    "time": "t", "quat": "q", "quaternion": "q", "attitude": "q", "omega": "w", "velocity": "v",
    "position": "r", "state": "s", "states": "s", "param": "p", "params": "p", "parameters": "p",
}  # fmt: skip


def user_function(function: Any, role: str, *others: Any, **named: Any) -> UserFunction:
    """A function of users, frozen, followed or compiled; one that is so already stays.

    ``role`` is a key of ``SIGNATURES``, and further arguments are those of ``UserFunction.of``.
    Raises ``TypeError`` if it is not a function, is neither followed nor compiled, or does not
    return the right number of results.
    """
    held = function if isinstance(function, UserFunction) else UserFunction(function)
    return held.of(role, *others, **named)


class UserFunction:
    """A function of users as a scene holds it, which later changes of its values do not reach.

    It is made by ``of``, once, when what it is given for is known. ``followed`` says whether its
    operations are part of a step, and ``reason`` why not. A function that is not followed is in a
    graph as ``("opaque", self, ...)`` and is called at ``address``, as ``void(double* arguments,
    double* results)``.
    """

    def __init__(self, function: Any) -> None:
        self.name, self._function = frozen.name_of(function), function
        arguments = frozen.signature_of(function).parameters.values()
        #: names of the arguments without a default
        self.required = tuple(x.name for x in arguments if x.default is x.empty)
        # defaults may have many lines
        plain = (str(x.replace(default=x.empty, annotation=x.empty)) for x in arguments)
        self.called_as = f"{self.name}({', '.join(plain)})"
        self.argument, self.reason = "function", ""
        self.signature: Any = None
        #: operations of a followed function, code and values of a called one
        self.recording: Recording | None = None
        self.code: Any = None

    def of(
        self,
        role: str,
        n_params: int,
        params: NDArray[np.float64] | None = None,
        states: int = 0,
        own: int | None = None,
        reads: Sequence[tuple[str, int]] = (),
        results: int = 0,
    ) -> UserFunction:
        """The function for a role and a number of parameters, which it has from then on.

        ``params``, (P,) or (N, P), are parameters with which the function is tried, ``states`` is
        the number of states that it takes, and ``own`` how many of them it carries itself, all or
        none by default. ``reads`` are the names and sizes of what other terms show it, and
        ``results`` are how many numbers it returns, if its role leaves that open.
        """
        argument, signature = role.partition(" ")[0], SIGNATURES[role].with_reads(reads)
        signature = signature._replace(results=results or signature.results)
        signature = signature.with_states(states, own)
        signature = signature._replace(n_params=n_params, results=signature.results or n_params)
        if self._function is None and self.signature is not None:
            if signature != self.signature:
                raise TypeError(
                    f"{argument}: found {self!r}, made for {self.signature.call} with "
                    f"{self.signature.n_params} parameters; accepted: one for {signature.call} "
                    f"with {n_params}"
                )
            return self
        if not isinstance(frozen.inner_of(self._function), python.FunctionType):
            raise TypeError(
                f"{argument}: found {checks.brief(self._function)}; accepted: a function "
                f"{SIGNATURES[role].with_reads(reads).with_states(states).call}"
            )
        self.argument, self.signature = argument, signature
        self._check_arguments(role)
        self._make(params)
        self._function = None
        return self

    def _check_arguments(self, role: str) -> None:
        """Refuse a function with other arguments, and say how to declare them."""
        states, names = self.signature.states, self.signature.names
        try:
            frozen.signature_of(self._function).bind(*[None] * (len(self.signature.before) + 1))
        except TypeError:
            accepted = [self.signature.call]
            if self.signature.carries and not states:
                accepted.append(f"with states=n {self.signature.with_states(1).call}")
            if f"{role} at position" in SIGNATURES:
                placed = SIGNATURES[f"{role} at position"].with_reads(self.signature.reads)
                placed = placed.with_states(states)
                accepted.append(f"with uses_position=True {placed.call}")
            raise TypeError(
                f"{self.argument}: found {self.called_as}; accepted: {', or '.join(accepted)}"
            ) from None
        for name, accepted in zip(self.required, names, strict=False):
            meant = _MEANINGS.get(name.casefold(), name)
            if meant != accepted and meant in names:
                raise TypeError(
                    f"{self.argument}: found {self.called_as}, with {name} in the place of "
                    f"{accepted}; accepted: {self.signature.call}"
                )

    def _make(self, params: NDArray[np.float64] | None) -> None:
        """Follow the function, or compile it."""
        try:
            try:
                self._follow(params)
            except TraceError as error:
                self.reason = str(error)
                self._compile(params)
        except RefusedError as error:
            raise TypeError(f"{self.argument}: found {self.described} with {error}") from None
        except TraceError as error:
            n = self.signature.n_params
            p = f"of {n} numbers" if n else "empty, without params"
            raise TypeError(
                f"{self.argument}: {self.described}, p {p}, is not followed: {self.reason}; and "
                f"not compiled: {error}; accepted: a function that is followed, or that numba.njit "
                "compiles"
            ) from None

    def _follow(self, params: NDArray[np.float64] | None) -> None:
        followed = follow(self._function, self.signature)
        spans = [x.span for x in followed.recording.tables if hasattr(x, "span")]
        self.usual = trial.points(self._arguments, params, *spans[:1])
        trial.check(followed, self._arguments, self.usual, self._in_python())
        self.recording = followed.recording

    def _compile(self, params: NDArray[np.float64] | None) -> None:
        """Compile the function; it may not give numbers nowhere, or others than Python."""
        self.usual = trial.points(self._arguments, params)
        self.code = portable(self._function)
        in_python = self._in_python()
        compared = [trial.agrees(x, np.array(self(*x)), in_python) for x in self.usual]
        if not any(compared):
            raise TraceError("an error in Python at every point where it was tried")
        for x in trial.larger(self._arguments, self.usual):
            results = np.array(self(*x))
            if not np.isnan(results).all():  # whole numbers end earlier than in Python
                trial.agrees(x, results, in_python)

    def _in_python(self) -> Callable[[Sequence[float]], Sequence[float]]:
        """The results of the user's own function at a point."""
        function = trial.ending(frozen.in_python(self._function))
        return lambda point: self.signature.in_a_row(function(*self.nested(point)))

    @cached_property
    def is_even(self) -> bool:
        """Whether it gives the same for q and −q, which are one attitude, where it is tried."""
        x, q = self._tried, slice(1, 1 + self._arguments.unit)
        # where a component is 0, a choice by its sign is none
        x = x[(x[:, q] != 0.0).all(axis=1)]
        other = x.copy()
        other[:, q] *= -1.0
        return trial.same(self._gives(x), self._gives(other))

    @cached_property
    def read_params(self) -> frozenset[int]:
        """Indices of the parameters on which its results depend, where it is tried."""
        x, n = self._tried, self.signature.n_params
        results, depends = self._gives(x), set()
        for k in range(n):
            other = x.copy()
            other[:, k - n] = 1.5 * x[:, k - n] + 0.5
            if not trial.same(results, self._gives(other)):
                depends.add(k)
        return frozenset(depends)

    @property
    def _tried(self) -> NDArray[np.float64]:
        """Points (n, numbers) at which it is evaluated."""
        if self.recording is None:
            return np.array(self.usual)
        return trial.many(self.recording, self._arguments, self.usual)

    def _gives(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Its results at points, (n, results)."""
        if self.recording is None:
            return np.array([self(*point) for point in x])
        return self.recording.results_of(self.recording.evaluate(x.T), len(x))

    def __repr__(self) -> str:
        if self._function is not None:
            return f"<function {self.name}>"
        how = "followed" if self.followed else f"called ({self.reason})"
        return f"<{self.argument} {self.name}: {how}>"

    @property
    def followed(self) -> bool:
        """Whether its operations are part of a step."""
        return self.recording is not None

    @property
    def _key(self) -> Any:
        return self._function, self.signature, self.recording, self.code

    def __eq__(self, other: object) -> bool:
        return isinstance(other, UserFunction) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key) if self._function is None else id(self)

    @property
    def fingerprint(self) -> str:
        """A text of what a called function does."""
        return hashlib.sha256(repr((self.signature, self.code)).encode()).hexdigest()

    def __getstate__(self) -> dict[str, Any]:
        return {k: x for k, x in self.__dict__.items() if k != "_compiled"}

    @property
    def tables(self) -> dict[Any, NDArray[np.float64]]:
        """Arrays of the tables that it reads, by their names in graphs."""
        return {} if self.recording is None else self.recording.tables

    @property
    def address(self) -> int:
        """Address of the compiled function."""
        return int(self._compiled.address)

    @cached_property
    def _compiled(self) -> Any:
        return compiled(self.code, self.signature)

    @property
    def _arguments(self) -> trial.Arguments:
        unit, n = 4 * (", q," in self.signature.call), self.signature.n_params
        return trial.Arguments(unit, self.signature.size - 1 - unit - n, n)

    def nested(self, numbers: Sequence[Any]) -> tuple[Any, ...]:
        """Numbers in a row as arguments."""
        return self.signature.nested(numbers)  # type: ignore[no-any-return]

    @property
    def described(self) -> str:
        """Its name in messages: ``spin(t, p)``."""
        return str(self.signature.call.replace(self.argument, self.name, 1))

    def call(self, *args: Any) -> Any:
        """Its result for numbers of a graph: 3 numbers, or one for a potential.

        Of the arguments it takes as many as it has, parameters last. The time derivatives of its
        states follow, if it has states. A function that is called computes in double precision.
        """
        *before, p = args
        numbers = graph.flattened([*before[: len(self.signature.before)], p])
        like = next((x for x in numbers if isinstance(x, Recorded)), None)
        if self.recording is not None:
            with graph.strictly(numbers):
                results = tuple(self.recording.replay(numbers))
        elif like is None:
            results = self(*numbers)
        else:
            results = graph.opaque(self, self.signature.results, numbers, like)  # type: ignore[arg-type]
        return results if len(results) > 1 else results[0]

    def __call__(self, *numbers: float) -> tuple[float, ...]:
        """The result of the compiled function, for all its arguments' numbers in a row."""
        arguments = (ctypes.c_double * max(1, len(numbers)))(*numbers)
        results = (ctypes.c_double * self.signature.results)()
        ENTRY(self.address)(arguments, results)
        return tuple(results)
