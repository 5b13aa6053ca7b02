"""A sample of an ensemble: which bodies, what each case's errors and times on them are."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import angle_between
from fastatt.propagation.convergence import EARLY, beginnings
from fastatt.trade.measure import Case, Problem, best_time, is_flat
from fastatt.trade.recommendation import Point
from fastatt.trade.reference import Reference, intervals, reference, speeds

_BASELINE = Case("rk4")  # which fits every scene
_SCREENING = 0.3  # s to find the bodies with the largest errors
_LOOKED_AT = 65536  # bodies, for the fastest at a given rate
_VERIFYING = 0.5  # s to see whether there are larger ones
_LONG = 0.04  # s that the sample's steps of 1 rad may take; beyond, errors are extrapolated in time
_TIMED = 8192  # bodies
_STEPS = 640
_UNSEEN = 1.5  # factor for bodies that nothing was seen of
_STATES = 2**20  # of a run that are kept at a time, at 16 to 1024 instants


@dataclass
class Look:
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
        """A guess at the steps that meet a tolerance, by the declared order from the best look."""
        n, error = min(self.errors.items(), key=lambda look: abs(math.log(look[1] / tol)))
        if not self.order:
            return n
        return n * 4.0 if error > 1.0 else n * (error / tol) ** (1.0 / self.order)


def pace_of(problem: Problem) -> float:
    """Seconds a step of the baseline, of a run that outweighs the call."""
    few = replace(problem, t_end=problem.t_end / 1e3)
    return best_time(lambda: few.run(_BASELINE, _STEPS), 2)[0] / _STEPS


def changed(
    problem: Problem, at: str, one: tuple[Case, int], other: tuple[Case, int]
) -> tuple[NDArray[np.float64], bool]:
    """How far two runs are apart at most, (N,) rad, and whether the first carries a flag.

    A run is a case and its number of steps; the other's is a multiple of the one's.
    """
    looks = looks_at(at, problem.ensemble.size)
    apart, flagged = np.zeros(problem.ensemble.size), False
    for n in beginnings(one[1], looks):
        early = replace(problem, t_end=problem.t_end * n / one[1])
        every = -(-n // looks)
        a, b = (
            early.run(case, n * by, every * by)
            for case, by in ((one[0], 1), (other[0], other[1] // one[1]))
        )
        found = np.nan_to_num(angle_between(a.q[1:], b.q[1:]), nan=np.pi).max(axis=0)
        apart, flagged = np.maximum(apart, found), flagged or bool(a.status.any())
    return apart, flagged


def looks_at(at: str, size: int) -> int:
    """How many times of a run of so many bodies are looked at: the end alone, or 16 and more."""
    return 1 if at == "end" else int(np.clip(_STATES // size, 16, 1024))


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
        problem = replace(whole, ensemble=whole.ensemble.take(rows))
        self.turn = float(speeds(problem).max()) * problem.t_end
        pace = pace_of(problem)
        long = float(np.clip(_LONG / pace, 200.0, 2e4))
        self.divide = 2 ** max(0, math.ceil(math.log2(max(self.turn, 1.0) / long)))
        looks = looks_at(at, rows.size)
        self._unit = n_saves or 1
        if self.divide > 1:
            looks = max(2, looks)
            self._unit = math.lcm(self._unit, 2 * self.divide)
        self.problem = replace(problem, t_end=problem.t_end / self.divide)
        self.known: Reference = reference(self.problem, looks=looks, goal=goal / self.divide)
        w = self.known.states.w
        if w is not None:  # a torque may have made them faster
            fastest = float(np.linalg.norm(w, axis=-1).max())
            self.turn = max(self.turn, fastest * whole.t_end)
        n = whole.ensemble.size
        # no step of any method is much cheaper, none is right that turns by more than π
        self.least_seconds = 0.3 * pace * n / rows.size * self.turn / math.pi
        timed = np.linspace(0, n - 1, min(n, _TIMED)).astype(np.intp)
        self.timed = replace(whole, ensemble=whole.ensemble.take(timed))
        self.scale = n / timed.size

    @property
    def sampled(self) -> int:
        """Number of bodies."""
        return self.problem.ensemble.size

    @property
    def unseen(self) -> float:
        """Safety where nothing was seen of the other bodies."""
        return 1.0 if self.sampled == self.whole.ensemble.size else _UNSEEN

    def _choose(
        self, size: int, generator: np.random.Generator
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The hardest and fastest bodies and some by chance; others, the hardest first."""
        n = self.whole.ensemble.size
        if n <= size:
            return np.arange(n), np.arange(0)
        few = generator.choice(n, size, replace=False)
        some = replace(self.whole, ensemble=self.whole.ensemble.take(few))
        turn = float(speeds(some).max()) * self.whole.t_end
        steps = max(8, math.ceil(turn / 0.5))
        pace = pace_of(some) / size
        pool = generator.permutation(n)[: max(size, int(_SCREENING / (3 * steps * pace)))]
        if pool.size < n:
            fastest = self._fastest(generator, pool.size // 2)
            rest = pool[~np.isin(pool, fastest)]
            pool = np.concatenate([fastest, rest[: pool.size - fastest.size]])
        problem = replace(self.whole, ensemble=self.whole.ensemble.take(pool))
        if pool.size >= 4 * size:
            hardness, _ = changed(problem, self.at, (_BASELINE, steps), (_BASELINE, 2 * steps))
        else:
            hardness = speeds(problem)
        ranked = np.argsort(hardness, kind="stable")[::-1]
        quick = np.argsort(speeds(problem), kind="stable")[::-1][: size // 8]
        ranked = np.concatenate([quick, ranked[~np.isin(ranked, quick)]])
        hard, rest = np.split(ranked, [size // 4])
        chosen = generator.choice(rest.size, size - hard.size, replace=False)
        rows = np.concatenate([hard, rest[chosen]])
        return pool[rows], pool[np.delete(rest, chosen)]

    def _fastest(self, generator: np.random.Generator, count: int) -> NDArray[np.intp]:
        """The fastest bodies of all, or, at a given rate, of as many as are looked at."""
        if self.whole.ensemble.w0 is not None:
            return np.argsort(speeds(self.whole))[-count:]
        some = generator.permutation(self.whole.ensemble.size)[:_LOOKED_AT]
        found = speeds(replace(self.whole, ensemble=self.whole.ensemble.take(some)))
        return np.asarray(some[np.argsort(found)[-count:]])

    def safety(self, look: Look, n: int) -> float:
        """How much larger than the sample's the largest error of all bodies is; inf with a flag.

        As many of the others as a fraction of a second allows, most of them the hardest, are run
        with this step and with a smaller one in double precision: what that changes is compared
        with that in the sample.
        Bodies not looked at continue the tail of those that were (Hill, Ann. Stat. 3 (1975) 1163),
        but where those by chance change half as much as the hardest at most.
        """
        steps = n // self.divide
        better = look.case._replace(dtype="float64")
        more = 2 * steps if look.order else steps
        each = (look.fixed + (steps + more) * look.slope) / self.whole.ensemble.size
        count = int(_VERIFYING / max(each, 1e-12)) if (better, more) != (look.case, steps) else 0
        if not self.others.size or count < min(self.others.size, self.sampled):
            return self.unseen
        hardest, easier = np.split(self.others, [3 * count // 4])
        every = max(1, -(-easier.size // max(1, count - hardest.size)))
        seen = np.concatenate([hardest, easier[::every]])
        problem = replace(self.problem, ensemble=self.whole.ensemble.take(seen))
        sampled, flagged = changed(self.problem, self.at, (look.case, steps), (better, more))
        rest, others_flagged = changed(problem, self.at, (look.case, steps), (better, more))
        if flagged or others_flagged:
            return math.inf
        factor = max(1.0, float(rest.max() / max(sampled.max(), 1e-300)))
        easy = float(rest[hardest.size :].max(initial=0.0))
        looked_at = seen.size if easy > 0.5 * rest.max() else self.others.size
        missed = (self.whole.ensemble.size - self.sampled) / looked_at
        top = np.sort(np.concatenate([sampled, rest]))[::-1][: max(10, seen.size // 50)]
        index = float(np.mean(np.log(np.maximum(top, 1e-300) / max(top[-1], 1e-300))))
        return 1.05 * factor * min(_UNSEEN, math.pow(missed, index))

    def error(self, look: Look, n: int) -> float:
        """Largest error of the sample, rad, and what the reference may add; inf with a flag."""
        if n not in look.errors:
            look.errors[n] = self._error(look.case, n)
            self.points.append(Point(look.case, n, look.errors[n], look.seconds(n)))
        return look.errors[n]

    def _error(self, case: Case, n: int) -> float:
        steps, part = n // self.divide, 1
        worst: list[float] = []
        own = float(self.known.own_error.max())
        while True:
            every, exact = self.known.beside(steps // part, part)
            problem = replace(self.problem, t_end=self.problem.t_end / part)
            run = problem.run(case, steps // part, every)
            apart = angle_between(run.q[1:], exact).max(axis=1)
            if run.status.any() or not np.isfinite(apart).all():
                return math.inf
            worst.append(float(apart.max()) + own)
            if part == 1 and self.divide > 1:
                end, middle = (max(float(x.max()), own) for x in (apart, apart[: apart.size // 2]))
                grown = float(np.clip(math.log2(end / middle), 1.0, 2.0))
                worst = [end * math.pow(self.divide, grown)]
            # where not every step was looked at, what decays is seen at the beginning
            part *= EARLY
            if every == 1 or steps % part or self.at == "end" or not self.known.fits(1, part):
                return max(worst)

    def unit(self, n: float) -> int:
        """What numbers of steps near n are multiples of.

        Saves fall on steps, and so do many of the times that a reference is known at, and the kinks
        of a history where there are more steps than kinks.
        """
        kinks = intervals(self.problem)
        if 1 < kinks <= n / self.divide:
            return math.lcm(self._unit, kinks * self.divide)
        power = int(math.log2(max(1.0, n / (32.0 * self.divide))))
        return math.lcm(self._unit, self.divide * 2**power)

    def rounded(self, n: float) -> int:
        """Steps that all saves fall on, no fewer than n."""
        unit = self.unit(n)
        return max(1, math.ceil(n / unit - 1e-9)) * unit

    def look(self, case: Case) -> Look:
        """The first look at a case: compile it, an error, its speed."""
        record = case.record
        scene = self.whole.ensemble.scene
        limit = math.inf
        if not (scene.is_constant and record.exact_for_constant):
            limit = record.limit(case.stored_as)
        first = self.rounded(self.turn / (0.98 * limit))
        order = record.order_of(scene.kind)
        found = Look(case, order, first)
        start = first if not order else max(first, self.rounded(max(self.turn / 0.5, 4.0)))
        self.time(found, start)
        self.error(found, start)
        return found

    def _run_steps(self, case: Case, dt: float, n: int) -> float:
        problem = replace(self.timed, t_end=dt * n)
        return best_time(lambda: problem.run(case, n), 2)[0]

    def time(self, look: Look, n: int) -> None:
        """Seconds a step and a call, at the step of n steps."""
        if not look.order:
            every = None if self.n_saves is None else 1
            call = partial(self.timed.run, look.case, self.n_saves or 1, every)
            look.fixed = self.scale * best_time(call, 2)[0]
            return
        dt = self.whole.t_end / n
        few = 16
        while (short := self._run_steps(look.case, dt, few)) < 2e-3 and few < 4096:
            few *= 4
        long = self._run_steps(look.case, dt, 4 * few)
        slope = max(long - short, 0.5 * long) / (3 * few) if long > short else long / (4 * few)
        look.slope = self.scale * slope
        look.fixed = self.scale * max(0.0, short - slope * few)
