"""Drift over long runs: how errors of what the motion conserves grow with the number of steps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import attrgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.status import Status
from fastatt.trade.measure import Case, Problem, counted, drifts_of
from fastatt.trade.reference import largest_rotation

#: rad; the rotation of the fastest body in a step
ANGLE = 0.2
_SAVES, _POINTS = 1024, 41  # saves of a run, and those that are kept, equally spaced in logarithms
# exponents of growth up to which a drift stays bounded, is a random walk, grows linearly
_LAWS = {"bounded": 0.25, "random walk": 0.75, "linear": 1.5}
#: labels of what drifts
LABELS = {
    "norm": "norm or orthogonality error",
    "energy": "energy, relative change",
    "momentum": "angular momentum, relative change",
}


@dataclass(frozen=True)
class Drifted:
    """How far a quantity drifted in ``n_steps`` of a long run: a root mean square over the bodies.

    ``quantity`` is a key of ``LABELS``; ``growth`` and ``status``, the numbers of bodies with each
    flag, are those of the whole run.
    """

    input: str
    method: str
    representation: str
    quantity: str
    dt: float
    n_steps: int
    drift: float
    growth: str
    status: str


def growth(steps: NDArray[np.int64], values: NDArray[np.float64]) -> str:
    """How a drift grows over the last decade and a half, by the exponent of time."""
    largest = np.maximum.accumulate(values)
    late = (steps > steps[-1] / 30.0) & (largest > 0.0)
    if late.sum() < 2:
        return next(iter(_LAWS))
    exponent = np.polyfit(np.log(steps[late]), np.log(largest[late]), 1)[0]
    return next((law for law, most in _LAWS.items() if exponent < most), "faster")


def long_run(name: str, problem: Problem, case: Case, n_steps: int) -> list[Drifted]:
    """Run a case in steps of ``ANGLE`` and measure its drifts; none where it is not finite."""
    dt = ANGLE / (largest_rotation(problem) / problem.duration)
    stride = n_steps // _SAVES
    whole = replace(problem, duration=dt * stride * _SAVES)
    run = whole.run(case, stride * _SAVES, stride)
    if (run.status & Status.NON_FINITE).any():
        return []
    measured = {"norm": np.abs(run.norm_error), **drifts_of(run, problem.ensemble.scene)}
    kept = np.unique(np.geomspace(1, _SAVES, _POINTS).astype(int))
    about, status = (name, case.name, case.representation), counted(run.status_counts())
    points = []
    for quantity, values in measured.items():
        drifts = np.sqrt(np.mean(np.square(values[kept]), axis=1))
        law = growth(stride * kept, drifts)
        points += [
            Drifted(*about, quantity, dt, n, value, law, status)
            for n, value in zip((stride * kept).tolist(), drifts.tolist(), strict=True)
        ]
    return points


def ends(points: Iterable[Drifted]) -> list[Drifted]:
    """The last of the drifts of each case and quantity."""
    return list({(x.input, x.method, x.representation, x.quantity): x for x in points}.values())


def draw(points: Sequence[Drifted], heading: str, path: Path) -> None:
    """Draw drift against steps, a row for each quantity, a curve for each method."""
    from fastatt.plots import study

    curves = []
    place = attrgetter("quantity", "representation", "method")
    for (quantity, name, method), drawn in groupby(points, place):
        steps, drifts = zip(*((x.n_steps, x.drift) for x in drawn), strict=True)
        label = f"steps of {points[0].dt:.3g} s"
        curves.append(study.Curve(LABELS[quantity], label, name, method, steps, drifts))
    study.draw(curves, heading, path)
