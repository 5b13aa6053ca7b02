"""Work and precision of every method on a user's scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import angle_between
from fastatt.attitudes import ATTITUDES
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import fits, methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.propagation.schedule import after
from fastatt.scene.scene import Scene
from fastatt.threads import progress_bar
from fastatt.trade import measure
from fastatt.trade.measure import BRIEF, Case, Problem, Row, machine_line, table, with_times
from fastatt.trade.reference import Reference, confirmation, largest_rotation, reference, speeds
from fastatt.trade.summary import TARGETS, closed_form, fastest
from fastatt.trade.timing import ROUNDS, time_in_turns

DTYPES = ("float64", "float32")
# |w| h of the coarsest step, rad, if the method allows it, and the number of halvings
_COARSEST = 2.0
_RUNGS = 14
_FEW = 4  # steps of a call that is nearly nothing else
# s; steps of shorter runs would underflow
_SHORTEST = 1e-290
# rad, after which rounding alone is some 1e-4 rad
_FARTHEST = 1e12


@dataclass(frozen=True)
class Study:
    """Bodies with a reference, and another method that confirms it."""

    name: str
    title: str
    problem: Problem
    known: Reference
    check: Reference

    @classmethod
    def of(cls, name: str, title: str, problem: Problem) -> Study:
        """Run the reference and what confirms it."""
        known = reference(problem)
        return cls(name, title, problem, known, confirmation(problem, known))

    @property
    def apart(self) -> NDArray[np.float64]:
        """The difference of the other method from the reference, (N,) rad."""
        angles: NDArray[np.float64] = angle_between(self.check.end.q, self.known.end.q)
        return np.nan_to_num(angles, nan=np.pi)

    def __str__(self) -> str:
        return (
            f"{self.title} over {self.problem.duration:g} s; reference: {self.known.source}, with "
            f"an error of {self.known.error.max():.1e} rad; {self.check.source} differs from it by "
            f"{self.apart.max():.1e} rad at most"
        )

    def rows(
        self, case: Case, steps: Sequence[int], seconds: float = math.inf, rounds: int = ROUNDS
    ) -> list[Row]:
        """A case in rising numbers of steps, until rounding dominates or the time is used up.

        That is the time for two runs of each, and for the ``rounds`` in which they are timed.
        The closed form has one row. If it is the reference itself, its error is measured against
        what confirms it.
        """
        if case.record.is_exact:
            steps = [1]
        order = case.record.order_of(self.problem.ensemble.scene.kind)
        unresolved = float(np.median(self.known.unresolved))
        # runs of a body, s
        most = seconds / ((rounds + 3) * self.problem.ensemble.size)
        rows: list[Row] = []
        for n in steps:
            rows = measure.with_orders([*rows, self.row(case, n)], case, order, unresolved)
            # the next run takes as long as all before it
            used = 2.0 * sum(row.seconds_per_body for row in rows)
            if most < math.inf and ((len(rows) > 2 and rows[-2].plateau) or used > most):
                break
        return rows

    def row(self, case: Case, n: int) -> Row:
        """A case in n steps."""
        end = self.check.end if case.record.is_exact else self.known.end
        return measure.measure(self.problem, end, case, n, self.name)

    def timed(self, ladders: Mapping[Case, Sequence[Row]], rounds: int = ROUNDS) -> list[Row]:
        """The rows of all cases with the times of runs that take turns."""
        rows = [(case, row) for case, ladder in ladders.items() for row in ladder]
        runs = [self.call(case, row.n_steps) for case, row in rows]
        one = replace(self, problem=self.problem.take(np.arange(1)))
        calls = {case: one.call(case, _FEW) for case in ladders}
        for call in calls.values():
            call()  # compiles
        times = time_in_turns([*runs, *calls.values()], rounds)
        alone = dict(zip(calls, times[len(runs) :], strict=True))
        size = self.problem.ensemble.size
        return [
            with_times(row, x, alone[case], size)
            for (case, row), x in zip(rows, times[: len(runs)], strict=True)
        ]

    def call(self, case: Case, n: int) -> Callable[[], Any]:
        """A run of a case in n steps, in one thread."""
        return partial(replace(self.problem, n_threads=1).run, case, n)


@dataclass(frozen=True)
class WorkPrecision:
    """Measured rows, as :func:`work_precision` returns them.

    Attributes
    ----------
    rows : list of Row
        One row for each case and step size: method, representation, dtype, dt, errors (rad),
        seconds for each body and their quartiles, the call's share of it, evaluations of the
        right-hand side, drift, observed order, status.
    study : Study
        The bodies that were measured, and the reference of the errors.
    """

    rows: list[Row]
    study: Study

    @property
    def frontier(self) -> list[Row]:
        """The rows for which no row is better in both time and largest error, fastest first.

        Rows with a flag are left out, and differences by rounding do not count.
        """
        return measure.frontier(self.rows)

    def table(self) -> str:
        """Return all rows as a text table.

        Returns
        -------
        str
            The table.
        """
        return table(self.rows)

    def __str__(self) -> str:
        best = closed_form(self.rows), *(fastest(self.rows, target) for target in TARGETS)
        shown = dict.fromkeys(row for row in best if row)
        return (
            f"{machine_line(1)}\n"
            f"{self.study}\n"
            f"{len(self.rows)} rows (table() has all); the fastest at "
            f"{', '.join(f'{target:.0e}' for target in TARGETS)} rad:\n"
            f"{table(list(shown), BRIEF)}"
        )

    def plot(self, path: str | Path) -> None:
        """Plot error against time per body and evaluations, with the frontier; needs matplotlib.

        Parameters
        ----------
        path : str or Path
            The picture.
        """
        heading = f"{self.study.title}\n{measure.processor_line(1)}"
        measure.draw(self.rows, self.study.problem.duration, heading, path)

    def to_csv(self, path: str | Path) -> None:
        """Write the rows as CSV with a line of names.

        Parameters
        ----------
        path : str or Path
            The file.
        """
        measure.to_csv(path, self.rows)


def work_precision(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike | None = None,
    *,
    t_end: float,
    v0: ArrayLike | None = None,
    r0: ArrayLike | None = None,
    s0: ArrayLike | None = None,
    t0: float = 0.0,
    methods: Sequence[str | Method] | None = None,
    n_steps: Sequence[int] | None = None,
    representations: Sequence[str] = ("quat",),
    dtypes: Sequence[str] = DTYPES,
    sample: int = 1024,
    repeats: int = ROUNDS,
    max_seconds: float = 60.0,
    n_threads: int | None = None,
    rng: int | np.random.Generator = 0,
    progress: bool = False,
) -> WorkPrecision:
    """Measure methods over a ladder of step sizes on a sample of an ensemble.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces.
    q0 : array_like of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`fastatt.propagate`.
    w0 : array_like of shape (3,) or (N, 3), optional
        Initial angular velocities along body axes, rad/s.
    t_end : float
        Time of the end, s, after ``t0``.
    v0 : array_like of shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s.
    r0 : array_like of shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m.
    s0 : array_like of shape (n,) or (N, n), optional
        Initial values of the scene's states.
    t0 : float, default 0.0
        Time of the initial state, s.
    methods : sequence of str or Method, optional
        Methods to measure; the default is every method that fits.
    n_steps : sequence of int, optional
        Numbers of steps of each method, all of which are run; the default is a ladder.
    representations : sequence of str, default ("quat",)
        Representations to measure.
    dtypes : sequence of str, default ("float64", "float32")
        Precisions to measure.
    sample : int, default 1024
        Number of bodies, half of them the fastest, the others chosen at random.
    repeats : int, default 5
        Number of rounds, in each of which all runs are timed in turn; short ones take part in more.
    max_seconds : float, default 60.0
        Time for all rows together, s, without compilation; each case has its share.
    n_threads : int, optional
        Number of threads of the runs that find errors, as in :func:`fastatt.propagate`.
    rng : int or numpy.random.Generator, default 0
        Random generator, or a seed for one, which chooses bodies.
    progress : bool, default False
        Show a progress bar, which needs tqdm.

    Returns
    -------
    WorkPrecision
        The measured rows.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit.

    Notes
    -----
    Each ladder begins where the fastest body rotates by 2 rad in a step, or by as much as the
    method allows, and the step is halved until rounding dominates or the time is used up. Times are
    CPU times of one thread for the sample, without compilation: the least counts, and quartiles are
    kept. Of few bodies and steps the call itself takes much of the time; ``call_share`` says how
    much. Errors are angles at the end, rad, against the
    ``reference``.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> measured = fa.work_precision(
    ...     scene, (1, 0, 0, 0), (0.1, 0.2, 0.3), t_end=5.0, methods=["rk4"], dtypes=("float64",),
    ...     repeats=1,
    ... )
    >>> {row.method for row in measured.rows}
    {'rk4'}
    """
    ensemble = Ensemble.of(scene, q0, w0, v0, r0, s0)
    cases = cases_of(scene, methods, representations, dtypes)
    whole = problem_over(ensemble, t_end, t0, n_threads)
    size = checks.whole("sample", sample, 1)
    problem = whole.take(spread(whole, size, np.random.default_rng(rng)))
    title = f"{problem.ensemble.size} of {ensemble.size} bodies ({scene.kind})"
    study, rounds = Study.of(scene.kind, title, problem), checks.whole("repeats", repeats, 1)
    share = checks.real("max_seconds", max_seconds) / len(cases)
    chosen = None
    if n_steps is not None:
        numbers = checks.several("n_steps", n_steps, "whole numbers above 0")
        chosen = sorted({checks.whole("n_steps", n, 1) for n in numbers})
        if not chosen:
            raise ValueError("n_steps: found []; accepted: a list of whole numbers above 0")
        share = math.inf
    ladders: dict[Case, list[Row]] = {}
    with progress_bar(progress, len(cases), "case") as done:
        for case in cases:
            least = coarsest(problem, case)
            steps = chosen or [least * 2**k for k in range(_RUNGS)]
            ladders[case] = study.rows(case, steps, share, rounds)
            done(1)
    return WorkPrecision(study.timed(ladders, rounds), study)


def cases_of(
    scene: Scene,
    methods: Sequence[str | Method] | None,
    representations: Sequence[str],
    dtypes: Sequence[str],
) -> list[Case]:
    """Every valid combination of these methods, representations and precisions.

    Raises ``ValueError`` for an unknown name, one that does not fit, a name of two methods or
    representations, and if no combination is valid.
    """
    fitting = methods_for(scene)
    tried = fitting if methods is None else checks.several("methods", methods, "methods")
    for method in tried:
        if not isinstance(method, Method):
            checks.choice("methods", method, fitting)
        elif not fits(method, scene):
            raise ValueError(
                f"methods: found {method.name}, for {', '.join(method.scenes)}; accepted for this "
                f"scene ({scene.kind}): {', '.join(fitting)}"
            )
    representations = _words("representations", representations, ATTITUDES)
    dtypes = _words("dtypes", dtypes, DTYPES)
    wanted = [Case(method).record for method in tried]
    names = [method.name for method in wanted]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"methods: found {name!r} twice; accepted: different names")
    cases = [
        Case(name_of(method), representation, dtype)
        for method in wanted
        for representation in representations
        for dtype in dtypes
        if fits(method, scene, representation)
    ]
    if not cases:
        raise ValueError(
            f"methods, representations, dtypes: found {names}, {representations}, {dtypes}, of "
            f"which nothing fits; accepted: {', '.join(fitting)}"
        )
    return cases


def _words(name: str, values: Sequence[str], accepted: Iterable[str]) -> list[str]:
    chosen = [checks.choice(name, x, accepted) for x in checks.several(name, values, "words")]
    return list(dict.fromkeys(chosen))


def name_of(record: Method) -> str | Method:
    """The name of a method of the library, or a user-defined method itself."""
    return record.name if METHODS.get(record.name) is record else record


def problem_over(
    ensemble: Ensemble, t_end: float, t0: float, n_threads: int | None = None
) -> Problem:
    """A problem from t0 to t_end, s, between which rounding leaves an attitude."""
    start = checks.real("t0", t0)
    duration = after(t_end, start) - start
    if duration < _SHORTEST:
        raise ValueError(f"t_end: found {t_end}; accepted: at least {_SHORTEST:g} s after t0")
    whole = Problem(ensemble, duration, start, n_threads)
    angle = largest_rotation(whole)
    if angle > _FARTHEST:
        most = whole.duration * (_FARTHEST / angle)
        raise ValueError(
            f"t_end: found {t_end:g}; accepted: at most {most:.1e} s after t0, in which the "
            f"fastest body rotates by {_FARTHEST:g} rad; rounding grows with the rotation"
        )
    return whole


def spread(problem: Problem, size: int, generator: np.random.Generator) -> NDArray[np.intp]:
    """Rows of bodies: the fastest first, which are half of them, and others at random."""
    n = problem.ensemble.size
    ranked = np.argsort(-speeds(problem), kind="stable")
    fastest, rest = np.split(ranked, [n if n <= size else max(1, size // 2)])
    others = generator.choice(rest, min(n, size) - fastest.size, replace=False)
    return np.concatenate([fastest, others])


def coarsest(problem: Problem, case: Case) -> int:
    """The number of steps in which the fastest body rotates by 2 rad, or as the method allows."""
    angle = min(_COARSEST, 0.9 * case.record.limit(case.representation))
    return max(1, math.ceil(largest_rotation(problem) / angle))
