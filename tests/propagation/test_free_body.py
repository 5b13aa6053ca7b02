"""Free bodies in closed form against integration with many digits and known numbers."""

import itertools
import math
import operator

import mpmath as mp
import numpy as np
import oracle
import pytest
import rigid_oracle as ro
from each import each, in_tiers

import fastatt as fa
from fastatt import closed_form
from fastatt.kernels import free_body

ONE = (1.0, 0.0, 0.0, 0.0)


def errors(w0, inertia, times, q0=ONE):
    """Largest errors over the times of the angle, in rad, and of w and m, over 1 + |w| t."""
    w0, inertia = [float(c) for c in w0], [float(c) for c in inertia]
    w_size, m_size = math.hypot(*w0), math.hypot(*map(operator.mul, w0, inertia))
    q, w = closed_form.free_body(q0, w0, inertia, times)
    # in units of time in which |w| is 1
    size = mp.mpf(w_size)
    turned = [c / size for c in oracle.vec(w0)]
    known = ro.integrate(inertia, q0, turned, [size * t for t in times], digits=22)
    worst = np.zeros(3)
    for k, true in enumerate(known):
        gap = (w[k] - [float(size * c) for c in true.w]) / (1.0 + w_size * abs(times[k]))
        angle = 2.0 * oracle.attitude_error(q[k], true.q) / (1.0 + w_size * abs(times[k]))
        scaled = np.linalg.norm(gap) / w_size, np.linalg.norm(gap * inertia) / m_size
        worst = np.maximum(worst, (angle, *scaled))
    return worst


BOUND = 1e-15


def triaxial(rng):
    """Random moments that a body can have."""
    while True:
        inertia = rng.uniform(0.1, 1.0, 3)
        if 2.0 * inertia.max() < inertia.sum():
            return inertia


def near_separatrix(rng, distance):
    """(w, inertia) with L² = 2T I2 but for a relative part of about ``distance``, of its sign."""
    inertia = triaxial(rng)
    low, middle, high = np.sort(inertia)
    ordered = (
        1.0 / math.sqrt(low * (middle - low)),
        rng.normal() * 10.0 ** rng.uniform(-1, 1),
        (1.0 + distance) / math.sqrt(high * (high - middle)),
    )
    w = np.empty(3)
    w[np.argsort(inertia)] = ordered * rng.choice([-1.0, 1.0], 3)
    return w / np.linalg.norm(w), inertia


# against integration


def against_integration():
    """(rate, moments, times, attitude)."""
    for inertia in itertools.permutations((0.5, 0.8, 1.1)):  # orders of axes, and signs
        rng = np.random.default_rng(sum(k * int(10 * c) for k, c in enumerate(inertia)))
        for signs in itertools.product((1, -1), repeat=3):
            yield signs * rng.uniform(0.2, 1.0, 3), inertia, (3.0, -5.0)
    rng = np.random.default_rng(1)
    for _ in range(8):
        q0 = tuple(oracle.quaternions(1, int(rng.integers(100)))[0])
        yield rng.normal(size=3), triaxial(rng), (1.0, -7.0, 20.0), q0
    for axis, tilt in itertools.product(range(3), (0.0, 1e-14, 1e-8, 1e-3)):
        w = np.full(3, tilt) * (1.0, -0.7, 0.4)
        w[axis] = -1.3
        yield w, (0.7, 0.9, 0.4), (2.0, -40.0)
    some = ((0.3, -0.8, 0.5), (1.0, 0.2, 0.0), (1e-9, 0.9, 1e-7))
    for inertia, (shift, w) in itertools.product(DEGENERATE.values(), enumerate(some)):
        yield w, np.roll(inertia, shift), (3.0, -11.0)
    for rod in ((1.0, 1e3, 1e3), (1e3 + 0.5, 1.0, 1e3)):
        for w in ((1.0, 1e-3, -2e-3), (0.3, 0.2, 0.4)):
            yield np.array(w)[[1, 0, 2]] if rod[1] == 1.0 else w, rod, (1.0, -3.0)
    for rate, unit in itertools.product((1e-6, 1e6), (1e-12, 1e12)):
        w, inertia = np.array((0.5, -0.3, 0.9)), np.array((0.8, 0.5, 0.6))
        yield rate * w, unit * inertia, (5.0 / rate,)
    yield (0.5, -0.3, 0.9), (0.8, 0.5, 0.6), (150.0,)


def test_against_integration():
    far = [case for case in against_integration() if not (errors(*case) <= BOUND).all()]
    assert far == []


@pytest.mark.parametrize("power", in_tiers([2, 12], [2, 4, 6, 8, 10, 12, 13]))
def test_near_the_separatrix(power):
    distance = 10.0**-power
    for side in (1, -1):
        rng = np.random.default_rng(10 * power + (side > 0.0))
        w, inertia = near_separatrix(rng, side * distance)
        constants = free_body.setup_rate(ONE, tuple(w.tolist()), tuple(inertia.tolist()))
        # near k = 1, where Jacobi's functions are hyperbolic
        assert constants[-1] == 1.0 or distance == 1e-2
        assert (errors(w, inertia, (1.0, 20.0, 90.0)) <= BOUND).all()


DEGENERATE = {
    "oblate": (0.6, 0.6, 1.0),
    "prolate": (1.0, 1.0, 0.3),
    "spherical": (0.7, 0.7, 0.7),
    "1e-6": (1.0, 1.0 + 1e-6, 1.0 + 2e-6),
    "1e-12": (1.0, 1.0, 1.0 + 1e-12),
    "an ulp": (1.0, 1.0 + 2.0**-52, 1.5),
    "nearly prolate": (2.0, 2.0 + 1e-12, 1.0),
    "plate": (0.3, 0.7, 1.0),
    "textbook": (2.0, 1.0, 2.0 / 3.0),
}


def test_degenerate_bodies_in_single_precision():
    """Within 1e9 times the bound of double precision, of moments that single precision holds."""
    moments = [np.roll(x, k) for x in DEGENERATE.values() for k in range(3)]
    moments = np.array(moments, dtype=np.float32)
    q0, w0 = np.float32([0.5, 0.5, -0.5, 0.5]), np.float32([0.1, -0.2, 0.3])
    t = np.array([0.0, 0.5, 3.0])
    q, w = closed_form.free_body(q0, w0, moments, t, dtype=np.float32)
    known, rates = closed_form.free_body(q0, w0, moments, t, dtype=np.float64)
    size = np.linalg.norm(w0)
    bound = 1e-6 * (1.0 + size * t[:, None])
    assert (fa.angle_between(q, known) <= bound).all()
    assert (np.linalg.norm(w - rates, axis=-1) <= bound * size).all()


@pytest.mark.parametrize(("dtype", "size"), [("float64", 2.0**-1000), ("float32", 2.0**-120)])
def test_slow_rates_are_not_taken_for_rest(dtype, size):
    """The attitude depends on the product of rate and time only, to the last bit."""
    scene, w = fa.Scene(inertia=(0.8, 0.5, 0.6)), np.array((0.5, -0.3, 0.9))
    runs = [
        fa.propagate(scene, ONE, x * w, dt=5.0 / x, n_steps=1, method="exact", dtype=dtype)
        for x in (1.0, size)
    ]
    assert np.array_equal(runs[0].q, runs[1].q)
    assert np.array_equal(size * runs[0].w.astype(float), runs[1].w)


@pytest.mark.parametrize(("dtype", "least", "longest"), [("f8", -1070, 1020), ("f4", -145, 126)])
@pytest.mark.parametrize("inertia", [(0.8, 0.5, 0.6), (0.8, 0.5, 0.5)])
def test_subnormal_rates(dtype, least, longest, inertia):
    scene, w = fa.Scene(inertia=inertia), np.array((0.75, -0.25, 0.5))
    given = {"n_steps": 1, "method": "exact"}
    for exponent in range(-longest - 5, least, -3):
        slow = (2.0**exponent * w).astype(dtype)
        run = fa.propagate(scene, ONE, slow, dt=2.0**longest, dtype=dtype, **given)
        rate, time = np.ldexp(slow.astype(float), -exponent), 2.0 ** (longest + exponent)
        truth = fa.propagate(scene, ONE, rate, dt=time, **given)
        assert run.status[0] == 0
        assert fa.angle_between(run.q[-1].astype(float), truth.q[-1]) < 4 * np.finfo(dtype).eps


def test_momentum_in_space_over_a_thousand_turns():
    rng = np.random.default_rng(3)
    bodies = [near_separatrix(rng, d) for d in (1e-3, -1e-6, 1e-12)]
    bodies += [(rng.normal(size=3), triaxial(rng)) for _ in range(200)]
    w0, inertia = (np.array(x) for x in zip(*bodies, strict=True))
    w0 /= np.linalg.norm(w0, axis=1)[:, None]
    q0 = np.array(oracle.quaternions(len(w0)))
    t = np.linspace(0.0, 2e3 * np.pi, 50)
    q, w = closed_form.free_body(q0, w0, inertia, t)
    found = rotated(q, inertia * w)
    kept = rotated(q0, inertia * w0)
    gap = np.linalg.norm((found - kept).astype(float), axis=-1)
    assert (gap <= 2e-15 * np.linalg.norm(inertia * w0, axis=1)).all()
    assert np.abs(np.linalg.norm(q, axis=-1) - 1.0).max() <= 8e-16
    energy = (inertia * w**2).sum(-1)
    assert np.abs(energy / (inertia * w0**2).sum(-1) - 1.0).max() <= 4e-15


def rotated(q, v):
    """q∘v∘q* of q/|q| in extended precision."""
    q, v = q.astype(np.longdouble), v.astype(np.longdouble)
    u, s = q[..., 1:], q[..., :1]
    x = np.cross(u, v)
    return v + 2.0 * (s * x + np.cross(u, x)) / (q * q).sum(-1, keepdims=True)


# known numbers


@pytest.mark.parametrize("body", [ro.BODY_H, ro.BODY_V], ids=["H", "V"])
def test_known_bodies(body):
    m0, inertia = oracle.floats(body.m0), oracle.floats(body.inertia)
    w0 = oracle.floats(body.w0)
    for t, (m_true, q_true) in body.states.items():
        q, w = closed_form.free_body(ONE, w0, inertia, t)
        assert oracle.attitude_error(q, q_true) <= 5e-15
        assert oracle.distance(w * inertia, m_true) <= 5e-15
        q, m = free_body.evaluate(free_body.setup(ONE, m0, inertia), float(t))
        assert oracle.attitude_error(q, q_true) <= 5e-15
        assert oracle.distance(m, m_true) <= 5e-15


@pytest.mark.parametrize("epsilon", ro.FLIP_TIMES)
def test_flips(epsilon):
    """The momentum along the intermediate axis comes back with its sign changed."""
    inertia = np.array((2.0, 1.0, 2.0 / 3.0))
    m0 = np.array((epsilon, math.sqrt(1.0 - epsilon**2), 0.0))
    _, w = closed_form.free_body(ONE, m0 / inertia, inertia, ro.FLIP_TIMES[epsilon])
    assert w * inertia == pytest.approx((epsilon, -m0[1], 0.0), abs=1e-8 * epsilon)


# limits


@pytest.mark.parametrize("inertia", list(itertools.permutations((1.0, 1.5, 3.0))))
def test_on_the_separatrix(inertia):
    """m1 = ±m3 for these moments, the products are exact: sech and tanh, and no flip ever."""
    order = np.argsort(inertia)
    m0 = np.empty(3)
    m0[order] = (1.0, 0.25, -1.0)
    constants = free_body.setup(ONE, tuple(m0.tolist()), inertia)
    # ṁ2 = m3 m1 (1/I1 − 1/I3), with the other sign where the order of the axes is odd
    size = mp.sqrt(mp.mpf("2.0625"))
    rate = -size / 3 * round(np.linalg.det(np.eye(3)[order]))
    for t in (0.0, 1.0, -3.0, 20.0, 200.0, -1e5):
        phase = mp.atanh(mp.mpf("0.25") / size) + rate * t
        transverse = size / mp.sqrt(2) * mp.sech(phase)
        q, m = free_body.evaluate(constants, t)
        found = np.array(m)[order]
        true = (transverse, size * mp.tanh(phase), -transverse)
        assert oracle.distance(found, true) <= 2e-15 * (1.0 + abs(t))
        assert abs(np.linalg.norm(q) - 1.0) <= 4e-16


@pytest.mark.parametrize("inertia", [(1.0, 1.5, 3.0), (1.5, 1.0, 3.0), (3.0, 1.0, 1.5)])
@pytest.mark.parametrize("rate", [-2.0, 0.0])
def test_intermediate_axis_is_an_equilibrium(inertia, rate):
    axis = inertia.index(1.5)
    w0 = np.zeros(3)
    w0[axis] = rate
    t = np.array((1.0, -1e3, 1e5))
    q, w = closed_form.free_body(ONE, w0, inertia, t)
    true = np.zeros((3, 4))
    true[:, 0], true[:, axis + 1] = np.cos(0.5 * rate * t), np.sin(0.5 * rate * t)
    assert (np.abs(q - true).max(axis=1) <= 4e-16 * (1.0 + np.abs(t))).all()
    assert np.abs(w - w0).max() <= 1e-15


@pytest.mark.parametrize("inertia", [(0.5, 0.8, 1.0), (1.0, 1.0, 0.5), (1.0, 1.0, 1.0)])
def test_rest(inertia):
    q, w = closed_form.free_body((0.6, 0.0, -0.8, 0.0), (0.0, 0.0, 0.0), inertia, [0.0, 1e9])
    assert np.abs(q - (0.6, 0.0, -0.8, 0.0)).max() <= 2e-16
    assert not w.any()


def test_finite_for_any_finite_body():
    rng = np.random.default_rng(4)
    for i in range(3000):
        w = rng.normal(size=3) * 10.0 ** rng.uniform(-80, 80, 3) * (rng.uniform(size=3) > 0.1)
        inertia = 10.0 ** rng.uniform(-60, 60, 3)
        inertia[1] = inertia[0] if i % 3 == 0 else inertia[1]
        inertia[2] = inertia[1] if i % 7 == 0 else inertia[2]
        constants = free_body.setup_rate(ONE, tuple(w.tolist()), tuple(inertia.tolist()))
        q, m = free_body.evaluate(constants, float(10.0 ** rng.uniform(-80, 80)))
        assert np.isfinite(m).all()
        assert abs(np.linalg.norm(q) - 1.0) <= 1e-15


@each("inertia", [(1.0, 2.0, 2.5), (2.0, 1.0, 2.0), (1.0, 1.0, 1.0)])
@each("place", range(11))
def test_nan_in_nan_out(inertia, place):
    x = [1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, *inertia, 0.7]
    x[place] = math.nan
    constants = free_body.setup_rate(tuple(x[:4]), tuple(x[4:7]), tuple(x[7:10]))
    q, m = free_body.evaluate(constants, x[10])
    assert np.isnan(q).all()
    assert np.isnan(m).all() == (place >= 4)


# ensembles


def ensemble(n, seed=5):
    rng = np.random.default_rng(seed)
    q0 = np.array(oracle.quaternions(n, seed))
    return q0, rng.normal(size=(n, 3)), np.array([triaxial(rng) for _ in range(n)])


def test_shapes():
    q0, w0, inertia = ensemble(5)
    t = [0.0, 1.0]

    def shapes(*arguments):
        return tuple(x.shape for x in closed_form.free_body(*arguments))

    assert shapes(q0[0], w0[0], inertia[0], 1.0) == ((4,), (3,))
    assert shapes(q0[0], w0[0], inertia[0], t) == ((2, 4), (2, 3))
    assert shapes(q0, w0, inertia[0], 1) == ((5, 4), (5, 3))
    assert shapes(q0, w0[0], inertia, t) == ((2, 5, 4), (2, 5, 3))
    assert shapes(q0[0], w0, np.diag(inertia[0]), t) == ((2, 5, 4), (2, 5, 3))
    assert shapes(q0[0], w0[0], inertia, t) == ((2, 5, 4), (2, 5, 3))


def test_tensors():
    """Body axes turned by p: q∘p*, p∘w∘p*, and back; one tensor for all, and one for each."""
    q0, w0, inertia = ensemble(4)
    solution = closed_form.free_body
    p = np.array(oracle.quaternions(4, 6))
    t = np.array((0.0, 2.5))
    q, w = solution(q0, w0, inertia, t)
    C = fa.quat_to_dcm(p)
    tensors = np.einsum("nij,nj,nkj->nik", C, inertia, C)
    turned_q0 = fa.quat_multiply(q0, p * (1.0, -1.0, -1.0, -1.0))
    turned_w0 = np.einsum("nij,nj->ni", C, w0)
    found_q, found_w = solution(turned_q0, turned_w0, tensors, t)
    assert fa.angle_between(fa.quat_multiply(found_q, p), q).max() <= 2e-14
    assert np.abs(np.einsum("nji,tnj->tni", C, found_w) - w).max() <= 2e-14
    shared = solution(turned_q0, turned_w0, tensors[0], t)
    assert np.abs(shared[0][:, 0] - found_q[:, 0]).max() <= 1e-14
    assert np.abs(shared[1][:, 0] - found_w[:, 0]).max() <= 1e-14


# bodies with two equal moments


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("moments", [(0.6, 1.0), (1.0, 0.3), (0.7, 0.7)])
def test_symmetric_top(axis, moments):
    equal, other = moments
    inertia = np.roll((equal, equal, other), axis - 2)
    w0 = np.array((0.7, -0.4, 1.1))
    q0 = oracle.quaternions(1, 7)[0]
    momentum = [mp.mpf(i) * c for i, c in zip(inertia, w0, strict=True)]
    fixed_in_space = ro.to_inertial(oracle.vec(q0), momentum)
    for t in (0.0, 1.0, -20.0):
        spin = (1 / mp.mpf(other) - 1 / mp.mpf(equal)) * momentum[axis] * t
        precession = oracle.quat_exp([c * t / equal for c in fixed_in_space])
        true_q = oracle.quat_mul(precession, q0)
        true_q = oracle.quat_mul(true_q, oracle.quat_exp([spin * (i == axis) for i in range(3)]))
        true_m = ro.to_body(true_q, fixed_in_space)
        true_w = [c / mp.mpf(i) for c, i in zip(true_m, inertia, strict=True)]
        for solution in (closed_form.symmetric_top, closed_form.free_body):
            q, w = solution(q0, w0, inertia, t)
            assert oracle.attitude_error(q, true_q) <= 1e-15 * (1.0 + abs(t))
            assert oracle.distance(w, true_w) <= 2e-15 * (1.0 + abs(t))
