"""Some bodies of an ensemble: which, and what each case's errors and times on them are."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from fastatt.trade.ladder import Ladder, largest_angle, see, times_compared
from fastatt.trade.measure import Case, Problem, best_time, is_flat
from fastatt.trade.recommendation import Point
from fastatt.trade.reference import Reference, intervals, reference, speeds

_BASELINE = Case("rk4")  # which fits every scene
_SCREENING = 0.3  # s to find the bodies with the largest errors
_LOOKED_AT = 65536  # bodies, for the fastest at a given rate
_VERIFYING = 0.5  # s to run what is recommended on the bodies outside of the sample
_LONG = 4e6  # body-radians of a sample: of longer runs it is smaller, of 8 bodies at least
_TIMED = 8192  # bodies
_STEPS = 640


@dataclass
class Candidate:
    """What is known of one case: errors by number of steps, seconds a step and a call."""

    case: Case
    order: int
    first: int
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
        n, error = min(self.errors.items(), key=lambda one: abs(math.log(one[1] / tol)))
        if not self.order:
            return n
        return n * 4.0 if error > 1.0 else n * (error / tol) ** (1.0 / self.order)


class Sample:
    """Some bodies of an ensemble, their reference, and a clock.

    ``n_saves`` is the number of saves that steps fall on, None for the end alone; ``at`` says where
    errors are looked at: over the "run" or at its "end".
    """

    def __init__(
        self,
        whole: Problem,
        n_saves: int | None,
        at: str,
        sample: int,
        generator: np.random.Generator,
        goal: float,
    ) -> None:
        self.whole, self.n_saves, self.at = whole, n_saves, at
        self.points: list[Point] = []
        rows, self.others = self._choose(sample, generator)
        self.problem = whole.take(rows)
        pace = best_time(lambda: self._few(self.problem).run(_BASELINE, _STEPS), 2)[0] / _STEPS
        self.most = times_compared(at, rows.size)
        self.known: Reference = reference(self.problem, most=self.most, goal=goal)
        self.turn = float(speeds(self.problem).max()) * whole.t_end
        if self.known.end.w is not None:  # a torque may have made them faster
            fastest = float(np.linalg.norm(self.known.end.w, axis=-1).max())
            self.turn = max(self.turn, fastest * whole.t_end)
        n = whole.ensemble.size
        # no step of any method is much cheaper, none is right that turns by more than π
        self.least_seconds = 0.3 * pace * n / rows.size * self.turn / math.pi
        timed = np.linspace(0, n - 1, min(n, _TIMED)).astype(np.intp)
        self.timed = whole.take(timed)
        self.scale = n / timed.size

    @property
    def sampled(self) -> int:
        """Number of bodies in the sample."""
        return self.problem.ensemble.size

    @staticmethod
    def _few(problem: Problem) -> Problem:
        """A run that is long enough for the call not to count."""
        return replace(problem, t_end=problem.t_end / 1e3)

    def _choose(
        self, size: int, generator: np.random.Generator
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The hardest and fastest bodies and some by chance; others, the hardest first."""
        n = self.whole.ensemble.size
        some = self.whole.take(generator.choice(n, min(n, size), replace=False))
        turn = float(speeds(some).max()) * self.whole.t_end
        size = min(size, max(8, int(_LONG / max(turn, 1.0))))
        if n <= size:
            return np.arange(n), np.arange(0)
        steps = max(8, math.ceil(turn / 0.5))
        pace = best_time(lambda: self._few(some).run(_BASELINE, _STEPS), 2)[0] / _STEPS
        affordable = _SCREENING * some.ensemble.size / (3 * steps * pace)
        pool = generator.permutation(n)[: max(size, int(affordable))]
        if pool.size < n:
            fastest = self._fastest(generator, pool.size // 2)
            rest = pool[~np.isin(pool, fastest)]
            pool = np.concatenate([fastest, rest[: pool.size - fastest.size]])
        problem = self.whole.take(pool)
        hardness = speeds(problem)
        ranked = np.argsort(hardness, kind="stable")[::-1]
        quick = ranked[: size // 8]
        if affordable >= 4 * size or pool.size == n > size:
            most = times_compared(self.at, pool.size)
            hardness = Ladder(problem, _BASELINE, steps, most).halve()
            ranked = np.argsort(hardness, kind="stable")[::-1]
        ranked = np.concatenate([quick, ranked[~np.isin(ranked, quick)]])
        hard, rest = np.split(ranked, [max(quick.size, size // 4)])
        chosen = generator.choice(rest.size, size - hard.size, replace=False)
        rows = np.concatenate([hard, rest[chosen]])
        return pool[rows], pool[np.delete(rest, chosen)]

    def _fastest(self, generator: np.random.Generator, count: int) -> NDArray[np.intp]:
        """The fastest bodies of all, or, at a given rate, of as many as are looked at."""
        if self.whole.ensemble.w0 is not None:
            return np.argsort(speeds(self.whole))[-count:]
        some = generator.permutation(self.whole.ensemble.size)[:_LOOKED_AT]
        found = speeds(self.whole.take(some))
        return np.asarray(some[np.argsort(found)[-count:]])

    def _errors(
        self, problem: Problem, known: Reference, case: Case, n: int
    ) -> NDArray[np.float64]:
        """The largest error of each body, rad, and what the reference may add; inf with a flag."""
        seen = see(problem, case, n, self.most)
        apart = largest_angle(seen.q, known.at(seen.times)) + known.own_error
        return np.where(seen.flagged, np.inf, apart)

    def error(self, candidate: Candidate, n: int) -> float:
        """The largest error of the sample, rad, and what the reference may add; inf with a flag."""
        if n not in candidate.errors:
            found = self._errors(self.problem, self.known, candidate.case, n)
            candidate.errors[n] = float(found.max())
            seconds = candidate.seconds(n)
            self.points.append(Point(candidate.case, n, candidate.errors[n], seconds))
        return candidate.errors[n]

    def error_of_others(self, candidate: Candidate, n: int) -> tuple[float, int]:
        """The same of bodies outside of the sample, and how many were run: the hardest first."""
        if not self.others.size:
            return 0.0, 0
        steps = 2.0 * n * candidate.slope + candidate.fixed
        count = int(_VERIFYING * self.whole.ensemble.size / max(steps, 1e-12))
        some = self.others[: max(count, self.sampled)]
        worst = 0.0
        for part in np.array_split(some, -(-some.size // 1024)):
            problem = self.whole.take(part)
            found = self._errors(problem, self.known.of(problem), candidate.case, n)
            worst = max(worst, float(found.max()))
        return worst, some.size

    def unit(self, n: float) -> int:
        """What numbers of steps near n are multiples of.

        Saves fall on steps, and so do the kinks of a history, where there are more steps than
        kinks.
        """
        kinks = intervals(self.problem)
        return math.lcm(self.n_saves or 1, kinks if kinks <= n else 1)

    def rounded(self, n: float) -> int:
        """Steps that all saves fall on, no fewer than n."""
        unit = self.unit(n)
        return max(1, math.ceil(n / unit - 1e-9)) * unit

    def candidate(self, case: Case) -> Candidate:
        """The first look at a case: compile it, an error, its speed."""
        record = case.record
        scene = self.whole.ensemble.scene
        limit = math.inf
        if not (scene.is_constant and record.exact_for_constant):
            limit = record.limit(case.stored_as)
        first = self.rounded(self.turn / (0.98 * limit))
        order = record.order_of(scene.kind)
        found = Candidate(case, order, first)
        start = first if not order else max(first, self.rounded(max(self.turn / 0.5, 4.0)))
        self.time(found, start)
        self.error(found, start)
        return found

    def _run_steps(self, case: Case, dt: float, n: int) -> float:
        problem = replace(self.timed, t_end=dt * n)
        return best_time(lambda: problem.run(case, n), 2)[0]

    def time(self, candidate: Candidate, n: int) -> None:
        """Seconds a step and a call, at the step of n steps."""
        if not candidate.order:
            every = None if self.n_saves is None else 1
            call = partial(self.timed.run, candidate.case, self.n_saves or 1, every)
            candidate.fixed = self.scale * best_time(call, 2)[0]
            return
        dt = self.whole.t_end / n
        few = 16
        while (short := self._run_steps(candidate.case, dt, few)) < 2e-3 and few < 4096:
            few *= 4
        long = self._run_steps(candidate.case, dt, 4 * few)
        slope = max(long - short, 0.5 * long) / (3 * few) if long > short else long / (4 * few)
        candidate.slope = self.scale * slope
        candidate.fixed = self.scale * max(0.0, short - slope * few)

    def best_found(self, candidates: list[Candidate]) -> tuple[float, int, Case]:
        """The smallest error of all, with its steps and its case."""
        tried = [(e, n, c.case) for c in candidates for n, e in c.errors.items()]
        return min(tried, key=itemgetter(0))
