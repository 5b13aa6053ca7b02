"""Newton's equation in body axes by every method that steps it, against mpmath."""

from __future__ import annotations

import numpy as np
import pytest
import rigid_oracle as ro
from exact import EPS, START, angle
from numba import njit
from oracle import floats

import fastatt as fa
from fastatt.propagation.choice_of_method import methods_for

INERTIA = (2.0, 1.0, 2.0 / 3.0)
SPIN = np.array([0.3, 0.9, -0.5])
V0, R0 = np.array([1.0, 2.0, -0.5]), np.array([0.1, 0.2, 0.3])
MASS, THRUST, WEIGHT, DRAG = 2.0, (0.3, -0.2, 0.5), (0.1, 0.0, -1.5), 0.4
SPAN = 3.0


@njit
def pushing(t, q, w, v, p):
    """A thrust, a weight and drag, and what none of the models has: time, rate and attitude."""
    return 0.3 - 0.4 * v[0] + 0.05 * w[1], -0.2 - 0.4 * v[1] + 0.1 * t, 0.5 * q[0] - 0.4 * v[2]


def oracle(force, inertia=INERTIA, spin=SPIN, span=SPAN):
    moved = {"force": force, "mass": MASS, "v0": V0, "r0": R0}
    s = ro.integrate(inertia, START.tolist(), spin, span, digits=20, **moved)
    return np.array(floats(s.v)), np.array(floats(s.r))


def built_in(t, q, w, v, r):
    weight = ro.to_body(q, WEIGHT)
    return [THRUST[i] + weight[i] - DRAG * v[i] for i in range(3)]


TERMS = fa.forces.Constant(THRUST), fa.forces.ConstantInertial(WEIGHT), fa.forces.Drag(DRAG)
FORCES = {
    "thrust": (THRUST, lambda t, q, w, v, r: THRUST),
    "sum": (fa.forces.Sum(TERMS), built_in),
    "user": (pushing, lambda t, q, w, v, r: pushing.py_func(t, q, w, v, ())),
}
BODY = fa.Scene(inertia=INERTIA, mass=MASS, force=THRUST)


def run(scene, method, n, span=SPAN, w0=SPIN, r0=R0, **options):
    beside = {} if scene.inertia is None else {"w0": w0}
    return fa.propagate(
        scene, START, **beside, v0=V0, r0=r0, dt=span / n, n_steps=n, method=method, **options
    )


def gap(traj, v, r):
    return max(np.abs(traj.v[-1] - v).max(), np.abs(traj.r[-1] - r).max())


def order(scene, end, method, n, **options):
    """The order that runs of two numbers of steps show."""
    errors = [gap(run(scene, method, k, **options), *end) for k in n]
    assert errors[1] > 100 * EPS
    return np.log(errors[0] / errors[1]) / np.log(n[1] / n[0])


def test_which_methods_fit():
    assert methods_for(BODY) == ["rk4", "rk8", "rk9", "gbs16"]
    assert run(BODY, None, 1).method == "rk8"


@pytest.mark.parametrize("name", ["sum", "user"])
def test_forces(name):
    force, described = FORCES[name]
    scene = fa.Scene(inertia=INERTIA, mass=MASS, force=force)
    end = oracle(described)
    assert gap(run(scene, "rk8", 100), *end) < 1e-12
    assert order(scene, end, "rk4", (100, 200)) == pytest.approx(4.0, abs=0.25)


def test_given_rates():
    """A body that turns at a constant inertial rate is one that turns at the same body rate."""
    w = np.array([0.7, -0.6, 0.5])
    body = fa.quat_rotate_inverse(START, w)
    end = oracle(FORCES["thrust"][1], (1, 1, 1), body)
    for scene in (
        fa.Scene(rate=fa.rates.Constant(w), frame="inertial", mass=MASS, force=THRUST),
        fa.Scene(rate=fa.rates.Constant(body), mass=MASS, force=THRUST),
    ):
        assert order(scene, end, None, (40, 80)) == pytest.approx(4.0, abs=0.25)
        found = run(scene, None, 40)
        assert found.method == "rk4"
        assert np.abs(found.w[-1] - body).max() < 100 * EPS


def test_tensor_inertia_and_matrices():
    """Body axes that are not principal, and the attitude as a matrix, change nothing."""
    turn = np.array([0.8, 0.2, -0.4, 0.4])
    turn /= np.linalg.norm(turn)
    c = fa.quat_to_dcm(turn)
    plain = run(BODY, "rk8", 100)
    scene = fa.Scene(inertia=c @ np.diag(INERTIA) @ c.T, mass=MASS, force=c @ THRUST)
    conj = turn * (1.0, -1.0, -1.0, -1.0)
    traj = fa.propagate(
        scene, fa.quat_multiply(START, conj), c @ SPIN, v0=c @ V0, r0=R0, dt=SPAN / 100,
        n_steps=100, method="rk8", representation="dcm",
    )  # fmt: skip
    assert np.abs(traj.v[-1] @ c - plain.v[-1]).max() < 1e-13
    assert np.abs(traj.r[-1] - plain.r[-1]).max() < 1e-13
    assert angle(fa.quat_multiply(traj.q[-1], turn), plain.q[-1]) < 1e-13
