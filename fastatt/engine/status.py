"""The status of each body, and the diagnostics from which its flags follow.

Three flags have none: of a state that is not finite, of a run without an end, and of a switch that
slides, which the run itself finds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from enum import IntFlag
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import rounding
from fastatt.tracing.formulas import Vector, as_like, dot
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
    JUMP : Status
        128: the torque of a built-in model jumped within a step, where the error of a
        ``QuaternionPD`` passed 180° or the speed of a wheel passed the range in which its Coulomb
        friction changes its sign: the run has order 1. With ``divides=True`` these models divide
        the step there.
    SLIDING : Status
        256: the function of a ``torques.Switch`` crossed zero without end within a step. The side
        follows the sign after whole steps from then on, which is of order 1.

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
    JUMP = 128  #: the torque of a built-in model jumped within a step
    SLIDING = 256  #: a switch crossed without end within a step


#: the type of the flags in arrays, with room for more
FLAGS = np.uint16


def count_flags(status: NDArray[FLAGS]) -> dict[str, int]:
    """The name of each flag that bodies have, with their number."""
    counts = {flag.name or "": int(np.count_nonzero(status & flag)) for flag in Status if flag}
    return {name: count for name, count in counts.items() if count}


class Step(NamedTuple):
    """What the diagnostics of a step are computed from."""

    #: the square of its rotation angle
    square: Any
    #: on which side of their jumps the models of the torque are, at its two ends (``Torque.sides``)
    begun: Sequence[Vector]
    ended: Sequence[Vector]


class Save(NamedTuple):
    """What the diagnostics of a save are computed from."""

    norm_error: Any
    #: the invariants at the start and now
    begun: Vector
    now: Vector


class Bounded(NamedTuple):
    """What bounds depend on: the limit of a step's rotation angle, rad, and the state."""

    turn: float
    attitude: Any
    dtype: Any


class Diagnostic(NamedTuple):
    """A number of which a run keeps each body's largest value, and the flag beyond its bound.

    The rows of the program, its formulas, the flags of the two ways of running, and the layout of
    the file of a run's end follow from these records.
    """

    name: str
    flag: Status
    #: its value from a ``Step``, or from a ``Save``
    formula: Callable[[Any], Any]
    bound: Callable[[Bounded], float]
    #: which bodies of a ``ClosedRun`` have the flag; None if its solution can't have it
    closed: Callable[[Any], NDArray[np.bool_]] | None
    #: whether a ``Job`` has it
    applies: Callable[[Any], bool] = lambda job: True
    #: whether steps compute it
    of_steps: bool = False
    #: whether the square of what the bound holds for is kept
    is_square: bool = False
    #: the flag of an infinite value of a method that iterates
    infinite: Status | None = None
    #: the flag for coordinates with poles
    at_poles: Status | None = None

    def flag_of(self, attitude: Any) -> Status:
        """The flag in a representation."""
        return self.at_poles if self.at_poles and attitude.has_poles else self.flag


def norm_bound(run: Bounded) -> float:
    """The largest norm error; at 1e-3 the attitude of RK4 is wrong by more than that."""
    if run.attitude.restore is None:
        return math.inf
    return 1e-3 if run.dtype == np.float64 else 1e-2


def jumped(step: Step) -> Any:
    """1 if the torque of a model jumped in a step, otherwise 0."""
    across = [dot(a, b) < 0.0 for a, b in zip(step.begun, step.ended, strict=True)]
    return choose(reduce(either, across), 1.0, 0.0)


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


#: in the order of their rows; the angle is the last one of steps, as ``engine.machine`` has it
DIAGNOSTICS = (
    Diagnostic(
        "jump", Status.JUMP, jumped, lambda run: 0.5, None, lambda job: job.jumps, of_steps=True
    ),
    Diagnostic(
        "angle", Status.STEP_TOO_LARGE, lambda step: step.square, lambda run: run.turn,
        lambda run: run.angles > rounding.most_turned(run.dtype), of_steps=True, is_square=True,
        infinite=Status.NOT_CONVERGED, at_poles=Status.SINGULAR,
    ),
    Diagnostic("norm", Status.NORM_LOST, lambda save: abs(save.norm_error), norm_bound, None),
    Diagnostic(
        "drift", Status.INVARIANT, lambda save: relative_change(save.begun, save.now),
        lambda run: 1e-2, None,
    ),
)  # fmt: skip


def flags(
    x: Vector, values: Mapping[str, Any], limits: Mapping[str, Any], attitude: Any, *,
    iterates: bool,
) -> Any:  # fmt: skip
    """The flags of a body from its state, its largest diagnostics, and their limits, by name."""
    finite = reduce(both, [abs(each) < math.inf for each in x])
    total = choose(finite, 0.0, float(Status.NON_FINITE))
    for of in filter(lambda of: of.name in values, DIAGNOSTICS):
        value, exceeded = values[of.name], float(of.flag_of(attitude))
        most, infinite = Double(value), exceeded
        if iterates and of.infinite is not None:
            infinite = float(of.infinite)
        size = apply("sqrt", most) if of.is_square else most
        flag = choose(size <= limits[of.name], 0.0, exceeded)
        # a NaN angle of a state that is lost tells nothing of the step
        flag = choose(either(finite, is_number(most)) if of.of_steps else finite, flag, 0.0)
        if infinite != exceeded:
            flag = choose(value == math.inf, choose(finite, infinite, 0.0), flag)
        total = total + flag
    return total
