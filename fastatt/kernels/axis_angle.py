"""Motions given by an axis e (unit vector) and an angle φ: the angular velocity, and the inverse.

Lurie, *Analytical Mechanics* (2002), §2.12. Angular velocities are along inertial axes; for body
axes change the signs of φ and of w.
"""

from fastatt._jit import kernel
from fastatt.kernels.trig import sincos
from fastatt.kernels.vec3 import add, axpy, cross, dot, scale, sub


@kernel
def rate(e, edot, phi, phidot):
    """Angular velocity w = e φ̇ + ė sin φ + (e×ė)(1 − cos φ).

    Parameters
    ----------
    e : tuple of 3 float
        Axis, a unit vector.
    edot : tuple of 3 float
        Time derivative of the axis, 1/s.
    phi : float
        Angle, rad.
    phidot : float
        Time derivative of the angle, rad/s.

    Returns
    -------
    tuple of 3 float
        Angular velocity along inertial axes, rad/s.
    """
    F = type(phi)
    s, c = sincos(F(0.5) * phi)
    a = F(2.0) * s * c
    b = F(2.0) * s * s
    return add(axpy(phidot, e, scale(a, edot)), scale(b, cross(e, edot)))


@kernel
def derivative(e, phi, w):
    """Derivatives of axis and angle, φ̇ = e·w and ė = ½ (cot(φ/2) w⊥ − e×w).

    Parameters
    ----------
    e : tuple of 3 float
        Axis, a unit vector.
    phi : float
        Angle, rad.
    w : tuple of 3 float
        Angular velocity along inertial axes, rad/s.

    Returns
    -------
    tuple
        (ė, φ̇), infinite at φ = 2πk.
    """
    F = type(phi)
    s, c = sincos(F(0.5) * phi)
    cot = c / s
    f = dot(e, w)
    across = sub(w, scale(f, e))
    return scale(F(0.5), sub(scale(cot, across), cross(e, w))), f
