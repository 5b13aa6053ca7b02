"""Rotation over an interval from a polynomial angular velocity, and fits of such polynomials.

w(t) = a + b t + c t² along body axes. The rotation vector up to time t is the integral of w
plus the coning term ½∫α×w dt with the running integral α; the next terms are of order t⁵. Bortz,
*IEEE Transactions on Aerospace and Electronic Systems* 7 (1971); Savage, *Journal of Guidance,
Control, and Dynamics* 21 (1998) 19. For equal intervals the fits to increments give the known
coefficients: 1/12 for one increment and the one before, 2/3 for two.
"""

from fastatt._jit import kernel
from fastatt.kernels.vec3 import axpy, cross, scale, sub


@kernel
def rotation_vector_linear(a, b, t):
    """Rotation vector from time 0 to t of w = a + b t.

    It is t a + t²/2 b + t³/12 a×b, rad.
    """
    F = type(t)
    angle = scale(t, axpy(F(0.5) * t, b, a))
    return axpy(F(1.0 / 12.0) * t * t * t, cross(a, b), angle)


@kernel
def rotation_vector_quadratic(a, b, c, t):
    """Rotation vector from time 0 to t of w = a + b t + c t².

    It is the linear one plus t³/3 c + t⁴/12 a×c + t⁵/60 b×c, rad. The products are computed as one:
    t³/12 (a − t²/5 c)×(b + t c).
    """
    F = type(t)
    s = t * t
    angle = scale(t, axpy(s, scale(F(1.0 / 3.0), c), axpy(F(0.5) * t, b, a)))
    coning = cross(axpy(F(-0.2) * s, c, a), axpy(t, c, b))
    return axpy(F(1.0 / 12.0) * t * s, coning, angle)


@kernel
def rates_quadratic(w0, w1, w2, t1, t2):
    """Parabola a + b t + c t² through rates at times 0, t1 and t2."""
    F = type(t1)
    d1 = scale(F(1.0) / t1, sub(w1, w0))
    d2 = scale(F(1.0) / (t2 - t1), sub(w2, w1))
    c = scale(F(1.0) / t2, sub(d2, d1))
    return w0, axpy(-t1, c, d1), c


@kernel
def increments_linear(before, now, h0, h1):
    """Straight line a + b t whose integrals over [−h0, 0] and [0, h1] are two increments."""
    F = type(h0)
    r1 = scale(F(1.0) / h1, now)
    b = scale(F(2.0) / (h0 + h1), axpy(F(-1.0) / h0, before, r1))
    return axpy(F(-0.5) * h1, b, r1), b
