"""Symmetric 3×3 matrices as tuples of six numbers, (11, 12, 13, 22, 23, 33)."""

from fastatt._jit import kernel
from fastatt.kernels import dcm


@kernel
def full(s):
    """All nine numbers of a symmetric matrix."""
    return s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]


@kernel
def upper(a):
    """The upper triangle of a matrix."""
    return a[0], a[1], a[2], a[4], a[5], a[8]


@kernel
def add(a, b):
    """Sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]


@kernel
def scale(k, s):
    """Multiple k s."""
    return k * s[0], k * s[1], k * s[2], k * s[3], k * s[4], k * s[5]


@kernel
def product(a, b):
    """Product a bᵀ of two matrices whose product is symmetric."""
    return upper(dcm.mul(a, dcm.transpose(b)))


@kernel
def mul(a, s):
    """Product a s of a matrix and a symmetric one."""
    return dcm.mul(a, full(s))


@kernel
def congruence(a, s):
    """Congruence a s aᵀ."""
    return product(mul(a, s), a)
