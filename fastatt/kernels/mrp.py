"""Modified Rodrigues parameters σ = e tan(φ/4) of the rotation by φ about the unit vector e.

σ and its shadow −σ/``|σ|²`` are the same attitude; the one with ``|σ|`` ≤ 1 is never singular.
Schaub and Junkins, "Stereographic orientation parameters for attitude dynamics", *Journal of the
Astronautical Sciences* 44 (1996) 1.
"""

from fastatt._jit import kernel
from fastatt.kernels.vec3 import axpy, cross, dot, largest, scale


@kernel
def to_quat(x):
    """Quaternion of modified Rodrigues parameters."""
    F = type(x[0])
    # relative to the largest of 1 and the components, whose squares may overflow
    m = largest(x)
    i = F(1.0) / (m if m > F(1.0) else F(1.0))
    x = scale(i, x)
    z = dot(x, x)
    a = i * i
    s = F(1.0) / (a + z)
    f = F(2.0) * s * i
    return s * (a - z), f * x[0], f * x[1], f * x[2]


@kernel
def from_quat(q):
    """Modified Rodrigues parameters of a unit quaternion."""
    F = type(q[0])
    s = F(1.0) / (F(1.0) + abs(q[0]))
    s = -s if q[0] < F(0.0) else s
    return s * q[1], s * q[2], s * q[3]


@kernel
def inner(x):
    """σ, or its shadow −σ/``|σ|²`` if ``|σ|`` > 1."""
    F = type(x[0])
    z = dot(x, x)
    s = F(-1.0) / z if z > F(1.0) else F(1.0)
    return scale(s, x)


@kernel
def derivative(x, w):
    """Derivative σ̇ = ¼ ((1 − ``|σ|²``) w + 2 σ×w + 2 (σ·w) σ)."""
    F = type(x[0])
    return half_derivative(x, scale(F(0.5), w))


@kernel
def half_derivative(x, v):
    """Derivative σ̇ at the angular velocity 2v."""
    F = type(x[0])
    k = F(0.5) * (F(1.0) - dot(x, x))
    return axpy(k, v, axpy(dot(x, v), x, cross(x, v)))
