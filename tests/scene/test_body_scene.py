"""Runs of rigid bodies: shapes, tensors, names of axes, precision, bodies at rest."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from each import in_tiers
from exact import EPS, LENGTHY, START, angle, exp, mul, same

import fastatt as fa
from fastatt.propagation.choice_of_method import methods_for

MOMENTS = np.array([0.6, 0.8, 1.0])
ORDERS = np.array([MOMENTS[list(o)] for o in itertools.permutations(range(3))])
SPIN = np.array([0.9, -0.4, 1.2])
N, STEPS, H = 130, 70, 0.02  # more than two tiles of 64 bodies
rng = np.random.default_rng(5)
Q0 = rng.normal(size=(N, 4))
W0 = rng.normal(size=(N, 3))
INERTIA = ORDERS[np.arange(N) % 6] * rng.uniform(0.95, 1.05, (N, 3))


def units(k):
    """k unit vectors for each body, each normal to the one before."""
    found = [rng.normal(size=(N, 3))]
    for _ in range(k):
        found.append(np.cross(found[-1], rng.normal(size=(N, 3))))
        found[-1] /= np.linalg.norm(found[-1], axis=1, keepdims=True)
    return found[1:]


# of which no two bodies have a number in common, so that one program is for all that is run
GRADIENT = (rng.uniform(0.4, 0.6, N), *units(2))
DIPOLE = rng.normal(size=(N, 3)) * 0.2, rng.uniform(0.8, 1.2, (N, 1)) * units(1)[0]
DRAG = rng.uniform(0.0, 0.2, (N, 1))


def free(bodies=slice(None)):
    return fa.Scene(inertia=INERTIA[bodies])


def acted_on(inertia, gradient, dipole, drag):
    terms = (
        fa.torques.GravityGradient(*gradient),
        fa.torques.MagneticDipole(*dipole),
        fa.torques.Damping(drag),
    )
    return fa.Scene(inertia=inertia, torque=fa.torques.Sum(terms))


def torqued(bodies=slice(None)):
    gradient, dipole = ([x[bodies] for x in numbers] for numbers in (GRADIENT, DIPOLE))
    return acted_on(INERTIA[bodies], gradient, dipole, DRAG[bodies])


def damped(drag, inertia=None):
    """What acts but the damping is 0."""
    n = len(drag)
    frame = np.tile(np.eye(3), (n, 1, 1))
    inertia = np.ones((n, 3)) if inertia is None else inertia
    gradient, dipole = (np.zeros(n), frame[:, 0], frame[:, 1]), (0 * frame[:, 0],) * 2
    return acted_on(inertia, gradient, dipole, np.asarray(drag)[:, None])


SCENES = {"free": free, "torqued": torqued}
EVERY = [
    (kind, m)
    for kind, scene in SCENES.items()
    for m in methods_for(scene(), stepped=True)
    if m not in LENGTHY
]
# one of each kind of steps: stages, turns, an implicit equation
OFTEN = ("rk8", "strang2", "kahan_li8", "dmv10")
every_method = pytest.mark.parametrize(
    ("kind", "method"), in_tiers([x for x in EVERY if x[1] in OFTEN], EVERY)
)


def run(scene, q0=Q0, w0=W0, method="rk4", representation="quat", n=STEPS, h=H, **options):
    options = {"method": method, "representation": representation, **options}
    return fa.propagate(scene, q0, w0, dt=h, n_steps=n, **options)


def gap(a, b):
    """Largest difference of attitudes and rates at the end."""
    return max(angle(a.q[-1], b.q[-1]).max(), np.abs(a.w[-1] - b.w[-1]).max())


def test_first_save_is_what_was_given():
    traj, none = run(free(), save_every=35), run(free(), n=0)
    assert np.abs(traj.w[0] - W0).max() < 4 * EPS * np.abs(W0).max()
    assert angle(traj.q[0], Q0 / np.linalg.norm(Q0, axis=1, keepdims=True)).max() < 4 * EPS
    assert same(none.w, traj.w[:1])
    assert same(none.q, traj.q[:1])


def test_shapes():
    """One attitude or one rate for all bodies, one body without an axis."""
    scene, five = fa.Scene(inertia=MOMENTS), (5, 1)
    one = run(scene, START, SPIN, save_every=35)
    assert (one.q.shape, one.w.shape, one.dcm.shape) == ((3, 4), (3, 3), (3, 3, 3))
    assert one.status.shape == (1,)
    for given in ((START, np.tile(SPIN, five)), (np.tile(START, five), SPIN)):
        many = run(scene, *given, save_every=35)
        assert (many.q.shape, many.w.shape) == ((3, 5, 4), (3, 5, 3))
        assert same(many.q[:, 4], one.q)
        assert same(many.w[:, 4], one.w)


def test_arguments_are_not_changed():
    given = Q0, W0, INERTIA
    kept = [x.copy() for x in given]
    run(torqued(), Q0, W0, save_every=1)
    assert all(map(same, given, kept))


# tensors


TURN = exp([0.3, -0.5, 0.7])


def tensors(moments, turn=TURN):
    c = fa.quat_to_dcm(turn)
    a = c @ (moments[..., None] * c.T)
    return 0.5 * (a + np.swapaxes(a, -1, -2))


@pytest.mark.parametrize("method", ["rk8", "strang2", "dmv10"])
def test_tensor_is_principal_moments_seen_from_other_axes(method):
    """v_body = p∘v_principal∘p*: attitudes q∘p*, rates p∘w∘p*, in the body's axes."""
    c = fa.quat_to_dcm(TURN)
    bodies = slice(6)
    moments = np.sort(INERTIA[bodies])
    q0 = Q0[bodies] / np.linalg.norm(Q0[bodies], axis=1, keepdims=True)
    plain = run(fa.Scene(inertia=moments), q0, W0[bodies], method, save_every=35)
    turned = run(
        fa.Scene(inertia=tensors(moments)),
        mul(q0, TURN * (1.0, -1.0, -1.0, -1.0)),
        W0[bodies] @ c.T,
        method,
        save_every=35,
    )
    assert angle(mul(turned.q, TURN), plain.q).max() < STEPS * 32 * EPS
    assert np.abs(turned.w @ c - plain.w).max() < STEPS * 32 * EPS


@every_method
def test_order_of_the_moments_is_the_naming_of_the_axes(kind, method):
    """A cyclic change of axes, inertial ones too, changes nothing but names."""
    few, cycle = slice(8), np.array([1, 2, 0])
    plain = run(SCENES[kind](few), Q0[few], W0[few], method)
    scene = fa.Scene(inertia=INERTIA[few][:, cycle])
    if kind != "free":
        frame, dipole = ([x[few][:, cycle] for x in v] for v in (GRADIENT[1:], DIPOLE))
        scene = acted_on(scene.inertia, (GRADIENT[0][few], *frame), dipole, DRAG[few])
    order = [0, *1 + cycle]
    named = run(scene, Q0[few][:, order], W0[few][:, cycle], method)
    allowed = STEPS * 32 * EPS * fa.METHODS[method].rate_calls
    assert angle(named.q[-1], plain.q[-1][:, order]).max() < allowed
    assert np.abs(named.w[-1] - plain.w[-1][:, cycle]).max() < allowed


# precision


@pytest.mark.parametrize(
    ("kind", "method"), [("free", "strang2"), ("free", "dmv10"), ("torqued", "kahan_li8")]
)
def test_float32_is_float64_to_its_rounding(kind, method):
    n = 500
    double = run(SCENES[kind](), method=method, n=n, h=2.0 / n)
    given = Q0.astype(np.float32), W0.astype(np.float32)
    single = run(SCENES[kind](), *given, method, n=n, h=2.0 / n)
    assert single.q.dtype == single.w.dtype == np.float32
    assert not single.status.any()
    # a stage rounds the momentum and the attitude by 2⁻²⁴, at worst always to the same side
    size = max(1.0, np.abs(W0).max())
    assert gap(single, double) < 2.0**-24 * n * fa.METHODS[method].rate_calls * size
    assert gap(single, double) > 1e-8
    asked = run(SCENES[kind](), method=method, n=n, h=2.0 / n, dtype="float32")
    assert asked.q.dtype == np.float32


@every_method
def test_at_rest(kind, method):
    """A body at rest stays, to the last bit, where nothing acts."""
    few = slice(5)
    scene = free(few) if kind == "free" else damped(np.full(5, 0.3), INERTIA[few])
    traj = run(scene, Q0[few], np.zeros((5, 3)), method, save_every=STEPS)
    assert not traj.status.any()
    assert not traj.w.any()
    assert same(traj.q[1], traj.q[0])


@every_method
def test_steps_that_a_method_takes_are_not_flagged(kind, method):
    """|w| h of 0.15 is a step for every one."""
    scale = 0.15 / np.linalg.norm(W0, axis=1).max() / H
    traj = run(SCENES[kind](), w0=W0 * scale, method=method)
    assert traj.status_counts() == {}


def test_damping_that_underflows():
    """A body that stops at once is at rest, or its status says that it is not known."""
    scene = damped(np.full(5, 1e6))
    traj = run(scene, Q0[:5], np.tile(SPIN, (5, 1)), "strang2", n=3, h=0.1)
    assert ((traj.status != 0) | (np.abs(traj.w[-1]) < 1e-15).all(axis=1)).all()
