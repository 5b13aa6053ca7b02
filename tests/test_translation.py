"""Newton's equation in body axes beside every method that carries it, against mpmath."""

from __future__ import annotations

import numpy as np
import pytest
import rigid_oracle as ro
from exact import EPS, LENGTHY, START, angle
from numba import njit
from oracle import floats

import fastatt as fa

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
    s = ro.integrate(inertia, START.tolist(), spin, span, force=force, mass=MASS, v0=V0, digits=20)
    return np.array(floats(s.v)), np.array(floats(s.r)) + R0


def built_in(t, q, w, v):
    weight = ro.to_body(q, WEIGHT)
    return [THRUST[i] + weight[i] - DRAG * v[i] for i in range(3)]


FORCES = {
    "thrust": (THRUST, lambda t, q, w, v: THRUST),
    "sum": (
        fa.forces.Sum(
            (
                fa.forces.Constant(THRUST),
                fa.forces.ConstantInertial(WEIGHT),
                fa.forces.Drag(DRAG),
            )
        ),
        built_in,
    ),
    "user": (pushing, lambda t, q, w, v: pushing.py_func(t, q, w, v, ())),
}
BODY = fa.Scene(inertia=INERTIA, mass=MASS, force=THRUST)


def run(scene, method, n, span=SPAN, w0=SPIN, r0=R0, **options):
    beside = {} if scene.inertia is None else {"w0": w0}
    return fa.propagate(
        scene, START, **beside, v0=V0, r0=r0, dt=span / n, n_steps=n, method=method, **options
    )


def gap(traj, v, r):
    return max(np.abs(traj.v[-1] - v).max(), np.abs(traj.r[-1] - r).max())


@pytest.mark.parametrize("method", [m for m in fa.methods_for(BODY, "quat") if m not in LENGTHY])
def test_order_is_four_at_least(method):
    """Of velocity and position, whatever the order of the attitude."""
    v, r = oracle(FORCES["thrust"][1])
    errors = [gap(run(BODY, method, n), v, r) for n in (40, 80)]
    assert errors[1] < 1e-5
    assert np.log2(errors[0] / errors[1]) > 3.75


@pytest.mark.parametrize("name", ["sum", "user"])
def test_forces(name):
    force, described = FORCES[name]
    v, r = oracle(described)
    scene = fa.Scene(inertia=INERTIA, mass=MASS, force=force)
    errors = [gap(run(scene, "rkmk4", n), v, r) for n in (100, 200)]
    assert errors[1] < 1e-7
    assert 12.0 < errors[0] / errors[1] < 20.0


@pytest.mark.parametrize("h", [0.01, 1.0, 2.5])
def test_exact_for_a_constant_turn_and_force(h):
    """V1 = exp(−hΩ)V0 + (h/μ)Jr(hΩ)F, and the position, at any step of less than π."""
    w = (0.7, -0.6, 0.5)
    v, r = oracle(FORCES["thrust"][1], (1, 1, 1), w, 20 * h)
    for scene in (
        fa.Scene(rate=fa.rates.Constant(w), mass=MASS, force=THRUST),
        fa.Scene(inertia=(1.5, 1.5, 1.5), mass=MASS, force=THRUST),
    ):
        method = "magnus4" if scene.inertia is None else "rkmk4"
        traj = run(scene, method, 20, 20 * h, w)
        assert gap(traj, v, r) < 1e-14 * 20 * (1.0 + h) * (1.0 + np.abs(r).max())


def test_rates_in_inertial_axes():
    """A body that turns at a constant inertial rate is one that turns at the same body rate."""
    w = np.array([0.7, -0.6, 0.5])
    body = fa.rotate_inverse(START, w)
    scenes = (
        fa.Scene(rate=fa.rates.Constant(w), frame="inertial", mass=MASS, force=THRUST),
        fa.Scene(rate=fa.rates.Constant(body), mass=MASS, force=THRUST),
    )
    one, two = (run(scene, "magnus4", 30) for scene in scenes)
    assert np.abs(one.v[-1] - two.v[-1]).max() < 100 * EPS
    assert np.abs(one.r[-1] - two.r[-1]).max() < 100 * EPS
    assert np.abs(one.w[-1] - body).max() < 100 * EPS


def test_tensor_inertia_and_matrices():
    """Body axes that are not principal, and the attitude as a matrix, change nothing."""
    turn = np.array([0.8, 0.2, -0.4, 0.4])
    turn /= np.linalg.norm(turn)
    c = fa.quat_to_dcm(turn)
    plain = run(BODY, "rkmk4", 50)
    scene = fa.Scene(inertia=c @ np.diag(INERTIA) @ c.T, mass=MASS, force=c @ THRUST)
    conj = turn * (1.0, -1.0, -1.0, -1.0)
    traj = fa.propagate(
        scene, fa.quat_multiply(START, conj), c @ SPIN, v0=c @ V0, r0=R0, dt=SPAN / 50, n_steps=50,
        method="rkmk4", representation="dcm",
    )  # fmt: skip
    assert np.abs(traj.v[-1] @ c - plain.v[-1]).max() < 1e-13
    assert np.abs(traj.r[-1] - plain.r[-1]).max() < 1e-13
    assert angle(fa.quat_multiply(traj.q[-1], turn), plain.q[-1]) < 1e-13


def test_each_body_has_its_own():
    """Masses, forces and starts a row each, against single runs; without r0 no position."""
    n = 66
    rng = np.random.default_rng(3)
    mass, force, v0 = rng.uniform(1, 3, n), rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    moments = rng.uniform(1, 1.5, (n, 3))
    scene = fa.Scene(inertia=moments, mass=mass, force=force)
    options = {"dt": 0.1, "n_steps": 10, "method": "rk4", "save_every": 5}
    q0 = np.tile(START, (n, 1))
    full = fa.propagate(scene, q0, SPIN, v0=v0, **options)
    assert full.v.shape == (3, n, 3)
    assert np.array_equal(full.v[0], v0)
    with pytest.raises(ValueError, match="r: is not carried; it is in a scene with mass"):
        _ = full.r
    for b in (0, 65):
        one = fa.Scene(inertia=moments[[b]], mass=mass[[b]], force=force[[b]])
        single = fa.propagate(one, q0[:1], SPIN, v0=v0[[b]], **options)
        assert np.array_equal(single.v[:, 0], full.v[:, b])


WRONG = [
    ({"mass": 1.0}, "force: is missing; mass and force go together"),
    ({"force": THRUST}, "mass: is missing; mass and force go together"),
    ({"mass": 0.0, "force": THRUST}, "mass is 0.0; accepted: above 0, kg"),
    ({"mass": [1.0, -2.0], "force": THRUST}, r"mass\[1\] is -2.0; accepted: above 0, kg"),
    ({"mass": 1.0, "force": (1, 2)}, r"force: Constant.force has shape \(2,\); accepted are"),
]


@pytest.mark.parametrize(("given", "message"), WRONG)
def test_refusals(given, message):
    with pytest.raises(ValueError, match=message):
        fa.Scene(inertia=INERTIA, **given)


def test_what_a_run_needs():
    with pytest.raises(ValueError, match="v0: is missing; a scene with mass needs"):
        fa.propagate(BODY, START, SPIN, dt=0.1, n_steps=1)
    plain = fa.Scene(inertia=INERTIA)
    with pytest.raises(ValueError, match="v0: found, but this scene has none; a scene with mass"):
        fa.propagate(plain, START, SPIN, v0=V0, dt=0.1, n_steps=1)
    with pytest.raises(ValueError, match="method: found 'dmv10'; accepted: rk4, cf4, rkmk4, rk8"):
        run(BODY, "dmv10", 10)
    with pytest.raises(TypeError, match="force: found float; accepted is a model of"):
        fa.Scene(inertia=INERTIA, mass=1.0, force=3.0)
