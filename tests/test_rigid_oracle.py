"""The references for torqued bodies against known numbers, closed forms and first integrals."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import oracle
import pytest
import rigid_oracle as ro

ONE = (1, 0, 0, 0)
START = (0.5, -0.5, 0.5, 0.5)
INERTIA = (0.6, 0.8, 1.0)
TENSOR = ((0.7, 0.05, -0.1), (0.05, 0.8, 0.02), (-0.1, 0.02, 0.9))
SPIN = (0.9, -0.4, 1.2)
TORQUES = {
    "constant_body": ro.constant_body((0.1, -0.2, 0.3)),
    "constant_inertial": ro.constant_inertial((0.1, -0.2, 0.3)),
    "linear_damping": ro.linear_damping((0.1, 0.2, 0.3)),
    "quadratic_damping": ro.quadratic_damping(0.2),
    "gravity_gradient": ro.gravity_gradient(TENSOR, 0.5),
    "heavy_top": ro.heavy_top(2.0, (0.1, 0.2, 0.3)),
    "dipole": ro.dipole((0.3, -0.2, 0.5), (1.0, 0.5, -0.7)),
    "pd_control": ro.pd_control(0.4, 0.3, (0.8, 0.0, 0.6, 0.0)),
    "rotor": ro.rotor((0.3, 0.2, -0.4)),
    "potential_v": ro.potential_v,
    "total": ro.total(ro.linear_damping(0.1), ro.potential_v),
}


def gap(a, b):
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


# known bodies


@pytest.mark.parametrize("body", [ro.BODY_H, ro.BODY_V], ids=["H", "V"])
def test_free_bodies(body):
    found = ro.integrate(body.inertia, ONE, body.w0, list(body.states), digits=24)
    for state, (m, q) in zip(found, body.states.values(), strict=True):
        bound = mp.mpf(10) ** (1 - body.digits)
        assert gap(ro.momentum(body.inertia, state.w), m) < bound
        assert gap(state.q, q) < bound


def test_digits():
    coarse, fine = (
        ro.integrate(TENSOR, START, SPIN, 3.0, ro.potential_v, digits=d).q for d in (20, 30)
    )
    assert 0 < gap(coarse, fine) < 1e-18


def test_backwards():
    there = ro.integrate(TENSOR, START, SPIN, 2.0, digits=20)
    back = ro.integrate(TENSOR, there.q, there.w, -2.0, digits=20)
    assert gap(back.q, START) < 1e-18
    assert gap(back.w, SPIN) < 1e-18


def test_jacobi():
    m = ro.JACOBI_PARAMETER
    found = [mp.ellipfun(f, 12, m=m) for f in ("sn", "cn", "dn")]
    assert gap(found, ro.JACOBI_12) < 1e-15
    assert abs(4 * mp.ellipk(m) - ro.JACOBI_PERIOD) < 1e-14


@pytest.mark.parametrize("epsilon", ro.FLIP_TIMES)
def test_flips(epsilon):
    """The momentum along the intermediate axis comes back with its sign changed."""
    inertia = ro.BODY_H.inertia
    w0 = ro.angular_velocity(inertia, (epsilon, mp.sqrt(1 - mp.mpf(epsilon) ** 2), 0))
    time = ro.FLIP_TIMES[epsilon]
    w = ro.integrate(inertia, ONE, w0, time, digits=20).w
    assert abs(w[0] - w0[0]) < 1e-8 * abs(w0[0])
    assert abs(w[1] + w0[1]) < 1e-8
    assert abs(w[2]) < 1e-8


# integrators


@pytest.mark.parametrize("name", TORQUES)
def test_float_agrees(name):
    """One body and an ensemble, in floats, end where the digits do."""
    exact = ro.integrate(TENSOR, START, SPIN, 4.0, TORQUES[name], digits=18)
    one = ro.integrate_float(TENSOR, START, SPIN, 4.0, TORQUES[name])
    many = ro.integrate_float(
        np.array([TENSOR, np.diag(INERTIA)]), START, [SPIN, SPIN], [2.0, 4.0], TORQUES[name]
    )
    assert one.q.shape == (4,)
    assert many.q.shape == (2, 2, 4)
    for found in (one.q, many.q[-1, 0]):
        assert gap(oracle.floats(exact.q), found) < 1e-12
    for found in (one.w, many.w[-1, 0]):
        assert gap(oracle.floats(exact.w), found) < 1e-12


def test_newton():
    """A force constant in space: free fall in inertial axes, whatever the body's turning."""
    v0, mass, force = (0.3, -0.1, 0.2), 2.0, (0.5, 0.25, -1.0)
    start = ro.to_inertial(START, oracle.vec(v0))

    def pull(t, q, w, v):
        return ro.to_body(q, force)

    arguments = (TENSOR, START, SPIN, 2.0, ro.potential_v)
    exact = ro.integrate(*arguments, force=pull, mass=mass, v0=v0, digits=18)
    found = ro.integrate_float(*arguments, force=pull, mass=mass, v0=v0)
    for state, bound in ((exact, 1e-16), (found, 1e-12)):
        speed = ro.to_inertial(state.q, state.v)
        assert gap(speed, [start[i] + force[i] for i in range(3)]) < bound
        assert gap(state.r, [2 * start[i] + force[i] for i in range(3)]) < bound


def test_coasting():
    """No force: the inertial velocity stays."""
    state = ro.integrate(TENSOR, START, SPIN, 1.5, mass=3.0, v0=(1.0, 2.0, 3.0), digits=18)
    assert gap(ro.to_inertial(state.q, state.v), ro.to_inertial(START, (1.0, 2.0, 3.0))) < 1e-16


def test_pole():
    """y = 1/(1 − t): no step passes the pole."""
    with pytest.raises(ArithmeticError, match=r"no convergence at t = (1\.0|0\.999)"):
        ro.solve(lambda t, y: (y[0] ** 2,), (1,), [2.0], digits=20)


# first integrals


def test_energy_of_potentials():
    """Torques with a potential: kinetic energy plus U stays."""
    moment, field, centre = (0.3, -0.2, 0.5), (1.0, 0.5, -0.7), (0.1, 0.2, 0.3)
    n = 0.5
    potentials = {
        "heavy_top": lambda q: 2 * ro.to_inertial(q, centre)[2],
        "dipole": lambda q: -ro.dot(ro.to_inertial(q, moment), field),
        "potential_v": lambda q: q[0] ** 2 - q[1] ** 2 - q[2] ** 2 + q[3] ** 2,
        "rotor": lambda q: 0,
    }
    for name, potential in potentials.items():
        first, last = ro.integrate(TENSOR, START, SPIN, [0, 3], TORQUES[name], digits=18)
        change = [ro.kinetic_energy(TENSOR, s.w) + potential(s.q) for s in (first, last)]
        assert abs(change[1] - change[0]) < 1e-16, name
    # gravity gradient, Jacobi's integral: T + 3/2 n² o·I o − n e3·L
    ends = ro.integrate(TENSOR, START, SPIN, [0, 3], TORQUES["gravity_gradient"], digits=18)
    kept = []
    for t, s in zip((0, 3), ends, strict=True):
        o = ro.to_body(s.q, (mp.cos(n * t), mp.sin(n * t), 0))
        height = 1.5 * n * n * ro.dot(o, ro.momentum(TENSOR, o))
        spin = n * ro.inertial_momentum(TENSOR, s.q, s.w)[2]
        kept.append(ro.kinetic_energy(TENSOR, s.w) + height - spin)
    assert abs(kept[1] - kept[0]) < 1e-16


def test_momentum():
    """Inertial momentum: kept by a rotor's total, growing evenly under a constant torque."""
    first, last = ro.integrate(TENSOR, START, SPIN, [0, 3], TORQUES["rotor"], digits=18)
    h = (0.3, 0.2, -0.4)
    kept = [
        ro.to_inertial(s.q, [a + b for a, b in zip(ro.momentum(TENSOR, s.w), h, strict=True)])
        for s in (first, last)
    ]
    assert gap(*kept) < 1e-16
    first, last = ro.integrate(TENSOR, START, SPIN, [0, 2], TORQUES["constant_inertial"], digits=18)
    ends = [ro.inertial_momentum(TENSOR, s.q, s.w) for s in (first, last)]
    gained = [b - a for a, b in zip(*ends, strict=True)]
    assert gap(gained, [2 * mp.mpf(c) for c in (0.1, -0.2, 0.3)]) < 1e-16


def test_potential_v_is_a_heavy_top():
    top = ro.heavy_top(1.0, (0.0, 0.0, 1.0))
    for q in oracle.quaternions(4):
        assert gap(ro.potential_v(0.0, q, None), top(0.0, q, None)) < 1e-15


def rk4(slope, y, h, steps):
    def rate(y):
        return np.array(slope(0.0, tuple(y)))

    for _ in range(steps):
        k1 = rate(y)
        k2 = rate(y + h / 2 * k1)
        k3 = rate(y + h / 2 * k2)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + h * k3))
    return y


def test_potential_v_figures():
    """Angle error of RK4 on body V under U, h = 0.1, T = 10: 7.6e-4 with U of q/|q|."""
    body = ro.BODY_V
    inertia, w0 = oracle.floats(body.inertia), oracle.floats(body.w0)
    exact = ro.integrate(inertia, ONE, w0, 10, ro.potential_v, digits=18)

    def of_attitude(t, q, w):
        return ro.potential_v(t, q / np.linalg.norm(q), w)

    for torque, figure in ((of_attitude, 7.6e-4), (ro.potential_v, 3.3e-4)):
        y = rk4(ro.equations(inertia, torque), np.array((*ONE, *w0)), 0.1, 100)
        assert float(oracle.quat_angle(y[:4], exact.q)) == pytest.approx(figure, rel=0.01)


# closed forms


def test_symmetric_top():
    q, w = ro.symmetric_top(START, SPIN, 0.6, 1.0, 5)
    state = ro.integrate((0.6, 0.6, 1.0), START, SPIN, 5, digits=20)
    assert gap(state.q, q) < 1e-18
    assert gap(state.w, w) < 1e-18


@pytest.mark.parametrize("which", [0, 1], ids=["slow", "fast"])
def test_heavy_top(which):
    i1, i3, theta, w3, weight, length = 0.6, 1.0, 0.7, 4.0, 2.0, 0.5
    rate = ro.heavy_top_precession(i1, i3, theta, w3, weight * length)[which]
    start = ro.regular_precession(theta, w3, rate, 0)
    top = ro.heavy_top(weight, (0.0, 0.0, length))
    state = ro.integrate((i1, i1, i3), *start, 2, top, digits=20)
    q, w = ro.regular_precession(theta, w3, rate, 2)
    assert gap(state.q, q) < 1e-18
    assert gap(state.w, w) < 1e-17


def test_heavy_top_limits():
    slow, fast = ro.heavy_top_precession(0.6, 1.0, 0.7, 1e6, 1.0)
    assert abs(slow * 1e6 - 1) < 1e-11
    assert abs(fast * 0.6 * mp.cos(0.7) / 1e6 - 1) < 1e-11
    with pytest.raises(ValueError, match="no regular precession"):
        ro.heavy_top_precession(0.6, 1.0, 0.7, 0.5, 1.0)


def test_top_energy():
    theta, psi, rates = 0.7, 0.3, (1.1, -0.4, 2.0)
    w = ro.euler_rate(theta, psi, *rates)
    energy = ro.kinetic_energy((0.6, 0.6, 1.0), w)
    assert abs(energy - ro.top_energy(0.6, 1.0, theta, *rates)) < 1e-40


def test_euler_rate():
    """w of 3-1-3 angles is the vector part of 2 q*∘q̇."""
    angles, rates, d = (0.4, 0.7, 0.3), (1.1, -0.4, 2.0), mp.mpf(10) ** -20
    ends = [
        ro.euler_attitude(*(mp.mpf(a) + s * d * r for a, r in zip(angles, rates, strict=True)))
        for s in (-1, 1)
    ]
    turned = oracle.quat_log(oracle.quat_mul(oracle.quat_conj(ends[0]), ends[1])) / (2 * d)
    assert gap(turned, ro.euler_rate(*angles[1:], *rates)) < 1e-30


@pytest.mark.parametrize("amplitude", [1e-3, 1.2])
def test_pitch_libration(amplitude):
    inertia, n, t = (1.0, 0.9, 0.6), 0.5, 6
    q0, w0, _ = ro.pitch_libration(inertia, n, amplitude, 0)
    state = ro.integrate(inertia, q0, w0, t, ro.gravity_gradient(inertia, n), digits=18)
    q, w, alpha = ro.pitch_libration(inertia, n, amplitude, t)
    assert gap(state.q, q) < 1e-16
    assert gap(state.w, w) < 1e-16
    if amplitude < 0.01:
        assert abs(alpha - amplitude * mp.cos(ro.pitch_frequency(inertia, n) * t)) < amplitude**3


@pytest.mark.parametrize(
    ("closed", "torque"),
    [
        (ro.linear_spin_down, ro.linear_damping(0.25)),
        (ro.quadratic_spin_down, ro.quadratic_damping(0.25)),
    ],
    ids=["linear", "quadratic"],
)
def test_spin_down(closed, torque):
    state = ro.integrate(INERTIA, ONE, (0.0, 0.0, 1.5), 4, torque, digits=18)
    w, angle = closed(1.0, 0.25, 1.5, 4)
    assert gap(state.w, (0, 0, w)) < 1e-16
    assert gap(state.q, oracle.quat_exp((0, 0, angle))) < 1e-16


def test_spin_down_of_a_sphere():
    state = ro.integrate((0.8,) * 3, ONE, SPIN, 2, ro.linear_damping(0.25), digits=18)
    found = [ro.linear_spin_down(0.8, 0.25, c, 2) for c in SPIN]
    assert gap(state.w, [w for w, _ in found]) < 1e-16
    assert gap(state.q, oracle.quat_exp([angle for _, angle in found])) < 1e-16


def test_pd_slew():
    """About one axis of a body under PD control: the angle's own equation, linear when small."""
    kp, kd, reference = 0.4, 0.3, oracle.floats(oracle.quat_exp((0, 0.5, 0)))
    q0 = oracle.quat_mul(reference, oracle.quat_exp((0, 1.5, 0)))
    torque = ro.pd_control(kp, kd, reference)
    state = ro.integrate(INERTIA, q0, (0, 0, 0), 5, torque, digits=18)
    theta, rate = ro.pd_slew(0.8, kp, kd, 1.5, 5, digits=18)
    turned = oracle.quat_mul(oracle.quat_conj(reference), state.q)
    assert gap(turned, oracle.quat_exp((0, theta, 0))) < 1e-15
    assert abs(state.w[1] - rate) < 1e-15


@pytest.mark.parametrize("kd", [0.3, 3.0])
def test_pd_slew_linear(kd):
    small = 1e-5
    exact = ro.pd_slew(0.8, 0.4, kd, small, 5, digits=18)
    assert gap(exact, ro.pd_slew_linear(0.8, 0.4, kd, small, 5)) < small**3


def test_pd_shorter_way():
    """q and −q are one attitude: the torque is the same."""
    torque = ro.pd_control(0.4, 0.3)
    q = (-0.1, 0.7, -0.5, 0.5)
    assert torque(0.0, q, SPIN) == torque(0.0, tuple(-c for c in q), SPIN)
    assert gap(torque(0.0, q, (0, 0, 0)), (0.28, -0.2, 0.2)) < 1e-15
