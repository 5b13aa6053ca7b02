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
from fastatt.trade.coverage import Coverage, coverage_of, share_of
from fastatt.trade.forcing import forcing
from fastatt.trade.measure import Case
from fastatt.trade.reference import speeds
from fastatt.trade.search import Point, Search
from fastatt.trade.work_precision import name_of, problem_over

_SIZES = 16  # the most different step sizes


@dataclass(frozen=True, kw_only=True)
class PerBodySteps(Coverage):
    """Per-body step sizes and numbers of steps, as :func:`per_body_steps` finds them.

    It also has the attributes of :class:`Coverage`.

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
        Largest error, rad, of the bodies that were run with these steps, after each step or, for
        more than 1024 steps, after the first ones and at as many equally spaced times. It includes
        the error of the reference.
    reference : str
        The reference of the errors of the fastest bodies.
    share : float
        The number of all steps divided by that with the smallest step size for all bodies.
    """

    method: str | Method
    dt: NDArray[np.float64] = field(repr=False)
    n_steps: NDArray[np.int64] = field(repr=False)
    t0: float
    expected_error: float
    reference: str
    share: float

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for :func:`fastatt.propagate`."""
        return {"method": self.method, "dt": self.dt, "n_steps": self.n_steps, "t0": self.t0}

    def __str__(self) -> str:
        name = self.method if isinstance(self.method, str) else self.method.name
        first = (
            f"{name}: {self.n_steps.min()} to {self.n_steps.max()} steps, {self.share:.2f} of the "
            f"steps of one dt for all; error {self.expected_error:.1e} rad at most, measured over "
            f"{self.measured} of {self.n_bodies} bodies, of body {self.worst_body}, against "
            f"{self.reference}"
        )
        return "\n".join([first, *self._lines()])


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
    quantile: float = 1.0,
    all_bodies: bool = False,
    rng: int | np.random.Generator = 0,
) -> PerBodySteps:
    """Find per-body step sizes for which the largest error over a run meets a tolerance.

    There are at most 16 different ones. The search takes some seconds.

    Parameters
    ----------
    scene : Scene
        A scene with inertia.
    q0 : array_like of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`fastatt.propagate`.
    w0 : array_like of shape (3,) or (N, 3)
        Initial angular velocities along body axes, rad/s.
    t_end : float
        Time of the end, s, after ``t0``.
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
        Number of bodies on which steps are searched, the fastest among them, in addition to those
        with the smallest and the largest of each number of the scene.
    quantile : float, default 1.0
        Share of the bodies for which the tolerance holds, above 0. Below 1, all bodies that are run
        are chosen at random.
    all_bodies : bool, default False
        Whether all bodies are run with the step size that is found and with half of it, to count
        those beyond the tolerance.
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
    size, which is found as :func:`fastatt.recommend` finds it: the fewest steps are searched that
    meet the tolerance on some bodies of the group, and these steps are verified on others of it,
    those with the largest errors first, on as many of all groups as take four million steps.

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
    case = Case(name_of(method_of(scene, method, "quat", stepped=True)))
    size, chance = checks.whole("sample", sample, 1), np.random.default_rng(rng)
    groups = _groups(speeds(whole))
    steps = np.empty(ensemble.size, dtype=np.int64)
    part, is_whole = share_of("quantile", quantile), checks.flag("all_bodies", all_bodies)
    runs: list[tuple[Search, Point]] = []
    for rows in groups:
        few = -(-size // len(groups))
        search = Search(whole.take(rows), few, chance, tol, len(groups), part)
        runs.append((search, search.fewest(case)))
        steps[rows] = runs[-1][1].n_steps
    # of the whole ensemble, with more samples than each search takes
    if jump := forcing(whole, case, int(steps.max())).jump:
        raise ValueError(f"scene: {jump}")
    return PerBodySteps(
        method=case.method, dt=whole.duration / steps, n_steps=steps, t0=whole.t0,
        expected_error=max(point.error for _, point in runs), reference=search.known.source,
        share=float(steps.mean() / steps.max()), **vars(coverage_of(runs, tol, is_whole)),
    )  # fmt: skip


def _groups(rates: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """The bodies between equal ratios of the rates, from the slowest group on."""
    top = max(float(rates.max()), 1e-300)
    # rates that are equal to rounding are in one group
    edges = np.geomspace(np.clip(rates.min(), 1e-6 * top, 0.9 * top), top, _SIZES + 1)
    group = np.digitize(rates, edges[1:-1])
    return [np.flatnonzero(group == k) for k in np.unique(group)]
