"""Errors of an estimated attitude and of a gyro's bias: their transition, noise and covariance.

The error δθ (rad) is a rotation in body axes, C_true = C exp [δθ], and δb = b_true − b (rad/s) that
of the bias that is taken off the gyro's rate, ω = gyro − b. Both obey

    δθ̇ = −ω×δθ − δb − n_v,    ḃ = n_u,

n_v the angle random walk, σ_v in rad/√s, n_u that of the bias, σ_u in rad/s^1.5. Over a step h of
constant ω turning by u = ωh

    (δθ, δb) ← [Φ11 Φ12; 0 1] (δθ, δb) + noise of covariance [Q11 Q12; Q12ᵀ Q22].

A covariance is (P11, P12, P22): P11 (rad²) and P22 (rad²/s²) as of ``sym3``, P12 nine numbers row
by row. All hold at any angle, |u| = 0 and past 2π included. Lefferts, Markley and Shuster, J.
Guidance 5 (1982) 417; Farrenkopf, J. Guidance 1 (1978) 282; Markley and Crassidis, *Fundamentals of
Spacecraft Attitude Determination and Control* (2014), §6.2.
"""

from fastatt._jit import kernel
from fastatt.kernels import dcm, quat, so3, sym3
from fastatt.kernels.vec3 import dot


@kernel
def transition(u, h):
    """(Φ11, Φ12) = (exp −[u], −h Jr(u)) of h s at a constant rate, of rotation vector u (rad).

    Φ11 also holds for any other path to the same rotation exp(u).
    """
    b, c = so3.jacobian_coefficients(dot(u, u))
    turned = dcm.from_quat(quat.conj(quat.exp(u)))
    return turned, dcm.scale(-h, so3.second_order(-b, c, u))


@kernel
def noise_at_rest(h, angle_variance, bias_variance):
    """``noise`` for ω = 0 (Farrenkopf): σ_v² h + σ_u² h³/3, −σ_u² h²/2, σ_u² h.

    Short by a share θ²/20 of Q11's bias part and θ/3 of Q12 for a rotation by θ in the step.
    """
    F = type(h)
    o = F(0.0)
    q22 = bias_variance * h
    q12 = F(-0.5) * q22 * h
    q11 = F(1.0 / 3.0) * q22 * h * h + angle_variance * h
    return (
        (q11, o, o, q11, o, q11),
        (q12, o, o, o, q12, o, o, o, q12),
        (q22, o, o, q22, o, q22),
    )


@kernel
def noise(u, h, angle_variance, bias_variance):
    """(Q11, Q12, Q22) of white noise over h s of rotation vector u (rad): exact for constant ω.

    ``angle_variance`` is σ_v² (rad²/s), ``bias_variance`` σ_u² (rad²/s³), each for all axes. With
    θ = |u|, Q11 = σ_v² h + σ_u² h³ (1/3 + (θ³/3 − 2θ + 2 sin θ)/θ⁵ [u]²), Q12 = −σ_u² h² (1/2 −
    (θ − sin θ)/θ³ [u] + (θ²/2 + cos θ − 1)/θ⁴ [u]²), Q22 = σ_u² h.
    """
    F = type(h)
    z = dot(u, u)
    _, r = so3.jacobian_coefficients(z)
    g = so3.second_order(F(0.0), F(3.0) * so3.square_integral_coefficient(z), u)
    c = so3.second_order(-(r + r), F(2.0) * so3.second_integral_coefficient(z), u)
    q11, q12, q22 = noise_at_rest(h, F(0.0), bias_variance)
    a = q11[0]
    v = angle_variance * h
    return (
        (a * g[0] + v, a * g[1], a * g[2], a * g[4] + v, a * g[5], a * g[8] + v),
        dcm.scale(q12[0], c),
        q22,
    )


@kernel
def predict(p, phi, q):
    """Covariance (P11, P12, P22) a step later: Φ P Φᵀ + Q, Φ = (Φ11, Φ12), Q = (Q11, Q12, Q22)."""
    f, g = phi
    p11, p12, p22 = p
    q11, q12, q22 = q
    a = dcm.add(sym3.mul(f, p11), dcm.mul(g, dcm.transpose(p12)))
    b = dcm.add(dcm.mul(f, p12), sym3.mul(g, p22))
    # of a fᵀ + b gᵀ, symmetric as a whole, the upper triangle
    s = sym3.add(sym3.product(a, f), sym3.product(b, g))
    return sym3.add(s, q11), dcm.add(b, q12), sym3.add(p22, q22)


@kernel
def to_inertial(c, p):
    """Covariance of the error in inertial axes, C_true = exp [C δθ] C, from that in body axes."""
    return sym3.congruence(c, p[0]), dcm.mul(c, p[1]), p[2]


@kernel
def to_body(c, p):
    """Covariance of the error in body axes from that in inertial axes."""
    return to_inertial(dcm.transpose(c), p)


@kernel
def transition_matrix(phi):
    """The 36 numbers, row by row, of (Φ11, Φ12)."""
    f, g = phi
    F = type(f[0])
    o = F(0.0)
    i = F(1.0)
    return (
        f[0], f[1], f[2], g[0], g[1], g[2],
        f[3], f[4], f[5], g[3], g[4], g[5],
        f[6], f[7], f[8], g[6], g[7], g[8],
        o, o, o, i, o, o,
        o, o, o, o, i, o,
        o, o, o, o, o, i,
    )  # fmt: skip


@kernel
def matrix(p):
    """The 36 numbers, row by row, of a covariance (P11, P12, P22)."""
    a, b, c = p
    return (
        a[0], a[1], a[2], b[0], b[1], b[2],
        a[1], a[3], a[4], b[3], b[4], b[5],
        a[2], a[4], a[5], b[6], b[7], b[8],
        b[0], b[3], b[6], c[0], c[1], c[2],
        b[1], b[4], b[7], c[1], c[3], c[4],
        b[2], b[5], b[8], c[2], c[4], c[5],
    )  # fmt: skip


@kernel
def blocks(a):
    """(P11, P12, P22) of the 36 numbers, row by row, of a covariance, by its upper triangle."""
    return (
        (a[0], a[1], a[2], a[7], a[8], a[14]),
        (a[3], a[4], a[5], a[9], a[10], a[11], a[15], a[16], a[17]),
        (a[21], a[22], a[23], a[28], a[29], a[35]),
    )
