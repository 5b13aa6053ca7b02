"""Derivatives of steps and of whole runs against differences of them, and identities."""

import math
from functools import partial
from itertools import permutations

import numpy as np
import pytest
from differences import attitude_errors, derivative, displaced
from each import each
from numba import njit
from oracle import EPS

import fastatt as fa
from fastatt import estimation
from fastatt.kernels import quat, so3

H = 0.1
# one method of each kind
RATE_METHODS = ["lie_euler", "rk4", "magnus6"]
SAMPLED = [("coning2", False), ("coning2", True)]
# |ω| h of some 0.3, bending so that the commutators count
CURVED = fa.Scene(
    rate=fa.rates.Polynomial([(1.0, -2.0, 2.0), (9.0, 6.0, -9.0), (30.0, -20.0, -10.0)])
)
# displaced by 2e-3 rad: truncation (2e-3)⁴/30 times a fifth derivative of some 1, 5e-13 of H, and
# rounding, 1.5 ulps over 2e-3 for each of some ten operations, 2e-12
STEP = 0.02
BOUND = 3e-12


def hat(v):
    return np.reshape(so3.hat(tuple(v)), (3, 3))


# given rates


@pytest.mark.parametrize("method", RATE_METHODS)
def test_rate_methods(method):
    made = estimation.step_tangent(CURVED, method=method)
    turn, attitude, bias = made.step(0.3, H, (0.0, 0.0, 0.0), made.params)
    nearby = [made.step(0.3, H, tuple(b), made.params)[0] for b in displaced(3, STEP)]
    true = derivative(attitude_errors(turn, nearby), STEP)
    assert np.abs(np.reshape(bias, (3, 3)) - true).max() <= BOUND * H
    assert np.abs(np.linalg.norm(turn) - 1) <= 2 * EPS
    assert np.abs(np.reshape(attitude, (3, 3)) - fa.quat_to_dcm(turn).T).max() <= 4 * EPS


# samples


def log(n):
    generator = np.random.default_rng(4)
    return np.cumsum(generator.normal(size=(n, 3)), axis=0)


@pytest.mark.parametrize(("method", "increments"), SAMPLED)
def test_sampled_methods(method, increments):
    spans = H * (1.0 + 0.3 * np.sin(np.arange(7 + increments)))
    samples = log(8) * (H if increments else 1.0)
    bias = np.vstack([np.zeros(3), displaced(3, STEP)])
    many = np.broadcast_to(samples, (13, *samples.shape))
    found = estimation.sample_transitions(
        many, spans, method=method, increments=increments, bias=bias
    )
    for i in range(found.rotation.shape[1]):
        true = derivative(attitude_errors(found.rotation[0, i], found.rotation[1:, i]), STEP)
        assert np.abs(found.bias[0, i] - true).max() <= BOUND * H
    # the bias moves every interval as far as a held rate's, to the commutators
    assert np.abs(found.bias[0, :, 0, 0] + spans).max() <= 0.1 * H


def test_turns_of_a_log_are_those_of_integrate_rates():
    samples = log(10)[None]
    found = estimation.sample_transitions(samples, H, method="previous", bias=(0.1, 0.2, -0.1))
    q = fa.integrate_rates(samples - (0.1, 0.2, -0.1), H, method="previous")
    turns = fa.quat_multiply(q[:, :-1] * (1, -1, -1, -1), q[:, 1:])
    assert np.abs(found.rotation - turns).max() <= 8 * EPS


# rigid bodies

Q = np.array([0.1, -0.5, 0.7, 0.5])
M = np.array([0.4, -0.3, 0.9])
# not in order: "strang2" turns all three axes round, to put the intermediate moment second
MOMENTS = np.array([2.0, 1.0, 1.4])
WEIGHT = np.array([0.1, -0.2, 0.9, 1.5])
# displacements of the state and of parameters, all of size 1: truncation NUDGE⁴/30 times a fifth
# derivative below 1, or of moments 120 |m| h/I⁶, 4e-13, and rounding some ulps over a nudge
NUDGE, NUDGE_MOMENTS = 4e-3, 7e-4
TRUNCATION = NUDGE**4 / 30
TOP_H = 0.4


def omega(m):
    """The form that a conservative body keeps, of (δθ, δm) in body axes."""
    return np.block([[-hat(m), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])


@pytest.fixture(scope="module")
def top():
    """A heavy top and its neighbours: 24 states, 12 inertias, 16 torques; then fast ones."""
    d = np.zeros((61, 6))
    d[1:25] = displaced(6, NUDGE)
    moments, weights = np.tile(MOMENTS, (61, 1)), np.tile(WEIGHT, (61, 1))
    moments[25:37] += displaced(3, NUDGE_MOMENTS)
    weights[37:53] += displaced(4, NUDGE)
    q = fa.quat_multiply(Q, fa.rotation_vector_to_quat(d[:, :3]))
    m = M + d[:, 3:]
    # |w| h from rest past whole turns
    turns = [0.0, 1e-8, 3.1, 2 * math.pi - 1e-6, 2 * math.pi + 1e-6, 9.0, 40.0, 1e3]
    m[53:] = np.outer(turns, np.array([2.0, -1.0, 2.0]) / 3.0 / TOP_H) * MOMENTS
    torque = fa.torques.HeavyTop(weights[:, :3], weights[:, 3])
    scene = fa.Scene(inertia=moments, torque=torque)
    found = estimation.body_tangent(scene, q, m / moments, TOP_H, method="strang2", parameters=True)
    return found, m, found.w * moments


def test_derivatives_of_a_torqued_splitting(top):
    found, _, m1 = top
    change = np.hstack([attitude_errors(found.q[0], found.q[1:53]), m1[1:53] - m1[0]])
    assert np.abs(found.matrix[0] - derivative(change[:24], NUDGE)).max() <= TRUNCATION
    moments = derivative(change[24:36], NUDGE_MOMENTS)
    assert np.abs(found.inertia[0] - moments).max() <= 2e-12
    assert np.abs(found.torque[0] - derivative(change[36:], NUDGE)).max() <= TRUNCATION
    gradient = found.adjoint(np.ones(6))
    assert np.abs(gradient - found.matrix.sum(axis=1)).max() <= 8 * EPS * gradient.max()


def test_splittings_are_symplectic_at_any_rate(top):
    found, m0, m1 = top
    for phi, before, after in zip(found.matrix, m0, m1, strict=True):
        size = np.linalg.norm(phi, 2) ** 2 * max(1.0, np.linalg.norm(before))
        assert np.abs(phi.T @ omega(after) @ phi - omega(before)).max() <= 1e-13 * size
        assert abs(np.linalg.det(phi) - 1) <= 1e-13 * size
    assert np.abs(found.matrix[0].T @ omega(m1[0]) @ found.matrix[0] - omega(M)).max() <= 1e-13


@each("method", [m.name for m in fa.METHODS.values() if m.steps and "free" in m.scenes])
def test_methods_are_symplectic_as_their_records_say(method):
    """Those of high order are so to rounding."""
    body = fa.Scene(inertia=MOMENTS)
    found = estimation.body_tangent(body, Q, M / MOMENTS, TOP_H, method=method)
    change = found.matrix.T @ omega(found.w * MOMENTS) @ found.matrix - omega(M)
    kept, record = np.abs(change).max() <= 1e-13, fa.METHODS[method]
    assert kept >= record.symplectic
    assert kept == record.symplectic or record.order >= 8


ORDERS = np.array(list(permutations((1.0, 1.2, 1.5))))


def test_columns_of_moments_in_any_order():
    """Splittings put the intermediate moment second; a body's neighbours do not matter."""
    w = M / ORDERS
    scene = fa.Scene(inertia=ORDERS)
    found = estimation.body_tangent(scene, Q, w, TOP_H, method="strang2", parameters=True)
    for k, moments in enumerate(ORDERS):
        near = np.vstack([moments, moments + displaced(3, NUDGE_MOMENTS)])
        ends = estimation.body_tangent(fa.Scene(inertia=near), Q, M / near, TOP_H, method="strang2")
        m1 = ends.w * near
        change = np.hstack([attitude_errors(ends.q[0], ends.q[1:]), m1[1:] - m1[0]])
        assert np.abs(found.inertia[k] - derivative(change, NUDGE_MOMENTS)).max() <= 2e-12
        alone = estimation.body_tangent(
            fa.Scene(inertia=moments), Q, w[k], TOP_H, method="strang2", parameters=True
        )
        assert np.abs(alone.inertia - found.inertia[k]).max() <= 8 * EPS


def test_users_torque_from_users_code():
    """Runge-Kutta under a torque with powers, functions and the attitude, at fixed parameters."""

    @njit
    def torque(t, q, w, p):
        down = quat.rotate_inverse(q, (0.0, 0.0, 1.0))
        s = math.sin(t)
        return p[0] * down[1] - p[1] * w[0], -p[0] * down[0] - p[1] * w[1], p[2] * s * w[2] ** 2

    scene = fa.Scene(inertia=MOMENTS, torque=torque, params=(1.5, 0.3, 0.7))
    made = estimation.step_tangent(scene, method="rk4")
    step = made.step

    @njit
    def user(t, h, q, m, p):
        return step(t, h, q, m, p)

    q1, m1, phi = user(0.3, 0.2, tuple(Q), tuple(M), made.params)
    d = displaced(6, NUDGE)
    starts = fa.quat_multiply(Q, fa.rotation_vector_to_quat(d[:, :3]))
    ends = [
        user(0.3, 0.2, tuple(a), tuple(M + b), made.params)
        for a, b in zip(starts, d[:, 3:], strict=True)
    ]
    theta = attitude_errors(q1, [end[0] for end in ends])
    true = derivative(np.hstack([theta, np.subtract([end[1] for end in ends], m1)]), NUDGE)
    assert np.abs(np.reshape(phi, (6, 6)) - true).max() <= TRUNCATION


TOP = fa.Scene(inertia=MOMENTS, torque=fa.torques.HeavyTop(WEIGHT[:3], WEIGHT[3]))


@pytest.mark.parametrize(
    ("scene", "start"), [(TOP, (tuple(Q.tolist()), tuple(M))), (CURVED, ((0.1, 0.2, 0.3),))]
)
def test_parameters_in_an_array(scene, start):
    """As a row of one; of an array that is too short nothing is read beyond it."""
    made = estimation.step_tangent(scene, method="rk4")
    step, p = made.step, np.array(made.params)

    @njit
    def user(t, h, start, p):
        return step(t, h, *start, p)

    true = step(0.0, H, *start, made.params)
    assert step(0.0, H, *start, p) == user(0.0, H, start, p) == true
    message = f"p: found fewer than {len(p)} numbers; accepted: {len(p)}"
    with pytest.raises(ValueError, match=message):
        step(0.0, H, *start, p[:-1])
    with pytest.raises(ValueError, match=message):
        user(0.0, H, start, p[:-1])


def test_of_a_torque_that_cannot_be_traced_differences():
    """A loop whose end depends on a number."""

    @njit
    def summed(t, q, w, p):
        total, k = 0.0, 0.0
        while k < 3.0 + p[0]:
            total -= math.sin(w[0])
            k += 1.0
        return total, w[0] * w[2], q[1]

    @njit
    def straight(t, q, w, p):
        return -4.0 * math.sin(w[0]), w[0] * w[2], q[1]

    looped, traced = (
        estimation.body_tangent(
            fa.Scene(inertia=MOMENTS, torque=torque, params=(0.5,)), Q, M, H, method="rk4"
        )
        for torque in (summed, straight)
    )
    assert np.abs(looped.w - traced.w).max() <= 4 * EPS
    assert 0.0 < np.abs(looped.matrix - traced.matrix).max() <= 1e-9 * H


# whole runs

# its torque turns with time
TURNING = fa.Scene(inertia=MOMENTS, torque=fa.torques.GravityGradient(0.5))
W = np.array([0.2, -0.3, 0.6])
RUN = {"dt": 0.2, "n_steps": 20, "method": "strang2", "t0": 0.3}
NEAR = 2e-3


def around(*steps):
    """Initial conditions of a body and of its neighbours at these distances."""
    d = np.vstack([np.zeros((1, 6)), *(displaced(6, step) for step in steps)])
    return fa.quat_multiply(Q, fa.rotation_vector_to_quat(d[:, :3])), W + d[:, 3:] / MOMENTS


def changes(run):
    """Of the neighbours' last states from the body's."""
    q, m = run.q[-1], run.w[-1] * MOMENTS
    return np.hstack([attitude_errors(q[0], q[1:]), m[1:] - m[0]])


@pytest.fixture(scope="module")
def found():
    """A run, its neighbours, and others twice as far."""
    return estimation.run_tangent(TURNING, *around(NEAR, 2.0 * NEAR), **RUN)


def test_it_is_the_derivative_of_the_run(found):
    run, tangent = found
    change = changes(run)
    near, far = derivative(change[:24], NEAR), derivative(change[24:], 2.0 * NEAR)
    # truncation falls by 16; rounding is that of 20 steps
    bound = np.abs(far - near).max() / 15.0 + 400 * EPS / NEAR
    assert bound < 1e-9
    assert np.abs(tangent.matrix[0] - near).max() <= bound


def test_it_is_the_derivative_where_steps_change_the_length_that_a_torque_reads():
    """Large steps of rk4, which loses some of the quaternion's length."""
    options = {"dt": 0.5, "n_steps": 20, "method": "rk4"}
    run, tangent = estimation.run_tangent(TOP, *around(NEAR), **options)
    assert np.abs(run.norm_error[-1]).min() > 1e-4
    near = derivative(changes(run), NEAR)
    assert np.abs(tangent.matrix[0] - near).max() <= 1e-7 * np.abs(near).max()


def test_the_run_is_that_of_propagate_and_its_first_step_that_of_body_tangent(found):
    run, tangent = found
    plain = fa.propagate(TURNING, Q, W, **RUN)
    assert fa.angle_between(plain.q[-1], run.q[-1, 0]) <= 8 * EPS
    first = estimation.body_tangent(TURNING, Q, W, 0.2, t0=0.3, method="strang2")
    assert np.abs(tangent.steps[0, 0, :6, :6] - first.matrix).max() <= 8 * EPS


def test_tangent_and_adjoint_are_transposed(found):
    """⟨A x, y⟩ = ⟨x, Aᵀ y⟩, of each body, to the rounding of 20 products."""
    _, tangent = found
    x, y = np.random.default_rng(0).normal(size=(2, 49, 6))
    after, before = tangent.tangent(x), tangent.adjoint(y)
    assert np.abs((after * y).sum(axis=1) - (x * before).sum(axis=1)).max() <= 1000 * EPS
    assert np.abs(after - (tangent.matrix @ x[..., None])[..., 0]).max() <= 1000 * EPS
    assert tangent.adjoint(np.ones(6)).shape == (49, 6)


def test_of_one_body_and_of_no_step():
    run, tangent = estimation.run_tangent(TURNING, Q, W, **RUN)
    assert run.q.shape == (21, 4)
    assert tangent.matrix.shape == (6, 6)
    assert tangent.tangent(np.eye(6)).shape == (6, 6)
    _, none = estimation.run_tangent(TURNING, Q, W, **(RUN | {"n_steps": 0}))
    assert (none.matrix == np.eye(6)).all()


def test_of_a_gyro_log():
    """Its bias moves the last attitude as the product of the transitions says."""
    h, rates = 0.1, np.random.default_rng(4).normal(size=(12, 3))
    transitions = estimation.sample_transitions(rates, h, method="coning2")
    tangent = estimation.RunTangent(transitions.matrix)
    moved = rates - displaced(3, NEAR)[:, None]
    last = fa.integrate_rates(np.concatenate([rates[None], moved]), h, method="coning2")[:, -1]
    true = derivative(attitude_errors(last[0], last[1:]), NEAR)
    assert np.abs(tangent.matrix[:3, 3:] - true).max() <= NEAR**4 / 30 + 100 * EPS / NEAR


def test_breakpoints_are_refused():
    """Derivatives are those of whole steps."""

    def pulse(t, q, w, p):
        return (0.1 if t < 1.0 else 0.0), 0.0, 0.0

    table = fa.TimeSeries([0.0, 1.0, 5.0], np.eye(3), kind="linear")
    run = partial(estimation.run_tangent, q0=Q, w0=W, method="rk4")
    of_table = fa.Scene(inertia=MOMENTS, torque=fa.torques.Constant(table))
    declared = fa.Scene(inertia=MOMENTS, torque=pulse, breakpoints=(1.0,))
    run(of_table, dt=0.25, n_steps=8)
    run(declared, dt=0.25, n_steps=3)
    for scene, dt in ((of_table, 0.3), (declared, 0.25)):
        with pytest.raises(ValueError, match=r"^scene: found breakpoints, or times of a table"):
            run(scene, dt=dt, n_steps=8)
