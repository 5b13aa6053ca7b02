"""Torque models: the numbers that a user gives, and their formulas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.scene.models import (
    Number,
    PackedLaw,
    PositiveNumber,
    Resources,
    TabledMomentum,
    TabledVector,
    UserModel,
    Vector3,
    resources_of,
)
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_record import Dependence, Pose, Torque
from fastatt.tracing.called import nested, points
from fastatt.tracing.formulas import Vector, as_like, dot, minus, rigid, scale, vec3
from fastatt.tracing.graph import apply
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.user import UserFunction, user_function


class Constant(Torque):
    """A torque along body axes, such as a thruster's: (3,), (N, 3) or a table, N·m."""

    torque: TabledVector
    depends = Dependence.POSITION

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return self.torque


class ConstantInertial(Torque):
    """A torque along inertial axes: (3,), (N, 3) or a table, N·m."""

    torque: TabledVector
    depends = Dependence.POSITION
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return pose.to_body(self.torque)


class Damping(Torque):
    """Linear damping τ = −c w. ``coefficient`` c: a number or (N,), N·m·s."""

    coefficient: Number
    depends = Dependence.DAMPED
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return rigid.damping(pose.w, self.linear_damping())

    def linear_damping(self) -> Any:
        return (self.coefficient,) * 3

    def decay(self) -> Any:
        return np.abs(self.coefficient)


class AxisDamping(Torque):
    """Linear damping, a coefficient an axis: τ_i = −c_i w_i. (3,) or (N, 3), N·m·s."""

    coefficients: Vector3
    depends = Dependence.DAMPED

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return rigid.damping(pose.w, self.coefficients)

    def linear_damping(self) -> Any:
        return self.coefficients

    def decay(self) -> Any:
        return np.abs(np.asarray(self.coefficients)).max(axis=-1)


class QuadraticDamping(Torque):
    """Quadratic damping τ = −c |w| w. ``coefficient`` c: a number or (N,), N·m·s²."""

    coefficient: Number
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return rigid.quadratic_damping(pose.w, self.coefficient)


class GravityGradient(Torque):
    """τ = 3 n² o×(I o) in a circular orbit of mean motion n, o the direction out from the planet.

    At t = 0 o lies along ``radial``, a quarter of an orbit later along ``along``, both inertial
    unit vectors. Numbers or a row per body; rad/s. Hughes, *Spacecraft Attitude Dynamics* (1986),
    §8.1.
    """

    mean_motion: Number
    radial: Vector3 = (1.0, 0.0, 0.0)
    along: Vector3 = (0.0, 1.0, 0.0)
    depends = Dependence.POSITION
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        o = pose.to_body(rigid.orbit_direction(t, self.mean_motion, self.radial, self.along))
        return rigid.gravity_gradient(o, pose.moments, self.mean_motion)

    def check(self, name: str) -> None:
        _check_orbit(name, self.mean_motion, "radial", self.radial, self.along)


class KeplerGravityGradient(Torque):
    """τ = 3 n² (a/r)³ o×(I o) in an elliptic orbit of mean motion n.

    o, the direction out from the planet, lies at periapsis along ``periapsis``, and turns towards
    ``along``: inertial unit vectors; ``mean_anomaly`` (rad) is that at t = 0. Numbers or a row per
    body; rad/s; ``eccentricity`` from 0 to 0.9. Hughes (1986), eq. 8.1.13.
    """

    mean_motion: Number
    eccentricity: Number
    periapsis: Vector3 = (1.0, 0.0, 0.0)
    along: Vector3 = (0.0, 1.0, 0.0)
    mean_anomaly: Number = 0.0
    depends = Dependence.POSITION
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        anomaly = self.mean_motion * t + self.mean_anomaly
        o, nearness = rigid.kepler_direction(anomaly, self.eccentricity, self.periapsis, self.along)
        # n² a³/r³ in place of n²
        rate = self.mean_motion * nearness * apply("sqrt", nearness)
        return rigid.gravity_gradient(pose.to_body(o), pose.moments, rate)

    def check(self: Any, name: str) -> None:
        e = self.eccentricity
        checks.refuse(f"{name}.eccentricity", e, (e < 0.0) | (e > 0.9), "0 to 0.9")
        _check_orbit(name, self.mean_motion, "periapsis", self.periapsis, self.along)


class GravityGradientAt(Torque):
    """τ = 3 (μ/r³) o×(I o) at ``position`` r o, m, from the planet's centre along inertial axes.

    ``position``: (3,), (N, 3) or a table; μ, m³/s², a number or (N,), that of the Earth (IERS
    Conventions 2010, table 1.1) unless said. Hughes (1986), eq. 8.1.13.
    """

    position: TabledVector
    gravitational_parameter: PositiveNumber = 3.986004418e14
    depends = Dependence.POSITION
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return _gravity_gradient(self.position, self.gravitational_parameter, pose)


class CentralGravityGradient(Torque):
    """τ = 3 (μ/r³) o×(I o) at the position r o that the scene carries, m, from the planet's centre.

    ``gravitational_parameter`` μ, m³/s²: a number or (N,), that of the Earth (IERS Conventions
    2010, table 1.1) unless said. Hughes (1986), eq. 8.1.13. The scene has mass and a force, such as
    ``fastatt.forces.CentralGravity``; methods whose record says ``couples`` take it.
    """

    gravitational_parameter: PositiveNumber = 3.986004418e14
    depends = Dependence.POSITION
    axis_free = True
    reads_position = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return _gravity_gradient(pose.beside.position, self.gravitational_parameter, pose)


class HeavyTop(Torque):
    """A weight off the fixed point: τ = r × Cᵀ(0, 0, −W).

    ``arm`` r: (3,) or (N, 3), from the fixed point to the centre of mass, m, body axes; ``weight``
    W: N, along −z of inertial axes. Inertia is that about the fixed point.
    """

    arm: Vector3
    weight: Number
    depends = Dependence.POSITION

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        # half of the vertical: the doubling is done to what stays
        return vec3.cross(vec3.scale(-2.0 * self.weight, self.arm), pose.to_body((0.0, 0.0, 0.5)))

    def energy(self: Any, t: Any, pose: Pose) -> Any:
        return self.weight * dot(self.arm, pose.to_body((0.0, 0.0, 1.0)))

    def lever(self) -> Any:
        return self.arm, (0.0, 0.0, self.weight)


class MagneticDipole(Torque):
    """τ = μ × CᵀB. ``dipole`` μ: A·m², body axes; ``field`` B: T, inertial axes.

    Each (3,), (N, 3) or a table.
    """

    dipole: TabledVector
    field: TabledVector
    depends = Dependence.POSITION

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return vec3.cross(self.dipole, pose.to_body(self.field))

    def energy(self: Any, t: Any, pose: Pose) -> Any:
        return -dot(self.dipole, pose.to_body(self.field))

    def lever(self: Any) -> Any:
        return self.dipole, -self.field


class Rotor(Torque):
    """Wheels of momentum h in the body (gyrostat): τ = h×w − dh/dt.

    ``momentum``: (3,) or (N, 3), constant, or a cubic table, N·m·s, body axes. ``inertia`` is the
    whole body's, wheels held. Hughes (1986), §6.1.
    """

    momentum: TabledMomentum

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        momentum, slope = self.momentum
        gyroscopic = vec3.cross(momentum, pose.w)
        return minus(gyroscopic, slope) if slope else gyroscopic

    def energy(self, t: Any, pose: Pose) -> Any:
        return 0.0

    def wheel_momentum(self) -> Any:
        return self.momentum


class Sampled(Torque):
    """A history of torques along body axes, linear between samples.

    ``torques``: (n, 3), N·m, at times start, start + dt, …; one history for all bodies. A step of
    a whole fraction of ``dt`` keeps the order of a method: the history has a kink at each sample.
    ``outside`` says what other times give, as of ``fastatt.TimeSeries``: "nan", which ends as a
    body's status, or "hold", the nearest sample.
    """

    torques: ArrayLike
    dt: float
    start: float = 0.0
    outside: str = "nan"

    def pack(self, n_bodies: int | None, argument: str, resources: Resources) -> PackedLaw:
        name = f"{argument}: Sampled"
        samples = checks.array(f"{name}.torques", self.torques, "(n, 3)")
        if len(samples) < 2:
            raise ValueError(f"{name}.torques has 1 sample; accepted: at least 2")
        dt = checks.above_zero(f"{name}.dt", self.dt, "above 0")
        start = checks.real(f"{name}.start", self.start)
        outside = checks.choice(f"{name}.outside", self.outside, ("nan", "hold"))
        times = start + dt * np.arange(len(samples))
        table = TimeSeries(times, samples, kind="linear", outside=outside)
        return Constant(table).pack(n_bodies, argument, resources)


class Custom(UserModel, Torque):
    """A user's ``@njit`` function ``torque(t, q, w, p) -> (t1, t2, t3)``, N·m along body axes.

    t in s, q and w as tuples, p the tuple of ``params``, (P,) or (N, P). ``uses_rate=False``
    promises that w is not used, which is checked at a few points and opens the splitting methods;
    ``potential(t, q, p)``, J, an ``@njit`` function too, is what ``drift`` takes the energy from.

    With ``uses_position`` it is ``torque(t, q, w, v, r, p)``, of a scene with mass: v the velocity,
    m/s, body axes, r the position, m, inertial axes. All is then stepped as one system, by methods
    whose record says ``couples``; ``potential(t, q, r, p)`` is that of torque and force together.

    With ``states``, a number, the function carries so many numbers of its own, s: it is
    ``torque(t, q, w, s, p) -> (torque, ds/dt)``, s after r where it takes the position, and is
    stepped as one system too.
    """

    uses_rate: bool = True
    potential: Callable[..., Any] | None = None
    uses_position: bool = False
    states: int = 0  # type: ignore[misc]

    @property
    def depends(self) -> Dependence:  # type: ignore[override]
        return Dependence.RATE if self.uses_rate else Dependence.POSITION

    @property
    def energy(self) -> Any:
        return None if self.potential is None else self._energy

    def _energy(self: Any, t: Any, pose: Pose) -> Any:
        return self.potential.given(t, pose.quaternion, pose.beside.position, self.params)

    def formula(self: Any, t: Any, pose: Pose, *states: Vector) -> Any:
        placed = pose.beside[:2] if self.uses_position else ()
        found = self.function.call(t, pose.quaternion, pose.w, *placed, *states, self.params)
        return as_like(found, pose.moments[0])

    def pack(self, n_bodies: int | None, argument: str, resources: Resources) -> PackedLaw:
        law, params = super().pack(n_bodies, argument, resources)
        function = law.model.function
        # where the scene is made, not at each run of it
        if not self.uses_rate and n_bodies is None and _uses_rate(function, params):
            raise ValueError(
                f"{argument}: found Custom.uses_rate False with {function.name}, which gives other "
                "torques at some w than at w = 0; accepted: True, or a function that does not use w"
            )
        if self.potential is not None:
            form = self.form.replace("torque", "potential")
            energy = user_function(self.potential, form, law.count, params)
            resources.update(resources_of(energy))
            law = replace(law, model=replace(law.model, potential=energy))
        return law, params


class _NoTorque(Torque):
    """A free body."""

    depends = Dependence.POSITION
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return 0.0, 0.0, 0.0

    def energy(self, t: Any, pose: Pose) -> Any:
        return 0.0


FREE = _NoTorque()
# by how much given unit vectors may be off
_ROUNDED = 1e-3


def check_unit(name: str, value: Any, strength: Any) -> None:
    """Refuse another length than 1, give or take the rounding of few digits, where it matters."""
    with np.errstate(over="ignore"):
        size = np.linalg.norm(value, axis=0)
    off = (strength != 0.0) & (np.abs(size - 1.0) > _ROUNDED)
    checks.refuse(f"{name}: its length", size, off, "1")


def _check_orbit(name: str, n: Any, first: str, out: Any, along: Any) -> None:
    """Refuse an orbit of mean motion n that is not given by two unit vectors at right angles."""
    check_unit(f"{name}.{first}", out, n)
    check_unit(f"{name}.along", along, n)
    across = (np.clip(out, -1.0, 1.0) * np.clip(along, -1.0, 1.0)).sum(axis=0)
    off = (n != 0.0) & (np.abs(across) > _ROUNDED)
    checks.refuse(f"{name}.{first}·along", across, off, "0, vectors at right angles")


def _gravity_gradient(r: Any, gravitational_parameter: Any, pose: Pose) -> Any:
    """The torque of a point mass at a position r, m, from it along inertial axes."""
    inverse = 1.0 / apply("sqrt", dot(r, r))
    rate = apply("sqrt", gravitational_parameter * inverse) * inverse
    return rigid.gravity_gradient(pose.to_body(scale(inverse, r)), pose.moments, rate)


def _uses_rate(function: UserFunction, params: NDArray[np.float64]) -> bool:
    """Whether a user's torque at a few points differs from that at a standstill."""
    for point in points(function.sizes, params, function.span):
        t, q, w, *rest = nested(point, function.sizes)
        values = []
        for v in (w, (0.0, 0.0, 0.0)):
            try:
                values.append(function.call(t, q, v, *rest))
            except TraceError:  # an error in Python at these numbers
                values.append((np.nan,) * function.form.results)
        turning, still = np.array(values)
        size = np.max(np.abs(still), where=np.isfinite(still), initial=0.0)
        if not np.allclose(turning, still, rtol=0.0, atol=1e-9 * size, equal_nan=True):
            return True
    return False
