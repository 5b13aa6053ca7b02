"""The same motion in every representation, and what each hands out."""

import itertools

import numpy as np
import pytest
from each import each, in_tiers
from exact import EPS, START, angle, conj, exp, generic, matrix, mul, rotate, steady

import fastatt as fa
from fastatt.attitudes import ATTITUDES

BODIES = generic(3)
START3 = np.broadcast_to(START, (3, 4))
REPRESENTATIONS = [*ATTITUDES]
N, H = 100, 0.02


def run(method, representation, n=N, h=H, scene=None, q0=START3, **options):
    return fa.propagate(
        BODIES.scene if scene is None else scene,
        q0,
        dt=h,
        n_steps=n,
        method=method,
        representation=representation,
        **options,
    )


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_rk4_in_any_coordinates_is_right_to_its_own_error(representation):
    """At twice the step the error is 16 times as large, and explains the difference."""
    end = BODIES.attitude(0.0, N * H)
    found, coarse = run("rk4", representation), run("rk4", representation, N // 2, 2 * H)
    own = angle(coarse.q[-1], end).max() / 16.0
    assert found.status.tolist() == [0, 0, 0]
    assert angle(found.q[-1], end).max() < 2.0 * own < 1e-6
    assert angle(found.q[-1], run("rk4", "quat").q[-1]).max() < 3.0 * own + 1e-8


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_views_of_one_attitude_agree(representation):
    """q, C and the angles of a trajectory, by the definitions of the conventions' page."""
    traj = run("rk4", representation, save_every=10)
    assert np.abs(np.linalg.norm(traj.q, axis=-1) - 1.0).max() < 4 * EPS
    identity = traj.dcm @ np.swapaxes(traj.dcm, -1, -2)
    assert np.abs(identity - np.eye(3)).max() < 12 * EPS
    assert np.linalg.det(traj.dcm) == pytest.approx(1.0, abs=12 * EPS)
    assert np.abs(matrix(traj.q) - traj.dcm).max() < 12 * EPS
    phi, theta, psi = np.moveaxis(traj.euler313, -1, 0)
    e1, e3 = np.eye(3)[0], np.eye(3)[2]
    turns = (phi, e3), (theta, e1), (psi, e3)
    q = np.array([1.0, 0.0, 0.0, 0.0])
    for a, e in turns:
        q = mul(q, exp(a[..., None] * e))
    assert angle(q, traj.q).max() < 12 * EPS


@pytest.mark.parametrize("representation", ["quat", "dcm", "dcm_rows"])
def test_vectors_turn_as_the_conventions_say(representation):
    """v_i = C v_b, and a body that turns about its z axis carries x to y."""
    quarter = steady([[0.0, 0.0, np.pi / 2]])
    traj = run("magnus4", representation, 1, 1.0, quarter.scene, np.array([[1.0, 0, 0, 0]]))
    assert traj.dcm[-1, 0] @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0], abs=4 * EPS)
    assert rotate(traj.q[-1, 0], [1.0, 0.0, 0.0]) == pytest.approx([0.0, 1.0, 0.0], abs=4 * EPS)
    # the inertial y axis seen from the body
    assert traj.dcm[-1, 0, 1] == pytest.approx([1.0, 0.0, 0.0], abs=4 * EPS)


def test_euler313_rates_have_the_stated_kinematics():
    """φ̇ = 1 alone: w = (sinθ sinψ, sinθ cosψ, cosθ), and the angles run straight."""
    theta, psi = 1.1, 0.4
    q0 = fa.euler313_to_quat([[0.2, theta, psi]])
    w = [[np.sin(theta) * np.sin(psi), np.sin(theta) * np.cos(psi), np.cos(theta)]]
    traj = run("rk4", "euler313", 50, 0.01, steady(w).scene, q0)
    assert traj.euler313[-1, 0] == pytest.approx([0.7, theta, psi], abs=1e-14)


# singularities


@each("offset", [0.0, 1e-6, 1e-3, 0.02])
def test_euler313_says_that_it_passed_its_singularity(offset):
    """θ falls through 0 at 1 rad/s, missing it by ``offset``."""
    q0 = fa.euler313_to_quat([[offset, 0.5, 0.0], [offset, 1.5, 0.0]])
    w = np.array([[-1.0, offset, 0.0], [-0.5, offset, 0.0]])
    traj = run("rk4", "euler313", 100, 0.01, steady(w).scene, q0)
    flagged = traj.status[0] & (fa.Status.NON_FINITE | fa.Status.SINGULAR)
    # straight through the pole φ and ψ stand still, and θ < 0 is as good an angle as any
    straight = offset == 0.0 and angle(traj.q[-1, 0], mul(q0[0], exp(w[0]))) < 1e-12
    assert flagged or straight
    assert traj.status[1] == 0
    assert angle(traj.q[-1, 1], mul(q0[1], exp(w[1]))) < 1e-9


@pytest.mark.filterwarnings("ignore:status")
@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_tumbling_bodies_are_right_or_flagged(representation):
    """They pass the poles of all coordinates, some of them near."""
    rng = np.random.default_rng(3)
    q0, w0, moments = rng.normal(size=(200, 4)), 3.0 * rng.normal(size=(200, 3)), (2.0, 1.0, 1.5)
    found = run("rk8", representation, 100, 0.04, fa.Scene(inertia=moments), q0, w0=w0)
    right, _ = fa.closed_form.free_body(q0, w0, moments, 4.0)
    assert (angle(found.q[-1], right)[found.status == 0] < 1e-6).all()
    assert found.status.any() == ATTITUDES[representation].has_poles


# the shadow set


@each("method", ["rk4", "rk8"])
def test_mrp_turn_over_and_over(method):
    """Tumbling bodies pass half a turn and whole ones in every way: none is flagged."""
    rng = np.random.default_rng(3)
    q0, w0 = rng.normal(size=(20, 4)), 3.0 * rng.normal(size=(20, 3))
    moments = (2.0, 1.0, 2.0 / 3.0)
    scene = fa.Scene(inertia=moments)
    options = {"dt": 0.01, "n_steps": 2000, "method": method, "save_every": 1}
    found = fa.propagate(scene, q0, w0, representation="mrp", **options)
    assert found.status.tolist() == [0] * 20
    size = np.linalg.norm(found.state, axis=-1)
    assert size.max() <= 1.0 + 4 * EPS
    assert ((np.abs(np.diff(found.state, axis=0)).max(axis=-1) > 0.5).sum(axis=0) > 3).all()
    true, _ = fa.closed_form.free_body(q0, w0, moments, found.t)
    error = angle(found.q, true).max()
    usual = angle(fa.propagate(scene, q0, w0, **options).q, true).max()
    assert error < (2.0 * usual if method == "rk4" else 1e-11)


@each("start", [[0.0, 1.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0]])
def test_mrp_start_at_half_a_turn_and_a_whole_one(start):
    w = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.3, -0.5, 0.2]])
    traj = run("rk4", "mrp", 400, 0.01, steady(w).scene, np.tile(start, (3, 1)))
    assert traj.status.tolist() == [0, 0, 0]
    assert angle(traj.q[-1], mul(np.array(start), exp(4.0 * w))).max() < 1e-8


COUPLED = [m.name for m in fa.METHODS.values() if m.couples]


@pytest.mark.parametrize("method", in_tiers(["rk4"], COUPLED))
def test_a_step_of_mrp_at_the_limit_is_right_and_beyond_flagged(method):
    """To 0.1 rad a rad turned, from half a turn on too; about a cone where a rate is given."""
    rng = np.random.default_rng(6)
    q0, w0 = rng.normal(size=(500, 4)), rng.normal(size=(500, 3))
    q0[:250, 0] *= 0.01
    limit = fa.METHODS[method].limit("mrp")
    w0 *= 0.99 * limit / np.linalg.norm(w0, axis=-1, keepdims=True)
    moments = (2.0, 1.0, 2.0 / 3.0)
    options = {"dt": 1.0, "n_steps": 1, "method": method, "representation": "mrp"}
    found = fa.propagate(fa.Scene(inertia=moments), q0, w0, **options)
    true, _ = fa.closed_form.free_body(q0, w0, moments, 1.0)
    assert angle(found.q[-1], true).max() < 0.1 * limit
    with pytest.warns(fa.StepWarning, match="limit is"):
        beyond = fa.propagate(fa.Scene(inertia=(1.0, 1.0, 1.0)), q0, 1.1 * w0, **options)
    assert (beyond.status & fa.Status.STEP_TOO_LARGE).all()
    if "rate" in fa.METHODS[method].scenes:
        cone = fa.Scene(rate=fa.rates.Coning(0.5, 0.99 * limit / (2.0 * np.sin(0.25))))
        true = fa.propagate(cone, q0, dt=0.01, n_steps=100, method="magnus8").q[-1]
        assert angle(fa.propagate(cone, q0, **options).q[-1], true).max() < 0.1 * limit


# inertial axes


INERTIAL = [("magnus4", "quat"), ("magnus4", "dcm"), *(("rk4", r) for r in REPRESENTATIONS[2:])]


@each(("method", "representation"), INERTIAL)
def test_rates_in_inertial_axes(method, representation):
    """q̇ = ½ w∘q against the reference of that equation."""
    scene = fa.Scene(rate=BODIES.model, frame="inertial")
    traj = run(method, representation, scene=scene, save_every=N)
    end = BODIES.attitude(0.0, N * H, frame="inertial")
    assert angle(traj.q[0], START).max() < 8 * EPS
    assert angle(traj.q[-1], end).max() < 1e-6
    coarse = run(method, representation, N // 2, 2 * H, scene)
    ratio = angle(coarse.q[-1], end).max() / angle(traj.q[-1], end).max()
    assert ratio == pytest.approx(16.0, rel=0.2)
    # the trajectory's own rate is in body axes
    w = rotate(conj(traj.q[-1]), BODIES.rate(N * H))
    assert np.abs(traj.w[-1] - w).max() < 20 * EPS


TENSOR = fa.Scene(inertia=[[2.0, 0.2, 0.1], [0.2, 1.5, -0.1], [0.1, -0.1, 1.0]])
COMPOSED = {
    "gauss12": (fa.Scene(rate=fa.rates.Coning(0.4, 1.3)), None), "rk8": (TENSOR, (0.3, 0.2, 0.5)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("method", "representation"),
    in_tiers(
        [("gauss12", "mrp"), ("rk8", "dcm")],
        itertools.product(COMPOSED, ("dcm", "mrp", "euler313")),
    ),
)
def test_rotations_are_composed_in_the_order_of_quaternions(method, representation):
    """After the attitude: a step of gauss12, and principal axes of a full tensor."""
    scene, w0 = COMPOSED[method]
    q0 = [0.8, 0.3, 0.4, -0.2]
    given = {"dt": 0.05, "n_steps": 20, "method": method}
    found = fa.propagate(scene, q0, w0, representation=representation, **given)
    expected = fa.propagate(scene, q0, w0, **given)
    assert fa.angle_between(found.q[-1], expected.q[-1]) < 1e-13


def test_closed_form_in_any_representation():
    scene = fa.Scene(inertia=[[0.6, 0.8, 1.0], [0.8, 1.0, 0.6], [0.7, 0.9, 1.0], [1.0, 1.0, 0.6]])
    start = np.tile(START, (4, 1)), (0.9, -0.4, 1.2)
    given = {"dt": 0.7, "n_steps": 3, "method": "exact"}
    usual = fa.propagate(scene, *start, **given)
    for name in REPRESENTATIONS:
        found = fa.propagate(scene, *start, representation=name, **given)
        assert angle(found.q[-1], usual.q[-1]).max() < 16 * EPS
        assert (found.state.shape[-1], found.representation) == (ATTITUDES[name].stored, name)
