"""Per-body step sizes for a tolerance, from runs of a sample of the bodies."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import method_of
from fastatt.propagation.ensemble import Ensemble
from fastatt.scene.scene import Scene, as_scene
from fastatt.trade.ladder import LARGE, largest_angle, times_compared
from fastatt.trade.measure import Case, Problem
from fastatt.trade.reference import Reference, reference, speeds
from fastatt.trade.search import FINER, UNSEEN
from fastatt.trade.work_precision import name_of, problem_over

_SIZES = 16  # the most different step sizes
_LEAST = 4  # steps
_FIRST = 0.3  # rotation angle of a step in the first trial, rad
_TRIALS = 14
_GAIN = 0.95  # another trial is made if it may need fewer than this share of the steps
_ROUNDED = 1e-6  # rad; a larger error that does not fall with the step is not rounding
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
        Largest error, rad, of the bodies that were run with these steps, at 64 times, which are
        closer to each other at the start. It includes the error of the reference.
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

    There are at most 16 different ones. The search takes as long as some tens of runs of the
    sample.

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
        Largest error of a body over the run, rad, above 0. If not all bodies are run, those that
        are stay below it by a factor of 1.5, and others can exceed it.
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
    Bodies are divided into at most 16 groups of similar initial rates; each group has one step
    size. Some bodies of each group, the fastest among them, are run with fewer and fewer steps, and
    their errors are measured against a reference. The fewest steps whose errors met the tolerance
    are returned.

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
    tol = checks.above_zero("tol", tol)
    record = method_of(scene, method, "quat", need="is_stepped")
    group = _groups(speeds(whole))
    size, chance = checks.whole("sample", sample, 1), np.random.default_rng(rng)
    rows = np.union1d(_sample(group, speeds(whole), size, chance), ensemble.extremes)
    problem, within = whole.take(rows), tol if rows.size == group.size else tol / UNSEEN
    known = reference(problem, most=times_compared("run", rows.size), goal=tol / FINER)
    known.refuse_jumps()
    known.refuse_beyond(tol)
    case = Case(name_of(record))
    fewest, error = _fewest(problem, known, case, group[rows], within)
    steps = fewest[group]
    return PerBodySteps(
        case.method, whole.t_end / steps, steps, whole.t0, error, rows.size, group.size,
        known.source, float(steps.mean() / steps.max()),
    )  # fmt: skip


def _groups(rates: NDArray[np.float64]) -> NDArray[np.intp]:
    """The group of each body: between equal ratios of the rates, from the slowest on."""
    top = max(float(rates.max()), 1e-300)
    # rates that are equal to rounding are in one group
    edges = np.geomspace(np.clip(rates.min(), 1e-6 * top, 0.9 * top), top, _SIZES + 1)
    return np.unique(np.digitize(rates, edges[1:-1]), return_inverse=True)[1]


def _sample(
    group: NDArray[np.intp], rates: NDArray[np.float64], size: int, chance: np.random.Generator
) -> NDArray[np.intp]:
    """Equally many bodies of each group, ``size`` in all, with its fastest; or all bodies."""
    if size >= group.size:
        return np.arange(group.size)
    members = [np.flatnonzero(group == k) for k in range(group.max() + 1)]
    chosen = [chance.permutation(each)[: max(1, size // len(members))] for each in members]
    fastest = [each[rates[each].argmax()] for each in members]
    return np.unique(np.concatenate([*chosen, fastest]))


def _fewest(
    problem: Problem, known: Reference, case: Case, group: NDArray[np.intp], tol: float
) -> tuple[NDArray[np.intp], float]:
    """The fewest steps of each group that met the tolerance in a run, with their largest error."""
    times = problem.t_end * (np.arange(1, 65) / 64.0) ** 2
    exact, order = known.at(times), case.record.order_of(problem.ensemble.scene.kind)

    def largest(values: NDArray[np.float64]) -> NDArray[np.float64]:
        found = np.zeros(group.max() + 1)
        np.maximum.at(found, group, values)
        return found

    n = np.ceil(largest(speeds(problem)) * problem.t_end / _FIRST + _LEAST - 1).astype(np.intp)
    best, stayed, least, before = 0 * n, 0 * n, np.zeros(n.size), np.full(n.size, np.inf)
    for _ in range(_TRIALS):
        run = problem.run(case, n[group], save_at=problem.t0 + times)
        errors = largest_angle(run.q, exact) + known.own_error
        worst = largest(np.where(run.status != 0, np.pi, errors))
        met = (worst <= tol) & ((best == 0) | (n < best))
        best, least = np.where(met, n, best), np.where(met, worst, least)
        # with more steps an error that is not rounding would fall
        stays = (best == 0) & (0.7 * before < worst) & (worst < _ROUNDED)
        stayed = np.where(stays, stayed + 1, 0)
        # neither large errors nor rounding errors have an order
        change = np.where(worst > LARGE, 2.0, (worst / (_AIM * tol)) ** (1.0 / order))
        further = np.ceil(np.maximum(n * np.clip(change, 0.5, 8.0), _LEAST)).astype(np.intp)
        n = np.where(best == 0, np.maximum(further, n + n // 4 + 1), np.minimum(further, best))
        before = worst
        if stayed.max() > 1 or (best.all() and (n > _GAIN * best).all()):
            break
    if not best.all():
        raise ValueError(
            f"tol: found {tol}; accepted: what {case.name} can meet, errors stay at "
            f"{worst[best == 0].max():.1e} rad"
        )
    return best, float(least.max())
