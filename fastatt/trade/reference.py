"""What errors are measured against, and how good that is itself.

A closed form where the scene has one; else a method of high order at a step that is halved until
nothing changes any more. A second method, of another family, confirms either.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import angle_between, quat_multiply, rotation_vector_to_quat
from fastatt.methods import METHODS
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.closed_forms import Evaluation, form_of, rows
from fastatt.propagation.convergence import EARLY, beginnings
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene import rates, torques
from fastatt.threads import number_of
from fastatt.trade.measure import Case, Problem, State

# of other families than those run tight; order 4 is extrapolated from a step and its half
_CONFIRMING = ("dmv10", "kahan_li8", "rkmk4", "cf4", "rk4")
# of what is not run tight
_BESIDE_CLOSED = ("dmv10", "rk9", *_CONFIRMING)
_HIGH = 6
_EVALUATIONS = 12  # a step of a tight run: what more of them round is seen
_EPS = float(np.finfo(np.float64).eps)
_LEAST = 4  # steps
# body-steps that a tight run may take, about 4 s of the slowest of them on one core
_WORK = 5e7
_SETTLED = 1e-6  # rad: nothing above is rounding
_LARGE = 0.3  # rad: a change above is none of an order yet
_INSTANTS = 16  # at which a given rate is looked at
_FINER = 4  # times as many steps as are needed: beside kinks, so that more times are steps


@dataclass(frozen=True)
class Reference:
    """Attitudes (S, N, 4) and angular velocities (S, N, 3) at some times, the last at the end.

    ``own_error`` (N,) is the most that it may be off by itself at those times, rad; ``source``
    names it. ``even(k, part)`` gives the attitudes (k, N, 4) at k even times of the first part-th,
    if ``k <= looks`` and ``fits(k, part)``.
    """

    states: State
    source: str
    own_error: NDArray[np.float64]
    looks: int
    even: Callable[[int, int], NDArray[Any]] = field(repr=False)
    fits: Callable[[int, int], bool] = field(repr=False, default=lambda times, part: True)

    @property
    def end(self) -> State:
        """The last of the states."""
        q, w = self.states
        return State(q[-1], None if w is None else w[-1])

    def beside(self, n: int, part: int = 1) -> tuple[int, NDArray[Any]]:
        """Steps from one look to the next of a run in n steps, and the attitudes at the looks.

        The run is that of the first part-th of the time.
        """
        most = min(n, self.looks)
        times = next(k for k in range(most, 0, -1) if n % k == 0 and (k == 1 or self.fits(k, part)))
        return n // times, self.even(times, part)


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
    return np.asarray(np.linalg.norm(run.w, axis=-1).max(axis=0))


def turns(problem: Problem) -> float:
    """The angle, rad, that the fastest body goes through, as far as ``speeds`` knows."""
    return float(speeds(problem).max()) * abs(problem.t_end)


def reference(
    problem: Problem, *, looks: int = 1, goal: float = 0.0, method: str | None = None
) -> Reference:
    """The closed form, or the tight run of a method, good to ``goal`` rad or to round-off.

    It is known at up to ``looks`` even times, the last of them the end.
    """
    if method is None:
        found = _closed_form(problem, looks)
        if found is not None:
            return found
        fitting = [METHODS[name] for name in methods_for(problem.ensemble.scene, "quat")]
        short = [m for m in fitting if m.is_stepped and m.rate_calls <= _EVALUATIONS]
        # the first of the highest order
        method = max(short, key=lambda m: m.order).name
    return _tight(problem, method, looks, goal)


def _closed_form(problem: Problem, looks: int) -> Reference | None:
    found = _solution(problem)
    if found is None:
        return None
    name, solution, gain = found

    def after(times: int, part: int = 1) -> State:
        return solution(problem.t_end * np.arange(1, times + 1) / (times * part))

    own = 2.0 * _EPS * (1.0 + np.hypot(speeds(problem), gain) * abs(problem.t_end))
    return Reference(after(looks), name, own, looks, lambda times, part: after(times, part).q)


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
        angle, frequency = map(np.atleast_1d, scene.rate)

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


def _ladder(problem: Problem, method: str, looks: int) -> Iterator[tuple[int, list[Trajectory]]]:
    """Runs with steps halved, as long as they may take; saved after each step, or ``looks`` times.

    Beside the whole there are its beginnings, of which the shortest was saved after each step. Each
    are saved at the times of those before, and between them where that is not too many.
    """
    n = max(_LEAST, math.ceil(turns(problem)))
    parts = [EARLY**k for k in range(len(beginnings(n, looks)))]
    unit = math.lcm(intervals(problem), parts[-1])
    n = -(-n // unit) * unit
    every = [-(-n // (part * looks)) for part in parts]
    most = max(8 * n, _WORK / max(problem.ensemble.size, 64))
    while n <= most:
        yield (
            n,
            [
                replace(problem, t_end=problem.t_end / part).run(Case(method), n // part, stride)
                for part, stride in zip(parts, every, strict=True)
            ],
        )
        n *= 2
        every = [stride * (1 if n <= looks else 2) for stride in every]


def _saved(run: Trajectory) -> State:
    return State(run.q[1:], run.w[1:] if "w" in run.carried else None)


def _apart(coarse: Trajectory, fine: Trajectory) -> NDArray[np.float64]:
    """How far two runs are apart at most at the saves of the first, (N,), rad."""
    each = (fine.t.size - 1) // (coarse.t.size - 1)
    apart = angle_between(coarse.q[1:], fine.q[each::each])
    return np.asarray(np.nan_to_num(apart, nan=np.pi).max(axis=0))


def intervals(problem: Problem) -> int:
    """How many intervals of a sampled torque the run spans: its kinks are to lie between steps."""
    torque = problem.ensemble.scene.torque
    for term in torque.terms if isinstance(torque, torques.Sum) else (torque,):
        if isinstance(term, torques.Sampled):
            n = problem.t_end / term.dt
            if abs(n - round(n)) < 1e-9 * n and 0 < n < _WORK:
                return round(n)
    return 1


def _tight(problem: Problem, method: str, looks: int, goal: float) -> Reference:
    """Halve the step until what that changes is no more than the goal, or rounding."""
    order = METHODS[method].order
    best: tuple[int, State, NDArray[np.float64]] | None = None
    before: list[Trajectory] = []
    last: NDArray[np.float64] | None = None
    change, smooth = math.inf, True
    for n, runs in _ladder(problem, method, looks):
        if before:
            pairs = zip(before, runs, strict=True)
            apart = np.max([_apart(*pair) for pair in pairs], axis=0)
            worst = float(apart.max())
            rounded = worst > 0.25 * change and worst < _SETTLED
            if last is not None and 2.0 * worst > last.max() and _SETTLED < worst < _LARGE:
                smooth = False
            if rounded or last is None:
                left = apart
            elif smooth and worst < change * 2.0 ** (-0.5 * order):
                left = apart / (2.0**order - 1.0)
            else:  # a change may be small by chance
                left = np.maximum(apart, last)
            if best is None or worst < change:
                best = n, _saved(runs[0]), left + _EPS
                change = worst
            if rounded or (last is not None and float(left.max()) <= goal):
                break
            last = apart
        before = runs
    assert best is not None
    steps, states, own = best
    kinks = intervals(problem)

    def fine(times: int, part: int) -> int:
        unit = math.lcm(times, kinks // math.gcd(kinks, part))
        return -(-steps // (part * unit)) * unit

    @lru_cache(maxsize=4)
    def even(times: int, part: int) -> NDArray[Any]:
        n = fine(times, part)
        return replace(problem, t_end=problem.t_end / part).run(Case(method), n, n // times).q[1:]

    def fits(times: int, part: int) -> bool:
        aligned = kinks == 1 or kinks % part == 0
        return aligned and part * fine(times, part) <= _FINER * max(steps, part * looks)

    name = f"{method} at {problem.t_end / steps:.4g} s"
    return Reference(states, name, own, looks, even, fits)


def confirm(problem: Problem, known: Reference, method: str | None = None) -> Confirmation:
    """Run another method tighter and tighter, as long as that brings it nearer the reference."""
    fitting = methods_for(problem.ensemble.scene, "quat")
    used = known.source.split()[0]
    if method is None:
        others = _CONFIRMING if used in METHODS else _BESIDE_CLOSED
        method = next((m for m in others if m in fitting and m != used), fitting[0])
    order = METHODS[method].order
    best: Confirmation | None = None
    before: State | None = None
    for n, (run,) in _ladder(problem, method, 1):
        q, w = state = _saved(run)
        name = f"{method} at {problem.t_end / n:.4g} s"
        if order < _HIGH:
            if before is None:
                before = state
                continue
            name = f"{method} extrapolated from {2.0 * problem.t_end / n:.4g} and half"
            q, w = _extrapolated(before, state, order)
            before = state
        end = State(q[-1], None if w is None else w[-1])
        apart = np.nan_to_num(angle_between(end.q, known.end.q), nan=np.pi)
        if best is not None and apart.max() > 0.5 * best.apart.max() and apart.max() < _SETTLED:
            break
        if best is None or apart.max() < best.apart.max():
            best = Confirmation(end, name, apart)
    assert best is not None
    return best


def _extrapolated(coarse: State, fine: State, order: int) -> State:
    """Richardson's extrapolation from a step and its half."""
    k = 2.0**order
    same = np.sign(np.einsum("...i,...i->...", coarse.q, fine.q))[..., None]
    q = (k * fine.q - same * coarse.q) / (k - 1.0)
    w = None
    if fine.w is not None and coarse.w is not None:
        w = (k * fine.w - coarse.w) / (k - 1.0)
    return State(q / np.linalg.norm(q, axis=-1, keepdims=True), w)
