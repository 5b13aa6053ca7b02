"""Vectors as tuples of three numbers."""

from fastatt._jit import kernel

__all__ = ["add", "axpy", "cross", "dot", "scale", "sub"]


@kernel
def dot(a, b):
    """Scalar product a·b.

    Parameters
    ----------
    a : tuple of 3 float
        First vector.
    b : tuple of 3 float
        Second vector.

    Returns
    -------
    float
        The product.
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    """Vector product a×b.

    Parameters
    ----------
    a : tuple of 3 float
        First vector.
    b : tuple of 3 float
        Second vector.

    Returns
    -------
    tuple of 3 float
        The product.
    """
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def add(a, b):
    """Sum a + b.

    Parameters
    ----------
    a : tuple of 3 float
        First vector.
    b : tuple of 3 float
        Second vector.

    Returns
    -------
    tuple of 3 float
        The sum.
    """
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def sub(a, b):
    """Difference a − b.

    Parameters
    ----------
    a : tuple of 3 float
        First vector.
    b : tuple of 3 float
        Second vector.

    Returns
    -------
    tuple of 3 float
        The difference.
    """
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def scale(k, a):
    """Multiple k a.

    Parameters
    ----------
    k : float
        Factor.
    a : tuple of 3 float
        Vector.

    Returns
    -------
    tuple of 3 float
        The vector.
    """
    return k * a[0], k * a[1], k * a[2]


@kernel
def axpy(k, a, b):
    """Sum k a + b.

    Parameters
    ----------
    k : float
        Factor.
    a : tuple of 3 float
        First vector.
    b : tuple of 3 float
        Second vector.

    Returns
    -------
    tuple of 3 float
        The sum.
    """
    return k * a[0] + b[0], k * a[1] + b[1], k * a[2] + b[2]


@kernel
def rotate_axes_first(v, c, s):
    """Components of a vector along axes that are rotated about axis 1."""
    return v[0], c * v[1] + s * v[2], c * v[2] - s * v[1]


@kernel
def rotate_axes_third(v, c, s):
    """Components of a vector along axes that are rotated about axis 3."""
    return c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]


@kernel
def largest(v):
    """The largest of |v1|, |v2|, |v3|."""
    m = abs(v[0])
    m = abs(v[1]) if abs(v[1]) > m else m
    return abs(v[2]) if abs(v[2]) > m else m
