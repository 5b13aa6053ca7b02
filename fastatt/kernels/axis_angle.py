"""Motion given by an axis e (unit vector) and an angle φ: its angular velocity and the inverse.

Lurie, *Analytical Mechanics* (2002), §2.12; w in inertial axes, rad/s; for body axes change
the sign of φ and of w.
"""

from __future__ import annotations

from fastatt._jit import kernel
from fastatt.kernels.trig import sincos
from fastatt.kernels.vec3 import cross, dot


@kernel
def rate(e, edot, phi, phidot):
    """w = e φ̇ + ė sin φ + (e×ė)(1 − cos φ) in inertial axes."""
    F = type(phi)
    s, c = sincos(F(0.5) * phi)
    a = F(2.0) * s * c
    b = F(2.0) * s * s
    n = cross(e, edot)
    return (
        e[0] * phidot + a * edot[0] + b * n[0],
        e[1] * phidot + a * edot[1] + b * n[1],
        e[2] * phidot + a * edot[2] + b * n[2],
    )


@kernel
def derivative(e, phi, w):
    """(ė, φ̇) of w in inertial axes: φ̇ = e·w, ė = ½ (cot(φ/2) w⊥ − e×w); infinite at φ = 2πk."""
    F = type(phi)
    s, c = sincos(F(0.5) * phi)
    cot = c / s
    f = dot(e, w)
    n = cross(e, w)
    h = F(0.5)
    return (
        h * (cot * (w[0] - f * e[0]) - n[0]),
        h * (cot * (w[1] - f * e[1]) - n[1]),
        h * (cot * (w[2] - f * e[2]) - n[2]),
    ), f
