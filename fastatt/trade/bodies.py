"""Ensembles of rigid bodies: free, heavy tops, and under torques that only general methods take."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from fastatt import torques
from fastatt.arrays import euler313_to_quat
from fastatt.methods import METHODS
from fastatt.running.choosing import methods_for
from fastatt.running.ensemble import Ensemble
from fastatt.scene import Scene
from fastatt.threads import progress_bar
from fastatt.trade.measure import Case, Problem, Row, State
from fastatt.trade.reference import Confirmation, Reference, confirm, reference
from fastatt.trade.work_precision import case_rows

T_END = 10.0
TRIAXIAL = (2.0, 1.0, 2.0 / 3.0)
FREE = Scene(inertia=TRIAXIAL)
# inertia about the fixed point, 0.1 m from the centre of mass
TOP = Scene(inertia=(1.0, 1.0, 0.5), torque=torques.HeavyTop(arm=(0.0, 0.0, 0.1), weight=10.0))
_TORQUES = (
    torques.GravityGradient(mean_motion=0.3),
    torques.Damping(0.02),
    torques.Rotor((0.1, 0.2, 0.3)),
)
TORQUED = Scene(inertia=TRIAXIAL, torque=torques.Sum(_TORQUES))
BODY_SCENES: Mapping[str, Scene] = MappingProxyType({"free": FREE, "top": TOP, "torqued": TORQUED})


@dataclass(frozen=True)
class BodyScene:
    """An ensemble with a reference, and the end of another method that confirms it."""

    problem: Problem
    title: str
    known: Reference
    check: Confirmation

    def describe(self) -> str:
        """What the errors are measured against, and how good that is itself."""
        return (
            f"{self.title}, {self.check.apart.size} bodies over {self.problem.t_end:g} s; "
            f"reference: {self.known.source}; {self.check}"
        )


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


_ENSEMBLES: dict[str, tuple[str, Callable[[int], State]]] = {
    "free": ("Free bodies", _aligned),
    "top": ("Heavy symmetric tops", _tilted_tops),
    "torqued": ("Bodies with gravity gradient, damping and a wheel", _aligned),
}


def body_scene(name: str, n_bodies: int) -> BodyScene:
    """The ensemble of a name of ``BODY_SCENES``, its reference propagated and confirmed."""
    title, starts = _ENSEMBLES[name]
    problem = Problem(Ensemble(BODY_SCENES[name], *starts(n_bodies)), T_END)
    known = reference(problem)
    return BodyScene(problem, title, known, confirm(problem, known))


def body_cases(scene: Scene) -> list[Case]:
    """Every method on quaternions and on matrices, on quaternions in float32 besides."""
    return [
        Case(name, stored, dtype)
        for name in methods_for(scene)
        for stored, dtype in (("quat", "float64"), ("dcm", "float64"), ("quat", "float32"))
        if stored in METHODS[name].representations
    ]


def body_trade(
    name: str,
    bodies: BodyScene,
    steps: Sequence[int],
    repeats: int,
    bar: bool,
    cases: Sequence[Case],
) -> list[Row]:
    """Cases over a ladder of numbers of steps."""
    measured = (name, bodies.problem, bodies.known, bodies.check)
    rows: list[Row] = []
    with progress_bar(bar, len(cases), "method") as done:
        for case in cases:
            rows += case_rows(*measured, case, repeats, steps=steps)
            done(1)
    return rows
