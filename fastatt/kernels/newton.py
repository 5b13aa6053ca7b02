"""Newton's equation in body axes, μ(V̇ + Ω×V) = F, over one step of a known turn.

In the axes of the step's start the velocity is V(s) = E(s) v(s) and V̇ = E F/μ, with E = exp σ the
turn since then. σ(s) is the cubic through the turn u of the whole step and the rates at its ends;
V follows from it by the classical Runge-Kutta weights, corrected by what those weights miss of a
constant turn under a constant force, for which the step is exact: v1 = exp(−u) v0 + (h/μ) Jr(u) F.
"""

from fastatt._jit import kernel
from fastatt.kernels import quat, so3
from fastatt.kernels.vec3 import add, axpy, dot, scale, sub


@kernel
def middle(u, h, w0, w1):
    """(σ, w) halfway through a step of turn u that starts at rate w0 and ends at w1."""
    F = type(h)
    end = so3.dexpinv(u, w1)
    turn = axpy(F(0.125) * h, sub(w0, end), scale(F(0.5), u))
    rate = axpy(F(-0.25), add(w0, end), scale(F(1.5) / h, u))
    return turn, so3.dexp(turn, rate)


@kernel
def turned_integral(u, f):
    """∫₀¹ exp(s u) f ds = Jl(u) f."""
    b, c = so3.jacobian_coefficients(dot(u, u))
    return so3.second_order_apply(b, c, u, f)


@kernel
def turned_second_integral(u, f):
    """∫₀¹ ∫₀ʳ exp(s u) f ds dr = (½ + (θ − sin θ)/θ³ [u] + (θ²/2 + cos θ − 1)/θ⁴ [u]²) f."""
    F = type(u[0])
    z = dot(u, u)
    _, b = so3.jacobian_coefficients(z)
    g = so3.second_order_apply(b + b, F(2.0) * so3.second_integral_coefficient(z), u, f)
    return scale(F(0.5), g)


@kernel
def velocity(h, u, v, k1, k2, k3, k4, f):
    """Velocity at the end, in the axes of the start; k are E F/μ at the stages, f F/μ halfway."""
    F = type(h)
    half = quat.exp(scale(F(0.5), u))
    sixth = F(1.0 / 6.0)
    e = axpy(F(4.0), quat.rotate(half, f), add(f, quat.rotate(quat.mul(half, half), f)))
    missed = axpy(-sixth, e, turned_integral(u, f))
    k = axpy(sixth, add(axpy(F(2.0), add(k2, k3), k1), k4), missed)
    return axpy(h, k, v)


@kernel
def displacement(h, u, v, k1, k2, k3, f):
    """What the body moved, in the axes of the start; arguments as of ``velocity``."""
    F = type(h)
    half = quat.exp(scale(F(0.5), u))
    sixth = F(1.0 / 6.0)
    missed = axpy(-sixth, axpy(F(2.0), quat.rotate(half, f), f), turned_second_integral(u, f))
    k = axpy(sixth, add(add(k1, k2), k3), missed)
    return axpy(h * h, k, scale(h, v))
