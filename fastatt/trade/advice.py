"""Advice on method, step size and precision, measured on a sample of the user's ensemble."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.scene.scene import Scene
from fastatt.trade.coverage import Coverage, coverage_of, share_of
from fastatt.trade.measure import Case
from fastatt.trade.search import Point, Search
from fastatt.trade.timing import TIE
from fastatt.trade.work_precision import DTYPES, cases_of, problem_over

_HOPELESS = 6.0  # a case with this many times the estimated work of the best is not tried
_SINGLE = 1e-6  # rad; float32 is never that accurate


@dataclass(frozen=True, kw_only=True)
class Recommendation(Coverage):
    """A method, step size and precision with what was measured, as :func:`recommend` returns them.

    It also has the attributes of :class:`Coverage`.

    Attributes
    ----------
    method, representation, dtype : str
        The recommended case.
    dt : float
        Step size, s.
    n_steps : int
        Number of steps.
    t0 : float
        Time of the initial state, s.
    expected_error : float
        Largest angle, rad, when the recommendation was run on ``measured`` bodies. It includes the
        error of the reference. The closed form "exact" in float64 is its own reference: then it is
        the estimated rounding error of the closed form, and the text says "estimated".
    expected_seconds : float
        CPU time of the whole call to ``propagate`` in one thread, s.
    runner_up : Point or None
        The second-best case, with its ``n_steps``, ``error`` and ``seconds``. It is as fast if the
        ratio of the times is below 1.1; the smaller error is then recommended.
    limited_by : {"truncation", "round-off", "reference"}
        "truncation" if a smaller step size would be more accurate, and "reference" if the error of
        the reference hides whether it would.
    tol : float
        The tolerance, rad.
    reference : str
        The reference of the errors.
    reference_error : float
        Error of the reference, rad.
    case : Case
        The method, also a custom one, and the representation.
    """

    method: str
    representation: str
    dtype: str
    dt: float
    n_steps: int
    t0: float
    expected_error: float
    expected_seconds: float
    runner_up: Point | None
    limited_by: str
    tol: float
    reference: str
    reference_error: float
    case: Case = field(repr=False)

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for :func:`fastatt.propagate`, without threads and saves."""
        return {**self.case._asdict(), "dt": self.dt, "n_steps": self.n_steps, "t0": self.t0}

    def __str__(self) -> str:
        how = f"{self.n_steps} steps of {self.dt:.6g} s"
        # a closed form in double precision is its own reference
        is_reference = self.case.record.is_exact and self.dtype == "float64"
        how_known = "estimated" if is_reference else "measured"
        over = f"{how_known} over {self.measured} of {self.n_bodies} bodies"
        over += f", most of body {self.worst_body}" if self.n_bodies > 1 else ""
        time = self.expected_seconds
        text = f"{time:.3g} s" if time >= 0.1 else f"{time * 1e3:.3g} ms"
        lines = [
            f"{self.case}: {how} (tol {self.tol:g})",
            f"  error      {self.expected_error:.1e} rad at most over the run, {over}; limited by "
            + self.limited_by,
            *self._lines(),
            f"  time       {text} of one thread",
        ]
        if up := self.runner_up:
            margin = up.seconds / time
            how_long = "as fast" if margin < TIE else f"{margin:.2f} times as long"
            lines.append(f"  runner-up  {up.case}, {up.n_steps} steps: {how_long}")
        lines.append(
            f"  reference  {self.reference}, with an error of {self.reference_error:.1e} rad"
        )
        return "\n".join(lines)


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
    methods: Sequence[str | Method] | None = None,
    representations: Sequence[str] = ("quat",),
    dtypes: Sequence[str] = DTYPES,
    sample: int = 128,
    quantile: float = 1.0,
    all_bodies: bool = False,
    n_threads: int | None = None,
    rng: int | np.random.Generator = 0,
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
        Largest error of any body, rad, above 0, after each step or, for more than 1024 steps,
        after the first ones and at as many equally spaced times. If only some bodies were run,
        their error is at most tol/1.5, as a margin for the others.
    v0 : array_like of shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s.
    r0 : array_like of shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m.
    s0 : array_like of shape (n,) or (N, n), optional
        Initial values of the scene's states.
    t0 : float, default 0.0
        Time of the initial state, s.
    methods : sequence of str or Method, optional
        Methods to choose from. The default is those that are the fastest for some scene of the
        kind (``Method.tried_on``); the message of an unknown one lists all.
    representations : sequence of str, default ("quat",)
        Representations to choose from.
    dtypes : sequence of str, default ("float64", "float32")
        Precisions to choose from.
    sample : int, default 128
        Number of bodies on which errors are measured, in addition to those with the smallest and
        the largest of each number of the scene.
    quantile : float, default 1.0
        Share of the bodies for which the tolerance holds, above 0. Below 1, all bodies that are run
        are chosen at random.
    all_bodies : bool, default False
        Whether all bodies are run with the step size that is found and with half of it, to count
        those beyond the tolerance.
    n_threads : int, optional
        Number of threads of the runs that find errors, as in :func:`fastatt.propagate`.
    rng : int or numpy.random.Generator, default 0
        Random generator, or a seed for one, which chooses bodies.

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
    The sample consists of the bodies most at risk and of others that are chosen at random; it is
    smaller for long runs. At risk are the fastest bodies, those nearest the separatrix, those with
    the largest errors in the first coarse steps, and those with the largest errors in a coarse run
    of as many bodies as take ten million steps. For each case the number of steps is searched whose
    largest error meets ``tol``, and the cases take turns to be timed, five times or more, of which
    the shortest counts. The recommendation itself was run on the sample, and on as many of the
    other bodies as take four million steps: half of them are those with the largest errors in the
    coarse run, and half are chosen at random.

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
    kind = "torqued" if scene.states else scene.kind
    usual = [name for name in methods_for(scene) if METHODS[name].is_tried_on(kind)]
    cases = cases_of(scene, usual if methods is None else methods, representations, dtypes)
    if methods is None:
        cases = _hopeful(cases, tol)
    size = checks.whole("sample", sample, 1)
    part, is_whole = share_of("quantile", quantile), checks.flag("all_bodies", all_bodies)
    search = Search(whole, size, np.random.default_rng(rng), tol, quantile=part)
    best, *others = search.fastest(sorted(cases, key=lambda case: _work(case, tol)))
    case, n = best.case, best.n_steps
    return Recommendation(
        method=case.name, representation=case.representation, dtype=case.dtype,
        dt=whole.duration / n, n_steps=n, t0=whole.t0,
        expected_error=best.error, expected_seconds=best.seconds,
        limited_by=search.limit(case, n), runner_up=others[0] if others else None,
        tol=tol, **vars(coverage_of([(search, best)], tol, is_whole)),
        reference=search.known.source, reference_error=float(search.known.error.max()),
        case=case,
    )  # fmt: skip


def _work(case: Case, tol: float) -> float:
    """An estimate of the work for a tolerance: tol^(−1/order) evaluations and exponentials."""
    m = case.record
    return max(1, m.rate_calls + m.exponentials) * tol ** (-1.0 / m.order) if m.order else 0.0


def _hopeful(cases: Sequence[Case], tol: float) -> list[Case]:
    """Cases without those whose order or precision is far too low for a tolerance."""
    least = min((_work(c, tol) for c in cases if c.record.order), default=0.0)
    kept = [c for c in cases if _work(c, tol) <= _HOPELESS * least]
    return [c for c in kept if c.dtype == "float64" or tol >= _SINGLE] or kept
