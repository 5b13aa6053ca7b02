"""Recommendations: a method, step size and precision, with their measurements and reasons."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fastatt.trade.measure import Case


@dataclass(frozen=True)
class Point:
    """One case with one step size: the largest error of the bodies (rad), and the time (s)."""

    case: Case
    n_steps: int
    error: float
    seconds: float


@dataclass(frozen=True)
class Recommendation:
    """A method, step size and precision with what was measured, as :func:`recommend` returns them.

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
    n_threads : int
        Number of threads for which the time was measured.
    at : {"run", "end"}
        Where errors were measured.
    expected_error : float
        Largest angle, rad, when the recommendation was run on ``measured`` bodies. It includes the
        error of the reference. The closed form "exact" in float64 is its own reference: then it is
        the estimated rounding error of the closed form, and the text says "estimated".
    expected_seconds : float
        Time of the whole call to ``propagate``, s.
    runner_up : Point or None
        The second-best case.
    margin : float or None
        Ratio of the times of the runner-up and of the recommendation.
    limited_by : {"truncation", "round-off", "reference"}
        "truncation" if a smaller step size would be more accurate, and "reference" if the error of
        the reference hides whether it would.
    tol : float
        The tolerance, rad.
    n_bodies : int
        Number of bodies.
    measured : int
        Number of bodies that were run.
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
    n_threads: int
    at: str
    expected_error: float
    expected_seconds: float
    runner_up: Point | None
    margin: float | None
    limited_by: str
    tol: float
    n_bodies: int
    measured: int
    reference: str
    reference_error: float
    case: Case = field(repr=False)

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for :func:`fastatt.propagate`, without threads and saves."""
        return {**self.case._asdict(), "dt": self.dt, "n_steps": self.n_steps, "t0": self.t0}

    def __str__(self) -> str:
        how = f"{self.n_steps} steps of {self.dt:.6g} s on {self.n_threads} threads"
        where = "over the run" if self.at == "run" else "at the end"
        # a closed form in double precision is its own reference
        is_reference = self.case.record.is_exact and self.dtype == "float64"
        how_known = "estimated" if is_reference else "measured"
        over = f"{how_known} over {self.measured} of {self.n_bodies} bodies"
        time = self.expected_seconds
        lines = [
            f"{self.case}: {how} (tol {self.tol:g})",
            f"  error      {self.expected_error:.1e} rad at most {where}, {over}; limited by "
            + self.limited_by,
            f"  time       {f'{time:.3g} s' if time >= 0.1 else f'{time * 1e3:.3g} ms'}",
        ]
        if self.runner_up is not None and self.margin is not None:
            up = self.runner_up
            lines.append(
                f"  runner-up  {up.case}, {up.n_steps} steps: {self.margin:.2f} times as long"
            )
        lines.append(
            f"  reference  {self.reference}, with an error of {self.reference_error:.1e} rad"
        )
        return "\n".join(lines)
