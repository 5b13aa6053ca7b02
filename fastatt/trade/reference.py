"""The reference of errors, and the error of the reference itself.

It is a closed form if the scene has one, else a method of high order whose step is halved until
errors fall as its order predicts, down to a goal or to rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt._cached import cached_property
from fastatt.arrays import quat_rotate_inverse
from fastatt.closed_form import solution_of
from fastatt.methods import METHODS
from fastatt.propagation.breakpoints import breaks_within
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.scene.scene import Scene
from fastatt.trade.forcing import BREAKPOINTS, SAMPLES, forcing
from fastatt.trade.ladder import SATURATED, Ladder, largest_angle, see
from fastatt.trade.measure import Case, Problem, State, last_state, top

# evaluations in a step of a reference, and of what confirms it; more of them round more
_EVALUATIONS, _CONFIRMING = 12, 15
_EPS = float(np.finfo(np.float64).eps)
_LEAST = 4  # steps
# the most body-steps of a reference, about 2 s of the slowest method on one core
_WORK = 2e7
_SETTLED = 1e-6  # rad; a larger change that does not fall with the step is not rounding
_FITS = 0.75  # the least observed share of a method's order
#: share of the tolerance that the error of a reference may have
RESOLVED = 0.25
_DOUBTED = 4.0  # ratio of an error without an order and the last changes
_INSTANTS = 16  # times at which a prescribed rate is evaluated
_EVALUATED = 65536  # bodies whose prescribed rate is evaluated


@dataclass(frozen=True, eq=False)
class Reference:
    """What errors are measured against: a run of a case.

    ``error`` (N,) is its error, rad, and ``source`` its name. ``jump`` says what jumps,
    where, and what is accepted, and ``doubt`` why its error does not fall as it should; both are ""
    if all is well.
    """

    problem: Problem
    case: Case
    n_steps: int
    source: str
    error: NDArray[np.float64]
    jump: str = ""
    doubt: str = ""
    #: whether its own error is rounding
    is_rounding: bool = True

    @cached_property
    def end(self) -> State:
        """Attitudes and, for bodies, angular velocities at the end."""
        return last_state(self.problem.run(self.case, self.n_steps))

    def at(self, times: NDArray[np.float64]) -> NDArray[Any]:
        """Attitudes (S, N, 4) at times (S,), s from the start."""
        each, back = np.unique(times, return_inverse=True)
        run = self.problem.run(self.case, self.n_steps, save_at=self.problem.t0 + each)
        return np.asarray(run.q[back])

    def of(self, other: Problem, quantile: float = 1.0) -> Reference:
        """The reference of other bodies, with the same steps."""
        if self.case.record.is_exact:
            return reference(other)
        errors = np.full(other.ensemble.size, top(self.error, quantile))
        return replace(self, problem=other, error=errors)

    def undetermined(self, rows: NDArray[np.intp], tol: float) -> NDArray[np.intp]:
        """Those of some rows that double precision does not determine to a share of ``tol`` rad.

        The rounding of all steps, as a change of their initial angular velocity, moves them
        farther.
        """
        if rows.size == 0:
            return rows
        one = self.problem.take(rows)
        if one.ensemble.w0 is None:
            return rows[:0]
        rounding = _EPS * math.sqrt(self.n_steps)
        near = replace(one.ensemble, w0=one.ensemble.w0 * (1.0 + rounding))
        runs = (
            see(problem, self.case, self.n_steps, _INSTANTS).q
            for problem in (one, replace(one, ensemble=near))
        )
        return rows[largest_angle(*runs) > RESOLVED * tol]

    @property
    def unresolved(self) -> NDArray[np.float64]:
        """Errors, (N,) rad, below which it cannot tell a method's error; 0 if only rounding is."""
        return np.where(self.is_rounding, 0.0, self.error)

    def refuse(self, tol: float, quantile: float = 1.0) -> None:
        """Raise ``ValueError`` if the scene jumps, or if errors of ``tol`` rad are not far above.

        The errors of a scene with a rate, torque or force that jumps are unknown.
        """
        if self.jump:
            raise ValueError(f"scene: {self.jump}")
        largest = top(self.error, quantile)
        if largest > RESOLVED * tol:
            body = self.problem.ensemble.places[np.argmax(self.error >= largest)]
            why = "that is rounding" if self.is_rounding else "it needs more steps than it takes"
            why = f"{self.doubt} {BREAKPOINTS}" if self.doubt else why
            raise ValueError(
                f"tol: found {tol:g}; accepted: at least {4.0 * largest:.1e}: {self.source}, the "
                f"reference, has an error of {largest:.1e} rad for body {body}: {why}"
            )


def speeds(problem: Problem) -> NDArray[np.float64]:
    """The largest ``|w|`` of each body, rad/s: initial, or of prescribed rates at some times.

    Of many prescribed rates some are evaluated, and the others are 0.
    """
    e = problem.ensemble
    if e.w0 is not None:
        return np.broadcast_to(np.linalg.norm(np.atleast_2d(e.w0), axis=-1), (e.size,))
    fitting = methods_for(e.scene)
    rows = np.random.default_rng(0).permutation(e.size)[:_EVALUATED]
    case = Case("magnus4" if "magnus4" in fitting else fitting[0])
    run = problem.take(rows).run(case, _INSTANTS, 1)
    rates = np.zeros(e.size)
    rates[rows] = np.linalg.norm(run.w, axis=-1).max(axis=0)
    return rates


def from_separatrix(ensemble: Ensemble) -> NDArray[np.float64]:
    """How far each body's energy is from that of rotation about the intermediate axis, a share."""
    moments, axes = ensemble.scene.principal
    w = np.atleast_2d(np.asarray(ensemble.w0))
    w = w if axes is None else quat_rotate_inverse(axes, w)
    momentum, middle = moments * w, np.sort(moments, axis=-1)[..., 1]
    with np.errstate(invalid="ignore"):
        share = middle * (momentum * w).sum(axis=-1) / (momentum**2).sum(axis=-1)
    return np.broadcast_to(np.abs(share - 1.0), (ensemble.size,))


def largest_rotation(problem: Problem) -> float:
    """The rotation angle, rad, of the fastest body over the run, as far as ``speeds`` knows."""
    return float(speeds(problem).max()) * abs(problem.duration)


def reference(
    problem: Problem,
    *,
    most: int = 1,
    goal: float = 0.0,
    method: str | None = None,
    samples: int = SAMPLES,
) -> Reference:
    """The closed form, or a run of high order that is accurate to ``goal`` rad or round-off.

    A run is compared with that of half as many steps at up to ``most`` equally spaced times, the
    last of which is the end. ``samples`` are those of rates, torques and forces.
    """
    scene = problem.ensemble.scene
    if method is None and problem.ensemble.w0 is not None and "exact" in methods_for(scene):
        gained = solution_of(scene).gain * abs(problem.duration)
        angle = np.hypot(speeds(problem) * abs(problem.duration), gained)
        error = 2.0 * _EPS * (1.0 + angle)
        return Reference(problem, Case("exact"), 1, "the closed form", error)
    if method is None:
        method = _of_high_order(scene, _EVALUATIONS)
    return _tight(problem, method, most, goal, samples)


def _of_high_order(scene: Scene, evaluations: int, other: str = "") -> str:
    """The first method of the highest order but ``other``, of those with few evaluations."""
    fitting = [METHODS[name] for name in methods_for(scene, "quat", stepped=True) if name != other]
    return max((m for m in fitting if m.rate_calls <= evaluations), key=lambda m: m.order).name


def intervals(problem: Problem) -> int:
    """The number of equal intervals between the times at which steps end; 1 for unequal ones."""
    scene, begin, end = problem.ensemble.scene, problem.t0, problem.duration
    breaks = breaks_within(scene, begin, end)
    gaps = np.diff(breaks.since, append=end)
    return gaps.size if gaps.size < _WORK and np.ptp(gaps) < 1e-9 * abs(end) else 1


def samples_of_control(problem: Problem) -> int:
    """The fewest steps of which none is longer than the period of a sampled controller.

    Longer steps would end at the samples all the same, but errors are measured after steps.
    """
    scene = problem.ensemble.scene
    periods = [x.period for x in scene.samplings]
    return math.ceil(abs(problem.duration) / min(periods)) if periods else 1


def _tight(problem: Problem, method: str, most: int, goal: float, samples: int) -> Reference:
    """Halve the step until errors fall by the method's order, to the goal or to rounding."""
    case, unit = Case(method), intervals(problem)
    least = max(_LEAST, samples_of_control(problem))

    def whole(n: float) -> int:
        return math.ceil(max(n, least) / unit) * unit

    first = whole(largest_rotation(problem))
    acting = forcing(problem, case, first, samples)
    longest = _WORK / max(problem.ensemble.size, 64)
    # the first step size resolves rates, torques and forces
    first = whole(min(max(first, acting.steps), max(first, longest / 16)))
    ladder = Ladder(problem, case, first, most)
    longest = max(8.0 * first, longest)
    ladder.halve()
    while True:
        ladder.halve()
        error, settled, doubt = _error_of(ladder, METHODS[method].order, goal)
        # advice, which has a goal, refuses jumps
        if settled or 2.0 * ladder.n_steps > longest or (acting.jump and goal > 0.0):
            break
    if not settled and not doubt:
        error = _sharper(ladder, error)
    name = f"{method} at {problem.duration / ladder.n_steps:.4g} s"
    is_rounding = ladder.worst() <= ladder.floor or _is_magnified_rounding(ladder)
    return Reference(
        problem, case, ladder.n_steps, name, error + _EPS, acting.jump, doubt,
        is_rounding=is_rounding,
    )  # fmt: skip


def _error_of(ladder: Ladder, order: int, goal: float) -> tuple[NDArray[np.float64], bool, str]:
    """The error of the finest run, (N,) rad, whether that is small enough, and a doubt of it.

    It is the last change if two changes fell as the order predicts, or one did down to rounding, or
    two are rounding. Otherwise it is a multiple of the last three changes, since one may be small
    by chance; the earlier ones are divided by 4 and by 16, as they fall at least at corners, but
    not those by rounding that the motion magnifies, which do not fall.
    """
    changes, worst = ladder.changes, ladder.worst()
    slopes = [ladder.slope(back) for back in (1, 2)[: len(changes) - 1]]
    fell = len(slopes) == 2 and (
        slopes[1] >= _FITS * order or (slopes[0] >= _FITS * order and ladder.worst(3) > SATURATED)
    )
    if worst <= ladder.floor and (fell or ladder.worst(2) <= ladder.floor):
        return changes[-1], True, ""
    if fell and slopes[0] >= _FITS * order:
        return changes[-1], worst <= goal, ""
    is_rounding = _is_magnified_rounding(ladder)
    fall = 1.0 if is_rounding else 4.0
    last = [change / fall**k for k, change in enumerate(changes[:-4:-1])]
    error = _DOUBTED * np.max(last, axis=0)
    enough = len(changes) > 2 and (is_rounding or float(error.max()) <= goal)
    doubt = (
        f"halving its step size divides its error by {2.0 ** slopes[0]:.3g}, where order {order} "
        f"predicts {2**order}, so that its error is uncertain: a torque or rate has corners, the "
        "motion magnifies rounding, or the run needs more steps than a reference takes. Remedies "
        "are a larger tol, an earlier t_end, or"
    )
    return error, enough, doubt


def _sharper(ladder: Ladder, change: NDArray[np.float64]) -> NDArray[np.float64]:
    """The error of a finest run whose last ``change`` fell as its order predicts, (N,) rad.

    A run with a few steps less has an error of the same size, while the last change is that of half
    as many steps. If it differs by more than that change, the error is larger.
    """
    apart = ladder.apart()
    return np.where(apart <= change, np.minimum(change, 2.0 * apart), _DOUBTED * apart)


def _is_magnified_rounding(ladder: Ladder) -> bool:
    """Whether changes do not fall, as those by rounding that the motion magnifies."""
    return len(ladder.changes) > 3 and 0.5 * ladder.worst(4) <= ladder.worst() < _SETTLED


def confirmation(problem: Problem, known: Reference) -> Reference:
    """Another method, as accurate as a reference."""
    other = _of_high_order(problem.ensemble.scene, _CONFIRMING, known.case.name)
    return reference(problem, method=other)
