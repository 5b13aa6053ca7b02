"""Euler's dynamic equations: momentum, energy and torques along principal body axes.

w is the angular velocity (rad/s) and m = I w the angular momentum (N·m·s), both along principal
body axes; ``inertia`` are the three principal moments (kg·m²). Goldstein, *Classical Mechanics*,
§5.5; Hughes, *Spacecraft Attitude Dynamics* (1986), chapters 4 and 8.
"""

import math

from fastatt._jit import kernel
from fastatt.kernels import quat
from fastatt.kernels.trig import powers_of_two, reduce_powers, short_waves, sincos
from fastatt.kernels.vec3 import add, cross, dot, scale

__all__ = [
    "acceleration", "damping", "gravity_gradient", "gyroscopic", "kinetic_energy",
    "kinetic_energy_symmetric", "momentum", "quadratic_damping", "quaternion_feedback",
    "saturated", "target_error",
]  # fmt: skip


@kernel
def momentum(w, inertia):
    """Angular momentum m = I w.

    Parameters
    ----------
    w : tuple of 3 float
        Angular velocity along principal axes, rad/s.
    inertia : tuple of 3 float
        Principal moments, kg·m².

    Returns
    -------
    tuple of 3 float
        Angular momentum, N·m·s.
    """
    return inertia[0] * w[0], inertia[1] * w[1], inertia[2] * w[2]


@kernel
def gyroscopic_coefficients(inertia):
    """Coefficients (1/I3 − 1/I2, 1/I1 − 1/I3, 1/I2 − 1/I1), without cancellation."""
    return (
        (inertia[1] - inertia[2]) / (inertia[1] * inertia[2]),
        (inertia[2] - inertia[0]) / (inertia[2] * inertia[0]),
        (inertia[0] - inertia[1]) / (inertia[0] * inertia[1]),
    )


@kernel
def gyroscopic(m, c):
    """Gyroscopic torque m×w = (c1 m2 m3, c2 m3 m1, c3 m1 m2).

    Parameters
    ----------
    m : tuple of 3 float
        Angular momentum along principal axes, N·m·s.
    c : tuple of 3 float
        Coefficients of :func:`gyroscopic_coefficients`.

    Returns
    -------
    tuple of 3 float
        Torque, N·m.
    """
    return c[0] * m[1] * m[2], c[1] * m[2] * m[0], c[2] * m[0] * m[1]


@kernel
def acceleration(w, inertia, torque):
    """Angular acceleration by Euler's equations, I1 ẇ1 + (I3 − I2) w2 w3 = τ1, cyclic.

    Parameters
    ----------
    w : tuple of 3 float
        Angular velocity along principal axes, rad/s.
    inertia : tuple of 3 float
        Principal moments, kg·m².
    torque : tuple of 3 float
        Torque along principal axes, N·m.

    Returns
    -------
    tuple of 3 float
        ẇ, rad/s².

    References
    ----------
    Hughes (1986), equation 4.1.3.
    """
    return (
        (torque[0] + (inertia[1] - inertia[2]) * w[1] * w[2]) / inertia[0],
        (torque[1] + (inertia[2] - inertia[0]) * w[2] * w[0]) / inertia[1],
        (torque[2] + (inertia[0] - inertia[1]) * w[0] * w[1]) / inertia[2],
    )


@kernel
def kinetic_energy(w, inertia):
    """Kinetic energy ½ w·I w.

    Parameters
    ----------
    w : tuple of 3 float
        Angular velocity along principal axes, rad/s.
    inertia : tuple of 3 float
        Principal moments, kg·m².

    Returns
    -------
    float
        Energy, J.
    """
    F = type(w[0])
    return F(0.5) * dot(w, momentum(w, inertia))


@kernel
def kinetic_energy_symmetric(angles, rates, inertia):
    """Kinetic energy of a symmetric top in 3-1-3 angles and their rates.

    Parameters
    ----------
    angles : tuple of 3 float
        (φ, θ, ψ), rad.
    rates : tuple of 3 float
        (φ̇, θ̇, ψ̇), rad/s.
    inertia : tuple of 2 float
        (I1, I3), kg·m².

    Returns
    -------
    float
        ½ I1 (φ̇² sin²θ + θ̇²) + ½ I3 (φ̇ cosθ + ψ̇)², J.
    """
    F = type(angles[1])
    s, c = sincos(angles[1])
    a = rates[0] * s
    b = rates[0] * c + rates[2]
    return F(0.5) * (inertia[0] * (a * a + rates[1] * rates[1]) + inertia[1] * b * b)


@kernel
def damping(w, coefficients):
    """Linear damping τ = −c w, axis by axis.

    Parameters
    ----------
    w : tuple of 3 float
        Angular velocity along principal axes, rad/s.
    coefficients : tuple of 3 float
        c, N·m·s.

    Returns
    -------
    tuple of 3 float
        Torque, N·m.
    """
    return -coefficients[0] * w[0], -coefficients[1] * w[1], -coefficients[2] * w[2]


@kernel
def quadratic_damping(w, coefficient):
    """Quadratic damping τ = −c ``|w|`` w.

    Parameters
    ----------
    w : tuple of 3 float
        Angular velocity along principal axes, rad/s.
    coefficient : float
        c, N·m·s².

    Returns
    -------
    tuple of 3 float
        Torque, N·m.
    """
    return scale(-coefficient * math.sqrt(dot(w, w)), w)


@kernel
def gravity_gradient(o, inertia, mean_motion):
    """Gravity-gradient torque τ = 3 n² o×(I o) in a circular orbit.

    Parameters
    ----------
    o : tuple of 3 float
        Radial unit vector along principal axes.
    inertia : tuple of 3 float
        Principal moments, kg·m².
    mean_motion : float
        n, rad/s.

    Returns
    -------
    tuple of 3 float
        Torque, N·m.

    References
    ----------
    Hughes (1986), equation 8.1.13.
    """
    F = type(o[0])
    k = F(3.0) * mean_motion * mean_motion
    return scale(k, cross(o, momentum(o, inertia)))


@kernel
def orbit_direction(t, mean_motion, radial, along):
    """Direction from the planet in a circular orbit, cos(n t) radial + sin(n t) along."""
    s, c = sincos(mean_motion * t)
    F = type(radial[0])
    return add(scale(F(c), radial), scale(F(s), along))


@kernel
def quaternion_feedback(e, w, stiffness, damping):
    """Quaternion feedback τ = −k sgn(e0) (e1, e2, e3) − c w, along the shorter rotation.

    Parameters
    ----------
    e : tuple of 4 float
        Attitude relative to the target, a unit quaternion.
    w : tuple of 3 float
        Angular velocity along principal axes, rad/s.
    stiffness : float
        k, N·m.
    damping : float
        c, N·m·s.

    Returns
    -------
    tuple of 3 float
        Torque, N·m.

    References
    ----------
    Wie, *Space Vehicle Dynamics and Control* (2008), §7.3.
    """
    k = stiffness if e[0] < type(e[0])(0.0) else -stiffness
    return k * e[1] - damping * w[0], k * e[2] - damping * w[1], k * e[3] - damping * w[2]


@kernel
def sign_of_scalar(e):
    """The sign of a quaternion's scalar part."""
    F = type(e[0])
    return F(-1.0) if e[0] < F(0.0) else F(1.0)


@kernel
def saturated(v, limit):
    """Limit each component of a vector to ±limit.

    Parameters
    ----------
    v : tuple of 3 float
        Vector.
    limit : tuple of 3 float
        Limits, above 0.

    Returns
    -------
    tuple of 3 float
        The vector; NaN remains.
    """
    x = limit[0] if v[0] > limit[0] else v[0]
    y = limit[1] if v[1] > limit[1] else v[1]
    z = limit[2] if v[2] > limit[2] else v[2]
    return (
        -limit[0] if x < -limit[0] else x,
        -limit[1] if y < -limit[1] else y,
        -limit[2] if z < -limit[2] else z,
    )


@kernel
def target_error(target, q):
    """Attitude relative to a target, target*∘q.

    Parameters
    ----------
    target : tuple of 4 float
        Target, a unit quaternion.
    q : tuple of 4 float
        Attitude, a unit quaternion.

    Returns
    -------
    tuple of 4 float
        The attitude error.
    """
    return quat.mul(quat.conj(target), q)


@kernel
def exp_decay(x):
    """The flow of linear damping, (e^−x, (1 − e^−x)/x).

    The second is computed as e^−y sinh(y)/y with y = x/2. The relative error is at most 1e-15
    (float64).
    """
    F = type(x)
    y = F(0.5) * x
    y = F(88.0) if y > F(88.0) else y
    y = F(-88.0) if y < F(-88.0) else y
    k, r = reduce_powers(y)
    s, c = short_waves(r, -r * r)
    p, inverse = powers_of_two(k)
    up = (c + s) * p
    down = (c - s) * inverse
    tiny = abs(y) < F(1e-30)
    safe = F(1.0) if tiny else y
    numerator = s if k == F(0.0) else F(0.5) * (up - down)
    ratio = F(1.0) if tiny else numerator / safe
    return down * down, down * ratio
