"""Per-body step sizes for a tolerance, by the bodies' rates and what runs of some showed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.engine.loop import WIDTH
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import method_of
from fastatt.propagation.ensemble import Ensemble
from fastatt.scene.rates import lengths
from fastatt.scene.scene import Scene, as_scene
from fastatt.trade.ladder import LARGE, largest_angle, times_compared
from fastatt.trade.measure import Case, Problem
from fastatt.trade.reference import Reference, reference
from fastatt.trade.work_precision import duration, name_of

_CLASSES = 12  # of like rates
_TIMES, _EARLY = 64, 8  # at which errors are measured: even ones, and halves of the first of them
_FIRST = 0.3  # rad a step of the first trial
_TRIALS, _LESS = 14, 6  # runs at most, and how many where one has met the tolerance
_GAIN = 0.95  # of the steps: less is worth another trial
_FINEST = 1e-15  # rad
_ROUNDED = 1e-6  # rad: an error above, which more steps do not bring down, is no rounding
_FINER = 30.0  # how much better than the tolerance the reference must be
_UNSEEN = 1.5  # what errors are below the tolerance, where some bodies are not run
_AIM = 0.8  # of the tolerance, from which a trial's steps are set


@dataclass(frozen=True)
class PerBodySteps:
    """A step and a number of steps for each body, (N,), and what a run with them showed.

    ``expected_error`` is the largest error over the run, rad, of the ``measured`` bodies of all
    ``n_bodies`` that were run with these steps, against ``reference``, whose own error is in it.
    ``share`` is the number of steps divided by that of one step, the smallest, for all.
    """

    method: str | Method
    dt: NDArray[np.float64] = field(repr=False)
    n_steps: NDArray[np.int64] = field(repr=False)
    t0: float
    expected_error: float
    measured: int
    n_bodies: int
    reference: str
    share: float

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for ``fastatt.propagate``."""
        return {"method": self.method, "dt": self.dt, "n_steps": self.n_steps, "t0": self.t0}

    def __str__(self) -> str:
        name = self.method if isinstance(self.method, str) else self.method.name
        return (
            f"{name}: {self.n_steps.min()} to {self.n_steps.max()} steps, {self.share:.2f} of the "
            f"steps of one dt for all; error {self.expected_error:.1e} rad at most, measured over "
            f"{self.measured} of {self.n_bodies} bodies against {self.reference}"
        )


def per_body_steps(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike,
    *,
    t_end: float,
    tol: float,
    method: str | Method | None = None,
    v0: ArrayLike | None = None,
    r0: ArrayLike | None = None,
    s0: ArrayLike | None = None,
    t0: float = 0.0,
    sample: int = 1536,
    seed: int = 0,
) -> PerBodySteps:
    """Per-body step sizes with which the largest error over a run meets a tolerance.

    Bodies are put into classes of like rates. Some of each are run with the steps that would be
    recommended, and their errors measured against a reference, until none is over the tolerance. A
    body takes the lesser of two numbers that are enough for all of its class that were run: one for
    the class, and one that falls with the rate to the power 1 + 1/order; those that are stepped
    together take the most of their numbers. Takes as long as some tens of runs of the sample.

    Parameters
    ----------
    scene, q0, w0, v0, r0, s0, t0 : as of :func:`fastatt.propagate`, of a scene with inertia.
    t_end : float
        Duration, s, above 0.
    tol : float
        Largest error of a body over the run, rad, at least 1e-15. Where not all bodies are run,
        those that are stay below it by a factor of 1.5, and others can exceed it.
    method : str or Method
        One that steps; None takes rk8 where it fits, else the first that does.
    sample : int
        How many bodies are run, the fastest among them, and in addition those with the least
        and the largest of each number of the scene.
    seed : int
        Of the choice of bodies.

    Returns
    -------
    PerBodySteps
        ``fastatt.propagate(scene, q0, w0, **steps.arguments)`` runs them.

    Raises
    ------
    ValueError, TypeError
        A torque that jumps, as of :func:`fastatt.recommend`; a tolerance that the method cannot
        meet; any other argument that does not fit, by name, with what is accepted.

    Examples
    --------
    >>> import fastatt as fa, numpy as np
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> w0 = np.geomspace(0.1, 10.0, 500)[:, None] * (0.6, 0.0, 0.8)
    >>> steps = fa.per_body_steps(scene, (1, 0, 0, 0), w0, t_end=10.0, tol=1e-6, method="rk4")
    >>> run = fa.propagate(scene, (1, 0, 0, 0), w0, **steps.arguments)
    >>> steps.share < 0.3
    True
    """
    if as_scene(scene).kind == "rate":
        raise ValueError("scene: found a rate; accepted: with inertia")
    ensemble = Ensemble.of(scene, q0, w0, v0, r0, s0)
    whole = Problem(ensemble, duration(t_end), checks.real("t0", t0))
    wanted = checks.real("tol", tol)
    if not wanted >= _FINEST:
        raise ValueError(f"tol: found {tol}; accepted: at least {_FINEST}, less is rounding")
    record = method_of(scene, method, "quat", need="is_stepped")
    n = whole.ensemble.size
    classes = _Classes(whole, record)
    rows = classes.sample(checks.whole("sample", sample, 1), np.random.default_rng(seed))
    if rows.size < n and scene.rows is not None:
        numbers = scene.packed(n).params
        rows = np.unique([*rows, *numbers.argmin(axis=0), *numbers.argmax(axis=0)])
    problem = whole.take(rows)
    known = reference(problem, most=times_compared("run", rows.size), goal=wanted / _FINER)
    known.refuse_jumps()
    if float(known.own_error.max()) > 0.25 * wanted and not known.doubt:
        raise _unmet(wanted, record, known.own_error)
    known.refuse_beyond(wanted)
    name = name_of(record, METHODS)
    limit = wanted if rows.size == n else wanted / _UNSEEN
    steps, error = _trials(problem, known, Case(name), classes, rows, limit)
    return PerBodySteps(
        name, whole.t_end / steps, steps, whole.t0, error, rows.size, n, known.source,
        float(steps.mean() / steps.max()),
    )  # fmt: skip


def _unmet(tol: float, method: Method, errors: NDArray[np.float64]) -> ValueError:
    return ValueError(
        f"tol: found {tol}; accepted: what {method.name} can meet, errors stay at "
        f"{errors.max():.1e} rad"
    )


class _Classes:
    """Bodies of like rates: equal ratios, so that the few fastest are not among the many slow."""

    def __init__(self, whole: Problem, method: Method) -> None:
        n = whole.ensemble.size
        rates = lengths(np.broadcast_to(np.asarray(whole.ensemble.w0, dtype=np.float64), (n, 3)))
        self.rates = np.maximum(rates, rates.max(initial=0.0) * 1e-6 + 1e-300)
        logs = np.log(self.rates)
        width = max(float(np.ptp(logs)), 1e-12) / _CLASSES
        self.of = np.minimum((logs - logs.min()) / width, _CLASSES - 1).astype(np.int64)
        tops = np.zeros(_CLASSES)
        np.maximum.at(tops, self.of, self.rates)
        kind = whole.ensemble.scene.kind
        power = 1.0 + 1.0 / method.order_of(kind)
        #: of the steps of the fastest body of the class, what a body's rate calls for
        self.share = (self.rates / tops[self.of]) ** power
        limit = method.limit("quat", body=True, torqued=kind == "torqued")
        self.least = np.maximum(1.0, self.rates * whole.t_end / limit)
        self.first = np.maximum(4.0, tops[self.of] * whole.t_end / _FIRST)

    def sample(self, n: int, chance: np.random.Generator) -> NDArray[np.intp]:
        """As many of each, n in all, the fastest of all among them; all if there are no more."""
        if n >= self.of.size:
            return np.arange(self.of.size)
        classes = [np.flatnonzero(self.of == k) for k in np.unique(self.of)]
        each = max(1, n // len(classes))
        chosen = [chance.choice(k, min(each, k.size), replace=False) for k in classes]
        return np.unique(np.append(np.concatenate(chosen), self.rates.argmax()))

    def steps(self, rows: NDArray[np.intp], wanted: NDArray[np.float64]) -> NDArray[np.float64]:
        """Steps that are enough for all bodies, from what those of some rows want."""
        flat, rising = np.zeros((2, _CLASSES))
        np.maximum.at(flat, self.of[rows], wanted)
        np.maximum.at(rising, self.of[rows], wanted / self.share[rows])
        found = np.minimum(flat[self.of], rising[self.of] * self.share)
        return np.asarray(np.maximum(found, self.least))


def _by_tiles(enough: NDArray[np.float64]) -> NDArray[np.int64]:
    """Whole steps, equal for the bodies of a tile, which wait for the slowest of them anyway."""
    steps: NDArray[np.int64] = np.ceil(enough - 1e-9).astype(np.int64)
    order = np.argsort(-steps, kind="stable")
    steps[order] = np.repeat(steps[order[::WIDTH]], WIDTH)[: steps.size]
    return steps


def _trials(
    problem: Problem,
    known: Reference,
    case: Case,
    classes: _Classes,
    rows: NDArray[np.intp],
    tol: float,
) -> tuple[NDArray[np.int64], float]:
    """The fewest steps that were run and met the tolerance, with their largest error."""
    even = problem.t_end * np.arange(1, _TIMES + 1) / _TIMES
    times = np.concatenate([even[0] * 0.5 ** np.arange(_EARLY, 0, -1), even])
    exact, order = known.at(times), case.record.order_of(problem.ensemble.scene.kind)
    enough = classes.steps(rows, classes.first[rows])
    best: tuple[NDArray[np.int64], float] | None = None
    errors, before = np.zeros(rows.size), math.inf
    for trial in range(_TRIALS):
        steps = _by_tiles(enough)
        run = problem.run(case, steps[rows], save_at=problem.t0 + times)
        errors = largest_angle(run.q, exact) + known.own_error
        errors = np.where(run.status != 0, np.pi, errors)
        worst = float(errors.max())
        met = worst <= tol
        gained = met and (best is None or steps.sum() < _GAIN * best[0].sum())
        if gained:
            best = steps, worst
        if best is not None and (trial >= _LESS or (met and not gained)):
            break
        # rounding: with more steps no method of any order leaves nearly as much
        if best is None and trial > 2 and 0.7 * before < worst < _ROUNDED:
            break
        before = worst
        # of large errors there is no order yet, and of those that rounding makes none either
        change = np.where(errors > LARGE, 2.0, (errors / (_AIM * tol)) ** (1.0 / order))
        enough = classes.steps(
            rows, np.maximum(steps[rows] * np.minimum(change, 8.0), 0.5 * enough[rows])
        )
    if best is None:
        raise _unmet(tol, case.record, errors)
    return best
