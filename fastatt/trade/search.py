"""Search for the fewest steps of each case that meet a tolerance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import NamedTuple

from fastatt.trade.measure import PLATEAU, REFERENCE, Case, best_time
from fastatt.trade.recommendation import Point, Recommendation
from fastatt.trade.sample import Candidate, Sample

SINGLE = 1e-6  # rad; float32 is never that accurate
_WORTH = 4.0  # a case with this many times the estimated time of the best is given up
_FASTER = 2.5  # the largest speed-up by single precision
_NEAR = 1.5  # cases with up to this many times the best time are timed again, alternately
_CLOSE = 0.06  # relative accuracy of the smallest number of steps
_TRIALS = 10  # numbers of steps that are tried on bodies outside of the sample
_MOST = 6e7  # the most body-steps of a trial, 2 or 3 s
_SHORT = 0.05  # s; shorter runs are timed as a whole
_WHOLE = 1.0  # s; in longer runs the time of a call is negligible
FINER = 30.0  # ratio of the tolerance and the reference's error
UNSEEN = 1.5  # margin of errors below the tolerance if some bodies are not run


def work(case: Case, tol: float) -> float:
    """An estimate of the work for a tolerance: tol^(−1/order) evaluations and exponentials."""
    m = case.record
    return max(1, m.rate_calls + m.exponentials) * tol ** (-1.0 / m.order) if m.order else 0.0


class _Run(NamedTuple):
    """Steps of a case that meet the goal, their error (rad), and the number of bodies."""

    candidate: Candidate
    n: int
    error: float
    measured: int

    @property
    def seconds(self) -> float:
        """Time of a call, s."""
        return self.candidate.seconds(self.n)


_SECONDS = attrgetter("seconds")


class Search(Sample):
    """The fewest steps of each case that meet a tolerance."""

    def cheapest(
        self, cases: Sequence[Case], tol: float, done: Callable[[int], object]
    ) -> Recommendation:
        """The case that meets the tolerance in the shortest time."""
        self.known.refuse_beyond(tol)
        # bodies outside of the sample may have slightly larger errors
        within = tol / 1.1 if self.others.size else tol
        met: list[_Run] = []
        guesses: dict[Case, float] = {}
        tried: list[Candidate] = []
        best = math.inf
        # closed forms first, then double precision, then single precision
        for case in sorted(cases, key=lambda c: (c.dtype == "float32", work(c, tol))):
            done(1)
            twin = guesses.get(case._replace(dtype="float64"), 0.0)
            if case.record.order and (best < self.least_seconds or twin > _FASTER * best):
                continue
            one = self.candidate(case)
            tried.append(one)
            guesses[case] = one.seconds(one.steps_for(within))
            n = None if guesses[case] > _WORTH * best else self._least(one, within, best)
            if n is not None:
                met.append(_Run(one, n, one.errors[n], self.sampled))
                best = min(best, one.seconds(n))
        sure: list[_Run] = []
        for run in sorted(met, key=_SECONDS):
            if len(sure) == 3 or (sure and run.seconds > _WORTH * sure[0].seconds):
                break
            if found := self._sure(run.candidate, run.n, tol):
                sure.append(found)
        if not sure:
            error, n, name = min(
                (e, n, str(one.case)) for one in tried for n, e in one.errors.items()
            )
            raise ValueError(
                f"tol: found {tol:g}; accepted: what can be reached, {error:.1e} rad by {name} in "
                f"{n} steps: the motion magnifies rounding, or the torque or rate has corners"
            )
        return self._advise(sure, tol)

    def _least(self, one: Candidate, tol: float, best: float) -> int | None:
        """About the smallest number of steps that meets the tolerance; None if none does."""
        bad, n = 0, one.start
        good: int | None = None
        while True:
            if self.error(one, n) <= tol:
                good = n
            else:
                bad = n
            if good is None:
                flat = len(one.errors) > 1 and one.is_flat(*sorted(one.errors)[-2:])
                n = self.rounded(2 * bad)
                if not one.order or flat or self._too_long(n) or one.seconds(n) > _WORTH * best:
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

    def _on_others(self, one: Candidate, n: int) -> _Run:
        """The error of the recommendation over the sample and the bodies outside of it."""
        others, count = self.error_of_others(one, n)
        return _Run(one, n, max(self.error(one, n), others), self.sampled + count)

    def _sure(self, one: Candidate, n: int, tol: float) -> _Run | None:
        """Steps that suffice for the bodies outside the sample too."""
        for _ in range(_TRIALS):
            found = self._on_others(one, n)
            wanted = tol if found.measured == self.whole.ensemble.size else tol / UNSEEN
            if found.error <= wanted:
                return found
            if not one.order:
                return None
            more = 1.1 if found.error == math.inf else (found.error / wanted) ** (1.0 / one.order)
            further = max(self.rounded(min(1.01 * more, 16.0) * n), n + self.unit(n))
            if self._too_long(further):
                return None
            self.error(one, further)
            if one.is_flat(n, further):
                return None
            n = further
        return None

    def _advise(self, met: list[_Run], tol: float) -> Recommendation:
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
        found, n = best.candidate, best.n
        limit = "truncation" if self._gains(found, n) else self._floor(found, n)
        return Recommendation(
            method=found.case.name, representation=found.case.representation,
            dtype=found.case.dtype, dt=self.whole.t_end / n, n_steps=n, t0=self.whole.t0,
            n_threads=self.whole.threads(n), at=self.at,
            expected_error=best.error, expected_seconds=seconds, limited_by=limit,
            runner_up=up, margin=None if up is None else up.seconds / seconds,
            tol=tol, n_bodies=self.whole.ensemble.size, measured=best.measured,
            reference=self.known.source, reference_error=float(self.known.own_error.max()),
            case=found.case,
        )  # fmt: skip

    def _gains(self, one: Candidate, n: int) -> bool:
        """Whether half the step size is more accurate; True if the whole run is one step."""
        if not one.order:
            return False
        scene, record = self.whole.ensemble.scene, one.case.record
        if n == 1 and not (scene.is_constant and record.exact_for_constant):
            return True
        return bool(self.error(one, 2 * n) <= one.errors[n] * 0.5 ** (0.5 * one.order))

    def _floor(self, one: Candidate, n: int) -> str:
        """What limits the error where half the step size is not more accurate."""
        if one.errors[n] <= 2.0 * float(self.known.unresolved.max()):
            return REFERENCE
        # a truncation error that falls irregularly is larger than both
        is_rounding = not one.order or one.is_flat(n, 2 * n)
        is_rounding |= one.errors[n] <= 2.0 * float(self.known.own_error.max())
        return PLATEAU if is_rounding else "truncation"

    def _clock(self, one: Candidate, n: int) -> float:
        """Seconds of the whole call: measured if short, else extrapolated from fewer steps."""
        if one.seconds(n) < _SHORT:
            return best_time(lambda: self.whole.run(one.case, n), 2)[0]
        self.time(one, n)
        return one.seconds(n)
