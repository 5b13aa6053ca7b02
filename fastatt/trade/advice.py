"""Advice on method, step and precision, measured on a sample of the user's own ensemble."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.attitudes import Attitude
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.scene.scene import Scene
from fastatt.threads import progress_bar
from fastatt.trade.measure import Case, Problem
from fastatt.trade.recommendation import Recommendation
from fastatt.trade.search import SINGLE, Search, work
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
_HOPELESS = 6.0  # times the guessed work of the best: not even tried


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
    s0: ArrayLike | None = None,
    t0: float = 0.0,
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
    0.3 s, shows to be the hardest, the fastest ones, and others by chance; of long runs fewer. For
    each case the number of steps is searched whose largest error meets ``tol``. What is recommended
    was run so, on the sample and on as many of the other bodies as take 0.5 s, the hardest first.
    Takes a few seconds.

    Errors are measured against a closed form, or a run of high order whose step is halved until
    its error falls as its order says. Rates, torques and forces are sampled along its path at 1024
    times or more: a pulse shorter than the time between two of these can stay unseen.

    Parameters
    ----------
    scene, q0, w0, v0, r0, s0, t0, n_threads : as of :func:`fastatt.propagate`.
    t_end : float
        Duration, s, above 0; the steps fill it exactly.
    tol : float
        Largest error of any body, rad. Where not all bodies could be run, those that were are
        below it by a factor of 1.5.
    budget : float
        Instead of ``tol``, the longest time that the run may take, s.
    at : {"run", "end"}
        Where errors are measured: over the run, after each of its steps or, of more than 1024, of
        the first ones and at so many even times; or at its end alone.
    methods : sequence of str or Method
        None takes those that are the cheapest somewhere; ``fastatt.methods_for`` lists all.
    representations, dtypes : sequence
        What to choose from.
    sample : int
        Number of bodies to measure errors on.
    seed : int
        Of the choice of bodies.
    progress : bool
        Show a bar (needs tqdm).

    Returns
    -------
    Recommendation
        ``fastatt.propagate(scene, q0, w0, **advice.arguments)`` runs it, with any ``save_every``
        or ``save_at`` in addition.

    Raises
    ------
    ValueError
        A rate, torque or force that jumps, or with which the error of the reference does not fall
        as its order says: no step has a known error then, unless steps end at the jumps. A
        tolerance or a budget that nothing meets, with what can be reached. Any other argument that
        does not fit, by name, with what is accepted.
    TypeError
        As ``propagate`` does.

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
    if (tol is None) == (budget is None):
        found = "neither" if tol is None else "both"
        raise ValueError(f"tol, budget: found {found}; accepted: one of them")
    wanted = checks.above_zero("budget", budget) if tol is None else checks.above_zero("tol", tol)
    ensemble = Ensemble.of(scene, q0, w0, v0, r0, s0)
    whole = Problem(ensemble, duration(t_end), checks.real("t0", t0), n_threads)
    fitting = methods_for(scene)
    kind = "torqued" if scene.states else scene.kind
    usual = [m for m in _USUAL.get(kind, _USUAL["free"]) if m in fitting]
    cases = cases_of(scene, usual if methods is None else methods, representations, dtypes)
    if tol is not None and methods is None:
        cases = _hopeful(cases, tol)
    search = Search(
        whole,
        checks.choice("at", at, ("run", "end")),
        checks.whole("sample", sample, 1),
        np.random.default_rng(seed),
        wanted / _FINER if tol is not None else 0.0,
    )
    search.known.refuse_jumps()
    with progress_bar(progress, len(cases), "case") as done:
        if tol is not None:
            return search.cheapest(cases, wanted, done)
        return search.most_accurate(cases, wanted, done)


def _hopeful(cases: Sequence[Case], tol: float) -> list[Case]:
    """Cases without those whose order or precision is far too low for a tolerance."""
    least = min((work(c, tol) for c in cases if c.record.order), default=0.0)
    kept = [c for c in cases if work(c, tol) <= _HOPELESS * least]
    return [c for c in kept if c.dtype == "float64" or tol >= SINGLE] or kept
