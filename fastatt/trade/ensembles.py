"""Ensembles with known solutions: coning, free bodies, heavy tops, torques, sampled rates."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt._cached import cached_property
from fastatt.arrays import angle_between, euler313_to_quat, quat_multiply
from fastatt.gyro.integrate import integrate_rates, methods_for_samples
from fastatt.propagation.ensemble import Ensemble
from fastatt.rounding import noted
from fastatt.scene import rates, torques
from fastatt.scene.scene import Scene
from fastatt.trade.measure import Case, Problem, Row, row_of
from fastatt.trade.timing import once
from fastatt.trade.work_precision import Study, cases_of, coarsest

SAMPLES = "samples"
_STEPS = 2.5  # a second, of the grid of ladders
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


class OfSamples(Study):
    """Methods for samples, which take coning rates at the ends of the steps."""

    def row(self, case: Case, n: int) -> Row:
        """A method in n intervals."""
        call = self.call(case, n)
        call()  # compiles
        seconds, (q, said) = once(call)
        status = "past the method's limit" if said else ""
        error = angle_between(q[:, -1], self.known.end.q)
        return row_of(self.name, case, self.problem.duration, n, seconds, error, status=status)

    def call(self, case: Case, n: int) -> Callable[[], Any]:
        """All attitudes, and whether there are warnings of large steps."""
        samples, dt, q0 = self._samples(n), self.problem.duration / n, self.problem.ensemble.q0

        def integrate() -> tuple[NDArray[Any], bool]:
            with noted() as said:
                q = integrate_rates(samples, dt, q0, method=case.name, n_threads=1)
            return q, bool(said)

        return integrate

    @cached_property
    def _samples(self) -> Callable[[int], NDArray[np.float64]]:
        """Rates at the ends of n intervals, the same for all methods."""
        rate, duration = self.problem.ensemble.scene.rate, self.problem.duration
        return cache(
            lambda n: coning_rates(rate.angle, rate.frequency, np.linspace(0.0, duration, n + 1))
        )


def steps(problem: Problem, case: Case, per_doubling: int) -> list[int]:
    """Numbers of steps of a case's ladder, from the coarsest that it allows on.

    They are those of one grid for all cases, with 2.5 steps a second, and so many more for each
    doubling.
    """
    least = 4 if case.record.window else coarsest(problem, case)
    middle = _STEPS * problem.duration
    grid = [round(middle * 2.0 ** (k / per_doubling)) for k in range(-8, 14 * per_doubling)]
    return [n for n in grid if n >= least]


# coning


def coning_attitudes(
    angle: NDArray[np.float64], frequency: NDArray[np.float64], t: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Exact attitudes (S, N, 4) of ``rates.Coning`` bodies at times t (S,)."""
    phase = frequency * t[:, None]
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    columns = [c, s * np.cos(phase), s * np.sin(phase), 0.0 * phase]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


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
    study, bodies = OfSamples if name == SAMPLES else Study, problem(name, n_bodies)
    title = f"{bodies.ensemble.size} {_ENSEMBLES[name][0]}"
    return study.of(name, title, bodies)


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
