"""Advice on method, step and precision, measured on a sample of the user's own ensemble."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.arrays import angle_between
from fastatt.attitudes import Attitude
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.scene import torques
from fastatt.scene.models import Sum
from fastatt.scene.scene import Scene
from fastatt.threads import progress_bar
from fastatt.trade.each import share_of
from fastatt.trade.measure import Case, Problem, best_time
from fastatt.trade.recommendation import Point, Recommendation, told
from fastatt.trade.reference import intervals, reference
from fastatt.trade.sample import Look, Sample, looks_at
from fastatt.trade.work_precision import DTYPES, cases_of, duration

# what was on the frontier of some measured scene; those that were not are left out unless named
_USUAL = {
    "rate": ("lie_midpoint", "rk4", "magnus4", "magnus6", "magnus8", "gauss12"),
    "free": ("exact", "strang2", "rk4", "dmv4", "dmv6", "dmv8", "dmv10", "kahan_li8"),
    "torqued": (
        "exact", "strang2", "rk4", "rk8", "rk9", "gbs16", "suzuki4", "kahan_li6", "kahan_li8",
    ),
}  # fmt: skip
_FINER = 30.0  # how much better than the tolerance the reference must be
_HOPELESS = 6.0  # times the guessed work of the best: not even looked at
_SINGLE = 1e-6  # rad: nothing is that exact in float32
_WORTH = 4.0  # a guessed time this much over the best known is not looked into
_NEAR = 1.5  # times as long as the best: timed again beside it
_CLOSE = 0.06  # of a number of steps: near enough to the least
_LOOKS = 10  # at numbers of steps, a case
_AHEAD = 16.0  # times the steps, from one look to the next: the order may not show yet
_MOST = 3e7  # body-steps of a look, 1 or 2 s
_SHORT = 0.05  # s: a run that is timed as a whole
_WHOLE = 1.0  # s: a run beside which a call does not count
_BETWEEN = 64  # times at least at which what a history's interval costs is looked at
_WHY = "whose motion magnifies rounding, or where what acts jumps"


def recommend(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike | None = None,
    *,
    t_end: float,
    tol: float | None = None,
    budget: float | None = None,
    v0: ArrayLike | None = None,
    r0: ArrayLike | None = None,
    t0: float = 0.0,
    save_interval: float | None = None,
    at: str = "run",
    methods: Sequence[str | Method] | None = None,
    representations: Sequence[str | Attitude] = ("quat",),
    dtypes: Sequence[str] = DTYPES,
    sample: int = 128,
    n_threads: int | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Recommendation:
    """The cheapest method, step and precision that meet a tolerance, or the best within a time.

    Runs a sample of the ensemble: the bodies that a coarse run of all, or of as many as take
    0.3 s, shows to be the hardest, the fastest ones, and others by chance. Each case's number of
    steps is looked for until the largest error meets ``tol``, and what is recommended was run so.
    Takes a few seconds.

    Parameters
    ----------
    scene, q0, w0, v0, r0, t0, n_threads : as of :func:`fastatt.propagate`.
    t_end : duration, s, above 0; the steps fill it exactly.
    tol : largest error of any body, rad.
    budget : instead of ``tol``, the longest time that the run may take, s.
    save_interval : s between saves, of which ``t_end`` is a multiple; None for the end alone.
    at : where errors are looked at: over the "run", after each of its steps or, of more than 1024,
        at so many even times of it and of its beginnings; or at its "end" alone.
    methods : None takes those that are the cheapest somewhere; ``fastatt.methods_for`` lists all.
        Methods of one's own stand beside names.
    representations, dtypes : what to choose from.
    sample : number of bodies to measure errors on.
    seed : of the choice of bodies.
    progress : show a bar (needs tqdm).

    Returns
    -------
    Recommendation : ``fastatt.propagate(scene, q0, w0, **advice.arguments)`` runs it; without
        ``save_interval``, with any ``save_every`` besides.

    Raises
    ------
    ValueError : a tolerance or a budget that nothing meets, with what can be reached; any other
        argument that does not fit, by name, with what is accepted. TypeError as well.
    """
    if (tol is None) == (budget is None):
        found = "neither" if tol is None else "both"
        raise ValueError(f"tol, budget: found {found}; accepted: one of them")
    wanted = checks.above_zero("budget", budget) if tol is None else checks.above_zero("tol", tol)
    ensemble = Ensemble.of(scene, q0, w0, v0, r0)
    whole = Problem(ensemble, duration(t_end), checks.real("t0", t0), n_threads)
    fitting = methods_for(scene)
    usual = [m for m in _USUAL.get(scene.kind, _USUAL["free"]) if m in fitting]
    cases = cases_of(scene, usual if methods is None else methods, representations, dtypes)
    if tol is not None and methods is None:
        cases = _hopeful(cases, tol)
    search = Search(
        whole,
        _saves(whole.t_end, save_interval),
        checks.choice("at", at, ("run", "end")),
        checks.whole("sample", sample, 1),
        np.random.default_rng(seed),
        wanted / _FINER if tol is not None else 0.0,
    )
    with progress_bar(progress, 2 * len(cases), "case") as done:
        if tol is not None:
            return search.cheapest(cases, wanted, done)
        return search.most_accurate(cases, wanted, done)


def _hopeful(cases: Sequence[Case], tol: float) -> list[Case]:
    """Cases without those whose order or precision is far too low for a tolerance.

    The guess at the work of a method is tol^(−1/order) evaluations and exponentials.
    """

    def work(case: Case) -> float:
        m = case.record
        return max(1, m.rate_calls + m.exponentials) * tol ** (-1.0 / m.order) if m.order else 1.0

    stepped = [c for c in cases if c.record.order]
    least = min(map(work, stepped), default=1.0)
    kept = [c for c in cases if work(c) <= _HOPELESS * least]
    return [c for c in kept if c.dtype == "float64" or tol >= _SINGLE] or kept


def _saves(t_end: float, interval: float | None) -> int | None:
    if interval is None:
        return None
    every = checks.above_zero("save_interval", interval)
    n = round(t_end / every)
    if n < 1 or abs(n * every - t_end) > 1e-9 * t_end:
        raise ValueError(
            f"save_interval: found {every}; accepted: t_end, {t_end}, over a whole number"
        )
    return n


def _rounds(cases: Sequence[Case]) -> list[list[Case]]:
    """Closed forms, then steps in double precision, then in single."""
    closed = [c for c in cases if not c.record.order]
    stepped = [c for c in cases if c.record.order]
    kinds = [[c for c in stepped if c.dtype == dtype] for dtype in DTYPES]
    return [some for some in (closed, *kinds) if some]


class _Met(NamedTuple):
    """Steps of a case that do what is wanted, and the safety of their error."""

    look: Look
    n: int
    safety: float = 1.0

    @property
    def seconds(self) -> float:
        """Of a call."""
        return self.look.seconds(self.n)


_SECONDS = attrgetter("seconds")


class Search(Sample):
    """The least steps of each case that meet a tolerance, or the best within a time."""

    def least(self, look: Look, tol: float, best: float) -> int | None:
        """The least number of steps that meets the tolerance, near enough; None where none can."""
        if not look.order:
            n = min(look.errors)
            return n if look.errors[n] <= tol else None
        for _ in range(_LOOKS):
            bad = max((n for n, e in look.errors.items() if e > tol), default=0)
            good = min((n for n, e in look.errors.items() if e <= tol and n > bad), default=None)
            if good is not None and (
                good <= look.first or good - bad <= max(self.unit(good), _CLOSE * good)
            ):
                return good
            n_next = self._next(look, tol, bad, good)
            if n_next is None or look.seconds(n_next) > _WORTH * best or self._too_long(n_next):
                return good
            self.error(look, n_next)
        return good

    def _too_long(self, n: int) -> bool:
        """Whether n steps of the sample are more than any look may take."""
        return bool(n / self.divide * self.sampled > _MOST)

    def _next(self, look: Look, tol: float, bad: int, good: int | None) -> int | None:
        """The next number of steps to look at."""
        tried = sorted(look.errors)
        near = tried[-2:] if good is None else [n for n in tried if n >= bad][:2]
        a, b = near[0], near[-1]
        ea, eb = look.errors[a], look.errors[b]
        p = float(look.order)
        if a != b and 0.0 < eb < ea < math.inf:
            p = float(np.clip(math.log(ea / eb) / math.log(b / a), 0.5 * p, 2.0 * p))
        if good is None:
            if a != b and b >= 1.4 * a and look.is_flat(a, b):
                return None
            if eb > 0.5:
                return self.rounded(2.0 * b)
            ahead = self.rounded(1.02 * b * min((eb / tol) ** (1.0 / p), _AHEAD))
            return max(ahead, b + self.unit(b))
        error = look.errors[good]
        back = 1.02 * good * (error / tol) ** (1.0 / p)
        if bad == 0:
            return min(self.rounded(max(back, look.first, good // 8)), good - self.unit(good))
        # between the two, away from either
        apart = 0.25 * (good - bad)
        n = self.rounded(min(max(back, bad + apart), good - apart))
        return min(n, good - self.unit(good))

    def cheapest(self, cases: Sequence[Case], tol: float, done: Any) -> Recommendation:
        """The case that meets the tolerance in the shortest time."""
        own = float(self.known.own_error.max()) * self.divide
        if own > 0.25 * tol:
            raise ValueError(
                f"tol: found {tol:g}; accepted: at least {4.0 * own:.1e}: {self.known.source}, the "
                f"reference, is good to {own:.1e} rad of some body, {_WHY}"
            )
        within = tol / 1.1 if self.sampled < self.whole.ensemble.size else tol
        met: list[_Met] = []
        best = math.inf

        def guess(look: Look) -> float:
            return look.seconds(look.steps_for(within))

        looks: list[Look] = []
        for some in _rounds(cases):
            # in single precision a method is no more than some 2.5 times as fast
            slow = {
                look.case._replace(dtype="float32") for look in looks if guess(look) > 2.5 * best
            }
            stepped = best > self.least_seconds
            new = [
                self.look(case)
                for case in some
                if case not in slow and (stepped or not case.record.order)
            ]
            looks += new
            done(2 * len(some))
            for look in sorted(new, key=guess):
                if guess(look) > _WORTH * best:
                    continue
                n = self.least(look, within, best)
                if n is not None:
                    met.append(_Met(look, n))
                    best = min(best, look.seconds(n))
        met.sort(key=_SECONDS)
        sure: list[_Met] = []
        for one in met[:3]:
            if sure and one.seconds > _NEAR * sure[0].seconds:
                sure.append(one._replace(safety=self.unseen))  # which is not what will be run
            elif found := self._sure(one.look, one.n, tol):
                sure.append(found)
        if not sure:
            tried = [(error, n, look.case) for look in looks for n, error in look.errors.items()]
            error, n, case = min(tried, key=itemgetter(0))
            raise ValueError(
                f"tol: found {tol:g}; accepted: what can be reached, {error:.1e} rad by {case} in "
                f"{n} steps, {_WHY}"
            )
        return self._advise(sure, tol=tol)

    def _sure(self, look: Look, n: int, tol: float) -> _Met | None:
        """Steps that are enough for the bodies outside the sample too."""
        for _ in range(_LOOKS):
            safety = self.safety(look, n)
            error = safety * self.error(look, n)
            if error <= tol:
                return _Met(look, n, safety)
            if not look.order:
                return None
            more = 1.3 if error == math.inf else 1.01 * (error / tol) ** (1.0 / look.order)
            further = max(self.rounded(min(more, _AHEAD) * n), n + self.unit(n))
            if self._too_long(further):
                return None
            self.error(look, further)
            if look.is_flat(n, further):
                return None
            n = further
        return None

    def most_accurate(self, cases: Sequence[Case], budget: float, done: Any) -> Recommendation:
        """The case of least error within the time; of those within twice that, the cheapest."""
        met: list[_Met] = []
        looks: list[Look] = []
        least = math.inf
        for some in _rounds(cases):
            if least < _SINGLE and some and some[0].dtype == "float32":
                break
            new = [self.look(case) for case in some]
            looks += new
            done(2 * len(some))
            for look in sorted(new, key=lambda look: -look.order):
                n = self._within(look, budget, least)
                if n is not None:
                    met.append(_Met(look, n))
                    least = min(least, look.errors[n])
        if not met:
            fastest = min((_Met(look, look.first) for look in looks), key=_SECONDS)
            raise ValueError(
                f"budget: found {budget:g} s; accepted: at least the {told(fastest.seconds)} that "
                f"{fastest.look.case} takes in {fastest.n} steps"
            )
        near = [(look, n) for look, n, _ in met if look.errors[n] <= 2.0 * least]
        sure = [_Met(look, n, self.safety(look, n)) for look, n in near]
        return self._advise(sure, budget=budget)

    def _within(self, look: Look, budget: float, least: float) -> int | None:
        """The number of steps with the least error that the time allows, if that may be least."""
        most = look.first
        if look.order:
            most = int((0.95 * budget - look.fixed) / look.slope)
            most -= most % self.unit(max(1, most))
        if most < look.first or look.seconds(most) > budget:
            return None
        n = min(look.errors)
        if n > most:
            self.error(look, most)
        while look.order and n < most:
            if look.errors[n] < 1.0 and look.errors[n] * (n / most) ** look.order > 4.0 * least:
                return None
            further = min(most, 2 * n)
            self.error(look, further)
            if look.is_flat(n, further):
                break
            n = further
        allowed = {n: e for n, e in look.errors.items() if n <= most and e < math.inf}
        return min(allowed, key=lambda n: allowed[n]) if allowed else None

    def _advise(
        self, met: list[_Met], tol: float | None = None, budget: float | None = None
    ) -> Recommendation:
        """Time the best again, side by side, and say what limits the first of them."""
        met.sort(key=_SECONDS)
        close = [one for one in met if one.seconds < _NEAR * met[0].seconds]
        timed = {id(look): math.inf for look, *_ in close}
        for _ in range(1 if met[0].seconds > _WHOLE else 2):  # they take turns
            for look, n, _ in close:
                timed[id(look)] = min(timed[id(look)], self._clock(look, n))

        def taken(one: _Met) -> float:
            return timed.get(id(one.look), one.seconds)

        # what was not timed beside the best was not made sure of either
        met.sort(key=lambda one: (id(one.look) not in timed, taken(one)))
        look, n, safety = met[0]
        seconds = taken(met[0])
        while budget is not None and seconds > budget and look.order:
            less = self.rounded(0.9 * n * budget / seconds)
            less -= self.unit(less)
            if less < look.first:
                break
            n, safety = less, self.safety(look, less)
            self.error(look, n)
            seconds = self._clock(look, n)
        up = None
        if len(met) > 1:
            other, m, factor = met[1]
            up = Point(other.case, m, factor * other.errors[m], taken(met[1]))
        error = safety * look.errors[n]
        sampling = self._sampling_error()
        limit = "round-off"
        if look.order and self.error(look, 2 * n) <= look.errors[n] * 0.5 ** (0.5 * look.order):
            limit = "truncation"
        if sampling is not None and sampling > error:
            limit = "sampling"
        return Recommendation(
            method=look.case.name, representation=look.case.stored_as, dtype=look.case.dtype,
            dt=self.whole.t_end / n, n_steps=n, save_every=self._every(n),
            n_threads=self.whole.threads(n), at=self.at,
            expected_error=error, expected_seconds=seconds, limited_by=limit,
            runner_up=up, margin=None if up is None else up.seconds / seconds,
            tol=tol, budget=budget,
            n_bodies=self.whole.ensemble.size, sampled=self.sampled, safety=safety,
            reference=self.known.source, reference_error=float(self.known.own_error.max()),
            sampling_error=sampling, own_steps=share_of(self.whole.ensemble, look.order),
            extrapolated_from=self.problem.t_end if self.divide > 1 else None,
            case=look.case, curve=self.points,
        )  # fmt: skip

    def _every(self, n: int) -> int | None:
        return None if self.n_saves is None else n // self.n_saves

    def _clock(self, look: Look, n: int) -> float:
        """Seconds of the whole call: measured where it is short, else from fewer steps."""
        if look.seconds(n) < _SHORT:
            return best_time(lambda: self.whole.run(look.case, n, self._every(n)), 2)[0]
        if not look.order:
            return look.seconds(n)
        self.time(look, n)
        one = replace(self.whole, t_end=self.whole.t_end / n)
        once = best_time(lambda: one.run(look.case, 1), 1)[0]
        return once + look.slope * (n - 1)

    def _sampling_error(self) -> float | None:
        """What the interval of a sampled torque costs: linear between samples, of order 2."""
        scene = self.problem.ensemble.scene
        coarse = _decimated(scene.torque)
        if coarse is None:
            return None
        fewer = replace(self.problem.ensemble, scene=replace(scene, torque=coarse))
        # at times between the samples, and theirs
        kinks = intervals(self.problem)
        n = kinks * -(-_BETWEEN // kinks)
        looks = looks_at(self.at, self.sampled)
        known = reference(replace(self.problem, ensemble=fewer), looks=looks)
        return float(angle_between(known.beside(n)[1], self.known.beside(n)[1]).max()) / 3.0


def _decimated(model: Any) -> Any:
    """The torque with every second sample of its histories; None where it has none."""
    if isinstance(model, torques.Sampled):
        samples = np.asarray(model.torques)
        if len(samples) % 2 == 0:  # the history ends where it did: its last line goes on
            samples = np.concatenate([samples, 2.0 * samples[-1:] - samples[-2:-1]])
        return model._replace(torques=samples[::2], dt=2.0 * model.dt)
    if isinstance(model, Sum):
        terms = [(term, _decimated(term)) for term in model.terms]
        if any(coarse is not None for _, coarse in terms):
            return Sum(tuple(term if coarse is None else coarse for term, coarse in terms))
    return None
