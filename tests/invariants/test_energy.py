"""Energy and momentum of bodies, and their drift, from definitions."""

import numpy as np
import pytest
from exact import EPS, START
from numba import njit

import fastatt as fa
from fastatt.invariants.energy import potential_energy

N = 5
RNG = np.random.default_rng(11)
W = RNG.normal(size=(3, N, 3))
Q = RNG.normal(size=(3, N, 4))
Q /= np.linalg.norm(Q, axis=-1, keepdims=True)
TENSORS = np.array([a @ a.T + 12.0 * np.eye(3) for a in RNG.normal(size=(N, 3, 3))])
SHAPES = {
    "moments": np.array([1.0, 2.0, 2.5]),
    "moments of each": RNG.uniform(1.0, 1.5, (N, 3)),
    "tensor": TENSORS[0],
    "tensor of each": TENSORS,
}


def tensor_of(inertia, b):
    given = inertia if inertia.ndim == 1 or inertia.shape == (3, 3) else inertia[b]
    return np.diag(given) if given.ndim == 1 else given


@pytest.mark.parametrize("inertia", SHAPES.values(), ids=SHAPES)
def test_momentum_and_kinetic_energy(inertia):
    m = fa.angular_momentum(W, inertia)
    space = fa.angular_momentum(W, inertia, Q)
    energy = fa.kinetic_energy(W, inertia)
    assert energy.shape == (3, N)
    for s in range(3):
        for b in range(N):
            expected = tensor_of(inertia, b) @ W[s, b]
            assert m[s, b] == pytest.approx(expected, rel=1e-14)
            assert space[s, b] == pytest.approx(fa.quat_to_dcm(Q[s, b]) @ expected, abs=1e-13)
            assert energy[s, b] == pytest.approx(0.5 * W[s, b] @ expected, rel=1e-14)


@njit
def pulling(t, q, w, p):
    return 2.0 * p[0] * (q[0] * q[1] + q[2] * q[3]), 2.0 * p[0] * (q[0] * q[2] - q[1] * q[3]), 0.0


@njit
def height(t, q, p):
    return p[0] * (q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3])


TORQUES = {
    "weight": fa.torques.HeavyTop((0.0, 0.0, 0.5), 2.0),
    "dipole": fa.torques.MagneticDipole((0.0, 0.0, 0.5), (0.0, 0.0, -2.0)),
    "user": fa.torques.Custom(pulling, (1.0,), uses_rate=False, potential=height),
    "sum": fa.torques.Sum(
        (fa.torques.HeavyTop((0.0, 0.0, 1.0), 1.0), fa.torques.Rotor((0.1, 0.2, 0.3)))
    ),
}


@pytest.mark.parametrize("name", TORQUES)
@pytest.mark.parametrize(
    "inertia", [SHAPES["moments"], SHAPES["tensor"]], ids=["moments", "tensor"]
)
def test_potentials(name, inertia):
    """All four are C33 of a unit weight at e3, in body axes that need not be principal."""
    scene = fa.Scene(inertia=inertia, torque=TORQUES[name])
    expected = fa.quat_to_dcm(Q)[..., 2, 2]
    assert np.abs(potential_energy(scene, Q) - expected).max() < 8 * EPS
    assert potential_energy(scene, 1.3 * Q[0, 0]) == pytest.approx(expected[0, 0], abs=8 * EPS)


def test_drift_under_a_weight():
    """Energy is kept to the method's order, momentum is not asked for; one body and many."""
    scene = fa.Scene(inertia=(1.0, 2.0, 2.5), torque=TORQUES["weight"])
    one = fa.propagate(scene, START, W[0, 0], dt=0.05, n_steps=100, save_every=10, method="rk4")
    drift = fa.drift(one, scene)
    kinetic = fa.kinetic_energy(one.w, scene.inertia)
    total = kinetic + potential_energy(scene, one.q[:, None], one.t)[:, 0]
    assert drift.energy.shape == (11,)
    assert drift.energy == pytest.approx(np.abs(total - total[0]) / kinetic.max(), abs=1e-16)
    assert 1e-12 < drift.energy.max() < 1e-4
    assert drift.momentum is None


def test_drift_of_free_bodies():
    scene = fa.Scene(inertia=SHAPES["moments of each"])
    q0 = np.tile(START, (N, 1))
    loose, tight = (
        fa.drift(
            fa.propagate(scene, q0, W[0], dt=0.1, n_steps=100, save_every=20, method=method), scene
        )
        for method in ("rk4", "exact")
    )
    assert tight.energy.shape == tight.momentum.shape == (6, N)
    assert tight.energy.max() < 20 * EPS
    assert tight.momentum.max() < 20 * EPS
    assert loose.energy[-1].max() > 100 * EPS
    assert loose.momentum[-1].max() > 100 * EPS


def test_drift_with_wheels():
    """Body and wheels together keep their momentum, and the energy without the wheels' own."""
    scene = fa.Scene(inertia=(1.0, 2.0, 2.5), torque=fa.torques.Rotor((0.3, -0.2, 0.5)))
    traj = fa.propagate(scene, START, W[0, 0], dt=0.01, n_steps=500, save_every=50, method="rk8")
    drift = fa.drift(traj, scene)
    assert drift.momentum.max() < 1e-13
    assert drift.energy.max() < 1e-13
