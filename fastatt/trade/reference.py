"""What errors are measured against, and how good that is itself.

A closed form where the scene has one; else a method of high order whose step is halved until
errors fall as its order says they do, down to a goal or to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import angle_between, quat_multiply, rotation_vector_to_quat
from fastatt.methods import METHODS
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.closed_forms import Evaluation, form_of, rows
from fastatt.scene import rates, torques
from fastatt.threads import number_of
from fastatt.trade.forcing import forcing
from fastatt.trade.ladder import Ladder
from fastatt.trade.measure import Case, Problem, State, last_state

# of high order, and other formulas than those that are run tight
_CONFIRMING = ("dmv10", "kahan_li8", "rk9", "magnus8", "gauss12", "rk4")
_EVALUATIONS = 12  # a step of a tight run: what more of them round is seen
_EPS = float(np.finfo(np.float64).eps)
_LEAST = 4  # steps
# body-steps that a tight run may take, about 2 s of the slowest of them on one core
_WORK = 2e7
_SETTLED = 1e-6  # rad: a change above, which no halving brings down, is no rounding
_FITS = 0.75  # of its order: by so much the error of a method falls at least
_DOUBTED = 4.0  # times the last changes: what an error without an order may be
_BREAKPOINTS = (
    "let steps end at its breakpoints (jumps and corners), with a run of its own from each to the "
    "next"
)
_INSTANTS = 16  # at which a given rate is looked at


@dataclass(frozen=True)
class Reference:
    """Attitudes and angular velocities that errors are measured against.

    ``at(times)`` gives attitudes (S, N, 4) at times (S,), s from the start. ``own_error`` (N,) is
    what they may be off by themselves, rad; ``source`` names them. ``jump`` says what jumps where,
    ``doubt`` how else the error does not fall as it should; "" where all is well.
    """

    end: State
    source: str
    own_error: NDArray[np.float64]
    at: Callable[[NDArray[np.float64]], NDArray[Any]] = field(repr=False)
    #: the same at the same steps of other bodies
    of: Callable[[Problem], Reference] = field(repr=False)
    jump: str = ""
    doubt: str = ""

    def refuse_jumps(self) -> None:
        """Raise ``ValueError`` where what acts jumps: no step has an error that is known then."""
        if self.jump:
            raise ValueError(
                f"scene: {self.jump}, where no method keeps its order; accepted: what is smooth; "
                f"{_BREAKPOINTS}"
            )

    def refuse_beyond(self, tol: float) -> None:
        """Raise ``ValueError`` for a tolerance, rad, that the reference is not far below."""
        own = float(self.own_error.max())
        if own > 0.25 * tol:
            why = f"{self.doubt}; {_BREAKPOINTS}" if self.doubt else "that is rounding"
            raise ValueError(
                f"tol: found {tol:g}; accepted: at least {4.0 * own:.1e}: {self.source}, the "
                f"reference, is good to {own:.1e} rad of some body: {why}"
            )


@dataclass(frozen=True)
class Confirmation:
    """Where another method ends, and how far that is from a reference: (N,), rad."""

    end: State
    source: str
    apart: NDArray[np.float64]

    def __str__(self) -> str:
        return (
            f"{self.source} differs from it by {np.median(self.apart):.1e} rad (median), "
            f"{self.apart.max():.1e} rad (worst)"
        )


def speeds(problem: Problem) -> NDArray[np.float64]:
    """The largest |w| of each body, rad/s: at the start or, of given rates, at even times."""
    e = problem.ensemble
    given = e.scene.rate.w if isinstance(e.scene.rate, rates.Constant) else e.w0
    if given is not None:
        w = np.atleast_2d(np.asarray(given, dtype=np.float64))
        return np.broadcast_to(np.linalg.norm(w, axis=-1), (e.size,))
    fitting = methods_for(e.scene)
    run = problem.run(Case("magnus4" if "magnus4" in fitting else fitting[0]), _INSTANTS, 1)
    return np.asarray(np.linalg.norm(run.w, axis=-1).max(axis=0)).reshape(-1)


def turns(problem: Problem) -> float:
    """The angle, rad, that the fastest body goes through, as far as ``speeds`` knows."""
    return float(speeds(problem).max()) * abs(problem.t_end)


def reference(
    problem: Problem, *, most: int = 1, goal: float = 0.0, method: str | None = None
) -> Reference:
    """The closed form, or the tight run of a method, good to ``goal`` rad or to round-off.

    A tight run is compared with that of half as many steps at up to ``most`` even times, the last
    of them the end.
    """
    if method is None:
        found = _closed_form(problem)
        if found is not None:
            return found
        fitting = [METHODS[name] for name in methods_for(problem.ensemble.scene, "quat")]
        short = [m for m in fitting if m.is_stepped and m.rate_calls <= _EVALUATIONS]
        # the first of the highest order
        method = max(short, key=lambda m: m.order).name
    return _tight(problem, method, most, goal)


def _closed_form(problem: Problem) -> Reference | None:
    found = _solution(problem)
    if found is None:
        return None
    name, solution, gain = found
    own = 2.0 * _EPS * (1.0 + np.hypot(speeds(problem), gain) * abs(problem.t_end))
    q, w = solution(np.array([problem.t_end]))
    end = State(q[-1], None if w is None else w[-1])

    def same(other: Problem) -> Reference:
        known = _closed_form(other)
        assert known is not None
        return known

    return Reference(end, name, own, lambda times: solution(times).q, same)


_Solution = tuple[str, Callable[[NDArray[np.float64]], State], Any]


def _solution(problem: Problem) -> _Solution | None:
    """What exact states are called, they after times t (S,), s, and what |w| gains on the way.

    The gain (rad/s, in the sum of squares) is of each body or of all; None where not known.
    """
    e, scene = problem.ensemble, problem.ensemble.scene
    q0 = np.broadcast_to(e.q0, (e.size, 4)).astype(np.float64)
    if e.w0 is not None and "exact" in methods_for(scene):
        w0 = np.broadcast_to(np.asarray(e.w0), (e.size, 3)).astype(np.float64)
        form, threads = form_of(scene), number_of(None)
        start = rows(q0, q0.dtype), rows(w0, w0.dtype)

        def formed(t: NDArray[np.float64]) -> State:
            q, w = np.empty((t.size, e.size, 4)), np.empty((t.size, e.size, 3))
            Evaluation(form, t.dtype, (t.size, e.size)).fill(start, t, (q, w), threads)
            return State(q, w)

        return "the closed form", formed, form.gain
    if isinstance(scene.rate, rates.Constant):
        w = np.atleast_2d(scene.rate.w)

        def turned(t: NDArray[np.float64]) -> State:
            turn = rotation_vector_to_quat(t[:, None, None] * w)
            pair = (q0, turn) if scene.frame == "body" else (turn, q0)
            return State(quat_multiply(*pair))

        return "one exponential", turned, 0.0
    if isinstance(scene.rate, rates.Coning) and scene.frame == "body":
        angle, frequency = np.atleast_1d(scene.rate.angle), np.atleast_1d(scene.rate.frequency)

        def cone(t: NDArray[np.float64]) -> State:
            path = coning_attitudes(angle, frequency, np.concatenate([[0.0], t]) + problem.t0)
            back = path[:1] * (1.0, -1.0, -1.0, -1.0)
            return State(quat_multiply(q0, quat_multiply(back, path[1:])))

        return "the exact coning motion", cone, 0.0
    return None


def coning_attitudes(
    angle: NDArray[np.float64], frequency: NDArray[np.float64], t: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Exact attitudes (S, N, 4) of ``rates.Coning`` bodies at times t (S,)."""
    phase = frequency * t[:, None]
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    columns = [c, s * np.cos(phase), s * np.sin(phase), 0.0 * phase]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def intervals(problem: Problem) -> int:
    """How many intervals of a sampled torque the run spans: its kinks are to lie between steps."""
    torque = problem.ensemble.scene.torque
    for term in torque.terms if isinstance(torque, torques.Sum) else (torque,):
        if isinstance(term, torques.Sampled):
            n = problem.t_end / term.dt
            if abs(n - round(n)) < 1e-9 * n and 0 < n < _WORK:
                return round(n)
    return 1


def _tight(problem: Problem, method: str, most: int, goal: float) -> Reference:
    """Halve the step until errors fall by the method's order, to the goal or to rounding.

    The first step resolves what acts, which is sampled at many more times than there are steps.
    """
    case, unit = Case(method), intervals(problem)

    def whole(n: float) -> int:
        return math.ceil(max(n, _LEAST) / unit) * unit

    first = whole(turns(problem))
    acting = forcing(problem, case, first)
    longest = _WORK / max(problem.ensemble.size, 64)
    first = whole(min(max(first, acting.steps), max(first, longest / 16)))
    ladder = Ladder(problem, case, first, most)
    longest = max(8.0 * first, longest)
    ladder.halve()
    while True:
        ladder.halve()
        own, settled, doubt = _own_error(ladder, METHODS[method].order, goal)
        # advice, which has a goal, refuses what jumps
        if settled or 2.0 * ladder.n_steps > longest or (acting.jump and goal > 0.0):
            break
    return _known(ladder, own + _EPS, acting.jump, doubt)


def _own_error(ladder: Ladder, order: int, goal: float) -> tuple[NDArray[np.float64], bool, str]:
    """What the finest run may be off by, (N,) rad, whether that is small enough, and a doubt of it.

    It is the last change where two fell as the order says, or one did down to rounding, or two are
    rounding; else what the last three changed is taken several times: by chance one is small.
    """
    changes, worst = ladder.changes, ladder.worst()
    slopes = [ladder.slope(back) for back in (1, 2)[: len(changes) - 1]]
    fell = len(slopes) == 2 and slopes[1] >= _FITS * order
    if worst <= ladder.floor and (fell or ladder.worst(2) <= ladder.floor):
        return changes[-1], True, ""
    if len(slopes) == 2 and min(slopes) >= _FITS * order:
        return changes[-1], worst <= goal, ""
    own = _DOUBTED * np.max(changes[-3:], axis=0)
    # rounding that the motion magnifies
    rounded = len(changes) > 3 and 0.5 * ladder.worst(4) <= worst < _SETTLED
    enough = len(changes) > 2 and (rounded or float(own.max()) <= goal)
    doubt = (
        f"its error falls with order {slopes[0]:.1f} in place of {order}, for corners in what acts "
        "or rounding that the motion magnifies"
    )
    return own, enough, doubt


def _known(ladder: Ladder, own: NDArray[np.float64], *findings: str) -> Reference:
    """The reference that the finest run of a ladder is, at its own steps."""
    n, case = ladder.n_steps, ladder.case

    def of(problem: Problem, error: NDArray[np.float64]) -> Reference:
        seen: dict[bytes, NDArray[Any]] = {}

        def at(times: NDArray[np.float64]) -> NDArray[Any]:
            key = times.tobytes()
            if key not in seen:
                seen.clear()
                each, back = np.unique(times, return_inverse=True)
                seen[key] = problem.run(case, n, save_at=problem.t0 + each).q[back]
            return seen[key]

        def same(other: Problem) -> Reference:
            return of(other, np.full(other.ensemble.size, error.max()))

        end = last_state(ladder.sight.run)
        name = f"{case.name} at {problem.t_end / n:.4g} s"
        return Reference(end, name, error, at, same, *findings)

    return of(ladder.problem, own)


def confirm(problem: Problem, known: Reference, method: str | None = None) -> Confirmation:
    """Run another method tighter and tighter, as long as that brings it nearer the reference."""
    fitting = methods_for(problem.ensemble.scene, "quat")
    used = known.source.split()[0]
    if method is None:
        method = next((m for m in _CONFIRMING if m in fitting and m != used), fitting[0])
    best: Confirmation | None = None
    n = max(_LEAST, math.ceil(turns(problem)))
    longest = max(8 * n, _WORK / max(problem.ensemble.size, 64))
    while n <= longest:
        end = problem.end(Case(method), n)
        apart = np.nan_to_num(angle_between(end.q, known.end.q), nan=np.pi)
        if best is not None and apart.max() > 0.5 * best.apart.max() and apart.max() < _SETTLED:
            break
        if best is None or apart.max() < best.apart.max():
            best = Confirmation(end, f"{method} at {problem.t_end / n:.4g} s", apart)
        n *= 2
    assert best is not None
    return best
