"""The references for torqued bodies against known numbers and first integrals."""

import mpmath as mp
import oracle
import pytest
import rigid_oracle as ro

ONE = (1, 0, 0, 0)
START = (0.5, -0.5, 0.5, 0.5)
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

    def pull(t, q, w, v, r):
        return ro.to_body(q, force)

    arguments = (TENSOR, START, SPIN, 2.0, lambda t, q, w, v, r: ro.potential_v(t, q, w))
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
