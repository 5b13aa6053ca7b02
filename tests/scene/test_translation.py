"""Newton's equation, with torques and forces that read the position, against mpmath."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import rigid_oracle as ro
from exact import EPS, START, angle
from numba import njit
from oracle import floats

import fastatt as fa
from fastatt.kernels import quat, vec3
from fastatt.propagation.choice_of_method import methods_for

INERTIA = (2.0, 1.0, 2.0 / 3.0)
TENSOR = np.array([[2.0, 0.2, 0.1], [0.2, 2.5, -0.3], [0.1, -0.3, 3.0]])
SPIN = np.array([0.3, 0.9, -0.5])
V0, R0 = np.array([0.4, -0.2, 0.5]), np.array([0.6, 0.2, -0.3])
MASS, THRUST, WEIGHT, DRAG = 2.0, (0.3, -0.2, 0.5), (0.1, 0.0, -1.5), 0.4
SPAN = 3.0
BODY = fa.Scene(inertia=INERTIA, mass=MASS, force=THRUST)
at_position = {"uses_position": True}


def oracle(torque, force, span, *, inertia=INERTIA, spin=SPIN, v0=V0, r0=R0):
    """(q, w, v, r) at the end, of 18 digits."""
    moved = {"force": force, "mass": MASS, "v0": v0, "r0": r0}
    end = ro.integrate(inertia, START.tolist(), spin, span, torque, digits=18, **moved)
    return [np.array(floats(x)) for x in end]


def run(scene, n, span=SPAN, method="rk8", **options):
    given = {"w0": None if scene.inertia is None else SPIN, "v0": V0, "r0": R0, **options}
    return fa.propagate(scene, START, dt=span / n, n_steps=n, method=method, **given)


def gap(traj, end):
    """The largest error of q (rad), w, v and r."""
    found = [getattr(traj, name)[-1] for name in "qwvr"]
    others = [np.abs(x - y).max() for x, y in zip(found[1:], end[1:], strict=True)]
    return max(angle(found[0], end[0]), *others)


def order(scene, end, method, n):
    """The order that runs of two numbers of steps show."""
    errors = [gap(run(scene, k, method=method), end) for k in n]
    assert errors[1] > 100 * EPS
    return np.log(errors[0] / errors[1]) / np.log(n[1] / n[0])


@njit
def pushing(t, q, w, v, p):
    """A thrust, a weight and drag, and what none of the models has: time, rate and attitude."""
    return 0.3 - 0.4 * v[0] + 0.05 * w[1], -0.2 - 0.4 * v[1] + 0.1 * t, 0.5 * q[0] - 0.4 * v[2]


def built_in(t, q, w, v, r):
    weight = ro.to_body(q, WEIGHT)
    return [THRUST[i] + weight[i] - DRAG * v[i] for i in range(3)]


TERMS = fa.forces.Constant(THRUST), fa.forces.ConstantInertial(WEIGHT), fa.forces.Drag(DRAG)
FORCES = {
    "sum": (fa.forces.Sum(TERMS), built_in),
    "user": (pushing, lambda t, q, w, v, r: pushing.py_func(t, q, w, v, ())),
}


def drawn(t, q, w, v, r, p):
    return p[0] * r[1] + 0.2 * t, -p[0] * r[0], -0.3 * v[2]


def pulled(t, q, w, v, r, p):
    return -p[0] * r[0], 0.1 * t, -r[2] - 0.2 * v[1]


COUPLED = fa.Scene(
    inertia=INERTIA,
    mass=MASS,
    torque=fa.torques.Custom(drawn, (0.7,), **at_position),
    force=fa.forces.Custom(pulled, (1.1,), **at_position),
)


def test_which_methods_fit():
    assert run(BODY, 1, method=None).method == "rk8"
    still = replace(COUPLED, torque=replace(COUPLED.torque, uses_rate=False))
    for scene in (BODY, COUPLED, still):
        assert methods_for(scene) == ["rk4", "rk8", "rk9", "gbs16"]


@pytest.mark.parametrize("name", ["sum", "user"])
def test_forces(name):
    force, described = FORCES[name]
    scene = fa.Scene(inertia=INERTIA, mass=MASS, force=force)
    end = oracle(None, described, SPAN)
    assert gap(run(scene, 100), end) < 1e-12
    assert order(scene, end, "rk4", (100, 200)) == pytest.approx(4.0, abs=0.25)


def test_given_rates():
    """A body that turns at a constant inertial rate is one that turns at the same body rate."""
    w = np.array([0.7, -0.6, 0.5])
    body = fa.quat_rotate_inverse(START, w)
    end = oracle(None, lambda *state: THRUST, SPAN, inertia=(1, 1, 1), spin=body)
    for scene in (
        fa.Scene(rate=fa.rates.Constant(w), frame="inertial", mass=MASS, force=THRUST),
        fa.Scene(rate=fa.rates.Constant(body), mass=MASS, force=THRUST),
    ):
        assert order(scene, end, None, (40, 80)) == pytest.approx(4.0, abs=0.25)
        found = run(scene, 40, method=None)
        assert found.method == "rk4"
        assert np.abs(found.w[-1] - body).max() < 100 * EPS


def test_tensor_inertia_and_matrices():
    """Body axes that are not principal, and the attitude as a matrix, change nothing."""
    turn = np.array([0.8, 0.2, -0.4, 0.4])
    turn /= np.linalg.norm(turn)
    c = fa.quat_to_dcm(turn)
    plain = run(BODY, 100)
    scene = fa.Scene(inertia=c @ np.diag(INERTIA) @ c.T, mass=MASS, force=c @ THRUST)
    conj = turn * (1.0, -1.0, -1.0, -1.0)
    traj = fa.propagate(
        scene, fa.quat_multiply(START, conj), c @ SPIN, v0=c @ V0, r0=R0, dt=SPAN / 100,
        n_steps=100, method="rk8", representation="dcm",
    )  # fmt: skip
    assert np.abs(traj.v[-1] @ c - plain.v[-1]).max() < 1e-13
    assert np.abs(traj.r[-1] - plain.r[-1]).max() < 1e-13
    assert angle(fa.quat_multiply(traj.q[-1], turn), plain.q[-1]) < 1e-13


# a planet


def planet(t, q, w, v, r):
    """Gravity of one at the origin, of μ = 1, along body axes."""
    size = ro.length(r)
    return ro.to_body(q, [-MASS * x / size**3 for x in r])


def gradient(t, q, w, v, r):
    """Its gradient: 3 μ/r³ o×(I o)."""
    size = ro.length(r)
    o = ro.to_body(q, [x / size for x in r])
    return [3 * x / size**3 for x in ro.cross(o, ro.times(ro.tensor(INERTIA), o))]


ECCENTRIC = 0.4
PERIAPSIS = np.array([1.0 - ECCENTRIC, 0.0, 0.0])
THERE = np.array([0.0, math.sqrt((1.0 + ECCENTRIC) / (1.0 - ECCENTRIC)), 0.0])
ORBIT = fa.Scene(
    inertia=INERTIA,
    mass=MASS,
    torque=fa.torques.CentralGravityGradient(1.0),
    force=fa.forces.CentralGravity(1.0),
)


def test_kepler_orbit():
    start = {"v0": fa.quat_rotate_inverse(START, THERE), "r0": PERIAPSIS}
    end = oracle(gradient, planet, 2.0, **start)
    assert gap(run(ORBIT, 100, 2.0, **start), end) < 1e-12


def test_a_step_too_large_at_periapsis_is_flagged():
    """By the turn in orbit, however slowly the body turns; its neighbour stays on its circle."""
    e = 0.9
    r0 = np.array([[1 - e, 0, 0], [1, 0, 0]])
    v0 = [[0, math.sqrt((1 + e) / (1 - e)), 0], [0, 1, 0]]
    body = fa.Scene(inertia=INERTIA, mass=MASS, force=fa.forces.CentralGravity(1.0))
    traj = fa.propagate(
        body, [[1, 0, 0, 0]] * 2, [1e-3, 0, 0], r0=r0, v0=v0,
        dt=2 * math.pi / 64, n_steps=64, method="rk8",
    )  # fmt: skip
    assert traj.status.tolist() == [fa.Status.STEP_TOO_LARGE, 0]
    assert np.abs(traj.r[-1] - r0)[0].max() > 0.1
    assert np.abs(traj.r[-1] - r0)[1].max() < 1e-11


def test_a_centre_among_several_forces_limits_steps():
    """As one alone does, wherever it stands in the sum."""
    centre, rest = fa.forces.CentralGravity(1.0), fa.forces.Constant((0.0, 0.0, 0.0))
    given = {"r0": [[0.05, 0, 0], [1, 0, 0]], "v0": [[0, 20.0**0.5, 0], [0, 1, 0]]}
    for force in (centre, fa.forces.Sum((centre, rest)), fa.forces.Sum((rest, centre))):
        body = fa.Scene(inertia=INERTIA, mass=MASS, force=force)
        q0, steps = [[1, 0, 0, 0]] * 2, {"dt": 0.05, "n_steps": 20, "method": "rk4"}
        traj = fa.propagate(body, q0, [1e-3, 0, 0], **given, **steps)
        assert traj.status.tolist() == [fa.Status.STEP_TOO_LARGE, 0]


def test_a_circular_orbit_at_a_given_rate():
    """A circular orbit of a body that turns as it is told, along inertial axes."""
    scene = fa.Scene(
        rate=fa.rates.Constant((0.0, 0.0, 0.3)), frame="inertial", mass=[1.0, MASS],
        force=fa.forces.CentralGravity(1.0),
    )  # fmt: skip
    given = {"v0": [0, 1, 0], "r0": [1, 0, 0]}
    c, s = math.cos(3.0), math.sin(3.0)
    errors = []
    for n in (50, 100):
        traj = fa.propagate(scene, [[1.0, 0, 0, 0]] * 2, **given, dt=3.0 / n, n_steps=n)
        v = fa.quat_rotate(traj.q[-1], traj.v[-1])
        errors.append(max(np.abs(traj.r[-1] - (c, s, 0)).max(), np.abs(v - (-s, c, 0)).max()))
    assert errors[1] < 1e-6
    assert 14.0 < errors[0] / errors[1] < 18.0
    far = fa.propagate(scene, [[1.0, 0, 0, 0]] * 2, **given, dt=1.0, n_steps=3)
    assert (far.status == fa.Status.STEP_TOO_LARGE).all()  # in orbit: the body turns by 0.3


# a spring from the origin to a point of the body


def stretched(q, r, p):
    a = quat.rotate(q, p[1:4])
    return r[0] + a[0], r[1] + a[1], r[2] + a[2]


def sprung(t, q, w, v, r, p):
    x = stretched(q, r, p)
    return quat.rotate_inverse(q, (-p[0] * x[0], -p[0] * x[1], -p[0] * x[2]))


def twisted(t, q, w, v, r, p):
    return vec3.cross(p[1:4], sprung(t, q, w, v, r, p))


def stored(t, q, r, p):
    x = stretched(q, r, p)
    return 0.5 * p[0] * (x[0] * x[0] + x[1] * x[1] + x[2] * x[2])


STIFF, ARM = 3.0, (0.3, -0.2, 0.5)
P = (STIFF, *ARM)


def of_spring(t, q, w, v, r):
    x = [a + b for a, b in zip(r, ro.to_inertial(q, ARM), strict=True)]
    return ro.to_body(q, [-STIFF * a for a in x])


def test_spring_at_an_offset_point():
    """Along axes that are not principal; energy is kept, and is that of all."""
    end = oracle(lambda *x: ro.cross(ARM, of_spring(*x)), of_spring, 4.0, inertia=TENSOR)
    scene = fa.Scene(
        inertia=TENSOR, mass=MASS, force=fa.forces.Custom(sprung, P, **at_position),
        torque=fa.torques.Custom(twisted, P, potential=stored, **at_position),
    )  # fmt: skip
    assert gap(run(scene, 200, 4.0), end) < 1e-12
    traj = run(scene, 4000, 200.0, save_every=400)
    turning = 0.5 * np.einsum("si,ij,sj->s", traj.w, TENSOR, traj.w)
    moving = 0.5 * MASS * (traj.v**2).sum(axis=1)
    potential = 0.5 * STIFF * ((traj.r + fa.quat_rotate(traj.q, ARM)) ** 2).sum(axis=1)
    total = turning + moving + potential
    assert np.ptp(turning) > 0.1 * total[0]
    assert np.abs(total / total[0] - 1.0).max() < 1e-12
    found = fa.drift(traj, scene).energy
    assert found == pytest.approx(np.abs(total - total[0]) / (turning + moving).max(), abs=16 * EPS)
