"""Errors of an estimated attitude and of a gyro's bias: transition, noise and covariance.

The error δθ (rad) is a rotation in body axes, C_true = C exp [δθ], and δb = b_true − b (rad/s) is
that of the bias that is subtracted from the gyro's rate, ω = gyro − b. They satisfy

    δθ̇ = −ω×δθ − δb − n_v,    ḃ = n_u,

with the angle random walk n_v, of density σ_v in rad/√s, and the rate random walk n_u, of density
σ_u in rad/s^1.5. Over a step h of constant ω, a rotation by u = ωh,

    (δθ, δb) ← [Φ11 Φ12; 0 1] (δθ, δb) + noise of covariance [Q11 Q12; Q12ᵀ Q22].

A covariance is (P11, P12, P22): P11 (rad²) and P22 (rad²/s²) in the order of ``sym3``, and the nine
numbers of P12 row by row. The formulas hold at any angle, including ``|u|`` = 0 and beyond 2π.
Lefferts, Markley and Shuster, *Journal of Guidance and Control* 5 (1982) 417; Farrenkopf, *Journal
of Guidance and Control* 1 (1978) 282; Markley and Crassidis, *Fundamentals of Spacecraft Attitude
Determination and Control* (2014), §6.2.
"""

from fastatt._jit import kernel
from fastatt.kernels import dcm, quat, so3, sym3
from fastatt.kernels.vec3 import dot


@kernel
def transition(u, h):
    """Transition of the error over a step at a constant rate.

    It is (Φ11, Φ12) = (exp −[u], −h Jr(u)). Φ11 also holds for any other path to the same rotation
    exp(u).
    """
    b, c = so3.jacobian_coefficients(dot(u, u))
    turned = dcm.from_quat(quat.conj(quat.exp(u)))
    return turned, dcm.scale(-h, so3.second_order(-b, c, u))


@kernel
def noise_at_rest(h, angle_variance, bias_variance):
    """Covariance of the noise over a step for ω = 0 (Farrenkopf).

    Returns (Q11, Q12, Q22) with σ_v² h + σ_u² h³/3, −σ_u² h²/2 and σ_u² h.
    """
    F = type(h)
    o = F(0.0)
    q22 = bias_variance * h
    q12 = F(-0.5) * q22 * h
    q11 = F(1.0 / 3.0) * q22 * h * h + angle_variance * h
    return ((q11, o, o, q11, o, q11), (q12, o, o, o, q12, o, o, o, q12), (q22, o, o, q22, o, q22))


@kernel
def noise(u, h, angle_variance, bias_variance):
    """Covariance of white noise over a step, exact for constant ω.

    With θ = ``|u|``, Q11 = σ_v² h + σ_u² h³ (1/3 + (θ³/3 − 2θ + 2 sin θ)/θ⁵ [u]²), Q12 =
    −σ_u² h² (1/2 − (θ − sin θ)/θ³ [u] + (θ²/2 + cos θ − 1)/θ⁴ [u]²), Q22 = σ_u² h.
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
    """Covariance after a step, Φ P Φᵀ + Q."""
    f, g = phi
    p11, p12, p22 = p
    q11, q12, q22 = q
    a = dcm.add(sym3.mul(f, p11), dcm.mul(g, dcm.transpose(p12)))
    b = dcm.add(dcm.mul(f, p12), sym3.mul(g, p22))
    # the upper triangle of a fᵀ + b gᵀ, which is symmetric
    s = sym3.add(sym3.product(a, f), sym3.product(b, g))
    return sym3.add(s, q11), dcm.add(b, q12), sym3.add(p22, q22)


@kernel
def to_inertial(c, p):
    """Convert a covariance of errors along body axes to errors along inertial axes.

    Returns the covariance for C_true = exp [C δθ] C.
    """
    return sym3.congruence(c, p[0]), dcm.mul(c, p[1]), p[2]


@kernel
def to_body(c, p):
    """Convert a covariance of errors along inertial axes to errors along body axes."""
    return to_inertial(dcm.transpose(c), p)


@kernel
def transition_matrix(phi):
    """The 6×6 matrix of (Φ11, Φ12)."""
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
    """The 6×6 matrix of a covariance (P11, P12, P22)."""
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
    """The blocks (P11, P12, P22) of a 6×6 covariance, from its upper triangle."""
    return (
        (a[0], a[1], a[2], a[7], a[8], a[14]),
        (a[3], a[4], a[5], a[9], a[10], a[11], a[15], a[16], a[17]),
        (a[21], a[22], a[23], a[28], a[29], a[35]),
    )
