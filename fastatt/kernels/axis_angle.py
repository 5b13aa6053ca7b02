"""Motion given by an axis e (unit vector) and an angle φ: its angular velocity and the inverse.

Lurie, *Analytical Mechanics* (2002), §2.12; w in inertial axes, rad/s; for body axes change
the sign of φ and of w.
"""

from fastatt._jit import kernel
from fastatt.kernels.trig import sincos
from fastatt.kernels.vec3 import add, axpy, cross, dot, scale, sub


@kernel
def rate(e, edot, phi, phidot):
    """w = e φ̇ + ė sin φ + (e×ė)(1 − cos φ) in inertial axes."""
    F = type(phi)
    s, c = sincos(F(0.5) * phi)
    a = F(2.0) * s * c
    b = F(2.0) * s * s
    return add(axpy(phidot, e, scale(a, edot)), scale(b, cross(e, edot)))


@kernel
def derivative(e, phi, w):
    """(ė, φ̇) of w in inertial axes: φ̇ = e·w, ė = ½ (cot(φ/2) w⊥ − e×w); infinite at φ = 2πk."""
    F = type(phi)
    s, c = sincos(F(0.5) * phi)
    cot = c / s
    f = dot(e, w)
    across = sub(w, scale(f, e))
    return scale(F(0.5), sub(scale(cot, across), cross(e, w))), f
