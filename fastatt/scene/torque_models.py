"""Torque models: the numbers that a user gives of what turns a body, and their formulas."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.scene.models import Field
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_record import Dependence, Pose, TorqueRecord
from fastatt.tracing.formulas import dot, minus, rigid, scale, vec3
from fastatt.tracing.graph import apply


class Constant(NamedTuple):
    """A torque along body axes, such as a thruster's: (3,), (N, 3) or a table, N·m."""

    torque: ArrayLike | TimeSeries


class ConstantInertial(NamedTuple):
    """A torque along inertial axes: (3,), (N, 3) or a table, N·m."""

    torque: ArrayLike | TimeSeries


class Damping(NamedTuple):
    """Linear damping τ = −c w. ``coefficient`` c: a number or (N,), N·m·s."""

    coefficient: ArrayLike


class AxisDamping(NamedTuple):
    """Linear damping, a coefficient an axis: τ_i = −c_i w_i. (3,) or (N, 3), N·m·s."""

    coefficients: ArrayLike


class QuadraticDamping(NamedTuple):
    """Quadratic damping τ = −c |w| w. ``coefficient`` c: a number or (N,), N·m·s²."""

    coefficient: ArrayLike


class GravityGradient(NamedTuple):
    """τ = 3 n² o×(I o) in a circular orbit of mean motion n, o the direction out from the planet.

    At t = 0 o lies along ``radial``, a quarter of an orbit later along ``along``, both inertial
    unit vectors. Numbers or a row per body; rad/s. Hughes, *Spacecraft Attitude Dynamics* (1986),
    §8.1.
    """

    mean_motion: ArrayLike
    radial: ArrayLike = (1.0, 0.0, 0.0)
    along: ArrayLike = (0.0, 1.0, 0.0)


class KeplerGravityGradient(NamedTuple):
    """τ = 3 n² (a/r)³ o×(I o) in an elliptic orbit of mean motion n.

    o, the direction out from the planet, lies at periapsis along ``periapsis``, and turns towards
    ``along``: inertial unit vectors; ``mean_anomaly`` (rad) is that at t = 0. Numbers or a row per
    body; rad/s; ``eccentricity`` from 0 to 0.9. Hughes (1986), eq. 8.1.13.
    """

    mean_motion: ArrayLike
    eccentricity: ArrayLike
    periapsis: ArrayLike = (1.0, 0.0, 0.0)
    along: ArrayLike = (0.0, 1.0, 0.0)
    mean_anomaly: ArrayLike = 0.0


class GravityGradientAt(NamedTuple):
    """τ = 3 (μ/r³) o×(I o) at ``position`` r o, m, from the planet's centre along inertial axes.

    ``position``: (3,), (N, 3) or a table; μ, m³/s², a number or (N,), that of the Earth (IERS
    Conventions 2010, table 1.1) unless said. Hughes (1986), eq. 8.1.13.
    """

    position: ArrayLike | TimeSeries
    gravitational_parameter: ArrayLike = 3.986004418e14


class CentralGravityGradient(NamedTuple):
    """τ = 3 (μ/r³) o×(I o) at the position r o that the scene carries, m, from the planet's centre.

    ``gravitational_parameter`` μ, m³/s²: a number or (N,), that of the Earth (IERS Conventions
    2010, table 1.1) unless said. Hughes (1986), eq. 8.1.13. The scene has mass and a force, such as
    ``fastatt.forces.CentralGravity``; methods whose record says ``couples`` take it.
    """

    gravitational_parameter: ArrayLike = 3.986004418e14


class HeavyTop(NamedTuple):
    """A weight off the fixed point: τ = r × Cᵀ(0, 0, −W).

    ``arm`` r: (3,) or (N, 3), from the fixed point to the centre of mass, m, body axes; ``weight``
    W: N, along −z of inertial axes. Inertia is that about the fixed point.
    """

    arm: ArrayLike
    weight: ArrayLike


class MagneticDipole(NamedTuple):
    """τ = μ × CᵀB. ``dipole`` μ: A·m², body axes; ``field`` B: T, inertial axes.

    Each (3,), (N, 3) or a table.
    """

    dipole: ArrayLike | TimeSeries
    field: ArrayLike | TimeSeries


class QuaternionPD(NamedTuple):
    """Attitude controller τ = −K sgn(e0) (e1, e2, e3) − D w with e = target*∘q.

    The rate of a target that moves, seen from the body, is taken off w. Where e0 passes 0 the
    torque jumps: across it a step of any method is of order 1. Wie, *Space Vehicle Dynamics and
    Control* (2008), §7.3.

    Parameters
    ----------
    stiffness : array_like
        K, N·m: a number, (3,) per body axis, or a (3, 3) matrix along body axes, symmetric and
        without negative eigenvalues. Of each body (N, 1, 1) or (N, 3, 3).
    damping : array_like
        D, N·m·s, in the same shapes.
    target : array_like or TimeSeries
        (4,) or (N, 4), unit quaternions, or a table, whose signs go on from sample to sample.
    limit : array_like, optional
        Largest torque along each body axis, N·m, above 0: a number, (3,), (N, 1) or (N, 3).

    Examples
    --------
    >>> import fastatt as fa
    >>> pd = fa.torques.QuaternionPD((2.0, 1.0, 1.0), 3.0, limit=0.1)
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=pd)
    """

    stiffness: ArrayLike
    damping: ArrayLike
    target: ArrayLike | TimeSeries = (1.0, 0.0, 0.0, 0.0)
    limit: ArrayLike | None = None


class Rotor(NamedTuple):
    """Wheels of momentum h in the body (gyrostat): τ = h×w − dh/dt.

    ``momentum``: (3,) or (N, 3), constant, or a cubic table, N·m·s, body axes. ``inertia`` is the
    whole body's, wheels held. Hughes (1986), §6.1.
    """

    momentum: ArrayLike | TimeSeries


class Sampled(NamedTuple):
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


class Custom(NamedTuple):
    """A user's ``@njit`` function ``torque(t, q, w, p) -> (t1, t2, t3)``, N·m along body axes.

    t in s, q and w as tuples, p the tuple of ``params``, (P,) or (N, P). ``uses_rate=False``
    promises that w is not used, which is checked at a few points and opens the splitting methods;
    ``potential(t, q, p)``, J, an ``@njit`` function too, is what ``drift`` takes the energy from.

    With ``uses_position`` it is ``torque(t, q, w, v, r, p)``, of a scene with mass: v the velocity,
    m/s, body axes, r the position, m, inertial axes. All is then stepped as one system, by methods
    whose record says ``couples``; ``potential(t, q, r, p)`` is that of torque and force together.
    """

    function: Callable[..., Any]
    params: ArrayLike | None = None
    uses_rate: bool = True
    potential: Callable[..., Any] | None = None
    uses_position: bool = False


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


def _check_kepler(name: str, model: Any, m: Any) -> None:
    e = m.eccentricity
    checks.refuse(f"{name}.eccentricity", e, (e < 0.0) | (e > 0.9), "0 to 0.9")
    _check_orbit(name, m.mean_motion, "periapsis", m.periapsis, m.along)


def _no_potential(t: Any, pose: Pose, m: Any) -> float:
    return 0.0


def _gravity_gradient(t: Any, pose: Pose, m: Any) -> Any:
    o = pose.to_body(rigid.orbit_direction(t, m.mean_motion, m.radial, m.along))
    return rigid.gravity_gradient(o, pose.moments, m.mean_motion)


def _kepler_gravity_gradient(t: Any, pose: Pose, m: Any) -> Any:
    anomaly = m.mean_motion * t + m.mean_anomaly
    o, nearness = rigid.kepler_direction(anomaly, m.eccentricity, m.periapsis, m.along)
    # n² a³/r³ in place of n²
    rate = m.mean_motion * nearness * apply("sqrt", nearness)
    return rigid.gravity_gradient(pose.to_body(o), pose.moments, rate)


def _gravity_gradient_at(t: Any, pose: Pose, m: Any) -> Any:
    r = m.position
    inverse = 1.0 / apply("sqrt", dot(r, r))
    rate = apply("sqrt", m.gravitational_parameter * inverse) * inverse
    return rigid.gravity_gradient(pose.to_body(scale(inverse, r)), pose.moments, rate)


def _central_gravity_gradient(t: Any, pose: Pose, m: Any) -> Any:
    here = GravityGradientAt(pose.place[1], m.gravitational_parameter)
    return _gravity_gradient_at(t, pose, here)


def _heavy_top(t: Any, pose: Pose, m: Any) -> Any:
    # half of the vertical: the doubling is done to what stays
    return vec3.cross(vec3.scale(-2.0 * m.weight, m.arm), pose.to_body((0.0, 0.0, 0.5)))


def _rotor(t: Any, pose: Pose, m: Any) -> Any:
    momentum, slope = m.momentum
    gyroscopic = vec3.cross(momentum, pose.w)
    return minus(gyroscopic, slope) if slope else gyroscopic


_VECTOR, _NUMBER, _ABOVE_ZERO = Field((3,)), Field(), Field(above_zero=True)
_TABLED, _WITH_SLOPES = Field((3,), table="values"), Field((3,), table="slopes")
_POSITION, _DAMPED, _RATE = Dependence
FREE = TorqueRecord(
    None, (), lambda t, pose, m: (0.0, 0.0, 0.0), _POSITION, True, potential=_no_potential
)
_ALL = (
    TorqueRecord(Constant, (_TABLED,), lambda t, pose, m: m.torque, _POSITION, False),
    TorqueRecord(
        ConstantInertial, (_TABLED,), lambda t, pose, m: pose.to_body(m.torque), _POSITION, True
    ),
    TorqueRecord(
        Damping, (_NUMBER,), lambda t, pose, m: rigid.damping(pose.w, (m.coefficient,) * 3),
        _DAMPED, True,
        damping=lambda m: (m.coefficient,) * 3,
        decay=lambda m: np.abs(m.coefficient),
    ),
    TorqueRecord(
        AxisDamping, (_VECTOR,), lambda t, pose, m: rigid.damping(pose.w, m.coefficients),
        _DAMPED, False,
        damping=lambda m: m.coefficients,
        decay=lambda m: np.abs(np.asarray(m.coefficients)).max(axis=-1),
    ),
    TorqueRecord(
        QuadraticDamping, (_NUMBER,),
        lambda t, pose, m: rigid.quadratic_damping(pose.w, m.coefficient), _RATE, True,
    ),
    TorqueRecord(
        GravityGradient, (_NUMBER, _VECTOR, _VECTOR), _gravity_gradient, _POSITION, True,
        check=lambda name, _, m: _check_orbit(name, m.mean_motion, "radial", m.radial, m.along),
    ),
    TorqueRecord(
        KeplerGravityGradient, (_NUMBER, _NUMBER, _VECTOR, _VECTOR, _NUMBER),
        _kepler_gravity_gradient, _POSITION, True, check=_check_kepler,
    ),
    TorqueRecord(GravityGradientAt, (_TABLED, _ABOVE_ZERO), _gravity_gradient_at, _POSITION, True),
    TorqueRecord(
        CentralGravityGradient, (_ABOVE_ZERO,), _central_gravity_gradient, _POSITION, True,
        reads_position=True,
    ),
    TorqueRecord(
        HeavyTop, (_VECTOR, _NUMBER), _heavy_top, _POSITION, False,
        potential=lambda t, pose, m: m.weight * dot(m.arm, pose.to_body((0.0, 0.0, 1.0))),
        lever=lambda m: (m.arm, (0.0, 0.0, m.weight)),
    ),
    TorqueRecord(
        MagneticDipole, (_TABLED, _TABLED),
        lambda t, pose, m: vec3.cross(m.dipole, pose.to_body(m.field)), _POSITION, False,
        potential=lambda t, pose, m: -dot(m.dipole, pose.to_body(m.field)),
        lever=lambda m: (m.dipole, -m.field),
    ),
    TorqueRecord(
        Rotor, (_WITH_SLOPES,), _rotor, _RATE, False,
        potential=_no_potential, momentum=lambda m: m.momentum,
    ),
)  # fmt: skip
MODELS: dict[type, TorqueRecord] = {r.model: r for r in _ALL if r.model is not None}
