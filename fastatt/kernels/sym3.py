"""Symmetric 3×3 matrices as tuples of six numbers, (11, 12, 13, 22, 23, 33)."""

from fastatt._jit import kernel
from fastatt.kernels import dcm


@kernel
def full(s):
    """All nine numbers of a symmetric matrix.

    Parameters
    ----------
    s : tuple of 6 float
        Symmetric matrix.

    Returns
    -------
    tuple of 9 float
        The matrix, row by row.
    """
    return s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]


@kernel
def upper(a):
    """The upper triangle of a matrix.

    Parameters
    ----------
    a : tuple of 9 float
        Matrix, row by row.

    Returns
    -------
    tuple of 6 float
        The triangle.
    """
    return a[0], a[1], a[2], a[4], a[5], a[8]


@kernel
def add(a, b):
    """Sum a + b.

    Parameters
    ----------
    a : tuple of 6 float
        First matrix.
    b : tuple of 6 float
        Second matrix.

    Returns
    -------
    tuple of 6 float
        The sum.
    """
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]


@kernel
def scale(k, s):
    """Multiple k s.

    Parameters
    ----------
    k : float
        Factor.
    s : tuple of 6 float
        Symmetric matrix.

    Returns
    -------
    tuple of 6 float
        The matrix.
    """
    return k * s[0], k * s[1], k * s[2], k * s[3], k * s[4], k * s[5]


@kernel
def product(a, b):
    """Product a bᵀ of two matrices whose product is symmetric.

    Parameters
    ----------
    a : tuple of 9 float
        Matrix, row by row.
    b : tuple of 9 float
        Matrix, row by row.

    Returns
    -------
    tuple of 6 float
        The product.
    """
    return upper(dcm.mul(a, dcm.transpose(b)))


@kernel
def mul(a, s):
    """Product a s of a matrix and a symmetric one.

    Parameters
    ----------
    a : tuple of 9 float
        Matrix, row by row.
    s : tuple of 6 float
        Symmetric matrix.

    Returns
    -------
    tuple of 9 float
        The product, row by row.
    """
    return dcm.mul(a, full(s))


@kernel
def congruence(a, s):
    """Congruence a s aᵀ.

    Parameters
    ----------
    a : tuple of 9 float
        Matrix, row by row.
    s : tuple of 6 float
        Symmetric matrix.

    Returns
    -------
    tuple of 6 float
        The matrix.
    """
    return product(mul(a, s), a)
