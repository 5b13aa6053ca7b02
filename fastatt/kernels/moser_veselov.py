"""The discrete Moser-Veselov step of a free body with modified inertia.

All numbers are dimensionless: ``inertia`` are the principal moments divided by the largest one, C =
½ ``|m̂|²`` and H = ½ Σ m̂²/I with m̂ = h m divided by the largest moment. The modified moments K
are 1/K = (1 + s)/I + d, with polynomials s and d in C and H. Hairer and Vilmart, *Journal of
Physics A* 39 (2006) 13225, equations 3.5 to 3.8; Moser and Veselov, *Communications in Mathematical
Physics* 139 (1991) 217.
"""

import math

from fastatt._jit import kernel
from fastatt.kernels.vec3 import add, axpy, cross, dot, scale, sub


@kernel
def power_sum(x):
    """x1 + x2 + x3."""
    return x[0] + x[1] + x[2]


@kernel
def squared(x):
    """(x1², x2², x3²)."""
    return x[0] * x[0], x[1] * x[1], x[2] * x[2]


@kernel
def product(x, y):
    """(x1 y1, x2 y2, x3 y3)."""
    return x[0] * y[0], x[1] * y[1], x[2] * y[2]


@kernel
def mixed_sum(above, below):
    """Σ (above_j + above_k) below_i over the axes i, with the other two axes j and k."""
    return (
        (above[1] + above[2]) * below[0]
        + (above[2] + above[0]) * below[1]
        + (above[0] + above[1]) * below[2]
    )


@kernel
def coefficients(inertia):
    """Coefficients of s and d by powers of the step, the second first.

    Those of the power 2n multiply Cⁿ, Cⁿ⁻¹H, …, Hⁿ, first in s, then in d.
    """
    F = type(inertia[0])
    D = inertia[0] * inertia[1] * inertia[2]
    D2 = D * D
    D3 = D2 * D
    D4 = D2 * D2
    inverse = (F(1.0) / inertia[0], F(1.0) / inertia[1], F(1.0) / inertia[2])
    two = squared(inertia)
    three = product(two, inertia)
    minus_two = squared(inverse)
    minus_three = product(minus_two, inverse)
    S1 = power_sum(inertia)
    S2 = power_sum(two)
    S3 = power_sum(three)
    S4 = power_sum(squared(two))
    X1 = power_sum(inverse)
    X2 = power_sum(minus_two)
    X3 = power_sum(minus_three)
    X4 = power_sum(squared(minus_two))
    Y11 = mixed_sum(inertia, inverse)
    Y21 = mixed_sum(two, inverse)
    Y12 = mixed_sum(inertia, minus_two)
    Y31 = mixed_sum(three, inverse)
    Y13 = mixed_sum(inertia, minus_three)
    Y22 = mixed_sum(two, minus_two)
    return (
        S1 / (F(6.0) * D),
        -X1 / F(3.0),
        F(-1.0) / (F(3.0) * D),
        S1 / (F(6.0) * D),
        (S2 / D - X1) / (F(30.0) * D),
        (F(1.0) - Y11) / (F(30.0) * D),
        (F(3.0) * S1 / D + F(2.0) * X2) / F(60.0),
        -S1 / (F(60.0) * D * D),
        X1 / (F(10.0) * D) - S2 / (F(60.0) * D * D),
        -(F(9.0) + Y11) / (F(60.0) * D),
        (F(4.0) * D + F(17.0) * S3 - F(15.0) * D * Y11) / (F(2520.0) * D * D * D),
        (F(9.0) * S1 + F(10.0) * D * X2 - F(6.0) * Y21) / (F(420.0) * D * D),
        ((F(6.0) * Y12 - F(100.0) * X1) * D + F(53.0) * S2) / (F(2520.0) * D * D),
        (F(15.0) - D * X3 - F(2.0) * Y11) / (F(630.0) * D),
        (F(34.0) * D * X1 - F(19.0) * S2) / (F(2520.0) * D * D * D),
        (S3 + F(2.0) * D * Y11 - F(85.0) * D) / (F(1260.0) * D * D * D),
        (F(47.0) * S1 + F(13.0) * Y21 - F(38.0) * D * X2) / (F(2520.0) * D * D),
        (F(9.0) * D * X1 + D * Y12 - F(11.0) * S2) / (F(1260.0) * D * D),
        (F(62.0) * S4 - F(94.0) * D * Y21 + F(66.0) * D2 * X2 + F(81.0) * D * S1)
        / (F(45360.0) * D4),
        (F(-77.0) * Y31 + F(75.0) * D * Y12 + F(214.0) * S2 - F(240.0) * D * X1)
        / (F(22680.0) * D3),
        (F(26.0) * D * Y22 + F(55.0) * S3 + F(204.0) * D - F(50.0) * D2 * X3 - F(59.0) * D * Y11)
        / (F(7560.0) * D3),
        (F(137.0) * D * X2 - D * Y13 + F(3.0) * S1 - F(69.0) * Y21) / (F(11340.0) * D2),
        (F(2.0) * D2 * X4 + F(5.0) * D * Y12 - F(171.0) * D * X1 + F(159.0) * S2)
        / (F(45360.0) * D2),
        (F(60.0) * Y11 * D - F(61.0) * S3 - F(247.0) * D) / (F(45360.0) * D4),
        (F(54.0) * D * S1 - S4 + F(218.0) * D * Y21 - F(426.0) * D2 * X2) / (F(45360.0) * D4),
        (F(125.0) * D * X1 - F(5.0) * Y31 - F(130.0) * S2 + F(4.0) * D * Y12) / (F(7560.0) * D3),
        (F(67.0) * S3 - F(735.0) * D - F(15.0) * D * Y22 + F(87.0) * D * Y11 + F(34.0) * D2 * X3)
        / (F(22680.0) * D3),
        (F(165.0) * S1 - D * Y13 - F(9.0) * Y21 - F(145.0) * D * X2) / (F(45360.0) * D2),
    )


@kernel
def corrections(C, H, k):
    """(s, d) from their coefficients, added from the smallest on."""
    h2 = H * H
    h3 = h2 * H
    h4 = h2 * h2
    s2 = k[0] * C + k[1] * H
    d2 = k[2] * C + k[3] * H
    s4 = (k[4] * C + k[5] * H) * C + k[6] * h2
    d4 = (k[7] * C + k[8] * H) * C + k[9] * h2
    s6 = ((k[10] * C + k[11] * H) * C + k[12] * h2) * C + k[13] * h3
    d6 = ((k[14] * C + k[15] * H) * C + k[16] * h2) * C + k[17] * h3
    s8 = (((k[18] * C + k[19] * H) * C + k[20] * h2) * C + k[21] * h3) * C + k[22] * h4
    d8 = (((k[23] * C + k[24] * H) * C + k[25] * h2) * C + k[26] * h3) * C + k[27] * h4
    return s2 + (s4 + (s6 + s8)), d2 + (d4 + (d6 + d8))


@kernel
def modified_inverse(inertia, s, d):
    """1/K of the modified moments, from s and d."""
    F = type(inertia[0])
    f = F(1.0) + s
    return f / inertia[0] + d, f / inertia[1] + d, f / inertia[2] + d


@kernel
def asymmetry(k):
    """((K2 − K3)/K1, cyclic) from k = 1/K."""
    return (
        (k[2] - k[1]) * k[0] / (k[1] * k[2]),
        (k[0] - k[2]) * k[1] / (k[2] * k[0]),
        (k[1] - k[0]) * k[2] / (k[0] * k[1]),
    )


@kernel
def sweep(c, u, kappa):
    """One Gauss-Seidel sweep of c1 = (1 + |c|²) u1 + ((K2 − K3)/K1) c2 c3, cyclic."""
    F = type(c[0])
    yz = c[1] * c[1] + c[2] * c[2]
    a = (F(1.0) + (c[0] * c[0] + yz)) * u[0] + kappa[0] * (c[1] * c[2])
    b = (F(1.0) + (a * a + yz)) * u[1] + kappa[1] * (c[2] * a)
    d = (F(1.0) + (a * a + b * b + c[2] * c[2])) * u[2] + kappa[2] * (a * b)
    return a, b, d


@kernel
def newton(c, u, kappa):
    """One Newton step of the equations of ``sweep``, solved by Cramer's rule."""
    F = type(c[0])
    s = F(1.0) + dot(c, c)
    r = (
        s * u[0] + kappa[0] * c[1] * c[2] - c[0],
        s * u[1] + kappa[1] * c[2] * c[0] - c[1],
        s * u[2] + kappa[2] * c[0] * c[1] - c[2],
    )
    v = (u[0] + u[0], u[1] + u[1], u[2] + u[2])
    a = (F(1.0) - v[0] * c[0], -v[0] * c[1] - kappa[0] * c[2], -v[0] * c[2] - kappa[0] * c[1])
    b = (-v[1] * c[0] - kappa[1] * c[2], F(1.0) - v[1] * c[1], -v[1] * c[2] - kappa[1] * c[0])
    d = (-v[2] * c[0] - kappa[2] * c[1], -v[2] * c[1] - kappa[2] * c[0], F(1.0) - v[2] * c[2])
    bd = cross(b, d)
    e = F(1.0) / dot(a, bd)
    # the columns of the adjoint matrix are products of its rows
    da = cross(d, a)
    ab = cross(a, b)
    return axpy(e, add(axpy(r[0], bd, scale(r[1], da)), scale(r[2], ab)), c)


@kernel
def solve(u, kappa):
    """(c, change): three sweeps from u and two Newton steps, and the last change squared.

    The result is accurate to round-off for ``|m|h``/I_min up to 0.5. Sweeps alone would need 8 at
    0.2 and 14 at 0.4.
    """
    c = sweep(sweep(sweep(u, u, kappa), u, kappa), u, kappa)
    c = newton(c, u, kappa)
    b = newton(c, u, kappa)
    e = sub(b, c)
    return b, dot(e, e)


@kernel
def rotation(c):
    """((1, c)/√α, 1/α), α = 1 + ``|c|²``: the rotation of the step as a unit quaternion."""
    F = type(c[0])
    inverse = F(1.0) / (F(1.0) + dot(c, c))
    r = math.sqrt(inverse)
    return (r, r * c[0], r * c[1], r * c[2]), inverse
