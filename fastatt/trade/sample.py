"""A sample of an ensemble, and the errors and times of each case on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fastatt.trade.ladder import Ladder, largest_angle, see, times_compared
from fastatt.trade.measure import Case, Problem, best_time, is_flat
from fastatt.trade.reference import Reference, fewest_steps, intervals, reference, speeds

_BASELINE = Case("rk4")  # fits every scene
_SCREENING = 0.3  # s for finding the bodies with the largest errors
_RANKED = 65536  # bodies that are ranked by a prescribed rate
_VERIFYING = 0.5  # s for running the recommendation on bodies outside of the sample
_LONG = 4e6  # body-radians; samples of longer runs are smaller, with 8 bodies at least
_TIMED = 8192  # bodies of a timed run
_STEPS = 640  # steps of a timed run, in which the time of the call is negligible
_LEAST_WORK = 0.3  # least time of a step of any method, as a share of the baseline's


@dataclass
class Candidate:
    """One case: errors by the number of steps, seconds of a step and of a call.

    ``first`` is the smallest number of steps, and ``start`` the first that is tried.
    """

    case: Case
    order: int
    first: int
    start: int
    errors: dict[int, float] = field(default_factory=dict)
    slope: float = 0.0
    fixed: float = 0.0

    def seconds(self, n: float) -> float:
        """Time of a call with n steps, s."""
        return self.fixed + self.slope * n

    def is_flat(self, n: int, further: int) -> bool:
        """Whether rounding keeps the error from falling between n steps and ``further``."""
        errors = self.errors
        return is_flat(self.case, self.order, (n, errors[n]), (further, errors[further]))

    def steps_for(self, tol: float) -> float:
        """An estimate of the steps that meet a tolerance, by the declared order."""
        error = self.errors[self.start]
        if not self.order:
            return self.start
        growth = 4.0 if error > 1.0 else (error / tol) ** (1.0 / self.order)
        return max(self.first, self.start * growth)


class Sample:
    """Some bodies of an ensemble, their reference, and timings.

    ``at`` says where errors are measured: over the "run" or at its "end". ``others`` are bodies
    outside of the sample, those with the largest errors first.
    """

    def __init__(
        self,
        whole: Problem,
        at: str,
        sample: int,
        generator: np.random.Generator,
        goal: float,
    ) -> None:
        self.whole, self.at = whole, at
        n = whole.ensemble.size
        few = generator.choice(n, min(n, sample), replace=False)
        short = replace(whole.take(few), t_end=whole.t_end / 1e3)
        seconds, _ = best_time(lambda: short.run(_BASELINE, _STEPS), 2)
        #: time of a step of one body, s
        self.pace = seconds / (_STEPS * few.size)
        rows, others = self._choose(sample, generator)
        rows = np.union1d(rows, whole.ensemble.extremes)
        self.problem, self.others = whole.take(rows), others[~np.isin(others, rows)]
        self.most = times_compared(at, rows.size)
        self.known: Reference = reference(self.problem, most=self.most, goal=goal)
        fastest = float(speeds(self.problem).max())
        if self.known.end.w is not None:  # a torque may have accelerated the bodies
            fastest = max(fastest, float(np.linalg.norm(self.known.end.w, axis=-1).max()))
        #: rotation angle of the fastest body, rad
        self.angle = fastest * whole.t_end
        self.fewest = fewest_steps(whole)
        # no step may rotate by more than π
        self.least_seconds = _LEAST_WORK * self.pace * n * self.angle / math.pi
        timed = np.linspace(0, n - 1, min(n, _TIMED)).astype(np.intp)
        self.timed = whole.take(timed)
        self.scale = n / timed.size

    @property
    def sampled(self) -> int:
        """Number of bodies in the sample."""
        return self.problem.ensemble.size

    def _choose(
        self, size: int, generator: np.random.Generator
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The fastest and hardest bodies and some at random; and others, the hardest first.

        As many bodies are screened as a coarse run can take in a given time, half of them the
        fastest; for a prescribed rate the fastest of those that are ranked.
        """
        n, rates_known = self.whole.ensemble.size, self.whole.ensemble.w0 is not None
        ranked = np.arange(n) if rates_known else generator.permutation(n)[:_RANKED]
        found = speeds(self.whole.take(ranked))
        angle = float(found.max()) * self.whole.t_end
        size = min(size, max(8, int(_LONG / max(angle, 1.0))))
        if n <= size:
            return np.arange(n), np.arange(0)
        steps = max(8, math.ceil(angle / 0.5))
        count = min(n, max(size, int(_SCREENING / (3 * steps * self.pace))))
        fastest = ranked[np.argsort(-found, kind="stable")][: max(1, count // 2)]
        rest = generator.permutation(n)
        pool = np.concatenate([fastest, rest[~np.isin(rest, fastest)]])[:count]
        problem = self.whole.take(pool)
        if count == n or count >= 4 * size:
            compared = times_compared(self.at, count)
            hardness = Ladder(problem, _BASELINE, steps, compared).halve()
        else:
            hardness = speeds(problem)
        order = np.argsort(-hardness, kind="stable")
        quick = np.arange(size // 8)  # the fastest come first
        order = np.concatenate([quick, order[~np.isin(order, quick)]])
        hard, rest = np.split(order, [max(1, size // 4)])
        chosen = generator.choice(rest.size, size - hard.size, replace=False)
        return pool[np.append(hard, rest[chosen])], pool[np.delete(rest, chosen)]

    def _largest_error(self, problem: Problem, known: Reference, case: Case, n: int) -> float:
        """The largest error, rad, including that of the reference; inf if a body has a flag."""
        seen = see(problem, case, n, self.most)
        if seen.flagged.any():
            return math.inf
        return float((largest_angle(seen.q, known.at(seen.times)) + known.own_error).max())

    def error(self, candidate: Candidate, n: int) -> float:
        """The largest error of the sample, rad, with that of the reference; inf with a flag."""
        if n not in candidate.errors:
            candidate.errors[n] = self._largest_error(self.problem, self.known, candidate.case, n)
        return candidate.errors[n]

    def error_of_others(self, candidate: Candidate, n: int) -> tuple[float, int]:
        """The error of bodies outside of the sample, the hardest first, and how many were run."""
        if not self.others.size:
            return 0.0, 0
        steps = 2.0 * n * candidate.slope + candidate.fixed
        count = int(_VERIFYING * self.whole.ensemble.size / max(steps, 1e-12))
        some = self.others[: max(count, self.sampled)]
        worst = 0.0
        for part in np.array_split(some, -(-some.size // 1024)):
            problem = self.whole.take(part)
            error = self._largest_error(problem, self.known.of(problem), candidate.case, n)
            worst = max(worst, error)
        return worst, some.size

    def unit(self, n: float) -> int:
        """The divisor of numbers of steps near n, so that steps end at equally spaced corners."""
        sampled = intervals(self.problem)
        return sampled if sampled <= n else 1

    def rounded(self, n: float) -> int:
        """The smallest multiple of the unit that is not below n, nor below the fewest steps."""
        n = max(n, self.fewest)
        unit = self.unit(n)
        return max(1, math.ceil(n / unit)) * unit

    def candidate(self, case: Case) -> Candidate:
        """A case, compiled and run once to measure its error and its speed."""
        record = case.record
        scene = self.whole.ensemble.scene
        limit = math.inf
        if not (scene.is_constant and record.exact_for_constant):
            limit = record.limit(case.representation)
        first = self.rounded(self.angle / (0.98 * limit))
        order = record.order_of(scene.kind)
        start = first if not order else max(first, self.rounded(max(self.angle / 0.5, 4.0)))
        found = Candidate(case, order, first, start)
        self.time(found, start)
        self.error(found, start)
        return found

    def _run_steps(self, case: Case, dt: float, n: int) -> float:
        problem = replace(self.timed, t_end=dt * n)
        return best_time(lambda: problem.run(case, n), 2)[0]

    def time(self, candidate: Candidate, n: int) -> None:
        """Measure the seconds of a step and of a call, with the step size of n steps."""
        case = candidate.case
        if not candidate.order:
            candidate.fixed = self.scale * best_time(lambda: self.timed.run(case, 1), 2)[0]
            return
        dt = self.whole.t_end / n
        few = 16
        while (short := self._run_steps(case, dt, few)) < 2e-3 and few < 4096:
            few *= 4
        long = self._run_steps(case, dt, 4 * few)
        slope = max(long - short, 0.5 * long) / (3 * few)
        candidate.slope = self.scale * slope
        candidate.fixed = self.scale * max(0.0, short - slope * few)
