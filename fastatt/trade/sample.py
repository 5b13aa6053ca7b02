"""Some bodies of an ensemble: which, and the errors and times of each case on them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fastatt.trade.ladder import Ladder, largest_angle, see, times_compared
from fastatt.trade.measure import Case, Problem, best_time, is_flat
from fastatt.trade.reference import Reference, intervals, reference, speeds

_BASELINE = Case("rk4")  # which fits every scene
_SCREENING = 0.3  # s to find the bodies with the largest errors
_RANKED = 65536  # bodies, for the fastest at a given rate
_VERIFYING = 0.5  # s to run what is recommended on the bodies outside of the sample
_LONG = 4e6  # body-radians of a sample: of longer runs it is smaller, of 8 bodies at least
_TIMED = 8192  # bodies
_STEPS = 640  # so many that the call does not count
_LEAST_WORK = 0.3  # of a step of the baseline: no step of any method is much cheaper


@dataclass
class Candidate:
    """One case: errors by number of steps, seconds a step and a call.

    It takes ``first`` steps at least, and is tried with ``start``.
    """

    case: Case
    order: int
    first: int
    start: int
    errors: dict[int, float] = field(default_factory=dict)
    slope: float = 0.0
    fixed: float = 0.0

    def seconds(self, n: float) -> float:
        """Of a call with n steps."""
        return self.fixed + self.slope * n

    def is_flat(self, n: int, further: int) -> bool:
        """Whether rounding is what keeps the error from falling, from n steps to more."""
        errors = self.errors
        return is_flat(self.case, self.order, (n, errors[n]), (further, errors[further]))

    def steps_for(self, tol: float) -> float:
        """A guess at the steps that meet a tolerance, by the declared order."""
        error = self.errors[self.start]
        if not self.order:
            return self.start
        growth = 4.0 if error > 1.0 else (error / tol) ** (1.0 / self.order)
        return max(self.first, self.start * growth)


class Sample:
    """Some bodies of an ensemble, their reference, and a clock.

    ``at`` says where errors are measured: over the "run" or at its "end". ``others`` are bodies
    outside of the sample, the hardest first.
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
        #: s of a step of one body
        self.pace = seconds / (_STEPS * few.size)
        rows, self.others = self._choose(sample, generator)
        self.problem = whole.take(rows)
        self.most = times_compared(at, rows.size)
        self.known: Reference = reference(self.problem, most=self.most, goal=goal)
        fastest = float(speeds(self.problem).max())
        if self.known.end.w is not None:  # a torque may have made them faster
            fastest = max(fastest, float(np.linalg.norm(self.known.end.w, axis=-1).max()))
        #: rad that the fastest body rotates by
        self.angle = fastest * whole.t_end
        # no step is right that rotates by more than π
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
        """The fastest and hardest bodies and some by chance; others, the hardest first.

        As many bodies are screened as a coarse run can take in a given time, half of them the
        fastest: at a given rate, of as many as are ranked.
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
        """The largest error, rad, and what the reference may add; inf with a flag."""
        seen = see(problem, case, n, self.most)
        if seen.flagged.any():
            return math.inf
        return float((largest_angle(seen.q, known.at(seen.times)) + known.own_error).max())

    def error(self, candidate: Candidate, n: int) -> float:
        """The largest error of the sample, rad, and what the reference may add; inf with a flag."""
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
        """Of what numbers of steps near n are multiples: steps end at a torque's samples."""
        sampled = intervals(self.problem)
        return sampled if sampled <= n else 1

    def rounded(self, n: float) -> int:
        """A multiple of the unit, no less than n."""
        unit = self.unit(n)
        return max(1, math.ceil(n / unit - 1e-9)) * unit

    def candidate(self, case: Case) -> Candidate:
        """A case, compiled and run once for its error and its speed."""
        record = case.record
        scene = self.whole.ensemble.scene
        limit = math.inf
        if not (scene.is_constant and record.exact_for_constant):
            limit = record.limit(case.stored_as)
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
        """Measure the seconds of a step and of a call, at the step of n steps."""
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
