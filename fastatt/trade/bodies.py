"""Ensembles of rigid bodies: free, heavy tops, and under torques that only general methods take."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import exact, torques
from fastatt.arrays import angle_between, euler313_to_quat
from fastatt.engine.pool import progress_bar
from fastatt.propagate import methods_for, propagate
from fastatt.scene import Scene
from fastatt.trade.measure import Case, Problem, Row, ladder_rows, measure

T_END = 10.0
TRIAXIAL = (2.0, 1.0, 2.0 / 3.0)
FREE = Scene(inertia=TRIAXIAL)
# inertia about the fixed point, 0.1 m from the centre of mass
TOP = Scene(inertia=(1.0, 1.0, 0.5), torque=torques.HeavyTop(arm=(0.0, 0.0, 0.1), weight=10.0))
TORQUED = Scene(
    inertia=TRIAXIAL,
    torque=torques.Sum(
        (
            torques.GravityGradient(mean_motion=0.3),
            torques.Damping(0.02),
            torques.Rotor((0.1, 0.2, 0.3)),
        )
    ),
)
BODY_SCENES: Mapping[str, Scene] = MappingProxyType({"free": FREE, "top": TOP, "torqued": TORQUED})
# steps of rk8 as a reference: on no ladder, or its error there would be 0
_FINE = 1000
CLOSED_FORM = "exact"
_MATRIX = ("rk4", "rkmk4", "kahan_li6", "dmv6")
_SINGLE = ("rk4", "strang2", "dmv2")

_State = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class BodyScene:
    """An ensemble with a reference, and the end (q, w) of another method that confirms it."""

    problem: Problem
    title: str
    reference: str
    confirmation: str
    confirmed: _State

    @property
    def reference_error(self) -> NDArray[np.float64]:
        """Angles between the reference and what confirms it, rad, (N,)."""
        return np.asarray(angle_between(self.confirmed[0], self.problem.q_end))

    def describe(self) -> str:
        """What the errors are measured against, and how good that is itself."""
        error = self.reference_error
        return (
            f"{self.title}, {error.size} bodies over {self.problem.t_end:g} s; reference: "
            f"{self.reference}; {self.confirmation} differs from it by {np.median(error):.1e} rad "
            f"(median), {error.max():.1e} rad (worst)"
        )


def _momenta(n_bodies: int) -> NDArray[np.float64]:
    """Of size 1 in all directions, (N, 3)."""
    m = np.random.default_rng(1).normal(size=(n_bodies, 3))
    return np.asarray(m / np.linalg.norm(m, axis=1, keepdims=True))


def _aligned(n_bodies: int) -> NDArray[np.float64]:
    return np.tile([1.0, 0.0, 0.0, 0.0], (n_bodies, 1))


def _end(scene: Scene, q0: NDArray[Any], w0: NDArray[Any], method: str, n_steps: int) -> _State:
    run = propagate(scene, q0, w0, dt=T_END / n_steps, n_steps=n_steps, method=method)
    return run.q[-1], run.w[-1]


def _free_bodies(n_bodies: int) -> BodyScene:
    """Momenta of size 1 in all directions."""
    q0, w0 = _aligned(n_bodies), _momenta(n_bodies) / TRIAXIAL
    q, w = exact.free_body(q0, w0, TRIAXIAL, T_END)
    return BodyScene(
        Problem("free", FREE, q0, w0, T_END, q, w),
        "Free bodies",
        reference="the closed form",
        confirmation=f"dmv10 at {T_END / 200:g} s",
        confirmed=_end(FREE, q0, w0, "dmv10", 200),
    )


def _heavy_tops(n_bodies: int) -> BodyScene:
    """Nutating tops, tilted by 0.3 to 1.2 rad, with a spin of 3 to 6 rad/s."""
    generator = np.random.default_rng(2)
    turn, spin = generator.uniform(0.0, 2.0 * np.pi, (2, n_bodies))
    tilt = generator.uniform(0.3, 1.2, n_bodies)
    q0 = euler313_to_quat(np.stack([turn, tilt, spin], axis=1))
    across = generator.normal(scale=0.3, size=(n_bodies, 2))
    w0 = np.column_stack([across, generator.uniform(3.0, 6.0, n_bodies)])
    return BodyScene(
        Problem("top", TOP, q0, w0, T_END, *_end(TOP, q0, w0, "rk8", _FINE)),
        "Heavy symmetric tops",
        reference=f"rk8 at {T_END / _FINE:g} s",
        confirmation=f"kahan_li8 at {T_END / 200:g} s",
        confirmed=_end(TOP, q0, w0, "kahan_li8", 200),
    )


def _torqued_bodies(n_bodies: int) -> BodyScene:
    """The free bodies' starts; no splitting takes the wheel."""
    q0, w0 = _aligned(n_bodies), _momenta(n_bodies) / TRIAXIAL
    coarse, fine = (_end(TORQUED, q0, w0, "rkmk4", n) for n in (1600, 3200))
    return BodyScene(
        Problem("torqued", TORQUED, q0, w0, T_END, *_end(TORQUED, q0, w0, "rk8", _FINE)),
        "Bodies with gravity gradient, damping and a wheel",
        reference=f"rk8 at {T_END / _FINE:g} s",
        confirmation=f"rkmk4 extrapolated from {T_END / 1600:g} and {T_END / 3200:g} s",
        confirmed=_extrapolated(coarse, fine),
    )


def _extrapolated(coarse: _State, fine: _State) -> _State:
    """Richardson's extrapolation of a method of order 4 from a step and its half."""
    same = np.sign(np.einsum("ni,ni->n", coarse[0], fine[0]))[:, None]
    q = (16.0 * fine[0] - same * coarse[0]) / 15.0
    w = (16.0 * fine[1] - coarse[1]) / 15.0
    return q / np.linalg.norm(q, axis=1, keepdims=True), w


_ENSEMBLES: dict[str, Callable[[int], BodyScene]] = {
    "free": _free_bodies,
    "top": _heavy_tops,
    "torqued": _torqued_bodies,
}


def body_scene(name: str, n_bodies: int) -> BodyScene:
    """The ensemble of a name of ``BODY_SCENES``, its reference propagated."""
    return _ENSEMBLES[name](n_bodies)


def body_cases(scene: Scene) -> list[Case]:
    """Every method on quaternions in float64, some on matrices, some in float32."""
    cases = []
    for name in methods_for(scene):
        cases.append(Case(name))
        if name in _MATRIX:
            cases.append(Case(name, "dcm"))
        if name in _SINGLE:
            cases.append(Case(name, dtype="float32"))
    return cases


def body_trade(
    bodies: BodyScene,
    steps: Sequence[int],
    repeats: int,
    bar: bool,
    cases: Sequence[Case] | None = None,
) -> list[Row]:
    """Cases, or those of ``body_cases``, over a ladder of numbers of steps.

    The closed form needs no steps: it has one row, and where it is the reference itself, its error
    is measured against what confirms it.
    """
    wanted = body_cases(bodies.problem.scene) if cases is None else cases
    q, w = bodies.confirmed
    rows: list[Row] = []
    with progress_bar(bar, len(wanted), "method") as done:
        for case in wanted:
            problem, ladder = bodies.problem, steps
            if case.method == CLOSED_FORM:
                problem, ladder = replace(problem, q_end=q, w_end=w), (1,)
            rungs = [measure(problem, case, n, repeats) for n in ladder]
            rows += ladder_rows(problem.name, case, T_END, rungs)
            done(1)
    return rows
