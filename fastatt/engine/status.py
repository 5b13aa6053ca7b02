"""The status of each body, and the diagnostics from which most of its flags follow."""

from __future__ import annotations

import math
from enum import IntFlag
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.tracing.formulas import Vector, as_like
from fastatt.tracing.graph import Double, apply, both, choose, either, negated

# invariants below this have no relative change
_TINY = 1e-37


class Status(IntFlag):
    """Flags of one body; 0 (``OK``) if nothing went wrong. Flags can be combined.

    Attributes
    ----------
    OK : Status
        0: no flag.
    NON_FINITE : Status
        1: the state holds NaN or infinity.
    STEP_TOO_LARGE : Status
        2: a step exceeded the method's limit (``Method.limits``, ``Method.damping_limit``), or a
        rotation in closed form lost its digits to rounding.
    INVARIANT : Status
        4: at a save, the energy or ``|m|²`` of a free body had changed by more than 1 %, or
        underflows while the body rotates.
    SINGULAR : Status
        8: coordinates with poles came too close to their singularity.
    NOT_CONVERGED : Status
        16: the iteration of an implicit step did not converge.
    NORM_LOST : Status
        32: before the state was renormalised, at a save or between saves, the norm error of the
        quaternion or the orthogonality error of the matrix was above 1e-3, in float32 above 1e-2;
        with ``compensated=True`` the errors that renormalising removes are added up. Coordinates
        (Euler angles, modified Rodrigues parameters) have no such flag.
    UNFINISHED : Status
        64: the run was interrupted before the end of this body.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.Status(36)
    <Status.INVARIANT|NORM_LOST: 36>
    """

    OK = 0
    NON_FINITE = 1  #: the state holds NaN or infinity
    STEP_TOO_LARGE = 2  #: a step exceeded the method's limit
    INVARIANT = 4  #: the energy or |m|² of a free body changed too much, or underflows
    SINGULAR = 8  #: coordinates came too close to their singularity
    NOT_CONVERGED = 16  #: an implicit step's iteration did not converge
    NORM_LOST = 32  #: the norm error of a quaternion or a matrix is above its bound
    UNFINISHED = 64  #: the run was interrupted before its end


def count_flags(status: NDArray[np.uint8]) -> dict[str, int]:
    """The name of each flag that bodies have, with their number."""
    counts = {flag.name or "": int(np.count_nonzero(status & flag)) for flag in Status if flag}
    return {name: count for name, count in counts.items() if count}


class Diagnostic(NamedTuple):
    """A quantity of which a run keeps each body's largest value, and the flag beyond its bound.

    The first is the square of a step's rotation angle, which the step computes. The others are
    those of ``Formulas.save``. ``infinite`` is the flag of an infinite value of a method that
    iterates; ``at_poles`` is the flag for coordinates with poles, if it is another one.
    """

    exceeded: Status
    infinite: Status
    at_poles: Status | None = None

    def flag(self, attitude: Any) -> Status:
        """The flag in a representation."""
        return self.at_poles if self.at_poles and attitude.has_poles else self.exceeded


#: of the angle, the norm and the invariants, in the order of the rows of a run's diagnostics
DIAGNOSTICS = (
    Diagnostic(Status.STEP_TOO_LARGE, Status.NOT_CONVERGED, Status.SINGULAR),
    Diagnostic(Status.NORM_LOST, Status.NORM_LOST),
    Diagnostic(Status.INVARIANT, Status.INVARIANT),
)
#: those that are evaluated at the saves
SAVED = DIAGNOSTICS[1:]


def bounds(limit: float, attitude: Any, dtype: Any) -> tuple[float, ...]:
    """The bounds of the diagnostics; the ``limit`` is that of a step's rotation angle, rad."""
    # at 1e-3 RK4's attitude is wrong by more than that
    norm = 1e-3 if dtype == np.float64 else 1e-2
    return limit, math.inf if attitude.restore is None else norm, 1e-2


def relative_change(a: Vector, b: Vector) -> Any:
    """The largest relative change from the invariants a to b; 0 if there are none."""
    changes = []
    for x, y in zip(a, b, strict=True):
        there = x > _TINY
        change = abs(y / choose(there, x, as_like(1.0, x)) - choose(there, 1.0, 0.0))
        # an invariant that overflows says nothing, while the state is finite
        changes.append(choose(x < math.inf, change, choose(x > 0.0, 0.0, x)))
    if not changes:
        return 0.0
    x, y = changes
    return choose(x > y, x, y)


def is_number(x: Any) -> Any:
    """Whether a number is not NaN."""
    return x == x  # noqa: PLR0124


def larger(before: Any, value: Any) -> Any:
    """The larger of two numbers, or NaN."""
    return choose(either(before >= value, negated(is_number(before))), before, value)


def flags(x: Vector, values: Vector, limits: Vector, attitude: Any, *, iterates: bool) -> Any:
    """The flags of a body from its state, its largest diagnostics, and their limits.

    The first of the diagnostics is the square of an angle.
    """
    finite = reduce(both, [abs(each) < math.inf for each in x])
    total = choose(finite, 0.0, float(Status.NON_FINITE))
    for k, (of, value, limit) in enumerate(zip(DIAGNOSTICS, values, limits, strict=True)):
        exceeded, most = float(of.flag(attitude)), Double(value)
        infinite = float(of.infinite) if iterates else exceeded
        flag = choose((apply("sqrt", most) if k == 0 else most) <= limit, 0.0, exceeded)
        # a NaN angle of a state that is lost tells nothing of the step
        flag = choose(finite if k else either(finite, is_number(most)), flag, 0.0)
        if infinite != exceeded:
            flag = choose(value == math.inf, choose(finite, infinite, 0.0), flag)
        total = total + flag
    return total
