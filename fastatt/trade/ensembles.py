"""Ensembles with known solutions: coning bodies, free bodies, heavy tops, bodies under torques."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import angle_between, euler313_to_quat, quat_multiply
from fastatt.attitudes import ATTITUDES
from fastatt.gyro.integrate import integrate_rates, methods_for_samples
from fastatt.propagation.ensemble import Ensemble
from fastatt.rounding import noted
from fastatt.scene import rates, torques
from fastatt.scene.scene import Scene
from fastatt.threads import progress_bar
from fastatt.trade.measure import Case, Problem, Row, best_time, row_of, with_orders
from fastatt.trade.reference import Confirmation, Reference, confirm, coning_attitudes, reference
from fastatt.trade.work_precision import DTYPES, case_rows, cases_of

CONING = "coning"
RATE, SAMPLES = "rate function", "samples"
# an inertial frame that is tilted, since 3-1-3 angles about the cone's axis are exact by accident
TILT = (0.48, -0.6, 0.64, 0.0)
TRIAXIAL = (2.0, 1.0, 2.0 / 3.0)
# inertia about the fixed point, 0.1 m from the centre of mass
TOP = Scene(inertia=(1.0, 1.0, 0.5), torque=torques.HeavyTop(arm=(0.0, 0.0, 0.1), weight=10.0))
_TORQUES = (
    torques.GravityGradient(mean_motion=0.3),
    torques.Damping(0.02),
    torques.Rotor((0.1, 0.2, 0.3)),
)
BODY_SCENES: Mapping[str, Scene] = MappingProxyType({
    "free": Scene(inertia=TRIAXIAL),
    "top": TOP,
    "torqued": Scene(inertia=TRIAXIAL, torque=torques.Sum(_TORQUES)),
})  # fmt: skip


@dataclass(frozen=True)
class Study:
    """An ensemble with a reference, and the end of another method that confirms it."""

    name: str
    heading: str
    problem: Problem
    known: Reference
    check: Confirmation

    def rows(
        self, cases: Sequence[Case], steps: Sequence[int], repeats: int, *, progress: bool = False
    ) -> list[Row]:
        """Cases over a ladder of numbers of steps."""
        source = RATE if self.name == CONING else self.name
        found: list[Row] = []
        with progress_bar(progress, len(cases), "method") as done:
            for case in cases:
                if case.record.window is None:
                    measured = self.problem, self.known, self.check
                    found += case_rows(source, *measured, case, repeats, steps=steps)
                else:
                    rows = [self._of_samples(case, n, repeats) for n in steps]
                    found += with_orders(rows, case, case.record.order)
                done(1)
        return found

    def _of_samples(self, case: Case, n: int, repeats: int) -> Row:
        """The row of a method for samples, from coning rates at the ends of n intervals."""
        e, t_end = self.problem.ensemble, self.problem.t_end
        rate = e.scene.rate
        data = coning_rates(rate.angle, rate.frequency, np.linspace(0.0, t_end, n + 1))
        with noted() as said:
            seconds, q = best_time(
                lambda: integrate_rates(data, t_end / n, e.q0, method=case.name), repeats
            )
        status = "past the method's limit" if said else ""
        error = angle_between(q[:, -1], self.known.end.q)
        return row_of(SAMPLES, case, t_end, n, seconds, error, status=status)


# coning


def coning_rates(
    angle: NDArray[Any], frequency: NDArray[Any], t: NDArray[Any]
) -> NDArray[np.float64]:
    """Samples (N, n, 3) of the body rates of ``rates.Coning`` at times t (n,)."""
    a, f = angle[:, None], frequency[:, None]
    axial = np.broadcast_to(-2.0 * f * np.sin(0.5 * a) ** 2, (angle.size, t.size))
    return np.stack([-f * np.sin(a) * np.sin(f * t), f * np.sin(a) * np.cos(f * t), axial], axis=-1)


def _coning(n_bodies: int) -> Ensemble:
    generator = np.random.default_rng(1)
    angle = generator.uniform(0.2, 1.5, n_bodies)
    frequency = generator.uniform(0.5, 2.0, n_bodies)
    q0 = quat_multiply(TILT, coning_attitudes(angle, frequency, np.zeros(1))[0])
    return Ensemble(Scene(rate=rates.Coning(angle, frequency)), q0)


# rigid bodies


def _tilted_tops(n_bodies: int) -> Ensemble:
    """Nutating tops, tilted by 0.3 to 1.2 rad, with a spin of 3 to 6 rad/s."""
    generator = np.random.default_rng(2)
    azimuth, spin = generator.uniform(0.0, 2.0 * np.pi, (2, n_bodies))
    tilt = generator.uniform(0.3, 1.2, n_bodies)
    q0 = euler313_to_quat(np.stack([azimuth, tilt, spin], axis=1))
    across = generator.normal(scale=0.3, size=(n_bodies, 2))
    w0 = np.column_stack([across, generator.uniform(3.0, 6.0, n_bodies)])
    return Ensemble(TOP, q0, w0)


def _aligned(scene: Scene, n_bodies: int) -> Ensemble:
    """Bodies with angular momenta of size 1 in all directions."""
    m = np.random.default_rng(1).normal(size=(n_bodies, 3))
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    return Ensemble(scene, np.tile([1.0, 0.0, 0.0, 0.0], (n_bodies, 1)), m / TRIAXIAL)


#: title, duration, s, and the bodies
_ENSEMBLES: dict[str, tuple[str, float, Callable[[int], Ensemble]]] = {
    CONING: ("coning bodies", 20.0, _coning),
    "free": ("free bodies", 10.0, partial(_aligned, BODY_SCENES["free"])),
    "top": ("heavy symmetric tops", 10.0, _tilted_tops),
    "torqued": (
        "bodies with gravity gradient, damping and a wheel",
        10.0,
        partial(_aligned, BODY_SCENES["torqued"]),
    ),
}
#: descriptions of the inputs in the rows
TITLES = {
    RATE: "rate as a function of time",
    SAMPLES: "rate as samples",
    **{name: title for name, (title, *_) in _ENSEMBLES.items()},
}


def study(name: str, n_bodies: int) -> Study:
    """Coning bodies, or those of a name in ``BODY_SCENES``, with a confirmed reference."""
    title, t_end, ensemble = _ENSEMBLES[name]
    problem = Problem(ensemble(n_bodies), t_end)
    known = reference(problem)
    check = confirm(problem, known)
    heading = f"{n_bodies} {title} over {t_end:g} s; reference: {known.source}; {check}"
    return Study(name, heading, problem, known, check)


def cases(name: str) -> list[Case]:
    """Every method of a study on several representations; single precision on quaternions only.

    For coning bodies the methods for samples come last.
    """
    if name == CONING:
        scene, stored = Scene(rate=rates.Coning(1.0, 1.0)), tuple(ATTITUDES)
        sampled = [Case(method) for method in methods_for_samples()]
    else:
        scene, stored, sampled = BODY_SCENES[name], ("quat", "dcm"), []
    given = cases_of(scene, None, stored, DTYPES)
    return [c for c in given if c.dtype == "float64" or c.representation == "quat"] + sampled
