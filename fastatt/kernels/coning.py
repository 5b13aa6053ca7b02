"""Rotation over an interval from a polynomial angular velocity, and fits of such polynomials.

w(t) = a + b t + c t² + d t³ along body axes. The rotation vector up to time t is the integral of w
plus the coning term ½∫α×w dt with the running integral α; the next terms are of order t⁵. Bortz,
*IEEE Transactions on Aerospace and Electronic Systems* 7 (1971); Savage, *Journal of Guidance,
Control, and Dynamics* 21 (1998) 19. For equal intervals the fits to increments give the known
coefficients: 1/12 for one increment and the one before, 2/3 for two, 33/80 and 57/80 for three.
"""

from fastatt._jit import kernel
from fastatt.kernels.vec3 import add, axpy, cross, scale, sub


@kernel
def rotation_vector_linear(a, b, t):
    """Rotation vector from time 0 to t of w = a + b t.

    Parameters
    ----------
    a : tuple of 3 float
        Constant coefficient, rad/s.
    b : tuple of 3 float
        Linear coefficient, rad/s².
    t : float
        Time, s.

    Returns
    -------
    tuple of 3 float
        t a + t²/2 b + t³/12 a×b, rad.
    """
    F = type(t)
    angle = scale(t, axpy(F(0.5) * t, b, a))
    return axpy(F(1.0 / 12.0) * t * t * t, cross(a, b), angle)


@kernel
def rotation_vector_quadratic(a, b, c, t):
    """Rotation vector from time 0 to t of w = a + b t + c t².

    Parameters
    ----------
    a : tuple of 3 float
        Constant coefficient, rad/s.
    b : tuple of 3 float
        Linear coefficient, rad/s².
    c : tuple of 3 float
        Quadratic coefficient, rad/s³.
    t : float
        Time, s.

    Returns
    -------
    tuple of 3 float
        The linear one plus t³/3 c + t⁴/12 a×c + t⁵/60 b×c, rad.

    Notes
    -----
    The products are computed as one: t³/12 (a − t²/5 c)×(b + t c).
    """
    F = type(t)
    s = t * t
    angle = scale(t, axpy(s, scale(F(1.0 / 3.0), c), axpy(F(0.5) * t, b, a)))
    coning = cross(axpy(F(-0.2) * s, c, a), axpy(t, c, b))
    return axpy(F(1.0 / 12.0) * t * s, coning, angle)


@kernel
def rotation_vector(a, b, c, d, t):
    """Rotation vector from time 0 to t of w = a + b t + c t² + d t³.

    Parameters
    ----------
    a : tuple of 3 float
        Constant coefficient, rad/s.
    b : tuple of 3 float
        Linear coefficient, rad/s².
    c : tuple of 3 float
        Quadratic coefficient, rad/s³.
    d : tuple of 3 float
        Cubic coefficient, rad/s⁴.
    t : float
        Time, s.

    Returns
    -------
    tuple of 3 float
        The quadratic one plus t⁴/4 d + 3t⁵/40 a×d + t⁶/48 b×d + t⁷/168 c×d, rad.

    Notes
    -----
    The products are computed as two: t³/12 (a − t²/5 c − t³/4 d)×(b + t c + 9t²/10 d) + t⁷/8400
    c×d.
    """
    F = type(t)
    s = t * t
    angle = axpy(s, axpy(F(0.25) * t, d, scale(F(1.0 / 3.0), c)), axpy(F(0.5) * t, b, a))
    left = axpy(F(-0.25) * t * s, d, axpy(F(-0.2) * s, c, a))
    right = axpy(F(0.9) * s, d, axpy(t, c, b))
    coning = axpy(F(1.0 / 700.0) * s * s, cross(c, d), cross(left, right))
    return axpy(F(1.0 / 12.0) * t * s, coning, scale(t, angle))


@kernel
def rates_quadratic(w0, w1, w2, t1, t2):
    """Parabola through rates at times 0, t1 and t2.

    Parameters
    ----------
    w0 : tuple of 3 float
        Rate at time 0, rad/s.
    w1 : tuple of 3 float
        Rate at ``t1``, rad/s.
    w2 : tuple of 3 float
        Rate at ``t2``, rad/s.
    t1 : float
        Time, s.
    t2 : float
        Time, s.

    Returns
    -------
    tuple of 3 tuples of 3 float
        (a, b, c).
    """
    F = type(t1)
    d1 = scale(F(1.0) / t1, sub(w1, w0))
    d2 = scale(F(1.0) / (t2 - t1), sub(w2, w1))
    c = scale(F(1.0) / t2, sub(d2, d1))
    return w0, axpy(-t1, c, d1), c


@kernel
def rates_cubic(w0, w1, w2, w3, t1, t2, t3):
    """Cubic through rates at times 0, t1, t2 and t3.

    Parameters
    ----------
    w0 : tuple of 3 float
        Rate at time 0, rad/s.
    w1 : tuple of 3 float
        Rate at ``t1``, rad/s.
    w2 : tuple of 3 float
        Rate at ``t2``, rad/s.
    w3 : tuple of 3 float
        Rate at ``t3``, rad/s.
    t1 : float
        Time, s.
    t2 : float
        Time, s.
    t3 : float
        Time, s.

    Returns
    -------
    tuple of 4 tuples of 3 float
        (a, b, c, d).
    """
    F = type(t1)
    d1 = scale(F(1.0) / t1, sub(w1, w0))
    d2 = scale(F(1.0) / (t2 - t1), sub(w2, w1))
    d3 = scale(F(1.0) / (t3 - t2), sub(w3, w2))
    e1 = scale(F(1.0) / t2, sub(d2, d1))
    e2 = scale(F(1.0) / (t3 - t1), sub(d3, d2))
    d = scale(F(1.0) / t3, sub(e2, e1))
    b = axpy(t1 * t2, d, axpy(-t1, e1, d1))
    return w0, b, axpy(-(t1 + t2), d, e1), d


@kernel
def increments_linear(before, now, h0, h1):
    """Straight line whose integrals over [−h0, 0] and [0, h1] are two increments.

    Parameters
    ----------
    before : tuple of 3 float
        Increment over [−h0, 0], rad.
    now : tuple of 3 float
        Increment over [0, h1], rad.
    h0 : float
        Interval, s.
    h1 : float
        First interval from time 0, s.

    Returns
    -------
    tuple of 2 tuples of 3 float
        (a, b).
    """
    F = type(h0)
    r1 = scale(F(1.0) / h1, now)
    b = scale(F(2.0) / (h0 + h1), axpy(F(-1.0) / h0, before, r1))
    return axpy(F(-0.5) * h1, b, r1), b


@kernel
def increments_quadratic(i1, i2, i3, h1, h2, h3):
    """Parabola with three increments over intervals h1, h2 and h3 from time 0.

    Parameters
    ----------
    i1 : tuple of 3 float
        First increment, rad.
    i2 : tuple of 3 float
        Second increment, rad.
    i3 : tuple of 3 float
        Third increment, rad.
    h1 : float
        First interval from time 0, s.
    h2 : float
        Second interval, s.
    h3 : float
        Third interval, s.

    Returns
    -------
    tuple of 3 tuples of 3 float
        (a, b, c).
    """
    F = type(h1)
    r1 = scale(F(1.0) / h1, i1)
    r2 = scale(F(1.0) / h2, i2)
    r3 = scale(F(1.0) / h3, i3)
    d1 = scale(F(1.0) / (h1 + h2), sub(r2, r1))
    d2 = scale(F(1.0) / (h2 + h3), sub(r3, r2))
    e = scale(F(1.0) / (h1 + h2 + h3), sub(d2, d1))
    t2 = h1 + h2
    a = axpy(h1 * t2, e, axpy(-h1, d1, r1))
    return a, scale(F(2.0), axpy(-(h1 + t2), e, d1)), scale(F(3.0), e)


@kernel
def miller(i1, i2, i3):
    """Rotation vector over three equal intervals, with coefficients optimal for pure coning.

    Parameters
    ----------
    i1 : tuple of 3 float
        First increment, rad.
    i2 : tuple of 3 float
        Second increment, rad.
    i3 : tuple of 3 float
        Third increment, rad.

    Returns
    -------
    tuple of 3 float
        Σθ + (9/20) θ1×θ3 + (27/40) (θ1×θ2 + θ2×θ3), rad.

    References
    ----------
    Miller, *Journal of Guidance, Control, and Dynamics* 6 (1983) 287.
    """
    F = type(i1[0])
    # a×b as a×(b − a), which is 0 for equal increments, while a fused a×a leaves its rounding
    outer = scale(F(9.0 / 20.0), cross(i1, sub(i3, i1)))
    inner = scale(F(27.0 / 40.0), add(cross(i1, sub(i2, i1)), cross(i2, sub(i3, i2))))
    return add(add(i1, i2), add(i3, add(outer, inner)))
