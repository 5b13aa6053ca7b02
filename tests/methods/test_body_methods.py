"""Orders and invariants of every method for rigid bodies, over the list.

Two types of scene serve nearly all: bodies with moments of their own, free, and the same under
gravity gradient, a weight and damping, whose zeros switch them off.
"""

import functools
import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
import rigid_oracle as ro
from each import each, in_tiers
from exact import EPS, LENGTHY, START, angle, observed_order
from oracle import floats

import fastatt as fa
from fastatt.methods import METHODS
from fastatt.propagation.choice_of_method import methods_for
from fastatt.scene.torque_record import Dependence

MOMENTS = np.array([0.6, 0.8, 1.0])
INERTIA = np.array([MOMENTS[list(o)] for o in itertools.permutations(range(3))])
N = len(INERTIA)
SPIN = np.array([0.9, -0.4, 1.2])
Q0, W0 = np.tile(START, (N, 1)), np.tile(SPIN, (N, 1))
MOTION, ARM, WEIGHT, DRAG = 0.5, np.array([0.1, 0.2, 0.3]), 1.0, 0.3
SPAN = 2.0
ONE_START, ONE_SPIN = START[None], SPIN[None]
DENSE = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 20, 24, 32, 48, 64)


def torqued(inertia, motion=MOTION, arm=ARM, drag=0.0):
    n = len(inertia)
    terms = (
        fa.torques.GravityGradient(np.full(n, motion)),
        fa.torques.HeavyTop(np.tile(arm, (n, 1)), np.full(n, WEIGHT)),
        # one of 0 saves a compilation
        fa.torques.Damping(np.full((n, 1), drag)),
    )
    return fa.Scene(inertia=inertia, torque=fa.torques.Sum(terms))


def stepped(scene):
    return [m for m in methods_for(scene) if fa.METHODS[m].is_stepped]


def in_each(names):
    """On quaternions; representatives on matrices too."""
    some = {"rk4": ("dcm", "dcm_rows"), "kahan_li8": ("dcm",), "dmv10": ("dcm", "dcm_rows")}
    return [(m, r) for m in names for r in ("quat", *some.get(m, ()))]


FREE = fa.Scene(inertia=INERTIA)
FREE_METHODS = stepped(FREE)
TORQUED_METHODS = stepped(torqued(INERTIA))
OF_FREE = in_each(FREE_METHODS)
OF_TORQUED = in_each(TORQUED_METHODS)
SPLITTINGS = [m for m in FREE_METHODS if fa.METHODS[m].takes < Dependence.RATE]
on_free = pytest.mark.parametrize(("method", "representation"), OF_FREE)


def run(scene, method, n, t=SPAN, q0=Q0, w0=W0, representation="quat", **options):
    return fa.propagate(
        scene, q0, w0, dt=t / n, n_steps=n, method=method, representation=representation, **options
    )


def ends(inertia, torque_of=None, t=SPAN):
    """(q, w) of each body at the end."""
    found = [
        ro.integrate(i.tolist(), START.tolist(), SPIN.tolist(), t, torque_of and torque_of(i), 18)
        for i in inertia
    ]
    return np.array([floats(s.q) for s in found]), np.array([floats(s.w) for s in found])


def acting(drag):
    return lambda inertia: ro.total(
        ro.gravity_gradient(inertia, MOTION), ro.heavy_top(WEIGHT, ARM), ro.linear_damping(drag)
    )


def gap(traj, q, w):
    return max(angle(traj.q[-1], q).max(), np.abs(traj.w[-1] - w).max())


# orders


@functools.cache
def end(drag=None):
    """Of the bodies: free, or under all torques with a damping, which may be 0."""
    return ends(INERTIA, None if drag is None else acting(drag))


def order(scene, expected, method, representation="quat"):
    def error(n):
        return gap(run(scene, method, n, representation=representation), *expected)

    # of order 16 float64 holds two points
    least = 2 if fa.METHODS[method].order > 10 else 3
    return observed_order(error, SPAN, ladder=DENSE, least=least)


def is_order(found, method, kind):
    """Of order 9 and more float64 leaves steps of a rad and more, where next terms count too."""
    declared = fa.METHODS[method].order_of(kind)
    slack = (0.5, 2.5) if method in LENGTHY else (0.25, 0.25)
    return declared - slack[0] <= found <= declared + slack[1]


@on_free
def test_order_on_free_bodies(method, representation):
    """Triaxial, their moments in every order; attitudes and rates."""
    if fa.METHODS[method].order > 10:  # 2 s in one step are rounding: 16 s by the closed form
        known = fa.closed_form.free_body(Q0, W0, INERTIA, 16.0)
        found = observed_order(
            lambda n: gap(run(FREE, method, n, 16.0), *known), 16.0, ladder=range(4, 12)
        )
        assert is_order(found, method, "free")
        return
    assert is_order(order(FREE, end(), method, representation), method, "free")


@pytest.mark.parametrize(("method", "representation"), OF_TORQUED)
def test_order_under_torque(method, representation):
    """Gravity gradient, which depends on time, and a weight."""
    found = order(torqued(INERTIA), end(0.0), method, representation)
    assert is_order(found, method, "torqued")


@pytest.mark.parametrize("method", TORQUED_METHODS)
def test_order_with_damping(method):
    scene = torqued(INERTIA, drag=DRAG)
    assert is_order(order(scene, end(DRAG), method), method, "torqued")


def test_damping_axis_by_axis():
    """A splitting takes it where the intermediate axis is the second, as its own axes are then."""
    drag = (0.1, 0.2, 0.3)
    model = fa.torques.Damping(drag)
    ordered = INERTIA[[0]]
    scene = fa.Scene(inertia=ordered, torque=model)
    q, w = ends(ordered, lambda _: ro.linear_damping(drag))
    for method in ("rk4", "strang2"):
        assert gap(run(scene, method, 2000, q0=ONE_START, w0=ONE_SPIN), q, w) < 1e-6
    refused = set(stepped(scene)) - set(stepped(fa.Scene(inertia=INERTIA, torque=model)))
    assert refused == {"strang2", "kahan_li8"}


ONE = np.array([[1.0, 0.0, 0.0, 0.0]])
H, V = (fa.Scene(inertia=[floats(known.inertia)]) for known in (ro.BODY_H, ro.BODY_V))
H_W0, V_W0 = (np.array([floats(known.w0)]) for known in (ro.BODY_H, ro.BODY_V))


@each("method", [m for m in FREE_METHODS if fa.METHODS[m].order >= 8])
@each(
    ("scene", "w0", "known", "t"),
    [(H, H_W0, ro.BODY_H, 1), (H, H_W0, ro.BODY_H, 10), (V, V_W0, ro.BODY_V, 10)],
)
def test_published_numbers(method, scene, w0, known, t):
    """Momentum and attitude to the last digits."""
    traj = run(scene, method, 60 * t, t, ONE, w0)
    m, q = (np.array(floats(x)) for x in known.states[t])
    assert traj.status.tolist() == [0]
    assert np.abs(floats(known.inertia) * traj.w[-1, 0] - m).max() < 1e-13
    assert angle(traj.q[-1, 0], q) < 1e-13


def energy(inertia, w):
    return 0.5 * (inertia * w * w).sum(-1)


# invariants


@each(*on_free.args)
def test_what_a_record_says_is_kept_is_kept(method, representation):
    """At a tenth of a second, over 100 s; what it does not say is seen to change."""
    conserves = fa.METHODS[method].conserves
    traj = run(FREE, method, 1000, 100.0, representation=representation, save_every=10)
    assert not traj.status.any()
    norm = np.abs(traj.norm_error).max()
    in_space = np.einsum("snij,snj->sni", traj.dcm, INERTIA * traj.w)
    momentum = np.abs(in_space / in_space[0] - 1.0).max()
    work = np.abs(energy(INERTIA, traj.w) / energy(INERTIA, W0) - 1.0).max()
    assert set(conserves) <= {"norm", "momentum", "energy"}
    for name, found in (("norm", norm), ("momentum", momentum), ("energy", work)):
        # a few ulps each step, mostly of one sign
        assert (found < 1000 * 8 * EPS) or name not in conserves
    kept = bool(max(norm, momentum, work) < 1000 * 8 * EPS)
    assert kept is (len(conserves) == 3) or fa.METHODS[method].order >= 6


@each("method", FREE_METHODS)
def test_reversal_of_free_bodies(method):
    """200 steps of 0.05 s and back."""
    out = run(H, method, 200, 10.0, ONE, H_W0)
    back = run(H, method, 200, -10.0, out.q[-1], out.w[-1])
    found = gap(back, ONE, H_W0)
    if "free" in fa.METHODS[method].reversible or fa.METHODS[method].order >= 8:
        assert found < 200 * fa.METHODS[method].rate_calls * EPS
    elif fa.METHODS[method].order == 4:
        assert found == pytest.approx(3e-9, rel=0.5)
    else:
        assert found < 3e-9


@each(("method", "drag"), [(m, drag) for m in TORQUED_METHODS for drag in (0.0, DRAG)])
def test_reversal_under_torque(method, drag):
    """Of splittings also with damping, whose flow is exact."""
    scene, n = torqued(INERTIA, drag=drag), 100
    out = run(scene, method, n, 5.0)
    back = fa.propagate(scene, out.q[-1], out.w[-1], dt=-0.05, n_steps=n, t0=5.0, method=method)
    found = gap(back, Q0, W0)
    grown = math.exp(DRAG / 0.6 * 5.0) if drag else 1.0
    if "torqued" in fa.METHODS[method].reversible or fa.METHODS[method].order >= 8:
        assert found < n * 2 * fa.METHODS[method].rate_calls * EPS * grown
    else:
        assert 1e-11 < found < 1e-6


@pytest.mark.parametrize("method", ["strang2", "kahan_li8"])
def test_energy_under_a_potential_swings_without_drift(method):
    inertia = INERTIA
    scene = torqued(INERTIA, motion=0.0)
    traj = run(scene, method, 4000, 1000.0, save_every=4)
    height = np.einsum("snj,j->sn", traj.dcm[:, :, 2], ARM)
    total = energy(inertia, traj.w) + WEIGHT * height
    change = (total - total[0]) / total[0]
    half = len(change) // 2
    assert np.abs(change[half:]).max() < 1.5 * np.abs(change[:half]).max()


# special bodies


@each("method", SPLITTINGS)
def test_steps_of_needles_within_the_limit_are_right(method):
    """However thin: to 0.1 rad a rad in one step, and in 48 steps with the compositions."""
    n, steps, rng = 10_000, 48, np.random.default_rng(3)
    e = 10.0 ** rng.uniform(-6.0, -0.5, n)
    moments = np.stack([e, 1.0 - e * rng.uniform(0.0, 0.999, n), np.ones(n)], axis=1)
    w = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-3.0, 0.0, (n, 3))
    a, b, c = 1.0 / moments.T
    size = np.linalg.norm(moments * w, axis=1) * np.sqrt(abs((a - b) * (c - b)))
    w *= (0.999 * fa.METHODS[method].limit("quat", body=True) / size)[:, None]
    scene, given = fa.Scene(inertia=moments), {"dt": 1.0, "n_steps": steps, "save_every": 1}
    start = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), w
    truth = fa.propagate(scene, *start, **given, method="exact")
    run = fa.propagate(scene, *start, **given, method=method)
    assert not (run.status & fa.Status.STEP_TOO_LARGE).any()
    passed = np.arange(1, steps + 1)[:, None] * np.linalg.norm(w, axis=1)
    worst = (fa.angle_between(run.q, truth.q)[1:] / passed)[:, run.status == 0].max(axis=1)
    assert worst[0] <= 0.1
    assert worst.max() <= (0.4 if method == "strang2" else 0.1)


@each("method", SPLITTINGS)
@each("h", [0.1, 1.0, 7.0])
def test_splittings_are_exact_for_symmetric_bodies(method, h):
    """Any step, the axis of symmetry any; spheres too."""
    a, c = 0.8, 1.1
    inertia = np.array([[a, a, c], [c, a, a], [a, c, a], [a, a, a]])
    n = 20
    traj = run(fa.Scene(inertia=inertia), method, n, n * h, Q0[:4], W0[:4])
    for b, axes in enumerate(((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 1, 2))):
        # axes permuted so that the axis of symmetry is the third
        q0 = np.array([START[0], *START[1:][list(axes)]])
        q, w = ro.symmetric_top(q0.tolist(), SPIN[list(axes)].tolist(), a, c if b < 3 else a, n * h)
        assert np.abs(traj.w[-1, b][list(axes)] - floats(w)).max() < 1e-14 * n * (1 + 8 * h)
        turned = np.array([traj.q[-1, b, 0], *traj.q[-1, b, 1:][list(axes)]])
        assert angle(turned, floats(q)) < 1e-14 * n * (1 + 8 * h)


# the extrapolated midpoint rule


def of_attitude(t, q, w, p):
    return q[0] * q[1] - 0.2 * w[0], 0.3 * q[2] * q[3], 0.0


def with_a_state(t, q, w, s, p):
    return of_attitude(t, q, w, p), (q[0] * q[1] - s[0],)


@pytest.mark.parametrize(
    ("torque", "representation"),
    in_tiers(
        [(of_attitude, "dcm_rows")],
        itertools.product((of_attitude, with_a_state), ("dcm", "dcm_rows")),
    ),
)
def test_matrices_that_are_no_rotation_within_a_step_keep_the_order(torque, representation):
    """Under a torque that reads the quaternion, across a change of its best-conditioned row."""
    states = int(torque is with_a_state)
    scene = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=torque, states=states)
    start = {"w0": (0.9, -1.4, 1.1), **({"s0": (0.1,)} if states else {})}
    reference = fa.propagate(
        scene, [0.5, 0.4, 0.6, 0.5], dt=0.005, n_steps=400, method="rk9", **start
    )
    run = fa.propagate(
        scene, [0.5, 0.4, 0.6, 0.5], dt=0.25, n_steps=8, method="gbs16",
        representation=representation, **start,
    )  # fmt: skip
    assert angle(run.q[-1], reference.q[-1]) < 1e-13


class Growth:
    """x' = x, whose speed is x."""

    attitude = SimpleNamespace(has_poles=False)
    base = staticmethod(lambda x: x)
    at = staticmethod(lambda t: t)
    field = staticmethod(lambda t, x: x)
    speed_squared = staticmethod(lambda t, slopes, x: x[0] ** 2)
    advanced = staticmethod(lambda x, change: (x[0] + change[0],))


@pytest.mark.parametrize(("method", "at_stage"), [("rk4", 1.0), ("rk8", np.exp(0.1))])
def test_the_turn_of_a_step_is_that_of_its_start_or_of_its_last_stage(method, at_stage):
    (end,), turn = METHODS[method].steps.body(Growth, 0.0, 0.1, (1.0,))
    assert end == pytest.approx(np.exp(0.1), rel=1e-7)
    assert turn == pytest.approx((0.1 * at_stage) ** 2, rel=1e-4)
