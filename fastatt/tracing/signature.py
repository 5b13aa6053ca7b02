"""What functions of users are called with, and what they return."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fastatt.tracing.nodes import RefusedError
from fastatt.tracing.unknown import Unknown

_NUMBERS = (Unknown, float, int, np.number, np.bool_)


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
    reads: tuple[tuple[str, int], ...] = ()
    n_params: int = 0

    @property
    def names(self) -> list[str]:
        """The names of the arguments, in their order."""
        return self.call.partition("(")[2].rstrip(")").split(", ")

    def with_states(self, n: int, own: int | None = None) -> Signature:
        """The signature of a function that also takes n states, before its parameters.

        ``own`` is how many of them it carries itself, all or none by default.
        """
        if not n:
            return self
        states = own if own is not None else n if self.carries else 0
        call = self.call.replace(", p)", ", s, p)")
        results = (n - states if self.results < 0 else self.results) + states
        return self._replace(call=call, before=(*self.before, n), results=results, states=states)

    def with_reads(self, reads: Sequence[tuple[str, int]]) -> Signature:
        """The signature of a function that takes numbers of other terms, before its states."""
        names = "".join(f", {name.replace('.', '_')}" for name, _ in reads)
        call = self.call.replace(", p)", f"{names}, p)")
        before = *self.before, *(n for _, n in reads)
        return self._replace(call=call, before=before, reads=tuple(reads))

    @property
    def size(self) -> int:
        """How many numbers the arguments have."""
        return sum(max(n, 1) for n in self.before) + self.n_params

    def nested(self, numbers: Sequence[Any]) -> tuple[Any, ...]:
        """Numbers in a row as arguments."""
        rest = iter(numbers)
        before = [tuple(itertools.islice(rest, n)) if n else next(rest) for n in self.before]
        return *before, tuple(rest)

    def in_a_row(self, result: Any) -> Sequence[Any]:
        """The numbers of a result; raises ``RefusedError`` for other ones."""
        states = self.states
        sizes = [self.results - states, states] if states else [self.results]
        is_row = isinstance(result, (tuple, list))
        parts = [result] if not states else list(result) if is_row else []
        parts = [list(x) if isinstance(x, (tuple, list)) or np.ndim(x) == 1 else [x] for x in parts]
        row = [x[()] if type(x) is np.ndarray and not x.ndim else x for y in parts for x in y]
        crosses = self.call.startswith(("event(", "switch("))
        if crosses and any(isinstance(x, (bool, np.bool_)) for x in row):
            raise RefusedError(
                "a result that is True or False, whose change has no time within a step; accepted: "
                "a number that crosses zero, such as w[0] - 0.3 for w[0] > 0.3"
            )
        others = [type(x).__name__ for x in row if not isinstance(x, _NUMBERS)]
        if [*map(len, parts)] != sizes or others:
            of = ""
            if isinstance(result, (tuple, list, np.ndarray)):
                size = result.shape if isinstance(result, np.ndarray) else (len(result),)
                of = f" of {size[0] if len(size) == 1 else size}"
                of += f" with {others[0]}" if others else ""
            name = "float" if isinstance(result, Unknown) else type(result).__name__
            with_states = f", and a tuple of {states}, the time derivatives of s" if states else ""
            raise RefusedError(
                f"a result that is {name}{of}; accepted: {sizes[0]} numbers, "
                f"{self.unit}{with_states}"
            )
        return row


SIGNATURES = {
    "rate": Signature("rate(t, p)", (0,), 3, "rad/s", carries=True),
    "torque": Signature("torque(t, q, w, p)", (0, 4, 3), 3, "N·m", carries=True),
    "torque at position": Signature(
        "torque(t, q, w, v, r, p)", (0, 4, 3, 3, 3), 3, "N·m", carries=True
    ),
    "control": Signature("control(t, q, w, p)", (0, 4, 3), 3, "numbers", carries=True),
    "command": Signature("command(t, q, w, p)", (0, 4, 3), -1, "N·m"),
    "force": Signature("force(t, q, w, v, p)", (0, 4, 3, 3), 3, "N"),
    "force at position": Signature("force(t, q, w, v, r, p)", (0, 4, 3, 3, 3), 3, "N"),
    "potential": Signature("potential(t, q, p)", (0, 4), 1, "J"),
    "potential at position": Signature("potential(t, q, r, p)", (0, 4, 3), 1, "J"),
    "switch": Signature("switch(t, q, w, p)", (0, 4, 3), 1, "a number"),
    "switch at position": Signature("switch(t, q, w, v, r, p)", (0, 4, 3, 3, 3), 1, "a number"),
    "event": Signature("event(t, q, w, p)", (0, 4, 3), 1, "a number"),
    "event at position": Signature("event(t, q, w, v, r, p)", (0, 4, 3, 3, 3), 1, "a number"),
}
