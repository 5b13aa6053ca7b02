"""3-1-3 Euler angles (φ, θ, ψ), rad: C = Rz(φ) Rx(θ) Rz(ψ).

They are singular at θ = 0 and π, where φ and ψ rotate about the same axis. Goldstein, *Classical
Mechanics*, §4.4 and §4.9; Whittaker, *Analytical Dynamics* (1937), §10.
"""

import math

from fastatt._jit import kernel
from fastatt.kernels.trig import atan2, sincos, sincos_bounded

__all__ = ["derivative", "from_quat", "rate", "to_quat"]


@kernel
def to_quat(angles):
    """Quaternion of Euler angles.

    Parameters
    ----------
    angles : tuple of 3 float
        (φ, θ, ψ), rad.

    Returns
    -------
    tuple of 4 float
        Unit quaternion, body to inertial.
    """
    F = type(angles[0])
    h = F(0.5)
    st, ct = sincos(h * angles[1])
    a, b = h * angles[0], h * angles[2]
    sp, cp = sincos(a + b)
    sm, cm = sincos(a - b)
    return ct * cp, st * cm, st * sm, ct * sp


@kernel
def from_quat(q):
    """Euler angles of a unit quaternion.

    Parameters
    ----------
    q : tuple of 4 float
        Unit quaternion, body to inertial.

    Returns
    -------
    tuple of 3 float
        (φ, θ, ψ), rad, with θ in [0, π]; φ = ψ at θ = 0 and φ = −ψ at θ = π.
    """
    F = type(q[0])
    s = atan2(q[3], q[0])
    d = atan2(q[2], q[1])
    sine = math.sqrt(q[1] * q[1] + q[2] * q[2])
    cosine = math.sqrt(q[0] * q[0] + q[3] * q[3])
    return s + d, F(2.0) * atan2(sine, cosine), s - d


@kernel
def rate(angles, derivative):
    """Angular velocity along body axes from the derivatives of Euler angles.

    Parameters
    ----------
    angles : tuple of 3 float
        (φ, θ, ψ), rad.
    derivative : tuple of 3 float
        (φ̇, θ̇, ψ̇), rad/s.

    Returns
    -------
    tuple of 3 float
        Angular velocity, rad/s.
    """
    st, ct = sincos(angles[1])
    sp, cp = sincos(angles[2])
    a = derivative[0] * st
    return (
        a * sp + derivative[1] * cp,
        a * cp - derivative[1] * sp,
        derivative[0] * ct + derivative[2],
    )


@kernel
def derivative(angles, w):
    """Derivatives of Euler angles from the angular velocity.

    Parameters
    ----------
    angles : tuple of 3 float
        (φ, θ, ψ), rad.
    w : tuple of 3 float
        Angular velocity along body axes, rad/s.

    Returns
    -------
    tuple of 3 float
        (φ̇, θ̇, ψ̇), rad/s; infinite or NaN where sin θ = 0.

    Notes
    -----
    Angles may be up to 1e15 rad (float32: 1e6).
    """
    st, ct = sincos_bounded(angles[1])
    sp, cp = sincos_bounded(angles[2])
    a = (w[0] * sp + w[1] * cp) / st
    return a, w[0] * cp - w[1] * sp, w[2] - a * ct
