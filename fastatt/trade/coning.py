"""Coning bodies: the rate as a function of time and as samples, against the exact attitude."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import rates
from fastatt.arrays import angle_between, quat_multiply
from fastatt.integrate import integrate_rates, methods_for_samples
from fastatt.methods import METHODS
from fastatt.running.choosing import methods_for
from fastatt.running.ensemble import Ensemble
from fastatt.scene import Scene
from fastatt.threads import progress_bar
from fastatt.trade.measure import Case, Problem, Row, Rung, best_time, ladder_rows, measure, noted
from fastatt.trade.reference import coning_attitudes, reference

T_END = 20.0
RATE, SAMPLES = "rate function", "samples"
# an inertial frame askew of the cone: about its own axis 3-1-3 angles are exact by accident
TILT = (0.48, -0.6, 0.64, 0.0)


def coning_rates(
    angle: NDArray[Any], frequency: NDArray[Any], t: NDArray[Any]
) -> NDArray[np.float64]:
    """Samples (N, n, 3) of the body rates of ``rates.Coning`` at times t (n,)."""
    a, f = angle[:, None], frequency[:, None]
    axial = np.broadcast_to(-2.0 * f * np.sin(0.5 * a) ** 2, (angle.size, t.size))
    return np.stack([-f * np.sin(a) * np.sin(f * t), f * np.sin(a) * np.cos(f * t), axial], axis=-1)


def coning_cases() -> dict[str, list[Case]]:
    """Every method, representation and precision, by the kind of input."""
    scene = Scene(rate=rates.Coning(1.0, 1.0))
    of_function = [
        Case(name, rep, dtype)
        for name in methods_for(scene)
        for rep in METHODS[name].representations
        for dtype in ("float64", "float32")
        if dtype == "float64" or rep == "quat"
    ]
    return {RATE: of_function, SAMPLES: [Case(name) for name in methods_for_samples()]}


def coning_trade(
    n_bodies: int,
    steps: Sequence[int],
    repeats: int,
    bar: bool,
    cases: Mapping[str, Sequence[Case]],
) -> list[Row]:
    """Cases by the kind of input over a ladder of numbers of steps."""
    generator = np.random.default_rng(1)
    angle = generator.uniform(0.2, 1.5, n_bodies)
    frequency = generator.uniform(0.5, 2.0, n_bodies)
    q0 = quat_multiply(TILT, coning_attitudes(angle, frequency, np.zeros(1))[0])
    scene = Scene(rate=rates.Coning(angle, frequency))
    problem = Problem(Ensemble(scene, q0), T_END)
    end = reference(problem).end

    def rung(source: str, case: Case, n: int) -> Rung:
        if source == RATE:
            return measure(problem, end, case, n, repeats)
        data = coning_rates(angle, frequency, np.linspace(0.0, T_END, n + 1))
        with noted() as said:
            seconds, q = best_time(
                lambda: integrate_rates(data, T_END / n, q0, method=case.name), repeats
            )
        status = "past the method's limit" if said else ""
        return Rung(n, seconds, angle_between(q[:, -1], end.q), status=status)

    rows: list[Row] = []
    with progress_bar(bar, sum(map(len, cases.values())), "method") as done:
        for source, of_source in cases.items():
            for case in of_source:
                rungs = [rung(source, case, n) for n in steps]
                rows += ladder_rows(source, case, T_END, rungs)
                done(1)
    return rows
