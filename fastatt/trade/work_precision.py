"""Work and precision of every method on a user's scene."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.attitudes import ATTITUDES
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import fits, methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.propagation.options import after
from fastatt.scene.scene import Scene
from fastatt.threads import default_threads, progress_bar
from fastatt.trade.measure import (
    Case,
    Problem,
    Row,
    frontier,
    machine_line,
    measure,
    panels,
    processor_line,
    to_csv,
    trade_table,
    with_orders,
)
from fastatt.trade.reference import (
    Confirmation,
    Reference,
    confirm,
    largest_rotation,
    reference,
    speeds,
)
from fastatt.trade.summary import BRIEF, TARGETS, closed_form, fastest

DTYPES = ("float64", "float32")
# |w| h of the coarsest step, rad, if the method allows it, and the number of halvings
_COARSEST = 2.0
_RUNGS = 14
# s; steps of shorter runs would underflow
_SHORTEST = 1e-290
# rad, after which rounding alone is some 1e-4 rad
_FARTHEST = 1e12
_EVALUATED = 1024  # bodies whose prescribed rate is evaluated for that


@dataclass(frozen=True)
class WorkPrecision:
    """Measured rows, as :func:`work_precision` returns them.

    Attributes
    ----------
    rows : list of Row
        One row for each case and step size: method, representation, dtype, dt, errors (rad),
        seconds for each body, drift, observed order, status.
    duration : float
        Duration of the motion, s.
    n_bodies : int
        Number of bodies.
    sampled : int
        Number of bodies that were measured.
    reference : str
        The reference of the errors.
    reference_error : float
        Largest error of the reference over the sample, rad.
    confirmation : str
        The difference of another method from the reference.
    """

    rows: list[Row]
    duration: float
    n_bodies: int
    sampled: int
    reference: str
    reference_error: float
    confirmation: str
    n_threads: int = field(default_factory=default_threads)

    @property
    def frontier(self) -> list[Row]:
        """The rows for which no row is better in both time and largest error, fastest first.

        Rows with a flag are left out, and differences by rounding do not count.
        """
        return frontier(self.rows)

    def table(self) -> str:
        """Return all rows as a text table.

        Returns
        -------
        str
            The table.
        """
        return trade_table(self.rows)

    def __str__(self) -> str:
        exact = closed_form(self.rows)
        best = [fastest(self.rows, target)[:1] for target in TARGETS]
        shown = [*([exact] if exact else []), *(row for ranked in best for row in ranked)]
        return (
            f"{machine_line()}\n"
            f"{self.sampled} of {self.n_bodies} bodies over {self.duration:g} s; reference: "
            f"{self.reference}, with an error of {self.reference_error:.1e} rad; "
            f"{self.confirmation}\n"
            f"{len(self.rows)} rows (table() has all); the fastest at "
            f"{', '.join(f'{target:.0e}' for target in TARGETS)} rad:\n"
            f"{trade_table(list(dict.fromkeys(shown)), BRIEF)}"
        )

    def plot(self, path: str | Path) -> None:
        """Plot error against time per body with the frontier; needs matplotlib.

        Parameters
        ----------
        path : str or Path
            The picture.
        """
        from fastatt.plots import study

        kind = self.rows[0].input
        title = f"{kind} scene, {self.sampled} of {self.n_bodies} bodies over {self.duration:g} s"
        heading = f"{title}\n{processor_line(self.n_threads)}"
        study.draw(panels(self.rows, self.duration), heading, path)

    def to_csv(self, path: str | Path) -> None:
        """Write the rows as CSV with a line of names.

        Parameters
        ----------
        path : str or Path
            The file.
        """
        to_csv(path, self.rows)


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
    representations: Sequence[str] = ("quat",),
    dtypes: Sequence[str] = DTYPES,
    sample: int = 1024,
    repeats: int = 3,
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
    representations : sequence of str, default ("quat",)
        Representations to measure.
    dtypes : sequence of str, default ("float64", "float32")
        Precisions to measure.
    sample : int, default 1024
        Number of bodies: the fastest, the slowest, and others that are chosen at random.
    repeats : int, default 3
        Number of runs, of which the shortest time counts.
    max_seconds : float, default 60.0
        Time for all rows together, s, without compilation; each case has its share.
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.propagate`.
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
    those of the sample, without compilation. Errors are angles at the end, rad, against the
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
    rows = spread(whole, size, np.random.default_rng(rng))
    problem = whole.take(rows)
    known = reference(problem)
    check = confirm(problem, known)
    checks.real("max_seconds", max_seconds)
    measured: list[Row] = []
    with progress_bar(progress, len(cases), "case") as done:
        for case in cases:
            measured += case_rows(
                scene.kind, problem, known, check, case, repeats, seconds=max_seconds / len(cases)
            )
            done(1)
    return WorkPrecision(
        rows=measured, duration=problem.duration, n_bodies=ensemble.size, sampled=rows.size,
        reference=known.source, reference_error=float(np.max(known.error)),
        confirmation=str(check), n_threads=n_threads or default_threads(),
    )  # fmt: skip


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
    representations = checks.several("representations", representations, "representations")
    dtypes = checks.several("dtypes", dtypes, "float32 and float64")
    for rep in representations:
        checks.choice("representations", rep, ATTITUDES)
    for dtype in dtypes:
        checks.choice("dtypes", dtype, DTYPES)
    wanted = [Case(method).record for method in tried]
    names = {"methods": [m.name for m in wanted], "representations": list(representations)}
    for argument, used in names.items():
        for name, times in Counter(used).items():
            if times > 1:
                raise ValueError(f"{argument}: found {name!r} twice; accepted: different names")
    cases = [
        Case(name_of(method), representation, dtype)
        for method in wanted
        for representation in representations
        for dtype in dtypes
        if fits(method, scene, representation)
    ]
    if not cases:
        raise ValueError(
            f"methods, representations, dtypes: found {', '.join(map(str, names.values()))}, "
            f"{list(dtypes)}, of which nothing fits; accepted: {', '.join(fitting)}"
        )
    return cases


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
    known = ensemble.w0 is not None
    few = whole if known else whole.take(np.arange(min(ensemble.size, _EVALUATED)))
    angle = largest_rotation(few)
    if angle > _FARTHEST:
        most = whole.duration * (_FARTHEST / angle)
        raise ValueError(
            f"t_end: found {t_end:g}; accepted: at most {most:.1e} s after t0, in which the "
            f"fastest body rotates by {_FARTHEST:g} rad; rounding grows with the rotation"
        )
    return whole


def spread(problem: Problem, size: int, generator: np.random.Generator) -> NDArray[np.intp]:
    """Rows of the fastest bodies (an eighth), the slowest (a sixteenth), and others at random."""
    n = problem.ensemble.size
    if n <= size:
        return np.arange(n)
    ranked = np.argsort(speeds(problem), kind="stable")
    least, between, most = np.split(ranked, [size // 16, n - max(1, size // 8)])
    rest = generator.choice(between, size - most.size - least.size, replace=False)
    return np.sort(np.concatenate([most, least, rest]))


def case_rows(
    name: str,
    problem: Problem,
    known: Reference,
    check: Confirmation,
    case: Case,
    repeats: int,
    *,
    steps: Sequence[int] | None = None,
    seconds: float = math.inf,
) -> list[Row]:
    """The ladder of one case: these numbers of steps, or halved ones from the method's limit on.

    It ends where rounding dominates or the time is used up. The closed form has one row. If it is
    the reference itself, its error is measured against what confirms it.
    """
    end = known.end
    if case.record.is_exact:
        end, steps = check.end, (1,)
    first = fewest(problem, case)
    return ladder_rows(
        lambda n: measure(problem, end, case, n, repeats, name),
        steps or [first * 2**k for k in range(_RUNGS)],
        case,
        case.record.order_of(problem.ensemble.scene.kind),
        float(np.median(known.unresolved)),
        seconds / ((repeats + 2) * problem.ensemble.size),
    )


def ladder_rows(
    row_of_steps: Callable[[int], Row],
    steps: Iterable[int],
    case: Case,
    order: int,
    unresolved: float,
    most: float,
) -> list[Row]:
    """Rows of falling steps, until rounding dominates or runs of a body took ``most`` seconds."""
    rows: list[Row] = []
    for n in steps:
        rows = with_orders([*rows, row_of_steps(n)], case, order, unresolved)
        # the next run takes as long as all before it
        used = 2.0 * sum(row.seconds_per_body for row in rows)
        if most < math.inf and ((len(rows) > 2 and rows[-2].plateau) or used > most):
            break
    return rows


def fewest(problem: Problem, case: Case) -> int:
    """The number of steps in which the fastest body rotates by 2 rad, or as the method allows."""
    angle = min(_COARSEST, 0.9 * case.record.limit(case.representation))
    return max(1, math.ceil(largest_rotation(problem) / angle))
