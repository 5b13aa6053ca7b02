"""The references for torqued bodies against known numbers, closed forms and first integrals."""

from __future__ import annotations

import mpmath as mp
import oracle
import pytest
import rigid_oracle as ro

ONE = (1, 0, 0, 0)
START = (0.5, -0.5, 0.5, 0.5)
INERTIA = (0.6, 0.8, 1.0)
TENSOR = ((0.7, 0.05, -0.1), (0.05, 0.8, 0.02), (-0.1, 0.02, 0.9))
SPIN = (0.9, -0.4, 1.2)
TORQUES = {
    "constant_inertial": ro.constant_inertial((0.1, -0.2, 0.3)),
    "gravity_gradient": ro.gravity_gradient(TENSOR, 0.5),
    "heavy_top": ro.heavy_top(2.0, (0.1, 0.2, 0.3)),
    "dipole": ro.dipole((0.3, -0.2, 0.5), (1.0, 0.5, -0.7)),
    "rotor": ro.rotor((0.3, 0.2, -0.4)),
    "potential_v": ro.potential_v,
}


def gap(a, b):
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def in_space(state):
    """C I w of the tensor's body."""
    return ro.to_inertial(state.q, ro.momentum(TENSOR, state.w))


# known bodies


@pytest.mark.parametrize("body", [ro.BODY_H, ro.BODY_V], ids=["H", "V"])
def test_free_bodies(body):
    found = ro.integrate(body.inertia, ONE, body.w0, list(body.states), digits=24)
    for state, (m, q) in zip(found, body.states.values(), strict=True):
        bound = mp.mpf(10) ** (1 - body.digits)
        assert gap(ro.momentum(body.inertia, state.w), m) < bound
        assert gap(state.q, q) < bound


# integrators


def test_newton():
    """A force constant in space: free fall in inertial axes, whatever the body's turning."""
    v0, mass, force = (0.3, -0.1, 0.2), 2.0, (0.5, 0.25, -1.0)
    start = ro.to_inertial(START, oracle.vec(v0))

    def pull(t, q, w, v):
        return ro.to_body(q, force)

    arguments = (TENSOR, START, SPIN, 2.0, ro.potential_v)
    state = ro.integrate(*arguments, force=pull, mass=mass, v0=v0, digits=18)
    speed = ro.to_inertial(state.q, state.v)
    assert gap(speed, [start[i] + force[i] for i in range(3)]) < 1e-16
    assert gap(state.r, [2 * start[i] + force[i] for i in range(3)]) < 1e-16


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
        spin = n * in_space(s)[2]
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
    ends = [in_space(s) for s in (first, last)]
    gained = [b - a for a, b in zip(*ends, strict=True)]
    assert gap(gained, [2 * mp.mpf(c) for c in (0.1, -0.2, 0.3)]) < 1e-16


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
