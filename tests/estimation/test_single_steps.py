"""Single steps beside the ensemble engine, from Python, jitted code and parallel loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from allocations import counted, is_made_in
from each import in_tiers
from exact import EPS, START, generic
from numba import njit, prange
from numba.core.errors import TypingError
from test_body_methods import FREE, INERTIA, Q0, W0, torqued
from test_translation import BODY, R0, SPIN, V0

import fastatt as fa

MOTION = generic(3)
START3 = np.broadcast_to(START, (3, 4))
H = 0.05


@pytest.fixture(scope="module")
def magnus():
    return fa.single_step(MOTION.scene, method="magnus4")


@pytest.fixture
def allocations():
    with counted() as number:
        yield number


# beside the engine


def gap(found, *expected):
    """Largest difference of numbers of about 1, or exactly nothing."""
    return np.abs(np.concatenate(found) - np.concatenate(expected)).max()


def row(stepper, body):
    """Parameters as a tuple: to hand an array over is an allocation of Numba's."""
    return tuple(np.atleast_2d(stepper.params)[body if np.ndim(stepper.params) == 2 else 0])


def start_of(q, *beside):
    return tuple(q), tuple(np.ravel(beside))


def one_by_one(stepper, body, n, *start):
    """Attitude and what is beside it after n steps of the body's own."""
    p = row(stepper, body)
    x = stepper.start(*start_of(*start), p)
    for i in range(n):
        x = stepper.step(i * H, H, x, p)
    q, beside = stepper.read(x, p)
    return np.array(q), np.array(beside)


def run_by_advance(stepper, body, n, *start):
    """The same, into the method's own state once and out of it once."""
    p = row(stepper, body)
    y, e = stepper.enter(0.0, H, stepper.state(*start, body=body), p)
    for i in range(n):
        y = stepper.advance(i * H, H, y, p, e)
    q, beside = stepper.read(stepper.leave(n * H, n * H, H, y, p, e), p)
    return np.array(q), np.array(beside)


def scene_for(kind):
    """A torque that does not depend on time: of stages the step and the engine add it otherwise."""
    return {"rate": MOTION.scene, "free": FREE}.get(kind) or torqued(INERTIA, motion=0.0)


# a derivative, an exponential, a splitting and an iteration, on coordinates and matrices too
REPRESENTATIVES = [
    ("torque", "rk4", "quat"), ("rate", "rk4", "euler313"), ("rate", "magnus4", "quat"),
    ("rate", "magnus4", "dcm"), ("torque", "kahan_li8", "quat"), ("free", "dmv10", "quat"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "method", "representation"),
    in_tiers([x for x in REPRESENTATIVES if "torque" in x or "dcm" in x], REPRESENTATIVES),
)
def test_steps_are_the_engines_bit_for_bit(kind, method, representation, allocations):
    """Splittings stay in their own state there, and go out of it and back at each step here."""
    scene = scene_for(kind)
    options = {"method": method, "representation": representation}
    stepper = fa.single_step(scene, **options)
    start = (START3,) if kind == "rate" else (Q0, W0)

    def engine(n):
        traj = fa.propagate(scene, *start, dt=H, n_steps=n, n_threads=1, **options)
        return np.hstack([traj.q[-1]] if kind == "rate" else [traj.q[-1], traj.w[-1]])

    def alone(run, n):
        return [np.hstack(run(stepper, b, n, *(a[b] for a in start))) for b in range(len(start[0]))]

    assert np.array_equal(alone(one_by_one, 1), engine(1))
    before = allocations()
    three = alone(one_by_one, 3)
    assert allocations() == before
    # to go out and back is two rotations or kicks a step, a few ulps each
    own_state = fa.METHODS[method].steps.stage is not None
    assert np.abs(np.array(three) - engine(3)).max() <= (32 * EPS if own_state else 0.0)
    if own_state or representation == "dcm":
        assert np.array_equal(alone(run_by_advance, 3), engine(3))


def test_velocity_and_position_go_along():
    stepper = fa.single_step(BODY, method="rk4", position=True)
    traj = fa.propagate(BODY, START, SPIN, v0=V0, r0=R0, dt=H, n_steps=3, n_threads=1, method="rk4")
    found = one_by_one(stepper, 0, 3, START, SPIN, V0, R0)
    assert gap(found, traj.q[-1], traj.w[-1], traj.v[-1], traj.r[-1]) == 0.0


def test_other_axes_and_an_inertial_rate():
    tensor = np.array([[2.0, 0.1, 0.05], [0.1, 1.5, -0.2], [0.05, -0.2, 1.0]])
    body = fa.Scene(inertia=tensor)
    stepper = fa.single_step(body, method="rk4")
    traj = fa.propagate(body, START, SPIN, dt=H, n_steps=3, n_threads=1, method="rk4")
    assert gap(run_by_advance(stepper, 0, 3, START, SPIN), traj.q[-1], traj.w[-1]) == 0.0
    coning = fa.Scene(rate=fa.rates.Coning(1.0, 1.0), frame="inertial")
    stepper = fa.single_step(coning)
    traj = fa.propagate(coning, START, dt=H, n_steps=3, n_threads=1)
    assert gap(one_by_one(stepper, 0, 3, START), traj.q[-1]) == 0.0


@pytest.mark.parametrize("shared", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_float32(shared):
    scene = MOTION.shared if shared else MOTION.scene
    stepper = fa.single_step(scene, method="magnus4", dtype="float32")
    traj = fa.propagate(
        scene, START3, dt=H, n_steps=3, t0=0.1, n_threads=1, method="magnus4", dtype="float32"
    )
    p = stepper.params if shared else stepper.params[2]
    x = np.array(stepper.state(START, body=2))
    assert x.dtype == np.float32
    assert type(p[0]) is (float if shared else np.float64)
    for i in range(3):
        stepper.step_into(0.1 + i * H, H, x, p)
    q, _ = stepper.read(tuple(x), p)
    read = [s for s in stepper.read.nopython_signatures if "float32" in str(s.args[0])]
    assert {str(t) for s in read for t in s.return_type[0]} == {"float32"}
    assert np.array_equal(np.array(q, dtype=np.float32), traj.q[-1, 2])


def test_a_turn_past_half_a_turn_takes_the_wide_exponential():
    w = (2.0, -3.0, 1.5)
    scene = fa.Scene(rate=fa.rates.Constant(w))
    stepper = fa.single_step(scene, method="lie_euler")
    for h in (0.1, 1.0, 10.0):
        x, angle = stepper.step_and_angle(0.0, h, stepper.state(START), stepper.params)
        traj = fa.propagate(scene, START, dt=h, n_steps=1, method="lie_euler", n_threads=1)
        assert gap([stepper.attitude(x)], traj.q[-1]) == 0.0
        assert angle == pytest.approx(h * np.linalg.norm(w), rel=4 * EPS)
        assert stepper(0.0, h, stepper.state(START)) == x


def test_an_iteration_that_does_not_converge_says_so():
    stepper = fa.single_step(FREE, method="dmv10")
    for w, expected in ((0.1, False), (1.0, True)):
        x = stepper.state(START, w * W0[0])
        _, angle = stepper.step_and_angle(0.0, 1.0, x, row(stepper, 0))
        assert (angle == math.inf) == expected


def test_the_angle_of_a_splitting_is_what_its_limit_holds_for():
    """Under a torque the larger of two, each in units of the limit under a torque."""
    m = np.linalg.norm(INERTIA[0] * W0[0])
    a, b, c = 1.0 / np.sort(INERTIA[0])
    asymmetry, size = H * m * np.sqrt((a - b) * (b - c)), H * np.linalg.norm(W0[0])
    free = fa.single_step(fa.Scene(inertia=INERTIA[0]), method="kahan_li8")
    _, angle = free.step_and_angle(0.0, H, free.state(START, W0[0]), row(free, 0))
    assert angle == pytest.approx(asymmetry, rel=16 * EPS)
    limits = fa.METHODS["kahan_li8"].limits
    asymmetry *= limits["torqued"] / limits["quaternion"]
    stepper = fa.single_step(torqued(INERTIA, motion=0.0, arm=np.zeros(3)), method="kahan_li8")
    _, angle = stepper.step_and_angle(0.0, H, stepper.state(START, W0[0]), row(stepper, 0))
    assert angle == pytest.approx(max(size, asymmetry), rel=0.05)  # |w| changes on the way


# from a user's own code


@pytest.fixture(scope="module")
def user():
    """A filter's loops over steps, as a user writes them."""
    stepper = fa.single_step(FREE, method="rk4")
    step, start, read = stepper.step, stepper.start, stepper.read
    into = stepper.step_into

    @njit
    def serial(n, h, q, w, p):
        x = start(q, w, p)
        for i in range(n):
            x = step(i * h, h, x, p)
        return read(x, p)

    @njit(parallel=True)
    def side_by_side(n, h, x, p):
        for b in prange(x.shape[0]):
            for i in range(n):
                into(i * h, h, x[b], p[b])

    return stepper, serial, side_by_side


def test_from_jitted_code(user, allocations):
    stepper, serial, _ = user
    p = tuple(stepper.params[2])
    q, w = serial(3, H, tuple(START), tuple(W0[2]), p)
    assert gap((q, w), *one_by_one(stepper, 2, 3, START, W0[2])) == 0.0
    before = allocations()
    serial(100, H, tuple(START), tuple(W0[2]), p)
    assert allocations() == before
    for text in serial.inspect_llvm().values():
        assert not is_made_in(text)


def test_in_a_parallel_loop_and_in_place(user):
    """The bodies of an ensemble, twice around the list, each by itself."""
    stepper, _, side_by_side = user
    params = np.concatenate([stepper.params, stepper.params])
    n = len(params)
    x = np.array([stepper.state(START, W0[0], body=b % len(INERTIA)) for b in range(n)])
    side_by_side(3, H, x, params)
    traj = fa.propagate(FREE, Q0, W0, dt=H, n_steps=3, n_threads=1, method="rk4")
    for b in range(n):
        i = b % len(INERTIA)
        assert gap(stepper.read(tuple(x[b]), params[b]), traj.q[-1, i], traj.w[-1, i]) == 0.0


def test_parameters_as_a_row_of_an_array():
    stepper = fa.single_step(FREE, method="rk4")
    p = stepper.params[1]
    x = stepper.start(tuple(START), tuple(W0[1]), p)
    assert x == stepper.start(tuple(START), tuple(W0[1]), tuple(p))
    expected, turn = stepper.step_and_angle(0.1, H, x, tuple(p))
    assert stepper.step_and_angle(0.1, H, x, p) == (expected, turn)
    assert stepper.step(0.1, H, x, p) == expected
    assert stepper.step(0.1, H, np.array(x), np.stack([p, p], axis=1)[:, 1]) == expected
    assert stepper.read(np.array(x), p) == stepper.read(x, tuple(p))
    y, e = stepper.enter(0.1, H, x, p)
    y = stepper.advance(0.1, H, y, p, e)
    assert stepper.leave(0.1 + H, H, H, y, p, e) == expected


def test_a_users_rate_that_is_no_straight_line():
    @njit
    def rate(t, p):
        k = 0
        while t > 0.04:
            t -= 0.04
            k += 1
        return p[0] * k, t, p[0]

    scene = fa.Scene(rate=rate, params=(0.3,))
    stepper = fa.single_step(scene)
    traj = fa.propagate(scene, START, dt=H, n_steps=3, n_threads=1)
    assert gap(one_by_one(stepper, 0, 3, START), traj.q[-1]) == 0.0


def test_methods_and_representations_of_ones_own():
    heun = fa.runge_kutta("heun", order=2, c=(0, 1), a=((1,),), b=(1 / 2, 1 / 2))
    middle = fa.lie_group(
        "middle", order=2, exponents=lambda w, t, h: (tuple(h * x for x in w(t + h / 2)),)
    )
    for method, representation in ((heun, "dcm"), (middle, "quat")):
        options = {"method": method, "representation": representation}
        stepper = fa.single_step(MOTION.shared, **options)
        assert stepper.method == method.name
        traj = fa.propagate(MOTION.shared, START, dt=H, n_steps=3, n_threads=1, **options)
        assert gap(one_by_one(stepper, 0, 3, START), traj.q[-1]) == 0.0


def test_scenes_that_differ_in_numbers_alone_share_what_is_compiled():
    one, other = (fa.single_step(fa.Scene(inertia=i)) for i in ((2.0, 1.0, 0.7), (3.0, 1.0, 2.5)))
    assert one.step is other.step
    assert one.read is other.read
    x = one.state(START, W0[0])
    assert one(0.0, H, x) != other(0.0, H, x)


# refusals


def test_arrays_that_are_too_short():
    """By each function that takes arrays, and from a user's code; what lies beyond stays."""
    stepper = fa.single_step(FREE, method="rk4")
    into = stepper.step_into
    p = np.ascontiguousarray(stepper.params[0])
    x = np.array(stepper.state(START, W0[0]))
    y, e = stepper.enter(0.0, H, x, p)

    @njit
    def user(t, h, x, p):
        into(t, h, x, p)

    stepping = stepper.step, stepper.step_and_angle, into, user, stepper.enter
    calls = [(f, (0.0, H, x, p)) for f in stepping]
    calls += [
        (stepper.read, (x, p)),
        (stepper.start, (tuple(START), tuple(W0[0]), p)),
        (stepper.advance, (0.0, H, y, p, e)),
        (stepper.leave, (H, H, H, y, p, e)),
    ]
    for function, given in calls:
        for name, whole in (("x", x), ("p", p)):
            beyond = whole.copy()
            short = tuple(beyond[:-1] if value is whole else value for value in given)
            if all(value is not whole for value in given):
                continue
            message = f"{name}: found fewer than {len(whole)} numbers; accepted: {len(whole)}"
            with pytest.raises(ValueError, match=message):
                function(*short)
            assert (beyond == whole).all()


REFUSED = r"found {}.* among the arguments; accepted are float64 or float32"


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("t", 0, r"step: found an integer among the arguments \(int64, .* write 1.0 instead of 1"),
        ("t", "0", REFUSED.format("unicode_type")),
        ("x", (1, 0, 0, 0), "step: found an integer among the arguments"),
        ("x", [1.0, 0.0, 0.0, 0.0], REFUSED.format("reflected list")),
        ("x", np.ones((2, 4)), REFUSED.format("array")),
        ("x", (1.0, 0.0, 0.0), "x: found 3 numbers; accepted: 4"),
        ("p", (1.0, 2.0), "p: found 2 numbers; accepted: 11"),
    ],
)
@pytest.mark.filterwarnings("ignore::numba.core.errors.NumbaPendingDeprecationWarning")
def test_steps_are_compiled_for_floats_alone(magnus, name, value, message):
    """From Python too: Numba says what they are not compiled for."""
    given = {"t": 0.0, "h": H, "x": (1.0, 0.0, 0.0, 0.0), "p": row(magnus, 0)}
    with pytest.raises(TypingError, match=message):
        magnus.step(**given | {name: value})


def test_an_array_that_is_only_read_need_not_be_writable(magnus):
    x = np.array([1.0, 0.0, 0.0, 0.0])
    known = magnus.step(0.0, H, x, row(magnus, 0))
    x.flags.writeable = False
    assert magnus.step(0.0, H, x, row(magnus, 0)) == known
    with pytest.raises(TypingError, match="readonly array"):
        magnus.step_into(0.0, H, x, row(magnus, 0))
