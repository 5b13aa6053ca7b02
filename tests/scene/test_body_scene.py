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
from fastatt.engine.run import BLOCK_LENGTH

MOMENTS = np.array([0.6, 0.8, 1.0])
ORDERS = np.array([MOMENTS[list(o)] for o in itertools.permutations(range(3))])
SPIN = np.array([0.9, -0.4, 1.2])
N, STEPS, H = 130, 70, 0.02  # more than two tiles of 64 bodies
LONG = BLOCK_LENGTH + 44  # more than a block of steps
rng = np.random.default_rng(5)
Q0 = rng.normal(size=(N, 4))
W0 = rng.normal(size=(N, 3))
INERTIA = ORDERS[np.arange(N) % 6] * rng.uniform(0.95, 1.05, (N, 3))
ARMS = rng.normal(size=(N, 3)) * 0.2
DRAG = rng.uniform(0.0, 0.2, N)
SIZES = [1, 2, 63, 64, 65]
SINGLES = [0, 63, 64, 129]


def free(bodies=slice(None)):
    return fa.Scene(inertia=INERTIA[bodies])


def torqued(bodies=slice(None), *, damped=True):
    n = len(INERTIA[bodies])
    terms = (
        fa.torques.GravityGradient(np.full(n, 0.5)),
        fa.torques.HeavyTop(ARMS[bodies], np.ones(n)),
    )
    if damped:
        terms = (*terms, fa.torques.Damping(DRAG[bodies]))
    return fa.Scene(inertia=INERTIA[bodies], torque=fa.torques.Sum(terms))


def undamped(bodies=slice(None)):
    return torqued(bodies, damped=False)


SCENES = {"free": free, "torqued": torqued, "undamped": undamped}
STEPPED = {
    kind: [m for m in fa.methods_for(scene()) if fa.METHODS[m].is_stepped]
    for kind, scene in SCENES.items()
}
# those that take no damping
STEPPED["undamped"] = [m for m in STEPPED["undamped"] if m not in STEPPED["torqued"]]
EVERY = [(kind, m) for kind, names in STEPPED.items() for m in names if m not in LENGTHY]
every_method = pytest.mark.parametrize(("kind", "method"), EVERY)


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


@every_method
def test_ensemble_is_single_runs_bit_for_bit(kind, method):
    """With inertia and torques of their own."""
    options = {"method": method, "save_every": 32}
    full = run(SCENES[kind](), **options)
    for n in SIZES:
        part = run(SCENES[kind](slice(n)), Q0[:n], W0[:n], **options)
        for name in ("q", "w", "norm_error", "dcm"):
            assert same(getattr(part, name), getattr(full, name)[:, :n]), (name, n)
        assert same(part.status, full.status[:n])
    for b in SINGLES:
        one = run(SCENES[kind]([b]), Q0[[b]], W0[[b]], **options)
        assert same(one.q[:, 0], full.q[:, b])
        assert same(one.w[:, 0], full.w[:, b])


@every_method
def test_threads_change_no_bit(kind, method):
    options = {"method": method, "save_every": 32}
    one, two, three = (run(SCENES[kind](), n_threads=k, **options) for k in (1, 2, 3))
    for name in ("q", "w", "norm_error", "status"):
        assert same(getattr(one, name), getattr(two, name))
        assert same(getattr(one, name), getattr(three, name))


@every_method
def test_saves_change_no_bit(kind, method):
    """No step starts from what was handed out, though a splitting's state lies ahead of it."""
    scene = SCENES[kind]()
    plain = run(scene, method=method, n=LONG, save_every=1)
    for every in (None, 7, 64, LONG, 1000):
        traj = run(scene, method=method, n=LONG, save_every=every)
        steps = [LONG] if every is None else [*range(0, LONG, every), LONG]
        assert same(traj.t, np.array(steps) * H)
        assert same(traj.q, plain.q[steps])
        assert same(traj.w, plain.w[steps])


def test_first_save_is_what_was_given():
    traj = run(free(), save_every=35)
    assert np.abs(traj.w[0] - W0).max() < 4 * EPS * np.abs(W0).max()
    assert angle(traj.q[0], Q0 / np.linalg.norm(Q0, axis=1, keepdims=True)).max() < 4 * EPS
    none = run(free(), n=0)
    assert same(none.w, traj.w[:1])
    assert same(none.q, traj.q[:1])


def test_shapes():
    """One attitude or one rate for all bodies, one body without an axis."""
    scene = fa.Scene(inertia=MOMENTS)
    one = run(scene, START, SPIN, save_every=35)
    assert (one.q.shape, one.w.shape, one.dcm.shape) == ((3, 4), (3, 3), (3, 3, 3))
    assert one.status.shape == (1,)
    many = run(scene, START, np.tile(SPIN, (5, 1)), save_every=35)
    assert (many.q.shape, many.w.shape) == ((3, 5, 4), (3, 5, 3))
    other = run(scene, np.tile(START, (5, 1)), SPIN, save_every=35)
    for traj in (many, other):
        assert same(traj.q[:, 4], one.q)
        assert same(traj.w[:, 4], one.w)


def test_arguments_are_not_changed():
    q0, w0, inertia = Q0.copy(), W0.copy(), INERTIA.copy()
    run(torqued(), q0, w0, save_every=1)
    assert same(q0, Q0)
    assert same(w0, W0)
    assert same(inertia, INERTIA)


def test_t0_is_the_time_of_the_torque():
    """Two halves of a run under gravity gradient are the whole."""
    for method, scene in (("rk8", torqued()), ("kahan_li6", undamped())):
        whole = run(scene, method=method)
        half = run(scene, method=method, n=STEPS // 2)
        rest = run(scene, half.q[-1], half.w[-1], method, n=STEPS // 2, t0=STEPS // 2 * H)
        assert gap(rest, whole) < STEPS * 32 * EPS
        early = run(scene, half.q[-1], half.w[-1], method, n=STEPS // 2)
        assert gap(early, whole) > 1e-3


# representations


REPRESENTATIONS = ["dcm", "dcm_rows", "euler313", "rotation_vector"]


@pytest.mark.parametrize("representation", REPRESENTATIONS)
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


def test_tensors_of_each_body_are_single_runs():
    bodies = slice(6)
    scene = fa.Scene(inertia=tensors(INERTIA[bodies]))
    full = run(scene, Q0[bodies], W0[bodies], "rk8")
    for b in range(6):
        one = run(fa.Scene(inertia=tensors(INERTIA[[b]])), Q0[[b]], W0[[b]], "rk8")
        assert same(one.q[:, 0], full.q[:, b])
        assert same(one.w[:, 0], full.w[:, b])


@every_method
def test_order_of_the_moments_is_the_naming_of_the_axes(kind, method):
    """A cyclic change of axes changes nothing but names."""
    bodies = slice(8)
    plain = run(SCENES[kind](bodies), Q0[bodies], W0[bodies], method)
    cycle = np.array([1, 2, 0])
    q0 = np.concatenate([Q0[bodies, :1], Q0[bodies, 1:][:, cycle]], axis=1)
    inertia, w0 = INERTIA[bodies][:, cycle], W0[bodies][:, cycle]
    torque = None
    if kind != "free":
        # inertial axes are renamed too: the orbit's, and the vertical is a field of e2 now
        n = 8
        turned = (
            fa.torques.GravityGradient(
                np.full(n, 0.5), np.tile(np.eye(3)[0][cycle], (n, 1)),
                np.tile(np.eye(3)[1][cycle], (n, 1)),
            ),
            fa.torques.MagneticDipole(
                ARMS[bodies][:, cycle], np.tile(-np.eye(3)[2][cycle], (n, 1))
            ),
        )  # fmt: skip
        drag = fa.torques.Damping(DRAG[bodies])
        torque = fa.torques.Sum((*turned, drag) if kind == "torqued" else turned)
    named = run(fa.Scene(inertia=inertia, torque=torque), q0, w0, method)
    q = np.concatenate([plain.q[-1][:, :1], plain.q[-1][:, 1:][:, cycle]], axis=1)
    allowed = STEPS * 32 * EPS * fa.METHODS[method].rate_calls
    assert angle(named.q[-1], q).max() < allowed
    assert np.abs(named.w[-1] - plain.w[-1][:, cycle]).max() < allowed


# precision


@pytest.mark.parametrize(
    ("kind", "method"),
    [("free", "strang2"), ("free", "dmv10"), ("undamped", "suzuki4")],
)
def test_float32_is_float64_to_its_rounding(kind, method):
    n = 500
    double = run(SCENES[kind](), method=method, n=n, h=2.0 / n)
    single = run(
        SCENES[kind](), Q0.astype(np.float32), W0.astype(np.float32), method, n=n, h=2.0 / n
    )
    assert single.q.dtype == single.w.dtype == np.float32
    assert not single.status.any()
    # a stage rounds the momentum and the attitude by 2⁻²⁴, at worst always to the same side
    size = max(1.0, np.abs(W0).max())
    assert gap(single, double) < 2.0**-24 * n * fa.METHODS[method].rate_calls * size
    assert gap(single, double) > 1e-8
    asked = run(SCENES[kind](), method=method, n=n, h=2.0 / n, dtype="float32")
    assert asked.q.dtype == np.float32


# extremes


@each(*every_method.args)
def test_at_rest(kind, method):
    """A body at rest stays, to the last bit, where nothing acts."""
    bodies = slice(5)
    q0 = Q0[bodies]
    if kind != "free":
        terms = (
            fa.torques.GravityGradient(np.zeros(5)),
            fa.torques.HeavyTop(np.zeros((5, 3)), np.zeros(5)),
        )
        if kind == "torqued":
            terms = (*terms, fa.torques.Damping(np.full(5, 0.3)))
        scene = fa.Scene(inertia=INERTIA[bodies], torque=fa.torques.Sum(terms))
    else:
        scene = free(bodies)
    traj = run(scene, q0, np.zeros((5, 3)), method, save_every=STEPS)
    assert not traj.status.any()
    assert not traj.w.any()
    assert same(traj.q[1], traj.q[0])


@each(*every_method.args)
@each("unit", [1e-12, 1e12])
def test_units_of_inertia_change_nothing(kind, method, unit):
    bodies = slice(6)
    plain = run(SCENES[kind](bodies), Q0[bodies], W0[bodies], method)
    torque = None
    if kind != "free":
        gravity, top, *drag = SCENES[kind](bodies).torque.terms
        scaled = [fa.torques.Damping(unit * term.coefficient) for term in drag]
        terms = gravity, fa.torques.HeavyTop(top.arm, unit * top.weight), *scaled
        torque = fa.torques.Sum(terms)
    scene = fa.Scene(inertia=unit * INERTIA[bodies], torque=torque)
    traj = run(scene, Q0[bodies], W0[bodies], method)
    assert same(traj.status, plain.status)
    assert gap(traj, plain) < STEPS * 16 * EPS * fa.METHODS[method].rate_calls


def needs_convergence(kind):
    records = [fa.METHODS[m] for m in STEPPED[kind]]
    return [m.name for m in records if m.measure == "momentum" and m.limit("quat") <= 1.0]


@pytest.mark.parametrize(("kind", "method"), [(k, m) for k in SCENES for m in needs_convergence(k)])
@pytest.mark.parametrize("rate", [3.0, 1e3, 1e12, 1e160])
def test_step_beyond_the_implicit_methods_is_flagged(kind, method, rate):
    """For that body alone: its neighbours keep every bit. A stage is at least a third of a step."""
    w0 = W0[:64].copy()
    w0[[7, 40]] = rate / H * np.array([2.0, -1.0, 2.0]) / 3.0
    options = {"method": method, "save_every": 9}
    with np.errstate(all="raise"):
        alone = run(SCENES[kind](slice(64)), Q0[:64], W0[:64], **options)
        together = run(SCENES[kind](slice(64)), Q0[:64], w0, **options)
    flags = fa.Status.STEP_TOO_LARGE | fa.Status.NOT_CONVERGED | fa.Status.NON_FINITE
    assert (together.status[[7, 40]] & flags != 0).all()
    others = [b for b in range(64) if b not in (7, 40)]
    assert not alone.status.any()
    for name in ("q", "w"):
        assert same(getattr(together, name)[:, others], getattr(alone, name)[:, others])
    assert same(together.status[others], alone.status[others])


@each(*every_method.args)
def test_steps_that_a_method_takes_are_not_flagged(kind, method):
    """|w| h of 0.15 is a step for every one."""
    scale = 0.15 / np.linalg.norm(W0, axis=1).max() / H
    traj = run(SCENES[kind](), w0=W0 * scale, method=method)
    assert traj.status_counts() == {}


@every_method
def test_non_finite_body_changes_no_bit_of_its_neighbours(kind, method):
    """A rate whose square overflows."""
    w0 = W0[:64].copy()
    w0[9] = 1e200
    alone = run(SCENES[kind](slice(64)), Q0[:64], W0[:64], method)
    together = run(SCENES[kind](slice(64)), Q0[:64], w0, method)
    others = [b for b in range(64) if b != 9]
    assert same(together.q[:, others], alone.q[:, others])
    assert same(together.w[:, others], alone.w[:, others])
    if fa.METHODS[method].limits:
        assert together.status[9] != 0


def damped(coefficients):
    n = len(coefficients)
    terms = (
        fa.torques.GravityGradient(np.zeros(n)),
        fa.torques.HeavyTop(np.zeros((n, 3)), np.zeros(n)),
        fa.torques.Damping(coefficients),
    )
    return fa.Scene(inertia=np.ones((n, 3)), torque=fa.torques.Sum(terms))


def test_stiff_damping_needs_the_splittings():
    """RK4 leaves its region of stability at c h/I = 2.785; the damping of a kick is exact."""
    c = np.array([1.0, 2.6, 2.9, 10.0, 100.0])
    q0, w0 = Q0[:5], np.tile(0.1 * SPIN, (5, 1))
    grown = np.abs(run(damped(c), q0, w0, "rk4", n=200, h=1.0).w[-1]).max(axis=1)
    assert (grown[:2] < 0.1).all()
    assert not (grown[2:] < 1.0).any()
    for method in ("strang2",):
        traj = run(damped(c), q0, w0, method, n=20, h=1.0)
        assert np.abs(traj.w[-1] - np.exp(-20.0 * c)[:, None] * w0).max() < 1e-15


@pytest.mark.parametrize("method", ["strang2"])
def test_damping_that_underflows(method):
    """A body that stops at once is at rest, or its status says that it is not known."""
    traj = run(damped(np.full(5, 1e6)), Q0[:5], np.tile(SPIN, (5, 1)), method, n=3, h=0.1)
    assert ((traj.status != 0) | (np.abs(traj.w[-1]) < 1e-15).all(axis=1)).all()


# packed code


def steps_of(monkeypatch, scene, method, **options):
    """For each program of a run its loops with a step's worth of arithmetic."""

    def call():
        run(scene, Q0[:64], W0[:64], method, n=4, n_threads=1, **options)

    job = job_of(monkeypatch, call)
    return [large_loops(text) for text in assemblies(job)]


@needs_avx
@every_method
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
    params = np.concatenate([ARMS[:64], DRAG[:64, None]], axis=1)
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


FREE_NAMES = ", ".join(fa.methods_for(ONE))
PROPAGATE = [
    ({"w0": None}, ValueError, "w0: is missing; a scene with inertia needs (3,) or (N, 3), rad/s"),
    ({"w0": [1.0, 2.0]}, ValueError, "w0: has shape (2,); accepted: (3,) or (N, 3)"),
    ({"w0": np.zeros((0, 3))}, ValueError, "w0: has shape (0, 3)"),
    ({"w0": [0.0, np.nan, 1.0]}, ValueError, "w0[1] is nan; accepted: finite numbers"),
    ({"w0": [[0.0, 0.0, 1.0], [0.0, np.inf, 0.0]]}, ValueError, "w0[1, 1] is inf"),
    ({"w0": "fast"}, TypeError, "w0: found 'fast'; accepted: real numbers of shape (3,)"),
    ({"scene": RATE}, ValueError, "w0: found, but this scene has none; a scene with inertia"),
    (
        {"q0": np.tile(START, (2, 1)), "w0": np.tile(SPIN, (3, 1))},
        ValueError,
        "w0: found rows w0 3, q0 2; accepted: one number of bodies",
    ),
    (
        {"scene": TWO, "q0": np.tile(START, (5, 1))},
        ValueError,
        "inertia: found 2 bodies; accepted: 5",
    ),
    ({"method": "rk5"}, ValueError, f"method: found 'rk5'; accepted: {FREE_NAMES}"),
    ({"method": "magnus4"}, ValueError, f"method: found 'magnus4'; accepted: {FREE_NAMES}"),
    (
        {"scene": fa.Scene(inertia=MOMENTS, torque=LINEAR), "method": "dmv4"},
        ValueError,
        "method: found 'dmv4'; accepted: rk4, cf4, rkmk4, rk8, rk9, gbs16, strang2",
    ),
    (
        {"method": "strang2", "representation": "euler313"},
        ValueError,
        "method for representation \"euler313\": found 'strang2'; accepted: rk4, rk8",
    ),
    (
        {"method": "strang2", "representation": "dcm_rows"},
        ValueError,
        "method for representation \"dcm_rows\": found 'strang2'; accepted: rk4, cf4, rkmk4, rk8",
    ),
]


@each(("arguments", "error", "message"), PROPAGATE)
def test_propagate_refuses(arguments, error, message):
    with pytest.raises(error, match=re.escape(message)):
        propagate(**arguments)


SCENE = [
    ({}, ValueError, "rate, inertia: found neither; accepted: one of them"),
    (
        {"inertia": MOMENTS, "rate": fa.rates.Constant([0.0, 0.0, 1.0])},
        ValueError,
        "rate, inertia: found both; accepted: one of them",
    ),
    (
        {"rate": fa.rates.Constant([0.0, 0.0, 1.0]), "torque": LINEAR},
        ValueError,
        "torque: found with a rate; accepted: with inertia only",
    ),
    (
        {"torque": LINEAR},
        ValueError,
        "rate, inertia: found neither, with a torque, which needs inertia; acc",
    ),
    (
        {"inertia": MOMENTS, "frame": "inertial"},
        ValueError,
        'frame: found "inertial" with inertia; accepted: "body"',
    ),
    (
        {"inertia": [MOMENTS] * 4, "torque": fa.torques.Damping([0.1, 0.2])},
        ValueError,
        "found parameters for 2 and 4 bodies",
    ),
]


@pytest.mark.parametrize(("arguments", "error", "message"), SCENE)
def test_scene_refuses(arguments, error, message):
    with pytest.raises(error, match=re.escape(message)):
        fa.Scene(**arguments)


def test_directions_need_a_rate():
    message = re.escape("scene: found inertia, mass or states; accepted: a scene with a rate alone")
    with pytest.raises(ValueError, match=message):
        fa.propagate_directions(ONE, [0.0, 0.0, 1.0], dt=0.1, n_steps=1)
