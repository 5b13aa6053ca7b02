"""Advice on method, step and precision, measured on a sample of the user's own ensemble."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, torques
from fastatt.arrays import angle_between
from fastatt.engine.pool import default_threads, progress_bar
from fastatt.engine.tiles import WIDTH
from fastatt.ensemble import Ensemble
from fastatt.methods import METHODS
from fastatt.models import Sum
from fastatt.propagate import methods_for
from fastatt.scene import Scene
from fastatt.trade.measure import Case, Problem, best_time, is_flat
from fastatt.trade.reference import Reference, reference, speeds
from fastatt.trade.work_precision import DTYPES, cases_of, duration

# what was on the frontier of some measured scene; those that were not are left out unless named
_USUAL = {
    "rate": ("lie_midpoint", "rk4", "magnus4", "magnus6"),
    "free": ("exact", "strang2", "rk4", "dmv4", "dmv6", "dmv8", "dmv10", "kahan_li8"),
    "torqued": ("strang2", "rk4", "rk8", "suzuki4", "kahan_li6", "kahan_li8"),
}
_BASELINE = Case("rk4")  # which fits every scene
_SINGLE = 1e-6  # rad: nothing is that exact in float32
_FINER = 30.0  # how much better than the tolerance the reference must be
_WORTH = 4.0  # a guessed time this much over the best known is not looked into
_NEAR = 1.5  # times as long as the best: timed again beside it
_CLOSE = 0.06  # of a number of steps: near enough to the least
_LOOKS = 10  # at numbers of steps, a case
_AHEAD = 16.0  # times the steps, from one look to the next: the order may not show yet
_MOST = 3e7  # body-steps of a look, 1 or 2 s
_SCREENING = 0.3  # s to find the bodies with the largest errors
_LOOKED_AT = 65536  # bodies, for the fastest at a given rate
_VERIFYING = 0.5  # s to see whether there are larger ones
_MORE = 1.5  # times the steps: what a run is compared with there
_LONG = 0.04  # s that the sample's steps of 1 rad may take; beyond, errors are extrapolated in time
_HOPELESS = 6.0  # times the guessed work of the best: not even looked at
_TIMED = 8192  # bodies
_STEPS = 640
_SHORT = 0.05  # s: a run that is timed as a whole
_WHOLE = 1.0  # s: a run beside which a call does not count
_WHY = "whose motion magnifies rounding, or where what acts jumps"
_UNSEEN = 1.5  # factor for bodies that nothing was seen of


@dataclass(frozen=True)
class Point:
    """One case at one step: the largest error over the sample (rad), and the time (s) of all."""

    case: Case
    n_steps: int
    error: float
    seconds: float


@dataclass(frozen=True)
class Recommendation:
    """What to run, what to expect of it, and why.

    ``expected_error`` is the largest angle at the end, rad, over the sample, times a factor for
    the bodies that were not in it; ``expected_seconds`` the time of a whole call to ``propagate``.
    ``margin`` is how many times as long the ``runner_up`` takes. ``limited_by`` is "truncation"
    where a smaller step would gain accuracy, "round-off" where it would not, "sampling" where
    the interval of a sampled torque costs more than both. ``curve`` holds all that was measured.
    """

    method: str
    representation: str
    dtype: str
    dt: float
    n_steps: int
    save_every: int | None
    n_threads: int
    expected_error: float
    expected_seconds: float
    runner_up: Point | None
    margin: float | None
    limited_by: str
    tol: float | None
    budget: float | None
    n_bodies: int
    sampled: int
    safety: float
    reference: str
    reference_error: float
    sampling_error: float | None
    extrapolated_from: float | None
    curve: list[Point] = field(repr=False)

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for ``fastatt.propagate``."""
        names = (
            "dt", "n_steps", "method", "representation", "save_every", "dtype", "n_threads"
        )  # fmt: skip
        return {name: getattr(self, name) for name in names}

    def __str__(self) -> str:
        wanted = f"tol {self.tol:g}" if self.tol is not None else f"budget {self.budget:g} s"
        case = Case(self.method, self.representation, self.dtype)
        how = f"{self.n_steps} steps of {self.dt:.6g} s on {self.n_threads} threads"
        seen = f"from {self.sampled} of {self.n_bodies} bodies (safety {self.safety:.2f})"
        lines = [
            f"{case}: {how} ({wanted})",
            f"  error      {self.expected_error:.1e} rad at most, {seen}; limited by "
            + self.limited_by,
            f"  time       {_time(self.expected_seconds)}",
        ]
        if self.runner_up is not None and self.margin is not None:
            up = self.runner_up
            lines.append(
                f"  runner-up  {up.case}, {up.n_steps} steps: {self.margin:.2f} times as long"
            )
        lines.append(f"  reference  {self.reference}, good to {self.reference_error:.1e} rad")
        if self.sampling_error is not None:
            lines.append(f"  sampling   the torque's interval costs {self.sampling_error:.1e} rad")
        if self.extrapolated_from is not None:
            lines.append(f"  errors measured over {self.extrapolated_from:g} s and extrapolated")
        return "\n".join(lines)


def _time(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 0.1 else f"{seconds * 1e3:.3g} ms"


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
    methods: Sequence[str] | None = None,
    representations: Sequence[str] = ("quat",),
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
    Takes a few seconds; where a method was never used with such a scene, 1 to 4 s more to compile.

    Parameters
    ----------
    scene, q0, w0, v0, r0, t0, n_threads : as of :func:`fastatt.propagate`.
    t_end : duration, s, above 0; the steps fill it exactly.
    tol : largest error of any body at the end (and at the saves), rad.
    budget : instead of ``tol``, the longest time that the run may take, s.
    save_interval : s between saves, of which ``t_end`` is a multiple; None for the end alone.
    methods : None takes those that are the cheapest somewhere; ``fastatt.methods_for`` lists all.
    representations, dtypes : what to choose from.
    sample : number of bodies to measure errors on.
    seed : of the choice of bodies.
    progress : show a bar (needs tqdm).

    Returns
    -------
    Recommendation : ``fastatt.propagate(scene, q0, w0, **advice.arguments)`` runs it.

    Raises
    ------
    ValueError : a tolerance or a budget that nothing meets, with what can be reached; any other
        argument that does not fit, by name, with what is accepted. TypeError as well.
    """
    if (tol is None) == (budget is None):
        found = "neither" if tol is None else "both"
        raise ValueError(f"tol, budget: found {found}; accepted: one of them")
    wanted = _above_zero("tol", tol) if tol is not None else _above_zero("budget", budget)
    ensemble = Ensemble.of(scene, q0, w0, v0, r0)
    whole = Problem(ensemble, duration(t_end), checks.real("t0", t0), n_threads)
    n_saves = _saves(whole.t_end, save_interval)
    fitting = methods_for(scene)
    usual = [m for m in _usual(scene) if m in fitting] if methods is None else methods
    cases = cases_of(scene, usual, representations, dtypes)
    if tol is not None and methods is None:
        cases = _hopeful(cases, tol)
    search = _Search(
        whole,
        save_interval is not None,
        n_saves,
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
        m = METHODS[case.method]
        return max(1, m.rate_calls + m.exponentials) * tol ** (-1.0 / m.order) if m.order else 1.0

    stepped = [c for c in cases if METHODS[c.method].order]
    least = min(map(work, stepped), default=1.0)
    kept = [c for c in cases if work(c) <= _HOPELESS * least]
    return [c for c in kept if c.dtype == "float64" or tol >= _SINGLE] or kept


def _rounds(cases: Sequence[Case]) -> list[list[Case]]:
    """Closed forms, then steps in double precision, then in single."""
    closed = [c for c in cases if not METHODS[c.method].order]
    stepped = [c for c in cases if METHODS[c.method].order]
    kinds = [[c for c in stepped if c.dtype == dtype] for dtype in DTYPES]
    return [some for some in (closed, *kinds) if some]


def _above_zero(name: str, value: Any) -> float:
    number = checks.real(name, value)
    if number <= 0.0:
        raise ValueError(f"{name}: found {number}; accepted: a number above 0")
    return number


def _saves(t_end: float, interval: float | None) -> int:
    if interval is None:
        return 1
    every = _above_zero("save_interval", interval)
    n = round(t_end / every)
    if n < 1 or abs(n * every - t_end) > 1e-9 * t_end:
        raise ValueError(
            f"save_interval: found {every}; accepted: t_end, {t_end}, over a whole number"
        )
    return n


def _usual(scene: Scene) -> tuple[str, ...]:
    return _USUAL[scene.kind if scene.kind in _USUAL else "free"]


@dataclass
class _Look:
    """What is known of one case: errors by number of steps, seconds a step and a call."""

    case: Case
    order: int
    first: int
    errors: dict[int, float] = field(default_factory=dict)
    slope: float = 0.0
    fixed: float = 0.0

    def seconds(self, n: float) -> float:
        return self.fixed + self.slope * n

    def steps_for(self, tol: float) -> float:
        """A guess at the steps that meet a tolerance, by the declared order from the best look."""
        n, error = min(self.errors.items(), key=lambda look: abs(math.log(look[1] / tol)))
        if not self.order:
            return n
        return n * 4.0 if error > 1.0 else n * (error / tol) ** (1.0 / self.order)


def _pace(problem: Problem) -> float:
    """Seconds a step of the baseline, of a run that outweighs the call."""
    few = replace(problem, t_end=problem.t_end / 1e3)
    return best_time(lambda: few.run(_BASELINE, _STEPS), 2)[0] / _STEPS


class _Search:
    """A sample, its reference, and a clock."""

    def __init__(
        self,
        whole: Problem,
        saved: bool,
        n_saves: int,
        sample: int,
        generator: np.random.Generator,
        goal: float,
    ) -> None:
        self.whole, self.saved, self.n_saves = whole, saved, n_saves
        self.points: list[Point] = []
        rows, self._others = self._choose(sample, generator)
        problem = replace(whole, ensemble=whole.ensemble.take(rows))
        self.turn = float(speeds(problem).max()) * problem.t_end
        pace = _pace(problem)
        long = float(np.clip(_LONG / pace, 200.0, 2e4))
        self.divide = 2 ** max(0, math.ceil(math.log2(max(self.turn, 1.0) / long)))
        self.watched = next(k for k in range(16, 0, -1) if n_saves % k == 0)
        self.unit = n_saves
        if self.divide > 1:
            self.watched, self.unit = 2, math.lcm(n_saves, 2 * self.divide)
        self.problem = replace(problem, t_end=problem.t_end / self.divide)
        self.known: Reference = reference(
            self.problem, n_saves=self.watched, goal=goal / self.divide
        )
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
        return self.problem.ensemble.size

    @property
    def _unseen(self) -> float:
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
        pace = _pace(some) / size
        pool = generator.permutation(n)[: max(size, int(_SCREENING / (3 * steps * pace)))]
        if pool.size < n:
            fastest = self._fastest(generator, pool.size // 2)
            pool = np.unique(np.concatenate([fastest, pool[: pool.size - fastest.size]]))
        problem = replace(self.whole, ensemble=self.whole.ensemble.take(pool))
        if pool.size >= 4 * size:
            ends = [problem.end(_BASELINE, k * steps).q for k in (1, 2)]
            hardness = np.nan_to_num(angle_between(*ends), nan=np.pi)
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

    def _safety(self, look: _Look, n: int) -> float:
        """How much larger than the sample's the largest error of all bodies is; inf with a flag.

        As many of the others as a fraction of a second allows, most of them the hardest, are run
        with this step and with a smaller one in double precision: what that changes is compared
        with that in the sample.
        Bodies not looked at continue the tail of those that were (Hill, Ann. Stat. 3 (1975) 1163),
        but where those by chance change half as much as the hardest at most.
        """
        if self.sampled == self.whole.ensemble.size:
            return self._unseen
        steps = n // self.divide
        better = look.case._replace(dtype="float64")
        more = math.ceil(_MORE * steps) if look.order else steps
        each = (look.fixed + (steps + more) * look.slope) / self.whole.ensemble.size
        count = int(_VERIFYING / max(each, 1e-12)) if (better, more) != (look.case, steps) else 0
        if not self._others.size or count < min(self._others.size, self.sampled):
            return self._unseen
        hardest, easier = np.split(self._others, [3 * count // 4])
        every = max(1, -(-easier.size // max(1, count - hardest.size)))
        seen = np.concatenate([hardest, easier[::every]])
        problem = replace(self.problem, ensemble=self.whole.ensemble.take(seen))
        changed = []
        for some in (self.problem, problem):
            runs = [some.run(look.case, steps), some.run(better, more)]
            if runs[0].status.any():
                return math.inf
            apart = angle_between(runs[0].q[-1], runs[1].q[-1])
            changed.append(np.nan_to_num(apart, nan=np.pi))
        sampled, rest = changed
        factor = max(1.0, float(rest.max() / max(sampled.max(), 1e-300)))
        easy = float(rest[hardest.size :].max(initial=0.0))
        looked_at = seen.size if easy > 0.5 * rest.max() else self._others.size
        missed = (self.whole.ensemble.size - self.sampled) / looked_at
        top = np.sort(np.concatenate(changed))[::-1][: max(10, seen.size // 50)]
        index = float(np.mean(np.log(np.maximum(top, 1e-300) / max(top[-1], 1e-300))))
        return 1.05 * factor * min(_UNSEEN, math.pow(missed, index))

    def error(self, look: _Look, n: int) -> float:
        """Largest error of the sample, rad, and what the reference may add; inf with a flag."""
        if n not in look.errors:
            look.errors[n] = self._error(look.case, n)
            self.points.append(Point(look.case, n, look.errors[n], look.seconds(n)))
        return look.errors[n]

    def _error(self, case: Case, n: int) -> float:
        steps = n // self.divide
        run = self.problem.run(case, steps, steps // self.watched)
        apart = angle_between(run.q[1:], self.known.states.q).max(axis=1)
        if run.status.any() or not np.isfinite(apart).all():
            return math.inf
        own = float(self.known.own_error.max())
        if self.divide == 1:
            return float(apart.max()) + own
        middle, end = np.maximum(apart, own)
        grown = float(np.clip(math.log2(end / middle), 1.0, 2.0))
        return float(end) * math.pow(self.divide, grown)

    def rounded(self, n: float) -> int:
        return max(1, math.ceil(n / self.unit - 1e-9)) * self.unit

    def look(self, case: Case) -> _Look:
        """The first look at a case: compile it, an error, its speed."""
        record = METHODS[case.method]
        scene = self.whole.ensemble.scene
        limit = math.inf
        if not (scene.is_constant and record.exact_for_constant):
            limit = record.limit(case.representation)
        first = self.rounded(self.turn / (0.98 * limit))
        order = record.order_of(scene.kind)
        found = _Look(case, order, first)
        start = first if not order else max(first, self.rounded(max(self.turn / 0.5, 4.0)))
        self._time(found, start)
        self.error(found, start)
        return found

    def _run_steps(self, case: Case, dt: float, n: int) -> float:
        problem = replace(self.timed, t_end=dt * n)
        return best_time(lambda: problem.run(case, n), 2)[0]

    def _time(self, look: _Look, n: int) -> None:
        """Seconds a step and a call, at the step of n steps."""
        if not look.order:
            every = None if not self.saved else 1
            problem = self.timed
            look.fixed = best_time(lambda: problem.run(look.case, self.n_saves, every), 2)[0]
            look.fixed *= self.scale
            return
        dt = self.whole.t_end / n
        few = 16
        while (short := self._run_steps(look.case, dt, few)) < 2e-3 and few < 4096:
            few *= 4
        long = self._run_steps(look.case, dt, 4 * few)
        slope = max(long - short, 0.5 * long) / (3 * few) if long > short else long / (4 * few)
        look.slope = self.scale * slope
        look.fixed = self.scale * max(0.0, short - slope * few)

    def least(self, look: _Look, tol: float, best: float) -> int | None:
        """The least number of steps that meets the tolerance, near enough; None where none can."""
        if not look.order:
            n = min(look.errors)
            return n if look.errors[n] <= tol else None
        for _ in range(_LOOKS):
            bad = max((n for n, e in look.errors.items() if e > tol), default=0)
            good = min((n for n, e in look.errors.items() if e <= tol and n > bad), default=None)
            if good is not None and (
                good <= look.first or good - bad <= max(self.unit, _CLOSE * good)
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

    def _next(self, look: _Look, tol: float, bad: int, good: int | None) -> int | None:
        """The next number of steps to look at."""
        tried = sorted(look.errors)
        near = tried[-2:] if good is None else [n for n in tried if n >= bad][:2]
        a, b = near[0], near[-1]
        ea, eb = look.errors[a], look.errors[b]
        p = float(look.order)
        if a != b and 0.0 < eb < ea < math.inf:
            p = float(np.clip(math.log(ea / eb) / math.log(b / a), 0.5 * p, 2.0 * p))
        if good is None:
            if a != b and b >= 1.4 * a and is_flat(look.case, look.order, (a, ea), (b, eb)):
                return None
            if eb > 0.5:
                return self.rounded(2.0 * b)
            ahead = self.rounded(1.02 * b * min((eb / tol) ** (1.0 / p), _AHEAD))
            return max(ahead, b + self.unit)
        error = look.errors[good]
        back = 1.02 * good * (error / tol) ** (1.0 / p)
        if bad == 0:
            return min(self.rounded(max(back, look.first, good // 8)), good - self.unit)
        # between the two, away from either
        apart = 0.25 * (good - bad)
        n = self.rounded(min(max(back, bad + apart), good - apart))
        return min(n, good - self.unit)

    def cheapest(self, cases: Sequence[Case], tol: float, done: Any) -> Recommendation:
        """The case that meets the tolerance in the shortest time."""
        self._check_reference(tol)
        within = tol / 1.1 if self.sampled < self.whole.ensemble.size else tol
        met: list[tuple[_Look, int]] = []
        best = math.inf

        def guess(look: _Look) -> float:
            return look.seconds(look.steps_for(within))

        looks: list[_Look] = []
        for some in _rounds(cases):
            # in single precision a method is no more than some 2.5 times as fast
            slow = {
                look.case._replace(dtype="float32") for look in looks if guess(look) > 2.5 * best
            }
            stepped = best > self.least_seconds
            new = [
                self.look(case)
                for case in some
                if case not in slow and (stepped or not METHODS[case.method].order)
            ]
            looks += new
            done(2 * len(some))
            for look in sorted(new, key=guess):
                if guess(look) > _WORTH * best:
                    continue
                n = self.least(look, within, best)
                if n is not None:
                    met.append((look, n))
                    best = min(best, look.seconds(n))
        met.sort(key=lambda found: found[0].seconds(found[1]))
        sure: list[tuple[_Look, int, float]] = []
        for look, n in met[:3]:
            if sure and look.seconds(n) > _NEAR * sure[0][0].seconds(sure[0][1]):
                sure.append((look, n, self._unseen))  # which is not what will be run
            elif found := self._sure(look, n, tol):
                sure.append(found)
        if not sure:
            raise ValueError(f"tol: found {tol:g}; {self._reachable(looks)}")
        return self._advise(sure, tol=tol)

    def _sure(self, look: _Look, n: int, tol: float) -> tuple[_Look, int, float] | None:
        """Steps that are enough for the bodies outside the sample too, and their safety."""
        for _ in range(_LOOKS):
            safety = self._safety(look, n)
            error = safety * self.error(look, n)
            if error <= tol:
                return look, n, safety
            if not look.order:
                return None
            more = 1.3 if error == math.inf else 1.01 * (error / tol) ** (1.0 / look.order)
            further = max(self.rounded(min(more, _AHEAD) * n), n + self.unit)
            if self._too_long(further):
                return None
            before = (n, look.errors[n])
            n = further
            if is_flat(look.case, look.order, before, (n, self.error(look, n))):
                return None
        return None

    def most_accurate(self, cases: Sequence[Case], budget: float, done: Any) -> Recommendation:
        """The case of least error within the time; of those within twice that, the cheapest."""
        met: list[tuple[_Look, int]] = []
        looks: list[_Look] = []
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
                    met.append((look, n))
                    least = min(least, look.errors[n])
        if not met:
            fastest = min(looks, key=lambda look: look.seconds(look.first))
            raise ValueError(
                f"budget: found {budget:g} s; accepted: at least the "
                f"{_time(fastest.seconds(fastest.first))} that {fastest.case} takes in "
                f"{fastest.first} steps"
            )
        sure = [
            (look, n, self._safety(look, n)) for look, n in met if look.errors[n] <= 2.0 * least
        ]
        return self._advise(sure, budget=budget)

    def _within(self, look: _Look, budget: float, least: float) -> int | None:
        """The number of steps with the least error that the time allows, if that may be least."""
        most = look.first
        if look.order:
            most = int((0.95 * budget - look.fixed) / look.slope) // self.unit * self.unit
        if most < look.first or look.seconds(most) > budget:
            return None
        n = min(look.errors)
        if n > most:
            self.error(look, most)
        while look.order and n < most:
            if look.errors[n] < 1.0 and look.errors[n] * (n / most) ** look.order > 4.0 * least:
                return None
            further = min(most, 2 * n)
            if is_flat(
                look.case,
                look.order,
                (n, look.errors[n]),
                (further, self.error(look, further)),
            ):
                break
            n = further
        allowed = {n: e for n, e in look.errors.items() if n <= most and e < math.inf}
        return min(allowed, key=lambda n: allowed[n]) if allowed else None

    def _check_reference(self, tol: float) -> None:
        own = float(self.known.own_error.max()) * self.divide
        if own > 0.25 * tol:
            raise ValueError(
                f"tol: found {tol:g}; accepted: at least {4.0 * own:.1e}: {self.known.source}, the "
                f"reference, is good to {own:.1e} rad of some body, {_WHY}"
            )

    def _reachable(self, looks: Sequence[_Look]) -> str:
        tried = [(e, n, look) for look in looks for n, e in look.errors.items()]
        error, n, look = min(tried, key=lambda found: found[0])
        return f"accepted: what can be reached, {error:.1e} rad by {look.case} in {n} steps, {_WHY}"

    def _advise(
        self,
        met: list[tuple[_Look, int, float]],
        tol: float | None = None,
        budget: float | None = None,
    ) -> Recommendation:
        """Time the best again, side by side, and say what limits the first of them."""
        met.sort(key=lambda found: found[0].seconds(found[1]))
        close = [f for f in met if f[0].seconds(f[1]) < _NEAR * met[0][0].seconds(met[0][1])]
        threads = self.whole.n_threads or default_threads()
        threads = max(1, min(threads, -(-self.whole.ensemble.size // WIDTH)))
        timed = {id(look): math.inf for look, _, _ in close}
        long = met[0][0].seconds(met[0][1]) > _WHOLE
        for _ in range(1 if long else 2):  # they take turns
            for look, n, _ in close:
                timed[id(look)] = min(timed[id(look)], self._clock(look, n))
        # what was not timed beside the best was not made sure of either
        met.sort(
            key=lambda found: (
                id(found[0]) not in timed,
                timed.get(id(found[0]), found[0].seconds(found[1])),
            )
        )
        look, n, safety = met[0]
        seconds = timed.get(id(look), look.seconds(n))
        while budget is not None and seconds > budget and look.order:
            less = self.rounded(0.9 * n * budget / seconds) - self.unit
            if less < look.first:
                break
            n, safety = less, self._safety(look, less)
            self.error(look, n)
            seconds = self._clock(look, n)
        if self.whole.n_threads is None and threads > 1 and seconds < 5e-3:
            alone = self._clock(look, n, 1)
            if alone < seconds:
                threads, seconds = 1, alone
        up = None
        if len(met) > 1:
            other, m, factor = met[1]
            taken = timed.get(id(other), other.seconds(m))
            up = Point(other.case, m, factor * other.errors[m], taken)
        error = safety * look.errors[n]
        sampling = self._sampling_error()
        limit = self._limit(look, n)
        if sampling is not None and sampling > error:
            limit = "sampling"
        return Recommendation(
            method=look.case.method,
            representation=look.case.representation,
            dtype=look.case.dtype,
            dt=self.whole.t_end / n,
            n_steps=n,
            save_every=n // self.n_saves if self.saved else None,
            n_threads=threads,
            expected_error=error,
            expected_seconds=seconds,
            runner_up=up,
            margin=None if up is None else up.seconds / seconds,
            limited_by=limit,
            tol=tol,
            budget=budget,
            n_bodies=self.whole.ensemble.size,
            sampled=self.sampled,
            safety=safety,
            reference=self.known.source,
            reference_error=float(self.known.own_error.max()),
            sampling_error=sampling,
            extrapolated_from=self.problem.t_end if self.divide > 1 else None,
            curve=self.points,
        )

    def _clock(self, look: _Look, n: int, threads: int | None = None) -> float:
        """Seconds of the whole call: measured where it is short, else from fewer steps."""
        every = n // self.n_saves if self.saved else None
        threads = self.whole.n_threads if threads is None else threads
        whole = replace(self.whole, n_threads=threads)
        if look.seconds(n) < _SHORT:
            return best_time(lambda: whole.run(look.case, n, every), 2)[0]
        if not look.order:
            return look.seconds(n)
        self._time(look, n)
        one = replace(whole, t_end=whole.t_end / n)
        once = best_time(lambda: one.run(look.case, 1), 1)[0]
        return once + look.slope * (n - 1)

    def _limit(self, look: _Look, n: int) -> str:
        if not look.order:
            return "round-off"
        finer = self.error(look, 2 * n)
        return "round-off" if finer > look.errors[n] * 0.5 ** (0.5 * look.order) else "truncation"

    def _sampling_error(self) -> float | None:
        """What the interval of a sampled torque costs: linear between samples, of order 2."""
        scene = self.whole.ensemble.scene
        coarse = _decimated(scene.torque)
        if coarse is None:
            return None
        fewer = replace(self.problem.ensemble, scene=replace(self._scene, torque=coarse))
        problem = replace(self.problem, ensemble=fewer)
        apart = angle_between(reference(problem).end.q, self.known.end.q)
        return float(apart.max()) / 3.0

    @cached_property
    def _scene(self) -> Scene:
        return self.problem.ensemble.scene


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
