"""Per-body step sizes for a tolerance, from the bodies' rates and from runs of a sample."""

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
from fastatt.trade.work_precision import name_of, problem_over

_CLASSES = 12  # classes of similar rates
_TIMES, _EARLY = 64, 8  # times at which errors are measured: equally spaced, and early ones
_FIRST = 0.3  # rotation angle of a step in the first trial, rad
_TRIALS, _LESS = 14, 6  # the most trials, and the most after one has met the tolerance
_GAIN = 0.95  # another trial is made if it may need fewer than this share of the steps
_FINEST = 1e-15  # rad
_ROUNDED = 1e-6  # rad; a larger error that does not fall with the step is not rounding
_FINER = 30.0  # ratio of the tolerance and the reference's error
_UNSEEN = 1.5  # margin of errors below the tolerance if some bodies are not run
_AIM = 0.8  # share of the tolerance at which a trial aims


@dataclass(frozen=True)
class PerBodySteps:
    """Per-body step sizes and numbers of steps, as :func:`per_body_steps` finds them.

    Attributes
    ----------
    method : str or Method
        The method.
    dt : ndarray of shape (N,)
        Step sizes, s.
    n_steps : ndarray of shape (N,)
        Numbers of steps.
    t0 : float
        Time of the initial state, s.
    expected_error : float
        Largest error, rad, of the bodies that were run with these steps, at 64 equally spaced times
        and 8 early ones. It includes the error of the reference.
    measured : int
        Number of bodies that were run.
    n_bodies : int
        Number of bodies.
    reference : str
        The reference of the errors.
    share : float
        The number of all steps divided by that with the smallest step size for all bodies.
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
        """Keyword arguments for :func:`fastatt.propagate`."""
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
    rng: int | np.random.Generator = 0,
) -> PerBodySteps:
    """Find per-body step sizes for which the largest error over a run meets a tolerance.

    It takes as long as some tens of runs of the sample.

    Parameters
    ----------
    scene : Scene
        A scene with inertia.
    q0 : array_like of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`fastatt.propagate`.
    w0 : array_like of shape (3,) or (N, 3)
        Initial angular velocities along body axes, rad/s.
    t_end : float
        Duration, s, above 0.
    tol : float
        Largest error of a body over the run, rad, at least 1e-15. If not all bodies are run, those
        that are stay below it by a factor of 1.5, and others can exceed it.
    method : str or Method, optional
        A method that takes steps. The default is rk8, or else the first that fits.
    v0 : array_like of shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s.
    r0 : array_like of shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m.
    s0 : array_like of shape (n,) or (N, n), optional
        Initial values of the scene's states.
    t0 : float, default 0.0
        Time of the initial state, s.
    sample : int, default 1536
        Number of bodies that are run, the fastest among them, in addition to those with the
        smallest and the largest of each number of the scene.
    rng : int or numpy.random.Generator, default 0
        Random generator, or a seed for one, which chooses bodies.

    Returns
    -------
    PerBodySteps
        ``fastatt.propagate(scene, q0, w0, **steps.arguments)`` runs them.

    Raises
    ------
    ValueError, TypeError
        If a torque jumps, as in :func:`fastatt.recommend`, if the method cannot meet the tolerance,
        or if an argument does not fit.

    Notes
    -----
    Bodies are grouped into classes of similar rates. Some of each class are run with the steps that
    would be recommended, and their errors are measured against a reference, until none is above the
    tolerance. The number of steps of a body is the smaller of two numbers that suffice for the
    bodies of its class that were run: one for the class, and one that falls with the rate to the
    power 1 + 1/order. Bodies that are stepped together take the largest of their numbers.

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
    whole = problem_over(ensemble, t_end, t0)
    wanted = checks.real("tol", tol)
    if not wanted >= _FINEST:
        raise ValueError(f"tol: found {tol}; accepted: at least {_FINEST}, less is rounding")
    record = method_of(scene, method, "quat", need="is_stepped")
    n = whole.ensemble.size
    classes = _Classes(whole, record)
    rows = classes.sample(checks.whole("sample", sample, 1), np.random.default_rng(rng))
    rows = np.union1d(rows, ensemble.extremes)
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
    """Bodies in classes of similar rates, so that the few fastest are in separate classes."""

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
        #: the steps that a body's rate requires, as a share of those of its class's fastest body
        self.share = (self.rates / tops[self.of]) ** power
        limit = method.limit("quat", body=True, torqued=kind == "torqued")
        self.least = np.maximum(1.0, self.rates * whole.t_end / limit)
        self.first = np.maximum(4.0, tops[self.of] * whole.t_end / _FIRST)

    def sample(self, n: int, chance: np.random.Generator) -> NDArray[np.intp]:
        """Equally many bodies of each class, n in all, with the fastest of all; or all bodies."""
        if n >= self.of.size:
            return np.arange(self.of.size)
        classes = [np.flatnonzero(self.of == k) for k in np.unique(self.of)]
        each = max(1, n // len(classes))
        chosen = [chance.choice(k, min(each, k.size), replace=False) for k in classes]
        return np.unique(np.append(np.concatenate(chosen), self.rates.argmax()))

    def steps(self, rows: NDArray[np.intp], wanted: NDArray[np.float64]) -> NDArray[np.float64]:
        """Steps that suffice for all bodies, from those that some rows need."""
        flat, rising = np.zeros((2, _CLASSES))
        np.maximum.at(flat, self.of[rows], wanted)
        np.maximum.at(rising, self.of[rows], wanted / self.share[rows])
        found = np.minimum(flat[self.of], rising[self.of] * self.share)
        return np.asarray(np.maximum(found, self.least))


def _by_tiles(enough: NDArray[np.float64]) -> NDArray[np.int64]:
    """Whole numbers of steps, equal for the bodies of a tile, which run together."""
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
    """The smallest numbers of steps that met the tolerance in a run, with their largest error."""
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
        # rounding: with more steps a truncation error would fall
        if best is None and trial > 2 and 0.7 * before < worst < _ROUNDED:
            break
        before = worst
        # neither large errors nor rounding errors have an order
        change = np.where(errors > LARGE, 2.0, (errors / (_AIM * tol)) ** (1.0 / order))
        enough = classes.steps(
            rows, np.maximum(steps[rows] * np.minimum(change, 8.0), 0.5 * enough[rows])
        )
    if best is None:
        raise _unmet(tol, case.record, errors)
    return best
