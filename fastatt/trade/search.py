"""The steps of each case that meet a tolerance, or are the best within a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from fastatt.scene import torques
from fastatt.scene.models import Sum
from fastatt.trade.ladder import largest_angle, see
from fastatt.trade.measure import Case, best_time
from fastatt.trade.recommendation import Point, Recommendation, in_words
from fastatt.trade.reference import reference
from fastatt.trade.sample import Candidate, Sample
from fastatt.trade.work_precision import DTYPES

SINGLE = 1e-6  # rad: nothing is that exact in float32
_WORTH = 4.0  # a guessed time this much over the best known is not followed
_NEAR = 1.5  # times as long as the best: timed again beside it
_CLOSE = 0.06  # of a number of steps: near enough to the least
_TRIALS = 10  # numbers of steps that are run, a case
_AHEAD = 16.0  # times the steps, from one trial to the next: the order may not show yet
_MOST = 6e7  # body-steps of a trial, 2 or 3 s
_SHORT = 0.05  # s: a run that is timed as a whole
_WHOLE = 1.0  # s: a run beside which a call does not count
_UNSEEN = 1.5  # what the error of all that were run is below the tolerance, where some were not
_BETWEEN = 64  # times at least at which what a history's interval costs is compared


def _rounds(cases: Sequence[Case]) -> list[list[Case]]:
    """Closed forms, then steps in double precision, then in single."""
    closed = [c for c in cases if not c.record.order]
    stepped = [c for c in cases if c.record.order]
    kinds = [[c for c in stepped if c.dtype == dtype] for dtype in DTYPES]
    return [some for some in (closed, *kinds) if some]


class _Met(NamedTuple):
    """Steps of a case that do what is wanted, their error (rad), and on how many bodies."""

    candidate: Candidate
    n: int
    error: float
    measured: int

    @property
    def seconds(self) -> float:
        """Of a call."""
        return self.candidate.seconds(self.n)


_SECONDS = attrgetter("seconds")


class Search(Sample):
    """The least steps of each case that meet a tolerance, or the best within a time."""

    def least(self, one: Candidate, tol: float, best: float) -> int | None:
        """The least number of steps that meets the tolerance, near enough; None where none can."""
        if not one.order:
            n = min(one.errors)
            return n if one.errors[n] <= tol else None
        good: int | None = None
        for _ in range(_TRIALS):
            bad = max((n for n, e in one.errors.items() if e > tol), default=0)
            good = min((n for n, e in one.errors.items() if e <= tol and n > bad), default=None)
            if good is not None and (
                good <= one.first or good - bad <= max(self.unit(good), _CLOSE * good)
            ):
                return good
            n_next = self._next(one, tol, bad, good)
            if n_next is None or one.seconds(n_next) > _WORTH * best or self._too_long(n_next):
                return good
            self.error(one, n_next)
        return good

    def _too_long(self, n: int) -> bool:
        """Whether n steps of the sample are more than any trial may take."""
        return bool(n * self.sampled > _MOST)

    def _next(self, one: Candidate, tol: float, bad: int, good: int | None) -> int | None:
        """The next number of steps to run."""
        tried = sorted(one.errors)
        near = tried[-2:] if good is None else [n for n in tried if n >= bad][:2]
        a, b = near[0], near[-1]
        ea, eb = one.errors[a], one.errors[b]
        p = float(one.order)
        if a != b and 0.0 < eb < ea < math.inf:
            p = float(np.clip(math.log(ea / eb) / math.log(b / a), 0.5 * p, 2.0 * p))
        if good is None:
            if a != b and b >= 1.4 * a and one.is_flat(a, b):
                return None
            if eb > 0.5:
                return self.rounded(2.0 * b)
            ahead = self.rounded(1.02 * b * min((eb / tol) ** (1.0 / p), _AHEAD))
            return max(ahead, b + self.unit(b))
        error = one.errors[good]
        back = 1.02 * good * (error / tol) ** (1.0 / p)
        if bad == 0:
            return min(self.rounded(max(back, one.first, good // 8)), good - self.unit(good))
        # between the two, away from either
        apart = 0.25 * (good - bad)
        n = self.rounded(min(max(back, bad + apart), good - apart))
        return min(n, good - self.unit(good))

    def cheapest(self, cases: Sequence[Case], tol: float, done: Any) -> Recommendation:
        """The case that meets the tolerance in the shortest time."""
        self.known.refuse_beyond(tol)
        # others are a little harder
        within = tol / 1.1 if self.others.size else tol
        met: list[_Met] = []
        best = math.inf

        def guess(one: Candidate) -> float:
            return one.seconds(one.steps_for(within))

        tried: list[Candidate] = []
        for some in _rounds(cases):
            # in single precision a method is no more than some 2.5 times as fast
            slow = {one.case._replace(dtype="float32") for one in tried if guess(one) > 2.5 * best}
            stepped = best > self.least_seconds
            new = [
                self.candidate(case)
                for case in some
                if case not in slow and (stepped or not case.record.order)
            ]
            tried += new
            done(2 * len(some))
            for one in sorted(new, key=guess):
                if guess(one) > _WORTH * best:
                    continue
                n = self.least(one, within, best)
                if n is not None:
                    met.append(_Met(one, n, one.errors[n], self.sampled))
                    best = min(best, one.seconds(n))
        sure: list[_Met] = []
        for one_met in sorted(met, key=_SECONDS):
            if len(sure) == 3 or (sure and one_met.seconds > _WORTH * sure[0].seconds):
                break
            if found := self._sure(one_met.candidate, one_met.n, tol):
                sure.append(found)
        if not sure:
            error, n, case = self.best_found(tried)
            raise ValueError(
                f"tol: found {tol:g}; accepted: what can be reached, {error:.1e} rad by {case} in "
                f"{n} steps: the motion magnifies rounding, or what acts has corners"
            )
        return self._advise(sure, tol=tol)

    def _run_on_others(self, one: Candidate, n: int) -> _Met:
        """The error of what is recommended over the sample and the bodies outside of it."""
        others, count = self.error_of_others(one, n)
        return _Met(one, n, max(self.error(one, n), others), self.sampled + count)

    def _sure(self, one: Candidate, n: int, tol: float) -> _Met | None:
        """Steps that are enough for the bodies outside the sample too."""
        for _ in range(_TRIALS):
            found = self._run_on_others(one, n)
            wanted = tol if found.measured == self.whole.ensemble.size else tol / _UNSEEN
            if found.error <= wanted:
                return found
            if not one.order:
                return None
            more = 1.1 if found.error == math.inf else (found.error / wanted) ** (1.0 / one.order)
            further = max(self.rounded(min(1.01 * more, _AHEAD) * n), n + self.unit(n))
            if self._too_long(further):
                return None
            self.error(one, further)
            if one.is_flat(n, further):
                return None
            n = further
        return None

    def most_accurate(self, cases: Sequence[Case], budget: float, done: Any) -> Recommendation:
        """The case of least error within the time; of those within twice that, the cheapest."""
        met: list[tuple[Candidate, int]] = []
        tried: list[Candidate] = []
        least = math.inf
        for some in _rounds(cases):
            if least < SINGLE and some and some[0].dtype == "float32":
                break
            new = [self.candidate(case) for case in some]
            tried += new
            done(2 * len(some))
            for one in sorted(new, key=lambda one: -one.order):
                n = self._within(one, budget, least)
                if n is not None:
                    met.append((one, n))
                    least = min(least, one.errors[n])
        if not met:
            fastest = min(tried, key=lambda one: one.seconds(one.first))
            raise ValueError(
                f"budget: found {budget:g} s; accepted: at least the "
                f"{in_words(fastest.seconds(fastest.first))} that {fastest.case} takes in "
                f"{fastest.first} steps"
            )
        near = [(one, n) for one, n in met if one.errors[n] <= 2.0 * least]
        return self._advise([self._run_on_others(one, n) for one, n in near], budget=budget)

    def _within(self, one: Candidate, budget: float, least: float) -> int | None:
        """The number of steps with the least error that the time allows, if that may be least."""
        most = one.first
        if one.order:
            most = int((0.95 * budget - one.fixed) / one.slope)
            most -= most % self.unit(max(1, most))
        if most < one.first or one.seconds(most) > budget:
            return None
        n = min(one.errors)
        if n > most:
            self.error(one, most)
        while one.order and n < most:
            if one.errors[n] < 1.0 and one.errors[n] * (n / most) ** one.order > 4.0 * least:
                return None
            further = min(most, 2 * n)
            if self._too_long(further):
                break
            self.error(one, further)
            if one.is_flat(n, further):
                break
            n = further
        allowed = {n: e for n, e in one.errors.items() if n <= most and e < math.inf}
        return min(allowed, key=lambda n: allowed[n]) if allowed else None

    def _advise(
        self, met: list[_Met], tol: float | None = None, budget: float | None = None
    ) -> Recommendation:
        """Time the best again, side by side, and say what limits the first of them."""
        met.sort(key=_SECONDS)
        close = [one for one in met if one.seconds < _NEAR * met[0].seconds]
        timed = [math.inf] * len(close)
        for _ in range(1 if met[0].seconds > _WHOLE else 2):  # they take turns
            for i, one in enumerate(close):
                timed[i] = min(timed[i], self._clock(one.candidate, one.n))
        (seconds, best), *rest = sorted(zip(timed, close, strict=True), key=lambda x: x[0])
        while budget is not None and seconds > budget and best.candidate.order:
            less = self.rounded(0.9 * best.n * budget / seconds)
            less -= self.unit(less)
            if less < best.candidate.first:
                break
            best = self._run_on_others(best.candidate, less)
            seconds = self._clock(best.candidate, less)
        # others were not timed beside the best
        rest += [(one.seconds, one) for one in met[len(close) :]]
        up = next((Point(o.candidate.case, o.n, o.error, s) for s, o in rest if s >= seconds), None)
        found, n = best.candidate, best.n
        change = self._sampling_change()
        limit = "truncation" if self._gains(found, n) else "round-off"
        if change is not None and change > 3.0 * best.error:
            limit = "sampling"
        return Recommendation(
            method=found.case.name, representation=found.case.stored_as, dtype=found.case.dtype,
            dt=self.whole.t_end / n, n_steps=n, t0=self.whole.t0, save_every=self._every(n),
            n_threads=self.whole.threads(n), at=self.at,
            expected_error=best.error, expected_seconds=seconds, limited_by=limit,
            runner_up=up, margin=None if up is None else up.seconds / seconds,
            tol=tol, budget=budget,
            n_bodies=self.whole.ensemble.size, measured=best.measured,
            reference=self.known.source, reference_error=float(self.known.own_error.max()),
            sampling_change=change, case=found.case, curve=self.points,
        )  # fmt: skip

    def _gains(self, one: Candidate, n: int) -> bool:
        """Whether half the step is more accurate; of a whole run in one step it is taken to be."""
        if not one.order:
            return False
        scene, record = self.whole.ensemble.scene, one.case.record
        if n == 1 and not (scene.is_constant and record.exact_for_constant):
            return True
        return bool(self.error(one, 2 * n) <= one.errors[n] * 0.5 ** (0.5 * one.order))

    def _every(self, n: int) -> int | None:
        return None if self.n_saves is None else n // self.n_saves

    def _clock(self, one: Candidate, n: int) -> float:
        """Seconds of the whole call: measured where it is short, else from fewer steps."""
        if one.seconds(n) < _SHORT:
            return best_time(lambda: self.whole.run(one.case, n, self._every(n)), 2)[0]
        if not one.order:
            return one.seconds(n)
        self.time(one, n)
        single = replace(self.whole, t_end=self.whole.t_end / n)
        once = best_time(lambda: single.run(one.case, 1), 1)[0]
        return once + one.slope * (n - 1)

    def _sampling_change(self) -> float | None:
        """By how much the attitude changes when a sampled torque has every second sample alone."""
        scene = self.problem.ensemble.scene
        coarse = _decimated(scene.torque)
        if coarse is None:
            return None
        fewer = replace(self.problem.ensemble, scene=replace(scene, torque=coarse))
        known = reference(replace(self.problem, ensemble=fewer), most=self.most)
        kinks = self.unit(math.inf)
        times = see(self.problem, Case("rk4"), kinks * -(-_BETWEEN // kinks), self.most).times
        return float(largest_angle(known.at(times), self.known.at(times)).max())


def _decimated(model: Any) -> Any:
    """The torque with every second sample of its histories; None where it has none."""
    if isinstance(model, torques.Sampled):
        samples = np.asarray(model.torques)
        if len(samples) % 2 == 0:  # the history ends where it did: its last line goes on
            samples = np.concatenate([samples, 2.0 * samples[-1:] - samples[-2:-1]])
        return replace(model, torques=samples[::2], dt=2.0 * model.dt)
    if isinstance(model, Sum):
        terms = [(term, _decimated(term)) for term in model.terms]
        if any(coarse is not None for _, coarse in terms):
            return Sum(tuple(term if coarse is None else coarse for term, coarse in terms))
    return None
