"""Measures of a trajectory: what left the group, and how far from a reference."""

import numpy as np
import pytest
from exact import EPS, START, angle, generic

import fastatt as fa

BODIES = generic(3)
START3 = np.broadcast_to(START, (3, 4))


def run(method, representation="quat", q0=START3, scene=None, h=0.1, **options):
    scene = BODIES.scene if scene is None else scene
    return fa.propagate(
        scene, q0, dt=h, n_steps=20, method=method, representation=representation, save_every=5,
        **options,
    )  # fmt: skip


@pytest.mark.parametrize("method", ["rk4", "magnus4"])
def test_norm_of_a_quaternion(method):
    """RK4 loses |w h|⁶/9216 a step and more when w varies; an exponential loses nothing."""
    traj = run(method)
    d = fa.drift(traj, BODIES.scene)
    assert d.norm.shape == d.orthogonality.shape == (5, 3)
    assert d.norm[0].max() <= 2 * EPS
    if method == "rk4":
        assert (d.norm[-1] > 1e-9).all()
        assert d.norm.max() < 20 * 0.18**6
        assert d.norm == pytest.approx(np.abs(traj.norm_error))
    else:
        assert d.norm.max() < 20 * 4 * EPS
    assert d.orthogonality.max() < 12 * EPS
    assert d.energy is None
    assert d.momentum is None


@pytest.mark.parametrize("representation", ["dcm", "dcm_rows"])
def test_orthogonality_of_a_matrix(representation):
    plain = fa.drift(run("rk4", representation), BODIES.scene)
    lie = fa.drift(run("magnus4", representation), BODIES.scene)
    assert plain.orthogonality[0].max() < 12 * EPS
    assert (plain.orthogonality[-1] > 1e-7).all()
    assert lie.orthogonality.max() < 20 * 12 * EPS
    assert plain.norm.max() < 4 * EPS
    halved = fa.propagate(
        BODIES.scene, START3, dt=0.05, n_steps=40, method="rk4", representation=representation,
        save_every=40,
    )  # fmt: skip
    ratio = plain.orthogonality[-1] / fa.drift(halved, BODIES.scene).orthogonality[-1]
    # at least h⁴, whichever of its terms leads
    assert (ratio > 12.0).all()


def test_angle_to_a_reference():
    traj = run("magnus4")
    d = fa.drift(traj, BODIES.scene)
    reference = np.stack([BODIES.attitude(0.0, t) if t else START3 for t in traj.t])
    found = d.angle_to(reference)
    assert found.shape == (5, 3)
    assert found == pytest.approx(angle(traj.q, reference), abs=4 * EPS)
    assert d.angle_to(fa.quat_to_dcm(reference)) == pytest.approx(found, abs=20 * EPS)
    assert d.angle_to(START).shape == (5, 3)
    assert d.angle_to(traj.q).max() == 0.0


def test_momentum_along_a_uniform_field():
    """The field exerts no torque about its own direction."""
    tensor = np.array([[2.0, 0.3, -0.1], [0.3, 1.5, 0.2], [-0.1, 0.2, 1.2]])
    w0 = np.array([[0.5, -0.3, 0.8], [0.1, 0.9, -0.4], [-0.6, 0.2, 0.3]])
    options = {"dt": 0.05, "n_steps": 100, "save_every": 10}
    b = (0.4, -0.5, 0.7)
    for torque, field in (
        (fa.torques.HeavyTop((0.02, -0.03, 0.2), [1.0, 2.0, 0.5]), (0.0, 0.0, 1.0)),
        (fa.torques.MagneticDipole((0.1, 0.2, -0.3), b), b),
    ):
        scene = fa.Scene(inertia=tensor, torque=torque)
        run = fa.propagate(scene, START3, w0, method="rk8", **options)
        found = fa.drift(run, scene)
        assert found.momentum_along_field.shape == (11, 3)
        assert found.momentum_along_field.max() < 1e-11
        coarse = fa.drift(fa.propagate(scene, START3, w0, method="rk4", **options), scene)
        C = fa.quat_to_dcm(run.q)
        total = (C @ (tensor @ run.w[..., None]))[..., 0]
        change = np.linalg.norm(np.cross(total - total[0], field), axis=-1)
        assert (change.max(axis=0) > 0.05).all()
        assert 1e-9 < coarse.momentum_along_field.max() < 1e-3


def test_summary_has_maxima_and_reasons():
    top = fa.Scene(inertia=(1.0, 1.0, 0.5), torque=fa.torques.HeavyTop((0.0, 0.0, 0.2), 1.0))
    damped = fa.Scene(inertia=(1.0, 1.0, 0.5), torque=fa.torques.Damping(0.1))
    options = {"dt": 0.05, "n_steps": 4, "method": "rk4", "save_every": 2}
    of_top, of_damped = (
        fa.drift(fa.propagate(scene, START3, np.ones((3, 3)), **options), scene)
        for scene in (top, damped)
    )
    of_rate = fa.drift(run("magnus4"), BODIES.scene)
    assert of_top.reasons == {"momentum": "a torque acts"}
    assert str(of_top).splitlines()[0] == "Drift of 3 bodies over 3 saves, largest values:"
    assert f"energy                {of_top.energy.max():.1e}" in str(of_top)
    assert "momentum              None, a torque acts" in str(of_top)
    assert of_damped.reasons["energy"] == "no potential energy of the torque is known"
    assert "momentum_along_field  None, no uniform field acts" in str(of_damped)
    assert set(of_rate.reasons.values()) == {"the scene has a rate"}


def test_a_body_that_is_lost_leaves_the_others_theirs():
    top = fa.Scene(inertia=(1.0, 1.0, 0.5), torque=fa.torques.HeavyTop((0.0, 0.0, 0.2), 1.0))
    w0 = np.ones((3, 3))
    options = {"dt": 0.05, "n_steps": 4, "method": "rk4", "save_every": 2}
    for scene in (top, fa.Scene(inertia=(2.0, 1.0, 0.7))):
        well = fa.drift(fa.propagate(scene, START3, w0, **options), scene)
        with pytest.warns(fa.StepWarning):
            lost = fa.propagate(scene, START3, [w0[0], [1e200] * 3, w0[2]], **options)
        found = fa.drift(lost, scene)
        for name in ("norm", "energy", "momentum"):
            before, now = getattr(well, name), getattr(found, name)
            if before is not None:
                np.testing.assert_array_equal(now[:, [0, 2]], before[:, [0, 2]])
                assert np.isnan(now[-1, 1])


@pytest.mark.parametrize("n", [None, 3])
def test_momentum_of_a_slew_from_rest_is_relative_to_that_of_the_body(n):
    """The whole has none, so that the change is rounding at the size of the parts."""
    wheels = fa.torques.ReactionWheels(np.eye(3), 0.02, fa.torques.QuaternionPD(1.0, 3.0))
    scene = fa.Scene(inertia=wheels.body_inertia((4.0, 3.0, 2.0)), torque=wheels)
    start = [0.8, 0.4, -0.4, 0.2], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    q0, w0, s0 = start if n is None else (np.tile(x, (n, 1)) for x in start)
    slew = fa.propagate(scene, q0, w0, s0=s0, dt=0.1, n_steps=200, save_every=10, method="rk8")
    assert np.abs(slew.s).max() > 0.1
    assert fa.drift(slew, scene).momentum.max() < 1e-13


def test_momentum_of_a_body_at_rest_with_a_rotor_is_relative_to_that_of_the_rotor():
    """A wheel too."""
    idle = fa.torques.ReactionWheels(np.eye(3), 0.02)
    for torque, start in (
        (fa.torques.Rotor((0.0, 0.0, 1e-3)), {}),
        (idle, {"s0": [0.0, 0.0, 1e-3]}),
    ):
        scene = fa.Scene(inertia=(4.0, 3.0, 2.0), torque=torque)
        options = {**start, "dt": 0.1, "n_steps": 50, "save_every": 5}
        still = fa.propagate(scene, START, [1e-9, 0.0, 0.0], **options)
        assert fa.drift(still, scene).momentum.max() < 1e-13
