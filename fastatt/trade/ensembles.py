"""Ensembles with a known answer: coning bodies, free ones, heavy tops, bodies under torques."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import angle_between, euler313_to_quat, quat_multiply
from fastatt.attitudes import ATTITUDES
from fastatt.gyro.integrate import integrate_rates, methods_for_samples
from fastatt.methods import METHODS
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.rounding import noted
from fastatt.scene import rates, torques
from fastatt.scene.scene import Scene
from fastatt.threads import progress_bar
from fastatt.trade.measure import Case, Problem, Row, Rung, State, best_time, ladder_rows
from fastatt.trade.reference import Confirmation, Reference, confirm, coning_attitudes, reference
from fastatt.trade.work_precision import DTYPES, case_rows, cases_of

CONING_T_END, BODY_T_END = 20.0, 10.0
CONING = "coning"
RATE, SAMPLES = "rate function", "samples"
# an inertial frame askew of the cone: about its own axis 3-1-3 angles are exact by accident
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
    """An ensemble with a reference and, of bodies, the end of another method that confirms it."""

    heading: str
    problem: Problem
    known: Reference
    check: Confirmation | None = None

    def rows(
        self,
        cases: Mapping[str, Sequence[Case]],
        steps: Sequence[int],
        repeats: int,
        *,
        progress: bool = False,
    ) -> dict[str, list[Row]]:
        """Cases over a ladder of numbers of steps, by the kind of input."""
        found: dict[str, list[Row]] = {source: [] for source in cases}
        with progress_bar(progress, sum(map(len, cases.values())), "method") as done:
            for source, of_source in cases.items():
                for case in of_source:
                    found[source] += self._ladder(source, case, steps, repeats)
                    done(1)
        return found

    def _ladder(self, source: str, case: Case, steps: Sequence[int], repeats: int) -> list[Row]:
        if case.record.window is None:
            measured = self.problem, self.known, self.check
            return case_rows(source, *measured, case, repeats, steps=steps)
        rungs = [self._of_samples(case, n, repeats) for n in steps]
        return ladder_rows(source, case, self.problem.t_end, rungs)

    def _of_samples(self, case: Case, n: int, repeats: int) -> Rung:
        """What a method makes of samples of the coning rates."""
        e, t_end, data = self.problem.ensemble, self.problem.t_end, self._samples(n)
        with noted() as said:
            seconds, q = best_time(
                lambda: integrate_rates(data, t_end / n, e.q0, method=case.name), repeats
            )
        status = "past the method's limit" if said else ""
        return Rung(n, seconds, angle_between(q[:, -1], self.known.end.q), status=status)

    @cached_property
    def _samples(self) -> Callable[[int], NDArray[np.float64]]:
        """The coning rates at both ends of n intervals, which all methods share."""
        angle, frequency = self.problem.ensemble.scene.rate
        t_end = self.problem.t_end
        return cache(lambda n: coning_rates(angle, frequency, np.linspace(0.0, t_end, n + 1)))


# coning


def coning_rates(
    angle: NDArray[Any], frequency: NDArray[Any], t: NDArray[Any]
) -> NDArray[np.float64]:
    """Samples (N, n, 3) of the body rates of ``rates.Coning`` at times t (n,)."""
    a, f = angle[:, None], frequency[:, None]
    axial = np.broadcast_to(-2.0 * f * np.sin(0.5 * a) ** 2, (angle.size, t.size))
    return np.stack([-f * np.sin(a) * np.sin(f * t), f * np.sin(a) * np.cos(f * t), axial], axis=-1)


def _coning(n_bodies: int) -> Study:
    generator = np.random.default_rng(1)
    angle = generator.uniform(0.2, 1.5, n_bodies)
    frequency = generator.uniform(0.5, 2.0, n_bodies)
    q0 = quat_multiply(TILT, coning_attitudes(angle, frequency, np.zeros(1))[0])
    problem = Problem(Ensemble(Scene(rate=rates.Coning(angle, frequency)), q0), CONING_T_END)
    over = f"over {CONING_T_END:g} s, against the exact attitude"
    return Study(f"Ensemble of {n_bodies} coning bodies {over}", problem, reference(problem))


# rigid bodies


def _tilted_tops(n_bodies: int) -> State:
    """Nutating tops, tilted by 0.3 to 1.2 rad, with a spin of 3 to 6 rad/s."""
    generator = np.random.default_rng(2)
    turn, spin = generator.uniform(0.0, 2.0 * np.pi, (2, n_bodies))
    tilt = generator.uniform(0.3, 1.2, n_bodies)
    q0 = euler313_to_quat(np.stack([turn, tilt, spin], axis=1))
    across = generator.normal(scale=0.3, size=(n_bodies, 2))
    return State(q0, np.column_stack([across, generator.uniform(3.0, 6.0, n_bodies)]))


def _aligned(n_bodies: int) -> State:
    """Momenta of size 1 in all directions."""
    m = np.random.default_rng(1).normal(size=(n_bodies, 3))
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    return State(np.tile([1.0, 0.0, 0.0, 0.0], (n_bodies, 1)), m / TRIAXIAL)


_BODIES: dict[str, tuple[str, Callable[[int], State]]] = {
    "free": ("Free bodies", _aligned),
    "top": ("Heavy symmetric tops", _tilted_tops),
    "torqued": ("Bodies with gravity gradient, damping and a wheel", _aligned),
}


def study(name: str, n_bodies: int) -> Study:
    """Coning bodies, or those of a name of ``BODY_SCENES``, whose reference is confirmed."""
    if name == CONING:
        return _coning(n_bodies)
    title, starts = _BODIES[name]
    problem = Problem(Ensemble(BODY_SCENES[name], *starts(n_bodies)), BODY_T_END)
    known = reference(problem)
    check = confirm(problem, known)
    return Study(
        f"{title}, {n_bodies} bodies over {BODY_T_END:g} s; reference: {known.source}; {check}",
        problem, known, check,
    )  # fmt: skip


def cases(name: str) -> dict[str, list[Case]]:
    """What is run of a study, by the kind of input: every method, some on several representations.

    In single precision they are run on quaternions alone.
    """
    if name == CONING:
        every = cases_of(Scene(rate=rates.Coning(1.0, 1.0)), None, list(ATTITUDES), DTYPES)
        of_function = [c for c in every if c.dtype == "float64" or c.representation == "quat"]
        return {RATE: of_function, SAMPLES: [Case(m) for m in methods_for_samples()]}
    kinds = ("quat", "float64"), ("dcm", "float64"), ("quat", "float32")
    return {
        name: [
            Case(method, stored, dtype)
            for method in methods_for(BODY_SCENES[name])
            for stored, dtype in kinds
            if stored in METHODS[method].representations
        ]
    }
