"""Advice on method, step size and precision, measured on a sample of the user's ensemble."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.scene.scene import Scene
from fastatt.threads import progress_bar
from fastatt.trade.measure import Case
from fastatt.trade.recommendation import Recommendation
from fastatt.trade.search import SINGLE, Search, work
from fastatt.trade.work_precision import DTYPES, cases_of, problem_over

#: methods that were on the frontier for some measured scene; others are tried only if named
USUAL = {
    "rate": ("lie_midpoint", "rk4", "magnus4", "magnus6", "magnus8", "gauss12"),
    "free": ("exact", "strang2", "rk4", "dmv10", "kahan_li8"),
    "torqued": (
        "exact", "strang2", "rk4", "rk8", "rk9", "gbs16", "kahan_li8",
    ),
}  # fmt: skip
_HOPELESS = 6.0  # a case with this many times the estimated work of the best is not tried


def recommend(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike | None = None,
    *,
    t_end: float,
    tol: float,
    v0: ArrayLike | None = None,
    r0: ArrayLike | None = None,
    s0: ArrayLike | None = None,
    t0: float = 0.0,
    at: str = "run",
    methods: Sequence[str | Method] | None = None,
    representations: Sequence[str] = ("quat",),
    dtypes: Sequence[str] = DTYPES,
    sample: int = 128,
    n_threads: int | None = None,
    rng: int | np.random.Generator = 0,
    progress: bool = False,
) -> Recommendation:
    """Recommend the method, step size and precision that meet a tolerance in the shortest time.

    The recommendation is measured on a sample of the ensemble, which takes a few seconds.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces.
    q0 : array_like of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`fastatt.propagate`.
    w0 : array_like of shape (3,) or (N, 3), optional
        Initial angular velocities along body axes, rad/s.
    t_end : float
        Time of the end, s, after ``t0``. It is a whole number of the recommended steps away.
    tol : float
        Largest error of any body, rad, above 0. If only some bodies were run, their error is at
        most tol/1.5, as a margin for the others.
    v0 : array_like of shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s.
    r0 : array_like of shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m.
    s0 : array_like of shape (n,) or (N, n), optional
        Initial values of the scene's states.
    t0 : float, default 0.0
        Time of the initial state, s.
    at : {"run", "end"}, default "run"
        Where errors are measured: over the run, after each step or, for more than 1024 steps, after
        the first ones and at as many equally spaced times; or at the end only.
    methods : sequence of str or Method, optional
        Methods to choose from. The default is those that are the fastest for some scene;
        the message of an unknown one lists all.
    representations : sequence of str, default ("quat",)
        Representations to choose from.
    dtypes : sequence of str, default ("float64", "float32")
        Precisions to choose from.
    sample : int, default 128
        Number of bodies on which errors are measured, in addition to those with the smallest and
        the largest of each number of the scene.
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.propagate`.
    rng : int or numpy.random.Generator, default 0
        Random generator, or a seed for one, which chooses bodies.
    progress : bool, default False
        Show a progress bar, which needs tqdm.

    Returns
    -------
    Recommendation
        ``fastatt.propagate(scene, q0, w0, **advice.arguments)`` runs it; ``save_every`` or
        ``save_at`` can be added.

    Raises
    ------
    ValueError
        If a rate, torque or force jumps, or if the error of the reference does not fall as its
        order predicts: no step size then has a known error, unless steps end at the jumps
        (``Scene.breakpoints``). Also if nothing meets the tolerance, with what can be reached, or
        if another argument does not fit.
    TypeError
        If an argument has the wrong type.

    Notes
    -----
    The sample consists of the bodies with the largest errors in a coarse run of all bodies, or of
    as many as take ten million steps, of the fastest bodies, and of others that are chosen at
    random; it is smaller for long runs. For each case the number of steps is searched whose largest
    error meets ``tol``. The recommendation itself was run on the sample, and on as many of the
    other bodies as take four million steps, those with the largest errors first.

    Errors are measured against a closed form, or against a run of high order whose step is halved
    until its error falls as its order predicts. Rates, torques and forces are sampled along its
    path at 1024 times or more, of 64 bodies of the sample and of those with the smallest and the
    largest of each number of the scene; a pulse that is shorter than the time between two samples,
    or of other bodies alone, can be missed.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=fa.torques.GravityGradient(0.1))
    >>> body = (1, 0, 0, 0), (0.1, 0.2, 0.3)
    >>> advice = fa.recommend(scene, *body, t_end=10.0, tol=1e-6, methods=["rk4", "rk8"])
    >>> run = fa.propagate(scene, *body, **advice.arguments)
    >>> advice.expected_error <= 1e-6
    True
    """
    tol = checks.above_zero("tol", tol)
    ensemble = Ensemble.of(scene, q0, w0, v0, r0, s0)
    whole = problem_over(ensemble, t_end, t0, n_threads)
    fitting = methods_for(scene)
    kind = "torqued" if scene.states else scene.kind
    usual = [m for m in USUAL.get(kind, USUAL["free"]) if m in fitting]
    cases = cases_of(scene, usual if methods is None else methods, representations, dtypes)
    if methods is None:
        cases = _hopeful(cases, tol)
    search = Search(
        whole,
        checks.choice("at", at, ("run", "end")),
        checks.whole("sample", sample, 1),
        np.random.default_rng(rng),
        tol,
    )
    with progress_bar(progress, len(cases), "case") as done:
        return search.cheapest(cases, done)


def _hopeful(cases: Sequence[Case], tol: float) -> list[Case]:
    """Cases without those whose order or precision is far too low for a tolerance."""
    least = min((work(c, tol) for c in cases if c.record.order), default=0.0)
    kept = [c for c in cases if work(c, tol) <= _HOPELESS * least]
    return [c for c in kept if c.dtype == "float64" or tol >= SINGLE] or kept
