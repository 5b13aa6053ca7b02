"""Ensembles with known solutions: coning, free bodies, heavy tops, torques, sampled rates."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import angle_between, euler313_to_quat, quat_multiply
from fastatt.gyro.integrate import integrate_rates, methods_for_samples
from fastatt.propagation.ensemble import Ensemble
from fastatt.rounding import noted
from fastatt.scene import rates, torques
from fastatt.scene.scene import Scene
from fastatt.trade.measure import Case, Problem, Row, best_time, row_of
from fastatt.trade.reference import Confirmation, Reference, confirm, coning_attitudes, reference
from fastatt.trade.work_precision import case_rows, cases_of, fewest, ladder_rows

SAMPLES = "samples"
_STEPS = 2.5  # a second, of the grid of ladders
_REPEATS = 1  # of short runs best_time makes ten times as many
_SAMPLED = 64  # bodies, at most, whose rates are sampled
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
BODY_SCENES = {
    "free": Scene(inertia=TRIAXIAL),
    "top": TOP,
    "torqued": Scene(inertia=TRIAXIAL, torque=torques.Sum(_TORQUES)),
}


@dataclass(frozen=True)
class Study:
    """An ensemble with a reference, and the end of another method that confirms it."""

    name: str
    title: str
    problem: Problem
    known: Reference
    check: Confirmation

    def __str__(self) -> str:
        n, duration = self.problem.ensemble.size, self.problem.duration
        return f"{n} {self.title} over {duration:g} s; reference: {self.known.source}; {self.check}"

    def steps(self, case: Case, per_doubling: int) -> list[int]:
        """Numbers of steps of a case's ladder, from the coarsest that it allows on.

        They are those of one grid for all cases, with 2.5 steps a second, and so many more for each
        doubling.
        """
        least = 1 if case.record.window else fewest(self.problem, case)
        coarsest = _STEPS * self.problem.duration
        grid = [round(coarsest * 2.0 ** (k / per_doubling)) for k in range(-8, 14 * per_doubling)]
        return [n for n in grid if n >= max(least, 4)]

    def rows(self, case: Case, steps: Sequence[int], seconds: float = math.inf) -> list[Row]:
        """A case in these numbers of steps, fewer if rounding dominates or the time is used up."""
        if case.record.window is None:
            return case_rows(
                self.name, self.problem, self.known, self.check, case, _REPEATS,
                steps=steps, seconds=seconds,
            )  # fmt: skip
        most = seconds / ((_REPEATS + 2) * self.problem.ensemble.size)
        return ladder_rows(
            lambda n: self._of_samples(case, n), steps, case, case.record.order, 0.0, most
        )

    def _of_samples(self, case: Case, n: int) -> Row:
        """The row of a method for samples, from coning rates at the ends of n intervals."""
        e, duration = self.problem.ensemble, self.problem.duration
        rate = e.scene.rate
        data = coning_rates(rate.angle, rate.frequency, np.linspace(0.0, duration, n + 1))
        with noted() as said:
            seconds, q = best_time(
                lambda: integrate_rates(data, duration / n, e.q0, method=case.name), _REPEATS
            )
        status = "past the method's limit" if said else ""
        error = angle_between(q[:, -1], self.known.end.q)
        return row_of(self.name, case, duration, n, seconds, error, status=status)


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
    "coning": ("coning bodies, their rates functions of time", 20.0, _coning),
    "free": ("free bodies", 10.0, partial(_aligned, BODY_SCENES["free"])),
    "top": ("heavy symmetric tops", 10.0, _tilted_tops),
    "torqued": (
        "bodies with gravity gradient, damping and a wheel",
        10.0,
        partial(_aligned, BODY_SCENES["torqued"]),
    ),
    SAMPLES: ("coning bodies, their rates sampled", 20.0, _coning),
}
SCENES = tuple(_ENSEMBLES)


def study(name: str, n_bodies: int) -> Study:
    """The ensemble of a name in ``SCENES``, with a confirmed reference."""
    bodies = problem(name, n_bodies)
    known = reference(bodies)
    return Study(name, _ENSEMBLES[name][0], bodies, known, confirm(bodies, known))


def problem(name: str, n_bodies: int) -> Problem:
    """The ensemble of a name in ``SCENES``, without a reference."""
    _, duration, ensemble = _ENSEMBLES[name]
    # samples of more bodies would take memory and time, and tell nothing else
    return Problem(ensemble(min(n_bodies, _SAMPLED) if name == SAMPLES else n_bodies), duration)


def cases(name: str) -> list[Case]:
    """Every method of a study, on quaternions and on matrices; those for samples have no matrix."""
    if name == SAMPLES:
        return [Case(method) for method in methods_for_samples()]
    return cases_of(problem(name, 1).ensemble.scene, None, ("quat", "dcm"), ("float64",))
