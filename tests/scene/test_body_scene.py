"""Rigid bodies through the library call: ensembles, threads, saves, tensors, status, errors."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from each import each
from exact import EPS, LENGTHY, START, angle, exp, mul
from machine_code import assemblies, is_packed, job_of, large_loops, needs_avx
from numba import njit

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
every_method = each(("kind", "method"), EVERY)
# for what the loop and the emitter do, which do not know the method
some_methods = pytest.mark.parametrize(
    ("kind", "method"), [("free", "dmv10"), ("torqued", "rk4"), ("torqued", "kahan_li8")]
)


def run(scene, q0=Q0, w0=W0, method="rk4", representation="quat", n=STEPS, h=H, **options):
    options = {"method": method, "representation": representation, **options}
    return fa.propagate(scene, q0, w0, dt=h, n_steps=n, **options)


def same(a, b):
    """Every bit: NaN equals NaN, 0 does not equal −0."""
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


def gap(a, b):
    """Largest difference of attitudes and rates at the end."""
    return max(angle(a.q[-1], b.q[-1]).max(), np.abs(a.w[-1] - b.w[-1]).max())


# an ensemble is its bodies


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


@pytest.mark.parametrize("method", ["rk8", "kahan_li8"])
def test_t0_is_the_time_of_the_torque(method):
    """Two halves of a run under gravity gradient are the whole."""
    scene = torqued()
    whole, half = (run(scene, method=method, n=n) for n in (STEPS, STEPS // 2))
    for t0 in (STEPS // 2 * H, 0.0):
        rest = run(scene, half.q[-1], half.w[-1], method, n=STEPS // 2, t0=t0)
        assert (gap(rest, whole) < STEPS * 32 * EPS) if t0 else (gap(rest, whole) > 1e-3)


# representations


@pytest.mark.parametrize("representation", ["dcm", "dcm_rows", "euler313"])
def test_representations_agree(representation):
    """To what RK4 leaves at this step, which falls by 16 with half of it."""
    bodies = slice(6)
    q0, w0 = np.tile(START, (6, 1)), np.tile(SPIN, (6, 1))
    reference = run(free(bodies), q0, w0, "rk8", n=100, h=0.01)
    errors = []
    for n in (100, 200):
        traj = run(free(bodies), q0, w0, "rk4", representation, n=n, h=1.0 / n)
        assert not traj.status.any()
        errors.append(gap(traj, reference))
    assert errors[0] < 1e-7
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


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


# extremes


@every_method
def test_at_rest(kind, method):
    """A body at rest stays, to the last bit, where nothing acts."""
    few = slice(5)
    scene = free(few) if kind == "free" else damped(np.full(5, 0.3), INERTIA[few])
    traj = run(scene, Q0[few], np.zeros((5, 3)), method, save_every=STEPS)
    assert not traj.status.any()
    assert not traj.w.any()
    assert same(traj.q[1], traj.q[0])


@each("method", [m for kind, m in EVERY if kind == "free" and fa.METHODS[m].measure == "momentum"])
@each("rate", [3.0, 1e3, 1e12, 1e160])
def test_step_beyond_the_implicit_methods_is_flagged(method, rate):
    """For that body alone: its neighbours keep every bit. A stage is at least a third of a step."""
    w0 = W0[:64].copy()
    w0[[7, 40]] = rate / H * np.array([2.0, -1.0, 2.0]) / 3.0
    options = {"method": method, "save_every": 9}
    with np.errstate(all="raise"):
        alone = run(free(slice(64)), Q0[:64], W0[:64], **options)
        together = run(free(slice(64)), Q0[:64], w0, **options)
    flags = fa.Status.STEP_TOO_LARGE | fa.Status.NOT_CONVERGED | fa.Status.NON_FINITE
    assert (together.status[[7, 40]] & flags != 0).all()
    others = [b for b in range(64) if b not in (7, 40)]
    assert not alone.status.any()
    for name in ("q", "w"):
        assert same(getattr(together, name)[:, others], getattr(alone, name)[:, others])
    assert same(together.status[others], alone.status[others])


@every_method
def test_steps_that_a_method_takes_are_not_flagged(kind, method):
    """|w| h of 0.15 is a step for every one."""
    scale = 0.15 / np.linalg.norm(W0, axis=1).max() / H
    traj = run(SCENES[kind](), w0=W0 * scale, method=method)
    assert traj.status_counts() == {}


def test_stiff_damping_needs_the_splittings():
    """RK4 leaves its region of stability at c h/I = 2.785; the damping of a kick is exact."""
    c = np.array([1.0, 2.6, 2.9, 10.0, 100.0])
    q0, w0 = Q0[:5], np.tile(0.1 * SPIN, (5, 1))
    grown = np.abs(run(damped(c), q0, w0, "rk4", n=200, h=1.0).w[-1]).max(axis=1)
    assert (grown[:2] < 0.1).all()
    assert not (grown[2:] < 1.0).any()
    traj = run(damped(c), q0, w0, "strang2", n=20, h=1.0)
    assert np.abs(traj.w[-1] - np.exp(-20.0 * c)[:, None] * w0).max() < 1e-15


def test_damping_that_underflows():
    """A body that stops at once is at rest, or its status says that it is not known."""
    scene = damped(np.full(5, 1e6))
    traj = run(scene, Q0[:5], np.tile(SPIN, (5, 1)), "strang2", n=3, h=0.1)
    assert ((traj.status != 0) | (np.abs(traj.w[-1]) < 1e-15).all(axis=1)).all()


# packed code


def steps_of(monkeypatch, scene, method, **options):
    """For each program of a run its loops with a step's worth of arithmetic."""

    def call():
        run(scene, Q0[:64], W0[:64], method, n=4, n_threads=1, **options)

    job = job_of(monkeypatch, call)
    return [large_loops(text) for text in assemblies(job)]


@needs_avx
@some_methods
def test_step_is_packed(monkeypatch, kind, method):
    """Bodies with inertia and torques of their own."""
    for loops in steps_of(monkeypatch, SCENES[kind](slice(64)), method):
        assert loops
        assert all(map(is_packed, loops))


@njit
def weight_and_damping(t, q, w, p):
    """A weight at p[:3], linear damping p[3]."""
    x = 2.0 * (q[1] * q[3] - q[0] * q[2])
    y = 2.0 * (q[2] * q[3] + q[0] * q[1])
    z = q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3]
    return (
        -(p[1] * z - p[2] * y) - p[3] * w[0],
        -(p[2] * x - p[0] * z) - p[3] * w[1],
        -(p[0] * y - p[1] * x) - p[3] * w[2],
    )


@needs_avx
def test_step_with_a_users_torque_is_packed(monkeypatch):
    params = np.concatenate([DIPOLE[0][:64], DRAG[:64]], axis=1)
    scene = fa.Scene(inertia=INERTIA[:64], torque=weight_and_damping, params=params)
    for loops in steps_of(monkeypatch, scene, "rk4"):
        assert loops
        assert all(map(is_packed, loops))


# wrong input


ONE = fa.Scene(inertia=MOMENTS)
TWO = fa.Scene(inertia=[MOMENTS, MOMENTS])
RATE = fa.Scene(rate=fa.rates.Constant([0.0, 0.0, 1.0]))
LINEAR = fa.torques.Damping(0.1)


def propagate(scene=ONE, q0=START, w0=SPIN, **options):
    return fa.propagate(scene, q0, w0, **{"dt": 0.1, "n_steps": 3, **options})


FREE_NAMES = ", ".join(methods_for(ONE))
PROPAGATE = [
    ({"w0": None}, "w0: is missing; a scene with inertia needs (3,) or (N, 3), rad/s"),
    ({"w0": [1.0, 2.0]}, "w0: has shape (2,); accepted: (3,) or (N, 3)"),
    ({"w0": np.zeros((0, 3))}, "w0: has shape (0, 3)"),
    ({"w0": [0.0, np.nan, 1.0]}, "w0[1] is nan; accepted: finite numbers"),
    ({"w0": [[0.0, 0.0, 1.0], [0.0, np.inf, 0.0]]}, "w0[1, 1] is inf"),
    ({"w0": "fast"}, "w0: found 'fast'; accepted: real numbers of shape (3,)"),
    ({"scene": RATE}, "w0: found, but this scene has none; a scene with inertia"),
    ({"q0": [START] * 2, "w0": [SPIN] * 3}, "w0: found rows w0 3, q0 2; accepted: one number of"),
    ({"scene": TWO, "q0": [START] * 5}, "inertia: found 2 bodies; accepted: 5"),
    ({"method": "rk5"}, f"method: found 'rk5'; accepted: {FREE_NAMES}"),
    ({"method": "magnus4"}, f"method: found 'magnus4'; accepted: {FREE_NAMES}"),
    (
        {"scene": fa.Scene(inertia=MOMENTS, torque=LINEAR), "method": "dmv2"},
        "method: found 'dmv2'; accepted: rk4, cf4, rkmk4, rk8, rk9, gbs16, strang2",
    ),
    ({"method": "strang2", "representation": "euler313"}, 'method for representation "euler313"'),
    ({"method": "strang2", "representation": "dcm_rows"}, 'method for representation "dcm_rows"'),
]


@each(("arguments", "message"), PROPAGATE)
def test_propagate_refuses(arguments, message):
    error = TypeError if "real numbers" in message else ValueError
    with pytest.raises(error, match=re.escape(message)):
        propagate(**arguments)


ABOUT_Z = fa.rates.Constant([0.0, 0.0, 1.0])
SCENE = [
    ({}, "rate, inertia: found neither; accepted: one of them"),
    ({"inertia": MOMENTS, "rate": ABOUT_Z}, "rate, inertia: found both; accepted: one of them"),
    ({"rate": ABOUT_Z, "torque": LINEAR}, "torque: found with a rate; accepted: with inertia only"),
    ({"torque": LINEAR}, "rate, inertia: found neither, with a torque, which needs inertia; acc"),
    ({"inertia": MOMENTS, "frame": "inertial"}, 'frame: found "inertial" with inertia; accepted: '),
    (
        {"inertia": [MOMENTS] * 4, "torque": fa.torques.Damping([[0.1], [0.2]])},
        "found parameters for 2 and 4 bodies",
    ),
]


@each(("arguments", "message"), SCENE)
def test_scene_refuses(arguments, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        fa.Scene(**arguments)


def test_directions_need_a_rate():
    message = re.escape("scene: found inertia, mass or states; accepted: a scene with a rate alone")
    with pytest.raises(ValueError, match=message):
        fa.propagate_directions(ONE, [0.0, 0.0, 1.0], dt=0.1, n_steps=1)
