"""Search on a sample of an ensemble for the fewest steps of each case that meet a tolerance."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.trade.forcing import SAMPLES
from fastatt.trade.ladder import Ladder, largest_angle, see, times_compared
from fastatt.trade.measure import PLATEAU, REFERENCE, Case, Problem, is_flat, top
from fastatt.trade.reference import (
    RESOLVED,
    Reference,
    from_separatrix,
    intervals,
    largest_rotation,
    reference,
    samples_of_control,
    speeds,
)
from fastatt.trade.timing import BUDGET, TIE, once, time_in_turns

_FINER = 30.0  # ratio of the tolerance and the reference's error
_FIRST = 8  # coarse steps of all bodies, from which their risk is seen
_TOGETHER = 8192  # bodies of a run of all
_TIMES = 16  # at which errors of all bodies are measured
_UNSEEN = 1.5  # margin of errors below the tolerance if some bodies are not run
_BASELINE = Case("rk4")  # fits every scene
_SCREENED = 1e7  # body-steps that find the bodies with the largest errors
_VERIFIED = 4e6  # body-steps of a run of bodies outside of the sample
_LONG = 4e6  # body-radians; samples of longer runs are smaller, with 8 bodies at least
_TIMED = 1024  # bodies of a timed run
_WORTH = 4.0  # a case with this many times the time of the best is given up
_VERIFIED_CASES = 3  # the fastest cases, which are run on bodies outside of the sample
_CLOSE = 0.06  # relative accuracy of the smallest number of steps
_TRIALS = 10  # numbers of steps that are tried on bodies outside of the sample
_MOST = 6e7  # the most body-steps of a trial, 2 or 3 s
_SHORT = 0.004  # s; shorter calls are timed as a whole


class Point(NamedTuple):
    """Steps of a case, their largest error, rad, over ``measured`` bodies, and a call's time, s.

    The time is the CPU time of one thread. ``worst`` is the body with the largest error; of so many
    bodies at ``random``, those ``beyond`` exceed the tolerance.
    """

    case: Case
    n_steps: int
    error: float
    measured: int
    seconds: float = 0.0
    worst: int = 0
    random: int = 0
    beyond: int = 0


def _largest(values: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Indices of so many of the largest values."""
    count = min(count, values.size)
    return np.argpartition(-values, count - 1)[:count]


class _Timed(NamedTuple):
    """A call, its time, s, and by how many times that of all bodies and steps is longer."""

    call: Callable[[], Any]
    seconds: float
    share: float


def ranked(points: Sequence[Point]) -> list[Point]:
    """Points by their times, those as fast as the fastest by their errors."""
    least = TIE * min(point.seconds for point in points)
    return sorted(points, key=lambda point: (max(point.seconds, least), point.error))


class Search:
    """Some bodies of an ensemble, their reference, and the fewest steps that meet a tolerance.

    The tolerance holds for a ``quantile`` of the bodies. The sample is those most at risk, unless
    that is below 1, and some at random. Bodies that double precision does not determine are set
    aside, ``undetermined``. The runs that find the sample, and those of others, are shorter if
    there are several ``searches``.

    Raises ``ValueError`` if a rate, torque or force jumps, or if the reference is too inaccurate.
    """

    def __init__(
        self, whole: Problem, sample: int, generator: np.random.Generator, tol: float,
        searches: int = 1, quantile: float = 1.0,
    ) -> None:  # fmt: skip
        self.whole, self.tol, self.quantile = whole, tol, quantile
        self.screened, self.verified = _SCREENED / searches, _VERIFIED / searches
        chosen, self.ranked, self.chance, self.drawn = self._choose(sample, generator)
        extremes = whole.ensemble.extremes if quantile == 1.0 else chosen[:0]
        self.rows, self.undetermined = np.union1d(chosen, extremes), chosen[:0]
        self.sampled, self.longest = self.rows.size, _MOST / self.rows.size
        # bodies outside of the sample may have slightly larger errors
        self.within = tol / 1.1 if self.sampled < whole.ensemble.size else tol
        self.most = times_compared(self.sampled)
        while True:
            self.problem = whole.take(self.rows)
            self.known: Reference = reference(
                self.problem, most=self.most, goal=tol / _FINER, samples=SAMPLES // searches
            )
            unresolved = np.flatnonzero(self.known.error > RESOLVED * tol)
            lost = self.known.undetermined(unresolved, RESOLVED * tol)
            is_lost = lost.size == self.rows.size
            if lost.size == 0 or (is_lost and searches == 1):
                self.known.refuse(tol, quantile)
                break
            self.undetermined = np.union1d(self.undetermined, self.rows[lost])
            self.rows = np.delete(self.rows, lost)
            if is_lost:
                break
        fastest = float(speeds(self.problem).max())
        if self.known.end.w is not None:  # a torque may have accelerated the bodies
            fastest = max(fastest, float(np.linalg.norm(self.known.end.w, axis=-1).max()))
        #: rotation angle of the fastest body, rad
        self.angle = fastest * whole.duration
        #: the errors of the sample, rad, with that of the reference; inf with a flag
        self.errors: dict[tuple[Case, int], NDArray[np.float64]] = {}

    def _choose(
        self, size: int, generator: np.random.Generator
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], int]:
        """The sample; some bodies, hardest first; some at random, the first so many in the sample.

        The others of the sample are those most at risk. A coarse run ranks as many bodies as it
        may, half of them those most at risk.
        """
        n = self.whole.ensemble.size
        angle = largest_rotation(self.whole)
        size = min(size, max(8, int(_LONG / max(angle, 1.0))))
        if n <= size:
            return np.arange(n), np.arange(0), np.arange(0), 0
        chance = generator.choice(n, min(n, size + int(self.verified / 64)), replace=False)
        if self.quantile < 1.0:
            return chance[:size], np.arange(0), chance, size
        steps = max(8, math.ceil(angle / 0.5))
        risks = self._risks(steps, chance)
        most = max(size, int(self.screened / (3 * steps)))
        half = [_largest(risk, most // (2 * len(risks))) for risk in risks]
        pool = np.unique(np.concatenate([*half, chance[: most // 2]]))
        problem = self.whole.take(pool)
        if 3 * steps * pool.size <= self.screened:
            hardness = Ladder(problem, _BASELINE, steps, times_compared(pool.size)).halve()
        else:
            hardness = speeds(problem)
        ranked = pool[np.argsort(-hardness, kind="stable")]
        few = max(1, size // 8)
        hard = np.unique(np.concatenate([ranked[:few], *(_largest(risk, few) for risk in risks)]))
        left = max(0, size - hard.size)
        return np.append(hard, chance[:left]), ranked, chance, left

    def _risks(self, steps: int, chance: NDArray[np.intp]) -> list[NDArray[np.float64]]:
        """Of each body what makes its error large: its rate, the separatrix, its first steps."""
        whole = self.whole
        risks = [speeds(whole)]
        if whole.ensemble.w0 is not None:
            risks.append(-from_separatrix(whole.ensemble))
        some = np.arange(whole.ensemble.size)
        if 3 * _FIRST * some.size > self.screened:
            some = chance[: max(1, int(self.screened / (3 * _FIRST)))]
        first = replace(whole.take(some), duration=whole.duration * _FIRST / steps)
        risks.append(np.full(whole.ensemble.size, -1.0))
        risks[-1][some] = Ladder(first, _BASELINE, _FIRST, 1).halve()
        return risks

    def unit(self, n: float) -> int:
        """The divisor of numbers of steps near n, so that steps end at equally spaced corners."""
        sampled = intervals(self.problem)
        return sampled if sampled <= n else 1

    def rounded(self, n: float) -> int:
        """The smallest multiple of the unit that is not below n, nor below the fewest steps."""
        n = max(n, samples_of_control(self.whole))
        unit = self.unit(n)
        return max(1, math.ceil(n / unit)) * unit

    def order(self, case: Case) -> int:
        """The declared order; 0 for a closed form."""
        return case.record.order_of(self.whole.ensemble.scene.kind)

    def least(self, case: Case) -> int:
        """The smallest number of steps within the method's limit."""
        scene, record = self.whole.ensemble.scene, case.record
        is_exact = scene.is_constant and record.exact_for_constant
        limit = math.inf if is_exact else record.limit(case.representation)
        return self.rounded(self.angle / (0.98 * limit))

    def start(self, case: Case) -> int:
        """The number of steps that is tried first."""
        least = self.least(case)
        return max(least, self.rounded(max(self.angle / 0.5, 4.0))) if self.order(case) else least

    def _errors(self, known: Reference, case: Case, n: int) -> NDArray[np.float64]:
        seen = see(known.problem, case, n, self.most)
        errors = largest_angle(seen.q, known.at(seen.times)) + known.error
        return np.where(seen.flagged, np.inf, errors)

    def error(self, case: Case, n: int) -> float:
        """The largest error of the sample, rad, with that of the reference; inf with a flag."""
        if (case, n) not in self.errors:
            self.errors[case, n] = self._errors(self.known, case, n)
        return top(self.errors[case, n], self.quantile)

    def is_flat(self, case: Case, n: int, further: int) -> bool:
        """Whether rounding keeps the error from falling between n steps and ``further``."""
        coarse, fine = ((m, self.error(case, m)) for m in (n, further))
        return is_flat(case, self.order(case), coarse, fine)

    def _timed(self, case: Case, n: int) -> _Timed:
        """What is timed of a call in n steps: of a long one fewer steps."""
        size = self.whole.ensemble.size
        rows = np.linspace(0, size - 1, min(size, _TIMED)).astype(np.intp)
        some, few = replace(self.whole.take(rows), n_threads=1), min(64, n)
        while True:
            part = replace(some, duration=self.whole.duration * few / n)
            call = partial(part.run, case, few)
            seconds = min(once(call)[0] for _ in range(2))
            if few == n or seconds > _SHORT:
                return _Timed(call, seconds, (n / few) * (size / rows.size))
            few = min(4 * few, n)

    def fewest(self, case: Case) -> Point:
        """The fewest steps of one case that meet the tolerance; raises ``ValueError``.

        If no body of the sample is determined, they are those that would be tried first.
        """
        if self.rows.size == 0:
            lost = self.sampled
            return Point(case, self.start(case), 0.0, lost, random=lost, beyond=lost)
        n = self._fewest(case, math.inf)
        sure = None if n is None else self._sure(case, n)
        if sure is None:
            raise self._refusal()
        return sure

    def fastest(self, cases: Iterable[Case]) -> list[Point]:
        """The cases that meet the tolerance in the shortest times; raises ``ValueError``."""
        met: list[Point] = []
        best = math.inf
        for case in cases:
            some = self._timed(case, start := self.start(case))
            step = some.seconds * some.share / start
            n = self._fewest(case, _WORTH * best / step)
            if n is not None:
                met.append(Point(case, n, self.error(case, n), self.sampled))
                best = min(best, n * step)
        sure: list[Point] = []
        for point in sorted(self._in_turns(met, 0.0), key=lambda point: point.seconds):
            least = sure[0].seconds if sure else math.inf
            enough = len(sure) >= _VERIFIED_CASES and point.seconds > TIE * least
            if enough or point.seconds > _WORTH * least:
                break
            if verified := self._sure(point.case, point.n_steps):
                sure.append(verified._replace(seconds=point.seconds))
        if not sure:
            raise self._refusal()
        return ranked(self._in_turns(sure))

    def _in_turns(self, points: Sequence[Point], budget: float = BUDGET) -> list[Point]:
        """Points with their times, of as many rounds as fit into a budget, s."""
        timed = [self._timed(point.case, point.n_steps) for point in points]
        times = time_in_turns([each.call for each in timed], budget=budget)
        return [
            point._replace(seconds=each.share * x.least)
            for point, each, x in zip(points, timed, times, strict=True)
        ]

    def _refusal(self) -> ValueError:
        error, n, name = min((self.error(case, n), n, str(case)) for case, n in self.errors)
        return ValueError(
            f"tol: found {self.tol:g}; accepted: what can be reached, {error:.1e} rad by {name} in "
            f"{n} steps: the motion magnifies rounding, or the torque or rate has corners"
        )

    def _fewest(self, case: Case, most: float) -> int | None:
        """About the smallest number of steps that meets the tolerance; None for over ``most``."""
        order, least, tol = self.order(case), self.least(case), self.within
        bad, good = 0, self.start(case)
        while self.error(case, good) > tol:
            is_flat = bad > 0 and self.is_flat(case, bad, good)
            bad, good = good, self.rounded(2 * good)
            if not order or is_flat or good > most or good > self.longest:
                return None
        # narrow the interval by the declared order
        while good > least and good - bad > max(self.unit(good), _CLOSE * good):
            error = max(self.error(case, good), 1e-300)
            if error >= tol * (1.0 - _CLOSE) ** order:
                break
            aim = 1.02 * good * (error / tol) ** (1.0 / order)
            low, high = float(max(least, good // 8)), float(good - self.unit(good))
            if bad:  # away from both ends
                low, high = bad + 0.25 * (good - bad), good - 0.25 * (good - bad)
            n = min(self.rounded(min(max(aim, low), high)), good - self.unit(good))
            if n <= bad:
                break
            bad, good = (bad, n) if self.error(case, n) <= tol else (n, good)
        return good

    def _sure(self, case: Case, n: int) -> Point | None:
        """Steps that suffice for the bodies outside the sample too."""
        order = self.order(case)
        for _ in range(_TRIALS):
            point = self._on_others(case, n)
            wanted = self.tol if point.random == self.whole.ensemble.size else self.tol / _UNSEEN
            if point.error <= wanted:
                return point
            if not order:
                return None
            more = 1.1 if point.error == math.inf else (point.error / wanted) ** (1.0 / order)
            further = max(self.rounded(min(1.01 * more, 16.0) * n), n + self.unit(n))
            if further > self.longest or self.is_flat(case, n, further):
                return None
            n = further
        return None

    def _on_others(self, case: Case, n: int) -> Point:
        """The error over the sample and over bodies outside of it, the hardest and some at random.

        All are run if they are few enough.
        """
        size, most = self.whole.ensemble.size, max(int(self.verified / max(n, 64)), self.sampled)
        self.error(case, n)
        rows, errors = [self.rows], [self.errors[case, n]]
        hard, chance = self.ranked[: most // 2], self.chance[: self.drawn + most - most // 2]
        is_all = size - self.rows.size <= most
        some = np.arange(size) if is_all else np.append(hard, chance)
        some = np.setdiff1d(some, np.append(self.rows, self.undetermined))
        for part in np.array_split(some, -(-some.size // 1024)) if some.size else ():
            known = self.known.of(self.whole.take(part), self.quantile)
            of_part = self._errors(known, case, n)
            lost = known.undetermined(np.flatnonzero(of_part > self.tol / _UNSEEN), self.tol)
            self.undetermined = np.union1d(self.undetermined, part[lost])
            rows.append(np.delete(part, lost))
            errors.append(np.delete(of_part, lost))
        each, error = np.concatenate(rows), np.concatenate(errors)
        random = np.arange(size) if is_all else chance
        beyond = np.append(each[error > self.tol], self.undetermined)
        return Point(
            case, n, top(error, self.quantile), each.size + self.undetermined.size,
            worst=int(self.whole.ensemble.places[each[np.argmax(error)]]),
            random=random.size, beyond=int(np.isin(beyond, random).sum()),
        )  # fmt: skip

    def by_halving(self, point: Point) -> NDArray[np.float64]:
        """Errors of all bodies, (N,) rad, by runs in the steps of a point and in twice as many.

        Those that double precision does not determine are found among those beyond the tolerance.
        """
        errors = []
        size = self.whole.ensemble.size
        for part in np.array_split(np.arange(size), -(-size // _TOGETHER)):
            known = self.known.of(self.whole.take(part), self.quantile)
            ladder = Ladder(known.problem, point.case, point.n_steps, _TIMES)
            errors.append(np.where(ladder.start.flagged, np.inf, ladder.halve()))
            lost = known.undetermined(np.flatnonzero(errors[-1] > self.tol), self.tol)
            self.undetermined = np.union1d(self.undetermined, part[lost])
        return np.concatenate(errors)

    def limit(self, case: Case, n: int) -> str:
        """What limits the error: truncation if half the step size is more accurate."""
        order, error = self.order(case), self.error(case, n)
        if order and self.error(case, 2 * n) <= error * 0.5 ** (0.5 * order):
            return "truncation"
        if error <= 2.0 * float(self.known.unresolved.max()):
            return REFERENCE
        # a truncation error that falls irregularly is larger than both
        is_rounding = not order or self.is_flat(case, n, 2 * n)
        is_rounding |= error <= 2.0 * float(self.known.error.max())
        return PLATEAU if is_rounding else "truncation"
