"""The derivative of a whole run and its transpose, against differences of runs."""

from __future__ import annotations

import numpy as np
import pytest
from differences import attitude_errors, derivative, displaced
from oracle import EPS

import fastatt as fa
from fastatt import estimation as es

MOMENTS = np.array([2.0, 1.0, 1.4])
# its torque turns with time
SCENE = fa.Scene(inertia=MOMENTS, torque=fa.torques.GravityGradient(0.5))
Q, W = np.array([0.1, -0.5, 0.7, 0.5]), np.array([0.2, -0.3, 0.6])
RUN = {"dt": 0.2, "n_steps": 20, "method": "strang2", "t0": 0.3}
STEP = 2e-3


@pytest.fixture(scope="module")
def found():
    """A run, its neighbours, and others twice as far."""
    d = np.vstack([np.zeros((1, 6)), displaced(6, STEP), displaced(6, 2.0 * STEP)])
    q = fa.quat_multiply(Q, fa.rotation_vector_to_quat(d[:, :3]))
    return es.run_tangent(SCENE, q, W + d[:, 3:] / MOMENTS, **RUN)


def test_it_is_the_derivative_of_the_run(found):
    run, tangent = found
    q, m = run.q[-1], run.w[-1] * MOMENTS
    change = np.hstack([attitude_errors(q[0], q[1:]), m[1:] - m[0]])
    near, far = derivative(change[:24], STEP), derivative(change[24:], 2.0 * STEP)
    # truncation falls by 16; rounding is that of 20 steps
    bound = np.abs(far - near).max() / 15.0 + 400 * EPS / STEP
    assert bound < 1e-9
    assert np.abs(tangent.matrix[0] - near).max() <= bound


def test_it_is_the_derivative_where_steps_change_the_length_that_a_torque_reads():
    """Large steps of rk4, which loses some of the quaternion's length."""
    d = np.vstack([np.zeros((1, 6)), displaced(6, STEP)])
    q = fa.quat_multiply(Q, fa.rotation_vector_to_quat(d[:, :3]))
    scene = fa.Scene(inertia=MOMENTS, torque=fa.torques.HeavyTop((0.1, -0.2, 0.9), 1.5))
    options = {"dt": 0.5, "n_steps": 20, "method": "rk4"}
    run, tangent = es.run_tangent(scene, q, W + d[:, 3:] / MOMENTS, **options)
    assert np.abs(run.norm_error[-1]).min() > 1e-4
    change = np.hstack(
        [attitude_errors(run.q[-1, 0], run.q[-1, 1:]), (run.w[-1, 1:] - run.w[-1, 0]) * MOMENTS]
    )
    near = derivative(change, STEP)
    assert np.abs(tangent.matrix[0] - near).max() <= 1e-7 * np.abs(near).max()


def test_the_run_is_that_of_propagate_and_its_first_step_that_of_body_tangent(found):
    run, tangent = found
    plain = fa.propagate(SCENE, Q, W, **RUN)
    assert fa.angle_between(plain.q[-1], run.q[-1, 0]) <= 8 * EPS
    first = es.body_tangent(SCENE, Q, W, 0.2, t0=0.3, method="strang2")
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
    run, tangent = es.run_tangent(SCENE, Q, W, **RUN)
    assert run.q.shape == (21, 4)
    assert tangent.matrix.shape == (6, 6)
    assert tangent.tangent(np.eye(6)).shape == (6, 6)
    _, none = es.run_tangent(SCENE, Q, W, **(RUN | {"n_steps": 0}))
    assert (none.matrix == np.eye(6)).all()


def test_of_a_gyro_log():
    """Its bias moves the last attitude as the product of the transitions says."""
    h, rates = 0.1, np.random.default_rng(4).normal(size=(12, 3))
    tangent = es.RunTangent(es.sample_transitions(rates, h, method="coning2").matrix)
    moved = rates - displaced(3, STEP)[:, None]
    last = fa.integrate_rates(np.concatenate([rates[None], moved]), h, method="coning2")[:, -1]
    true = derivative(attitude_errors(last[0], last[1:]), STEP)
    assert np.abs(tangent.matrix[:3, 3:] - true).max() <= STEP**4 / 30 + 100 * EPS / STEP


def test_breakpoints_are_refused():
    """Derivatives are those of whole steps."""

    def pulse(t, q, w, p):
        return (0.1 if t < 1.0 else 0.0), 0.0, 0.0

    table = fa.TimeSeries([0.0, 1.0, 5.0], np.eye(3), kind="linear")
    run = {"dt": 0.25, "method": "rk4"}
    of_table = fa.Scene(inertia=MOMENTS, torque=fa.torques.Constant(table))
    declared = fa.Scene(inertia=MOMENTS, torque=pulse, breakpoints=(1.0,))
    es.run_tangent(of_table, Q, W, **run, n_steps=8)
    es.run_tangent(declared, Q, W, **run, n_steps=3)
    for scene, dt in ((of_table, 0.3), (declared, 0.25)):
        with pytest.raises(ValueError, match=r"^scene: found breakpoints, or times of a table"):
            es.run_tangent(scene, Q, W, dt=dt, n_steps=8, method="rk4")
