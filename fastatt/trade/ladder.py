"""Runs of one case with its step halved repeatedly, and the changes of their attitudes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import angle_between
from fastatt.propagation.trajectory import Trajectory
from fastatt.trade.measure import Case, Problem

#: rad; runs that differ by more show no order yet, and beyond all angles are alike
LARGE, SATURATED = 0.3, 1.0
# states of a run that are compared, at 16 to 1024 times
_STATES = 2**20


def times_compared(size: int) -> int:
    """The number of times at which runs of so many bodies are compared."""
    return int(np.clip(_STATES // size, 16, 1024))


class Sight(NamedTuple):
    """Attitudes (S, N, 4) of a run at some times (S,), s from its start; and the whole run."""

    times: NDArray[np.float64]
    q: NDArray[np.float64]
    run: Trajectory
    flagged: NDArray[np.bool_]


def see(problem: Problem, case: Case, n: int, most: int, by: int = 1) -> Sight:
    """A run in ``n by`` steps, at the times of ``n`` steps: after each, or after ``most`` of them.

    If there are more steps, the times are equally spaced ones and the first ones, since decaying
    motions change most at the start.
    """
    parts = [(n, -(-n // most))]
    if n > most > 1:
        parts.insert(0, (most, 1))
    runs = [
        replace(problem, duration=problem.duration * m / n).run(case, m * by, stride * by)
        for m, stride in parts
    ]
    steps = [np.array([*range(stride, m, stride), m]) for m, stride in parts]
    return Sight(
        np.concatenate(steps) * (problem.duration / n),
        np.concatenate([run.q[1:] for run in runs]),
        runs[-1],
        np.any([run.status != 0 for run in runs], axis=0),
    )


def largest_angle(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The largest angle over the first axis, rad; π if it is not finite."""
    apart = np.nan_to_num(angle_between(a, b), nan=np.pi, posinf=np.pi)
    return np.asarray(apart.max(axis=0), dtype=np.float64)


class Ladder:
    """Runs of a case in ``n_steps`` steps, twice as many, and so on, compared at the same times.

    ``changes`` has the change by each halving, (N,) rad; ``sight`` is that of the finest run.
    """

    def __init__(self, problem: Problem, case: Case, n_steps: int, most: int) -> None:
        self.problem, self.case, self.first, self.most = problem, case, n_steps, most
        self.start = self.sight = see(problem, case, n_steps, most)
        self.changes: list[NDArray[np.float64]] = []

    @property
    def n_steps(self) -> int:
        """Number of steps of the finest run."""
        return int(self.first * 2 ** len(self.changes))

    def halve(self) -> NDArray[np.float64]:
        """Run with half the step size; returns the difference from the run before, (N,) rad."""
        by = 2 ** (len(self.changes) + 1)
        finer = see(self.problem, self.case, self.first, self.most, by)
        self.changes.append(largest_angle(self.sight.q, finer.q))
        self.sight = finer
        return self.changes[-1]

    def apart(self, share: float = 0.77) -> NDArray[np.float64]:
        """The difference of the finest run from one in some ``share`` of its steps, (N,) rad.

        Its steps are no whole fraction of the others: a motion that goes through whole cycles in
        each step of the others does not in its.
        """
        n = self.n_steps
        first = max(1, round(share * n))
        other = next(m for m in range(first, first + n + 2) if math.gcd(m, n) == 1)
        times, rows = np.unique(self.sight.times, return_index=True)
        run = self.problem.run(self.case, other, save_at=self.problem.t0 + times)
        return largest_angle(self.sight.q[rows], run.q)

    @property
    def floor(self) -> float:
        """The difference of two runs, rad, that rounding explains."""
        run = self.sight.run
        turned = float(np.linalg.norm(run.w, axis=-1).max()) * self.problem.duration
        eps = float(np.finfo(run.state.dtype).eps)
        return 20.0 * eps * (1.0 + turned + math.sqrt(self.n_steps))

    def worst(self, back: int = 1) -> float:
        """The largest of the last change, or of the one ``back`` before."""
        return float(self.changes[-back].max())

    def slope(self, back: int = 1) -> float:
        """The order from the largest of two successive changes."""
        coarse, fine = self.worst(back + 1), self.worst(back)
        return math.log2(coarse / fine) if fine > 0.0 < coarse else math.inf
