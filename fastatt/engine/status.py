"""The status of each body, and the diagnostics from which most of its flags follow."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntFlag
from typing import Any, NamedTuple, Protocol

import numpy as np

from fastatt.tracing.formulas import Vector, as_like
from fastatt.tracing.graph import choose

# a relative change is taken from invariants above this
_TINY = 1e-37


class Status(IntFlag):
    """What went wrong with one body; 0 where nothing did."""

    OK = 0
    NON_FINITE = 1  #: the state holds NaN or infinity
    STEP_TOO_LARGE = 2  #: a step rotated further than the method's limit
    INVARIANT = 4  #: the energy or |m|² of a free body changed by more than 1 %, or underflows
    SINGULAR = 8  #: the representation's coordinates passed too near their singularity
    NOT_CONVERGED = 16  #: an implicit step's iteration did not converge
    NORM_LOST = 32  #: the state left its group by more than round-off explains
    UNFINISHED = 64  #: the run was interrupted before its end


class Judged(Protocol):
    """What the bounds of a run's diagnostics depend on."""

    @property
    def limit(self) -> float:
        """The largest rotation angle of a step for which the method is trustworthy, rad."""

    @property
    def kind(self) -> np.dtype[Any]:
        """Precision of the state."""

    @property
    def attitude(self) -> Any:
        """How the attitude is represented."""


class Diagnostic(NamedTuple):
    """A measure of which a run keeps each body's largest value, and the flag beyond its bound.

    The first is the square of a step's rotation angle, which the step itself computes. The others
    are what ``Formulas.measures`` gives at each save by their names. ``infinite`` is the flag of an
    infinite value, ``at_poles`` that of coordinates that have poles, where it is another one.
    """

    name: str
    bound: Callable[[Judged], float]
    exceeded: Status
    infinite: Status
    at_poles: Status | None = None

    def flag(self, attitude: Any) -> Status:
        """The flag in a representation."""
        return self.at_poles if self.at_poles and attitude.has_poles else self.exceeded


def _norm_bound(run: Judged) -> float:
    # at 1e-3 RK4's attitude is wrong by more than that
    bound = 1e-3 if run.kind == np.float64 else 1e-2
    return math.inf if run.attitude.restore is None else bound


#: in the order of the rows of a run's diagnostics
DIAGNOSTICS = (
    Diagnostic(
        "angle",
        lambda run: run.limit,
        Status.STEP_TOO_LARGE,
        Status.NOT_CONVERGED,
        at_poles=Status.SINGULAR,
    ),
    Diagnostic("norm", _norm_bound, Status.NORM_LOST, Status.NORM_LOST),
    Diagnostic("invariant", lambda run: 1e-2, Status.INVARIANT, Status.INVARIANT),
)
#: those whose values are found at the saves
SAVED = tuple(x.name for x in DIAGNOSTICS[1:])


def relative_change(a: Vector, b: Vector) -> Any:
    """Largest relative change from the invariants a to b, 0 where there are none."""
    changes = []
    for x, y in zip(a, b, strict=True):
        there = x > _TINY
        change = abs(y / choose(there, x, as_like(1.0, x)) - choose(there, 1.0, 0.0))
        # beyond the largest number nothing is known of it, while the state itself is finite
        changes.append(choose(x < math.inf, change, choose(x > 0.0, 0.0, x)))
    if not changes:
        return 0.0
    x, y = changes
    return choose(x > y, x, y)
