"""Symmetric 3×3 matrices as 6-tuples, (11, 12, 13, 22, 23, 33), as ``dcm.gram`` gives them."""

from __future__ import annotations

from fastatt._jit import kernel


@kernel
def full(s):
    """All nine numbers, row by row."""
    return s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]


@kernel
def upper(a):
    """The upper triangle of nine numbers."""
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
    """a bᵀ of two 3×3 matrices whose product is symmetric: its upper triangle only."""
    return (
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
        a[0] * b[3] + a[1] * b[4] + a[2] * b[5],
        a[0] * b[6] + a[1] * b[7] + a[2] * b[8],
        a[3] * b[3] + a[4] * b[4] + a[5] * b[5],
        a[3] * b[6] + a[4] * b[7] + a[5] * b[8],
        a[6] * b[6] + a[7] * b[7] + a[8] * b[8],
    )


@kernel
def mul(a, s):
    """a s of a 3×3 matrix and a symmetric one: nine numbers."""
    return (
        a[0] * s[0] + a[1] * s[1] + a[2] * s[2],
        a[0] * s[1] + a[1] * s[3] + a[2] * s[4],
        a[0] * s[2] + a[1] * s[4] + a[2] * s[5],
        a[3] * s[0] + a[4] * s[1] + a[5] * s[2],
        a[3] * s[1] + a[4] * s[3] + a[5] * s[4],
        a[3] * s[2] + a[4] * s[4] + a[5] * s[5],
        a[6] * s[0] + a[7] * s[1] + a[8] * s[2],
        a[6] * s[1] + a[7] * s[3] + a[8] * s[4],
        a[6] * s[2] + a[7] * s[4] + a[8] * s[5],
    )


@kernel
def congruence(a, s):
    """a s aᵀ."""
    return product(mul(a, s), a)
