"""Single steps beside the ensemble engine, from Python, jitted code, parallel loops and threads."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
from exact import START, exp, generic, mul
from numba import njit, prange
from numba.core.errors import TypingError
from numba.core.runtime import _nrt_python, rtsys
from test_body_methods import FREE, INERTIA, Q0, W0, stepped, under_torque
from test_translation import BODY, R0, SPIN, V0

import fastatt as fa
from fastatt import steps
from fastatt.methods.method import is_staged
from fastatt.methods.sampled import WINDOWS

pytestmark = pytest.mark.slow

EPS = 2.0**-52
MOTION = generic(3)
START3 = np.broadcast_to(START, (3, 4))
RATE_METHODS = [m.name for m in fa.METHODS.values() if "rate" in m.scenes]
FREE_METHODS = stepped(FREE)
TORQUED_METHODS = stepped(under_torque("srkn4"))
# a torque changes the steps of splittings, and is all there is of one explicit method more
UNDER_TORQUE = [m for m in TORQUED_METHODS if m not in FREE_METHODS or m in ("rk4", "strang2")]
SAMPLED = [
    (m.name, inc)
    for m in fa.METHODS.values()
    for inc in (False, True)
    if ("increments" if inc else "sampled rates") in m.scenes
]
H = 0.05
# bit for bit, but for a product and a sum that the compiler fuses in one of the two places only
ULPS = 4 * EPS


@pytest.fixture(scope="module")
def magnus():
    return fa.single_step(MOTION.scene, method="magnus4")


@pytest.fixture
def allocations():
    """Counts allocations of compiled code while the test runs."""
    was_on = _nrt_python.memsys_stats_enabled()
    _nrt_python.memsys_enable_stats()
    yield lambda: rtsys.get_allocation_stats().alloc
    if not was_on:
        _nrt_python.memsys_disable_stats()


def test_every_method_that_steps_is_tested():
    tested = {*RATE_METHODS, *FREE_METHODS, *TORQUED_METHODS, *(m for m, _ in SAMPLED)}
    assert tested == {m.name for m in fa.METHODS.values() if m.tag is not None}
    assert {*FREE_METHODS, *UNDER_TORQUE} >= set(TORQUED_METHODS)


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


def of_rates():
    extra = [("magnus4", "dcm_rows"), ("rk4", "dcm"), ("rk4", "euler313")]
    return [*((m, "quat") for m in RATE_METHODS), *extra]


@pytest.mark.parametrize(("method", "representation"), of_rates())
def test_steps_at_a_given_rate_are_the_engines(method, representation, allocations):
    scene = MOTION.scene
    options = {"method": method, "representation": representation}
    stepper = fa.single_step(scene, **options)
    traj = fa.propagate(scene, START3, dt=H, n_steps=3, n_threads=1, **options)
    one_by_one(stepper, 0, 1, START)
    before = allocations()
    found = np.array([one_by_one(stepper, b, 3, START)[0] for b in range(3)])
    assert allocations() == before
    assert np.abs(found - traj.q[-1]).max() <= ULPS


def scene_for(kind, method):
    return FREE if kind == "free" else under_torque(method)


@pytest.mark.parametrize(
    ("kind", "method"),
    [*(("free", m) for m in FREE_METHODS), *(("torqued", m) for m in UNDER_TORQUE)],
)
def test_steps_of_a_body_are_the_engines(kind, method, allocations):
    """Splittings stay in their own state there, and go out of it and back at each step here."""
    scene = scene_for(kind, method)
    stepper = fa.single_step(scene, method=method)
    one = fa.propagate(scene, Q0, W0, dt=H, n_steps=1, n_threads=1, method=method)
    three = fa.propagate(scene, Q0, W0, dt=H, n_steps=3, n_threads=1, method=method)
    one_by_one(stepper, 0, 1, START, W0[0])
    before = allocations()
    # to go out and back is two rotations or kicks a step, a few ulps each
    most = 32 * EPS if is_staged(type(fa.METHODS[method].tag)) else ULPS
    for b in (0, 3):
        assert gap(one_by_one(stepper, b, 1, START, W0[b]), one.q[-1, b], one.w[-1, b]) <= ULPS
        assert gap(one_by_one(stepper, b, 3, START, W0[b]), three.q[-1, b], three.w[-1, b]) <= most
    assert allocations() == before


@pytest.mark.parametrize(
    ("kind", "method"), [("free", "strang2"), ("free", "dmv6"), ("torqued", "srkn4")]
)
def test_a_run_in_the_methods_own_state_is_the_engines(kind, method):
    scene = scene_for(kind, method)
    stepper = fa.single_step(scene, method=method)
    traj = fa.propagate(scene, Q0, W0, dt=H, n_steps=3, n_threads=1, method=method)
    found = run_by_advance(stepper, 1, 3, START, W0[1])
    assert gap(found, traj.q[-1, 1], traj.w[-1, 1]) <= ULPS


def test_a_run_in_the_own_state_of_a_method_without_one(magnus):
    found = run_by_advance(magnus, 1, 3, START)
    assert gap(found, *one_by_one(magnus, 1, 3, START)) <= ULPS


def test_velocity_and_position_go_along():
    stepper = fa.single_step(BODY, method="rk4", position=True)
    traj = fa.propagate(BODY, START, SPIN, v0=V0, r0=R0, dt=H, n_steps=3, n_threads=1, method="rk4")
    found = one_by_one(stepper, 0, 3, START, SPIN, V0, R0)
    assert gap(found, traj.q[-1], traj.w[-1], traj.v[-1], traj.r[-1]) <= ULPS


@pytest.mark.parametrize("method", ["magnus4", "rk4"])
def test_float32(method):
    """A float32 clock, as the engine's where each body has its own parameters."""
    stepper = fa.single_step(MOTION.scene, method=method, dtype="float32")
    traj = fa.propagate(
        MOTION.scene, START3, dt=H, n_steps=1, n_threads=1, method=method, dtype="float32"
    )
    x = np.array(stepper.state(START, body=2))
    assert x.dtype == stepper.params.dtype == np.float32
    stepper.step_into(np.float32(0.0), H, x, stepper.params[2])
    q, _ = stepper.read(tuple(x), stepper.params[2])
    assert {str(t) for t in stepper.read.nopython_signatures[0].return_type[0]} == {"float32"}
    assert np.abs(np.array(q) - traj.q[-1, 2]).max() <= 4 * 2.0**-23


def test_a_turn_past_half_a_turn_takes_the_wide_exponential():
    w = (2.0, -3.0, 1.5)
    scene = fa.Scene(rate=fa.rates.Constant(w))
    stepper = fa.single_step(scene, method="lie_euler")
    for h in (0.1, 1.0, 10.0):
        x, angle = stepper.step_and_turn(0.0, h, stepper.state(START), stepper.params)
        traj = fa.propagate(scene, START, dt=h, n_steps=1, method="lie_euler", n_threads=1)
        assert gap([stepper.attitude(x)], traj.q[-1]) <= ULPS
        assert angle == pytest.approx(h * np.linalg.norm(w), rel=4 * EPS)
        assert stepper(0.0, h, stepper.state(START)) == x


def test_an_iteration_that_does_not_converge_says_so():
    stepper = fa.single_step(FREE, method="dmv10")
    for w, expected in ((0.1, False), (1.0, True)):
        x = stepper.state(START, w * W0[0])
        _, angle = stepper.step_and_turn(0.0, 1.0, x, row(stepper, 0))
        assert (angle == math.inf) == expected


# samples


def sample_log(method, increments, n):
    t = np.arange(n + 1) * H
    values = MOTION.increments(t) if increments else MOTION.rate(t)
    return np.ascontiguousarray(np.moveaxis(values, 0, 1)[0])


@pytest.mark.parametrize(("method", "increments"), SAMPLED)
def test_windows_of_samples_are_the_engines(method, increments, allocations):
    """The first whole window of a log, in tuples and in arrays."""
    window = steps.sample_step(method, increments=increments)
    n = window.history + window.span
    log = sample_log(method, increments, n)
    engine = fa.integrate_rates(log, H, START, method=method, increments=increments)
    out = np.empty((window.span + 1, 4))
    gaps, work = np.full(n, H), np.empty(window.work)
    assert log.shape == (window.samples, 3)
    for _ in range(2):
        before = allocations()
        out[0] = engine[window.history]
        window.step_into(log, gaps, out, work)
    assert allocations() == before + 4  # Numba's own, of each array handed over
    assert np.abs(out - engine[window.history :]).max() <= ULPS
    if method == "coning2":  # the named functions call the same kernel for the others
        flat = window.step(tuple(out[0]), tuple(log.ravel().tolist()), tuple(gaps.tolist()))
        assert np.array_equal(np.reshape(flat, (-1, 4)), out[1:])


CALLS = {
    ("hold", False): lambda q, v: steps.hold(q, v[0], H),
    ("hold", True): lambda q, v: steps.hold_increments(q, v[0]),
    ("trapezoid", False): lambda q, v: steps.trapezoid(q, *v, H),
    ("previous", False): lambda q, v: steps.previous(q, *v, H, H),
    ("previous", True): lambda q, v: steps.previous_increments(q, *v, H, H),
    ("coning2", False): lambda q, v: steps.coning2(q, *v, H, H),
    ("coning2", True): lambda q, v: steps.coning2_increments(q, *v, H, H),
    ("coning3", False): lambda q, v: steps.coning3(q, *v, H, H, H),
    ("coning3", True): lambda q, v: steps.coning3_increments(q, *v, H, H, H),
    ("coning3_optimal", True): lambda q, v: steps.coning3_optimal_increments(q, *v),
}


def test_every_method_of_samples_has_its_functions():
    assert set(CALLS) == {s for s in SAMPLED if s[0] != "picard"}


@pytest.mark.parametrize(("method", "increments"), CALLS)
def test_functions_of_samples(method, increments):
    window = WINDOWS[type(fa.METHODS[method].tag)]
    n = window.history + window.span
    log = sample_log(method, increments, n)
    engine = fa.integrate_rates(log, H, START, method=method, increments=increments)
    samples = [tuple(row) for row in log.tolist()]
    found = CALLS[method, increments](tuple(engine[window.history].tolist()), samples)
    assert np.abs(np.reshape(found, (-1, 4)) - engine[window.history + 1 :]).max() <= ULPS


def test_large_angles_of_samples():
    u = (4.0, -3.0, 2.0)
    q = fa.integrate_rates([u], 1.0, START, method="hold", increments=True)[-1]
    assert gap([steps.hold_increments(tuple(START), u)], q) <= ULPS
    assert gap([steps.hold(tuple(START), (8.0, -6.0, 4.0), 0.5)], q) <= ULPS


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

    @njit(nogil=True)
    def with_samples(q, rates, h):
        for i in range(rates.shape[0] - 1):
            a = (rates[i, 0], rates[i, 1], rates[i, 2])
            b = (rates[i + 1, 0], rates[i + 1, 1], rates[i + 1, 2])
            q = steps.trapezoid(steps.hold(q, a, h), a, b, h)
        return q

    return stepper, serial, side_by_side, with_samples


def test_from_jitted_code(user, allocations):
    stepper, serial, _, with_samples = user
    p = tuple(stepper.params[2])
    q, w = serial(3, H, tuple(START), tuple(W0[2]), p)
    assert gap((q, w), *one_by_one(stepper, 2, 3, START, W0[2])) <= ULPS
    rates = sample_log("trapezoid", False, 8)
    with_samples(tuple(START), rates, H)
    before = allocations()
    serial(100, H, tuple(START), tuple(W0[2]), p)
    q = with_samples(tuple(START), rates, H)
    assert allocations() == before + 1  # Numba's own, of the array handed over
    slow = tuple(START)
    for a, b in pairwise(rates):
        slow = steps.trapezoid(steps.hold(slow, tuple(a), H), tuple(a), tuple(b), H)
    assert gap([q], slow) <= 16 * ULPS
    for function in (serial, with_samples):
        for text in function.inspect_llvm().values():
            assert "call ptr @NRT_MemInfo_alloc" not in text
            assert "call i8* @NRT_MemInfo_alloc" not in text


def test_in_a_parallel_loop_and_in_place(user):
    """The bodies of an ensemble, twice around the list, each by itself."""
    stepper, _, side_by_side, _ = user
    params = np.concatenate([stepper.params, stepper.params])
    n = len(params)
    x = np.array([stepper.state(START, W0[0], body=b % len(INERTIA)) for b in range(n)])
    side_by_side(3, H, x, params)
    traj = fa.propagate(FREE, Q0, W0, dt=H, n_steps=3, n_threads=1, method="rk4")
    for b in range(n):
        i = b % len(INERTIA)
        assert gap(stepper.read(tuple(x[b]), params[b]), traj.q[-1, i], traj.w[-1, i]) <= ULPS


def test_in_threads(user):
    _, _, _, with_samples = user
    logs = [np.random.default_rng(k).normal(size=(2000, 3)) for k in range(8)]
    alone = [with_samples(tuple(START), log, H) for log in logs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda log: with_samples(tuple(START), log, H), logs))
    assert together == alone


def test_a_users_rate():
    @njit
    def constant(t, p):
        return 0.0 * t, p[0], 2.0 * p[0]

    stepper = fa.single_step(fa.Scene(rate=constant, params=(0.3,)))
    assert stepper.method == "magnus4"
    x = stepper(0.0, H, stepper.state(START))
    expected = mul(START, exp([0.0, 0.3 * H, 0.6 * H]))
    assert gap([stepper.attitude(x)], expected) <= ULPS


# refusals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "exact"}, "method: found 'exact'; accepted: rk4, cf4"),
        ({"method": "magnus4"}, "method: found 'magnus4'; accepted"),
        ({"representation": "mrp"}, "representation: found 'mrp'"),
        ({"position": True}, "position: found True"),
    ],
)
def test_refusals(options, message):
    with pytest.raises(ValueError, match=message):
        fa.single_step(FREE, **options)


def test_refusals_of_types(magnus):
    with pytest.raises(TypeError, match="scene: found 3"):
        fa.single_step(3)
    with pytest.raises(TypeError, match="dtype"):
        fa.single_step(FREE, dtype="int")
    with pytest.raises(TypeError, match=r"state: found 2 arguments; accepted: q$"):
        magnus.state(START, (1.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"q is the zero quaternion"):
        magnus.state((0.0, 0.0, 0.0, 0.0))
    with pytest.raises(TypingError, match=r"step: found an integer .* write 1.0 instead of 1"):
        magnus.step(0.0, H, (1, 0, 0, 0), magnus.params[0])
    with pytest.raises(ValueError, match="method: found 'rk4'; accepted: hold"):
        steps.sample_step("rk4")
