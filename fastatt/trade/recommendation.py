"""What advice says: a method, a step and a precision, what was measured of them, and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fastatt.trade.measure import Case


@dataclass(frozen=True)
class Point:
    """One case at one step: the largest error over the bodies (rad), and the time (s) of all."""

    case: Case
    n_steps: int
    error: float
    seconds: float


@dataclass(frozen=True)
class Recommendation:
    """What to run, what was measured of it, and why.

    ``expected_error`` is the largest angle over the run (``at`` "run") or at its end ("end"), rad,
    that was measured when what is recommended was run on ``measured`` of the ``n_bodies``, against
    the ``reference``, whose own error is in it. ``expected_seconds`` is the time of a whole call to
    ``propagate`` on ``n_threads``.
    ``case`` holds the method and the representation, user-defined ones among them.
    ``margin`` is how many times as long the ``runner_up`` takes. ``limited_by`` is "truncation"
    where a smaller step would gain accuracy, "round-off" where it would not.
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
    tol: float | None
    budget: float | None
    n_bodies: int
    measured: int
    reference: str
    reference_error: float
    case: Case = field(repr=False)

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for ``fastatt.propagate``; threads and saves are left to the caller."""
        return {**self.case._asdict(), "dt": self.dt, "n_steps": self.n_steps, "t0": self.t0}

    def __str__(self) -> str:
        wanted = f"tol {self.tol:g}" if self.tol is not None else f"budget {self.budget:g} s"
        how = f"{self.n_steps} steps of {self.dt:.6g} s on {self.n_threads} threads"
        where = "over the run" if self.at == "run" else "at the end"
        over = f"measured over {self.measured} of {self.n_bodies} bodies"
        lines = [
            f"{self.case}: {how} ({wanted})",
            f"  error      {self.expected_error:.1e} rad at most {where}, {over}; limited by "
            + self.limited_by,
            f"  time       {in_words(self.expected_seconds)}",
        ]
        if self.runner_up is not None and self.margin is not None:
            up = self.runner_up
            lines.append(
                f"  runner-up  {up.case}, {up.n_steps} steps: {self.margin:.2f} times as long"
            )
        lines.append(f"  reference  {self.reference}, good to {self.reference_error:.1e} rad")
        return "\n".join(lines)


def in_words(seconds: float) -> str:
    """A time in s, or ms."""
    return f"{seconds:.3g} s" if seconds >= 0.1 else f"{seconds * 1e3:.3g} ms"
