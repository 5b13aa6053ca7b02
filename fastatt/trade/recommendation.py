"""What advice says: a method, a step and a precision, what to expect of them, and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fastatt.trade.measure import Case


@dataclass(frozen=True)
class Point:
    """One case at one step: the largest error over the sample (rad), and the time (s) of all."""

    case: Case
    n_steps: int
    error: float
    seconds: float


@dataclass(frozen=True)
class Recommendation:
    """What to run, what to expect of it, and why.

    ``expected_error`` is the largest angle over the run (``at`` "run") or at its end ("end"), rad,
    over the sample, times a factor for the bodies that were not in it; ``expected_seconds`` the
    time of a whole call to ``propagate`` on ``n_threads``.
    ``case`` holds a method and a representation of one's own, where those are what is recommended.
    ``margin`` is how many times as long the ``runner_up`` takes. ``limited_by`` is "truncation"
    where a smaller step would gain accuracy, "round-off" where it would not, "sampling" where
    the interval of a sampled torque costs more than both. ``own_steps`` is what steps of each
    body's own (``fastatt.own_steps``) would be of these, by the rates, None where it is not much
    less. ``curve`` holds all that was measured.
    """

    method: str
    representation: str
    dtype: str
    dt: float
    n_steps: int
    save_every: int | None
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
    sampled: int
    safety: float
    reference: str
    reference_error: float
    sampling_error: float | None
    extrapolated_from: float | None
    own_steps: float | None
    case: Case = field(repr=False)
    curve: list[Point] = field(repr=False)

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for ``fastatt.propagate``.

        Threads and, unless an interval was asked for, saves are the caller's own.
        """
        found = {**self.case._asdict(), "dt": self.dt, "n_steps": self.n_steps}
        return found if self.save_every is None else {**found, "save_every": self.save_every}

    def __str__(self) -> str:
        wanted = f"tol {self.tol:g}" if self.tol is not None else f"budget {self.budget:g} s"
        how = f"{self.n_steps} steps of {self.dt:.6g} s on {self.n_threads} threads"
        seen = f"from {self.sampled} of {self.n_bodies} bodies (safety {self.safety:.2f})"
        where = "over the run" if self.at == "run" else "at the end"
        lines = [
            f"{self.case}: {how} ({wanted})",
            f"  error      {self.expected_error:.1e} rad at most {where}, {seen}; limited by "
            + self.limited_by,
            f"  time       {told(self.expected_seconds)}",
        ]
        if self.runner_up is not None and self.margin is not None:
            up = self.runner_up
            lines.append(
                f"  runner-up  {up.case}, {up.n_steps} steps: {self.margin:.2f} times as long"
            )
        lines.append(f"  reference  {self.reference}, good to {self.reference_error:.1e} rad")
        if self.own_steps is not None:
            lines.append(f"  own steps  {self.own_steps:.2f} of the steps, by fastatt.own_steps")
        if self.sampling_error is not None:
            lines.append(f"  sampling   the torque's interval costs {self.sampling_error:.1e} rad")
        if self.extrapolated_from is not None:
            lines.append(f"  errors measured over {self.extrapolated_from:g} s and extrapolated")
        return "\n".join(lines)


def told(seconds: float) -> str:
    """A time in s, or ms."""
    return f"{seconds:.3g} s" if seconds >= 0.1 else f"{seconds * 1e3:.3g} ms"
