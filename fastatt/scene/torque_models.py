"""Torque models: the numbers that a user gives of what turns a body."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from fastatt.scene.time_series import TimeSeries


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
    """Attitude controller τ = −k sgn(e0) (e1, e2, e3) − c w with e = target*∘q.

    ``stiffness`` k, N·m, ``damping`` c, N·m·s: numbers or (N,); ``target``: (4,) or (N, 4), unit,
    or a table, whose signs go on from sample to sample. The rate of a target that moves, seen from
    the body, is then taken off w. Where e0 passes 0 the torque jumps: across it a step of any
    method is of order 1. Wie, *Space Vehicle Dynamics and Control* (2008), §7.3.
    """

    stiffness: ArrayLike
    damping: ArrayLike
    target: ArrayLike | TimeSeries = (1.0, 0.0, 0.0, 0.0)


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
    promises that w is not used, which opens the splitting methods (and is looked into at a few
    points); ``potential(t, q, p)``, J, an
    ``@njit`` function too, is what ``drift`` takes the energy from.

    With ``uses_position`` it is ``torque(t, q, w, v, r, p)``, of a scene with mass: v the velocity,
    m/s, body axes, r the position, m, inertial axes. All is then stepped as one system, by methods
    whose record says ``couples``; ``potential(t, q, r, p)`` is that of torque and force together.
    """

    function: Callable[..., Any]
    params: ArrayLike | None = None
    uses_rate: bool = True
    potential: Callable[..., Any] | None = None
    uses_position: bool = False
