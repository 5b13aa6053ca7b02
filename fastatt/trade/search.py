"""Search on a sample of an ensemble for the fewest steps of each case that meet a tolerance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.trade.forcing import SAMPLES
from fastatt.trade.ladder import Ladder, largest_angle, see, times_compared
from fastatt.trade.measure import PLATEAU, REFERENCE, Case, Problem, best_time, is_flat
from fastatt.trade.recommendation import Point, Recommendation
from fastatt.trade.reference import Reference, fewest_steps, intervals, reference, speeds

SINGLE = 1e-6  # rad; float32 is never that accurate
_FINER = 30.0  # ratio of the tolerance and the reference's error
_UNSEEN = 1.5  # margin of errors below the tolerance if some bodies are not run
_BASELINE = Case("rk4")  # fits every scene
_SCREENED = 1e7  # body-steps that find the bodies with the largest errors
_VERIFIED = 4e6  # body-steps of a run of bodies outside of the sample
_RANKED = 65536  # bodies that are ranked by a prescribed rate
_LONG = 4e6  # body-radians; samples of longer runs are smaller, with 8 bodies at least
_TIMED = 8192  # bodies of a timed run
_WORTH = 4.0  # a case with this many times the estimated time of the best is given up
_FASTER = 2.5  # the largest speed-up by single precision
_NEAR = 1.5  # cases with up to this many times the best time are timed again, alternately
_CLOSE = 0.06  # relative accuracy of the smallest number of steps
_TRIALS = 10  # numbers of steps that are tried on bodies outside of the sample
_MOST = 6e7  # the most body-steps of a trial, 2 or 3 s
_SHORT = 0.05  # s; shorter runs are timed as a whole
_WHOLE = 1.0  # s; in longer runs the time of a call is negligible


def work(case: Case, tol: float) -> float:
    """An estimate of the work for a tolerance: tol^(−1/order) evaluations and exponentials."""
    m = case.record
    return max(1, m.rate_calls + m.exponentials) * tol ** (-1.0 / m.order) if m.order else 0.0


@dataclass
class Candidate:
    """One case: errors by the number of steps, and the seconds of a step of all bodies.

    ``first`` is the smallest number of steps, and ``start`` the first that is tried.
    """

    case: Case
    order: int
    first: int
    start: int
    errors: dict[int, float] = field(default_factory=dict)
    step_seconds: float = 0.0

    def is_flat(self, n: int, further: int) -> bool:
        """Whether rounding keeps the error from falling between n steps and ``further``."""
        errors = self.errors
        return is_flat(self.case, self.order, (n, errors[n]), (further, errors[further]))

    def guess(self, tol: float) -> float:
        """An estimate of the seconds that meet a tolerance, by the declared order."""
        if not self.order:
            return self.start * self.step_seconds
        error = self.errors[self.start]
        growth = 4.0 if error > 1.0 else (error / tol) ** (1.0 / self.order)
        return max(self.first, self.start * growth) * self.step_seconds


class Met(NamedTuple):
    """Steps of a case that meet the tolerance, their error, rad, and the number of bodies."""

    candidate: Candidate
    n: int
    error: float
    measured: int

    @property
    def seconds(self) -> float:
        """Time of a call, s."""
        return self.n * self.candidate.step_seconds


_SECONDS = attrgetter("seconds")


class Search:
    """Some bodies of an ensemble, their reference, and the fewest steps that meet a tolerance.

    ``at`` says where errors are measured: over the "run" or at its "end". ``others`` are bodies
    outside of the sample, those with the largest errors first. The runs that find these, and those
    of others, are shorter if there are several ``searches``.

    Raises ``ValueError`` if a rate, torque or force jumps, or if the reference is too inaccurate.
    """

    def __init__(
        self,
        whole: Problem,
        at: str,
        sample: int,
        generator: np.random.Generator,
        tol: float,
        searches: int = 1,
    ) -> None:
        self.whole, self.at, self.tol = whole, at, tol
        self.screened, self.verified = _SCREENED / searches, _VERIFIED / searches
        rows, others = self._choose(sample, generator)
        rows = np.union1d(rows, whole.ensemble.extremes)
        self.problem, self.others = whole.take(rows), others[~np.isin(others, rows)]
        self.sampled = rows.size
        # bodies outside of the sample may have slightly larger errors
        self.within = tol / 1.1 if self.others.size else tol
        self.most = times_compared(at, rows.size)
        self.known: Reference = reference(
            self.problem, most=self.most, goal=tol / _FINER, samples=SAMPLES // searches
        )
        self.known.refuse(tol)
        fastest = float(speeds(self.problem).max())
        if self.known.end.w is not None:  # a torque may have accelerated the bodies
            fastest = max(fastest, float(np.linalg.norm(self.known.end.w, axis=-1).max()))
        #: rotation angle of the fastest body, rad
        self.angle = fastest * whole.duration

    def _choose(
        self, size: int, generator: np.random.Generator
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The fastest and hardest bodies and some at random; and others, the hardest first.

        A coarse run screens as many bodies as it may, half of them the fastest; for a prescribed
        rate the fastest of those that are ranked.
        """
        n, rates_known = self.whole.ensemble.size, self.whole.ensemble.w0 is not None
        ranked = np.arange(n) if rates_known else generator.permutation(n)[:_RANKED]
        rates = speeds(self.whole.take(ranked))
        angle = float(rates.max()) * self.whole.duration
        size = min(size, max(8, int(_LONG / max(angle, 1.0))))
        if n <= size:
            return np.arange(n), np.arange(0)
        steps = max(8, math.ceil(angle / 0.5))
        count = min(n, max(size, int(self.screened / (3 * steps))))
        fastest = ranked[np.argsort(-rates, kind="stable")][: max(1, count // 2)]
        rest = generator.permutation(n)
        pool = np.concatenate([fastest, rest[~np.isin(rest, fastest)]])[:count]
        problem = self.whole.take(pool)
        if 3 * steps * count <= self.screened:
            hardness = Ladder(problem, _BASELINE, steps, times_compared(self.at, count)).halve()
        else:
            hardness = speeds(problem)
        order = np.argsort(-hardness, kind="stable")
        quick = np.arange(size // 8)  # the fastest come first
        order = np.concatenate([quick, order[~np.isin(order, quick)]])
        hard, rest = np.split(order, [max(1, size // 4)])
        chosen = generator.choice(rest.size, size - hard.size, replace=False)
        return pool[np.append(hard, rest[chosen])], pool[np.delete(rest, chosen)]

    def unit(self, n: float) -> int:
        """The divisor of numbers of steps near n, so that steps end at equally spaced corners."""
        sampled = intervals(self.problem)
        return sampled if sampled <= n else 1

    def rounded(self, n: float) -> int:
        """The smallest multiple of the unit that is not below n, nor below the fewest steps."""
        n = max(n, fewest_steps(self.whole))
        unit = self.unit(n)
        return max(1, math.ceil(n / unit)) * unit

    def _largest_error(self, problem: Problem, known: Reference, case: Case, n: int) -> float:
        """The largest error, rad, including that of the reference; inf if a body has a flag."""
        seen = see(problem, case, n, self.most)
        if seen.flagged.any():
            return math.inf
        return float((largest_angle(seen.q, known.at(seen.times)) + known.error).max())

    def error(self, one: Candidate, n: int) -> float:
        """The largest error of the sample, rad, with that of the reference; inf with a flag."""
        if n not in one.errors:
            one.errors[n] = self._largest_error(self.problem, self.known, one.case, n)
        return one.errors[n]

    def _on_others(self, one: Candidate, n: int) -> Met:
        """The error over the sample and over bodies outside of it, the hardest first."""
        some = self.others[: max(int(self.verified / max(n, 64)), self.sampled)]
        worst = self.error(one, n)
        for part in np.array_split(some, -(-some.size // 1024)) if some.size else ():
            problem = self.whole.take(part)
            error = self._largest_error(problem, self.known.of(problem), one.case, n)
            worst = max(worst, error)
        return Met(one, n, worst, self.sampled + some.size)

    def candidate(self, case: Case) -> Candidate:
        """A case, compiled and run once to measure its error."""
        record, scene = case.record, self.whole.ensemble.scene
        limit = math.inf
        if not (scene.is_constant and record.exact_for_constant):
            limit = record.limit(case.representation)
        first = self.rounded(self.angle / (0.98 * limit))
        order = record.order_of(scene.kind)
        start = first if not order else max(first, self.rounded(max(self.angle / 0.5, 4.0)))
        one = Candidate(case, order, first, start)
        self.error(one, start)
        return one

    def time(self, one: Candidate, n: int) -> None:
        """Measure the seconds of a step, with the step size of n steps."""
        size = self.whole.ensemble.size
        rows = np.linspace(0, size - 1, min(size, _TIMED)).astype(np.intp)
        some, few = self.whole.take(rows), 64 if one.order else 1
        while True:
            part = replace(some, duration=self.whole.duration * few / n)
            seconds, _ = best_time(partial(part.run, one.case, few), 2)
            if not one.order or seconds > 4e-3 or few >= 16384:
                break
            few *= 4
        one.step_seconds = seconds / few * (size / rows.size)

    def fewest(self, case: Case) -> Met:
        """The fewest steps of one case that meet the tolerance; raises ``ValueError``."""
        one = self.candidate(case)
        n = self._least(one, math.inf)
        sure = None if n is None else self._sure(one, n)
        if sure is None:
            raise self._refusal([one])
        return sure

    def cheapest(self, cases: Sequence[Case], done: Callable[[int], object]) -> Recommendation:
        """The case that meets the tolerance in the shortest time; raises ``ValueError``."""
        met: list[Met] = []
        guesses: dict[Case, float] = {}
        tried: list[Candidate] = []
        best = math.inf
        # closed forms first, then double precision, then single precision
        for case in sorted(cases, key=lambda c: (c.dtype == "float32", work(c, self.tol))):
            done(1)
            if guesses.get(case._replace(dtype="float64"), 0.0) > _FASTER * best:
                continue
            one = self.candidate(case)
            self.time(one, one.start)
            tried.append(one)
            guesses[case] = one.guess(self.within)
            n = None if guesses[case] > _WORTH * best else self._least(one, best)
            if n is not None:
                met.append(Met(one, n, one.errors[n], self.sampled))
                best = min(best, met[-1].seconds)
        sure: list[Met] = []
        for run in sorted(met, key=_SECONDS):
            if len(sure) == 3 or (sure and run.seconds > _WORTH * sure[0].seconds):
                break
            if verified := self._sure(run.candidate, run.n):
                sure.append(verified)
        if not sure:
            raise self._refusal(tried)
        return self._advise(sure)

    def _refusal(self, tried: Sequence[Candidate]) -> ValueError:
        error, n, name = min((e, n, str(one.case)) for one in tried for n, e in one.errors.items())
        return ValueError(
            f"tol: found {self.tol:g}; accepted: what can be reached, {error:.1e} rad by {name} in "
            f"{n} steps: the motion magnifies rounding, or the torque or rate has corners"
        )

    def _least(self, one: Candidate, best: float) -> int | None:
        """About the smallest number of steps that meets the tolerance; None if none does."""
        bad, n, tol = 0, one.start, self.within
        good: int | None = None
        while True:
            if self.error(one, n) <= tol:
                good = n
            else:
                bad = n
            if good is None:
                flat = len(one.errors) > 1 and one.is_flat(*sorted(one.errors)[-2:])
                n = self.rounded(2 * bad)
                is_slow = self._too_long(n) or n * one.step_seconds > _WORTH * best
                if not one.order or flat or is_slow:
                    return None
                continue
            # narrow the interval by the declared order
            error = max(one.errors[good], 1e-300)
            near = good - bad <= max(self.unit(good), _CLOSE * good)
            if good == one.first or near or error >= tol * (1.0 - _CLOSE) ** one.order:
                return good
            aim = 1.02 * good * (error / tol) ** (1.0 / one.order)
            low, high = float(max(one.first, good // 8)), float(good - self.unit(good))
            if bad:  # away from both ends
                low, high = bad + 0.25 * (good - bad), good - 0.25 * (good - bad)
            n = min(self.rounded(min(max(aim, low), high)), good - self.unit(good))
            if n <= bad:
                return good

    def _too_long(self, n: int) -> bool:
        """Whether n steps of the sample exceed the limit of a trial."""
        return bool(n * self.sampled > _MOST)

    def _sure(self, one: Candidate, n: int) -> Met | None:
        """Steps that suffice for the bodies outside the sample too."""
        for _ in range(_TRIALS):
            run = self._on_others(one, n)
            wanted = self.tol if run.measured == self.whole.ensemble.size else self.tol / _UNSEEN
            if run.error <= wanted:
                return run
            if not one.order:
                return None
            more = 1.1 if run.error == math.inf else (run.error / wanted) ** (1.0 / one.order)
            further = max(self.rounded(min(1.01 * more, 16.0) * n), n + self.unit(n))
            if self._too_long(further):
                return None
            self.error(one, further)
            if one.is_flat(n, further):
                return None
            n = further
        return None

    def _advise(self, met: list[Met]) -> Recommendation:
        """Time the best cases again, alternately, and determine what limits the first of them."""
        met.sort(key=_SECONDS)
        close = [one for one in met if one.seconds < _NEAR * met[0].seconds]
        timed = [math.inf] * len(close)
        for _ in range(1 if met[0].seconds > _WHOLE else 2):  # alternately
            for i, one in enumerate(close):
                timed[i] = min(timed[i], self._clock(one.candidate, one.n))
        (seconds, best), *rest = sorted(zip(timed, close, strict=True), key=lambda x: x[0])
        # the cases that were not timed again
        rest += [(one.seconds, one) for one in met[len(close) :]]
        up = next((Point(o.candidate.case, o.n, o.error, s) for s, o in rest if s >= seconds), None)
        n, case = best.n, best.candidate.case
        return Recommendation(
            method=case.name, representation=case.representation, dtype=case.dtype,
            dt=self.whole.duration / n, n_steps=n, t0=self.whole.t0,
            n_threads=self.whole.threads(n), at=self.at,
            expected_error=best.error, expected_seconds=seconds,
            limited_by=self._limit(best.candidate, n),
            runner_up=up, margin=None if up is None else up.seconds / seconds,
            tol=self.tol, n_bodies=self.whole.ensemble.size, measured=best.measured,
            reference=self.known.source, reference_error=float(self.known.error.max()),
            case=case,
        )  # fmt: skip

    def _limit(self, one: Candidate, n: int) -> str:
        """What limits the error: truncation if half the step size is more accurate."""
        scene, record = self.whole.ensemble.scene, one.case.record
        is_one_step = n == 1 and not (scene.is_constant and record.exact_for_constant)
        gain = 0.5 ** (0.5 * one.order)
        if one.order and (is_one_step or self.error(one, 2 * n) <= one.errors[n] * gain):
            return "truncation"
        return self._floor(one, n)

    def _floor(self, one: Candidate, n: int) -> str:
        """What limits the error where half the step size is not more accurate."""
        if one.errors[n] <= 2.0 * float(self.known.unresolved.max()):
            return REFERENCE
        # a truncation error that falls irregularly is larger than both
        is_rounding = not one.order or one.is_flat(n, 2 * n)
        is_rounding |= one.errors[n] <= 2.0 * float(self.known.error.max())
        return PLATEAU if is_rounding else "truncation"

    def _clock(self, one: Candidate, n: int) -> float:
        """Seconds of the whole call: measured if short, else extrapolated from fewer steps."""
        if n * one.step_seconds < _SHORT:
            return best_time(lambda: self.whole.run(one.case, n), 2)[0]
        self.time(one, n)
        return n * one.step_seconds
