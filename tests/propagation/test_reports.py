"""What a run says of its attitudes beside a target: angles, rotation vectors, directions."""

from __future__ import annotations

import numpy as np
import pytest
from exact import EPS, angle, exp, mul

import fastatt as fa

SCENE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
RNG = np.random.default_rng(2)
Q0, W0 = RNG.normal(size=(5, 4)), RNG.normal(size=(5, 3))
OPTIONS = {"dt": 0.05, "n_steps": 40, "method": "rk8", "save_every": 4}
RUN = fa.propagate(SCENE, Q0, W0, **OPTIONS)
ONE = fa.propagate(SCENE, Q0[0], W0[0], **OPTIONS)
UNITS = RNG.normal(size=(11, 5, 4))
UNITS /= np.linalg.norm(UNITS, axis=-1, keepdims=True)
TARGETS = [UNITS[0, 0], UNITS[0], UNITS[:, :1], UNITS]


@pytest.mark.parametrize("target", TARGETS, ids=["one", "each body", "each save", "all"])
def test_angle_and_rotation_vector_to_a_target(target):
    error, u = RUN.pointing_error(target), RUN.rotation_vector_to(target)
    assert (error.shape, u.shape) == ((11, 5), (11, 5, 3))
    wanted = np.broadcast_to(target, RUN.q.shape)
    assert np.abs(error - angle(RUN.q, wanted)).max() < 8 * EPS
    assert np.abs(np.linalg.norm(u, axis=-1) - error).max() < 8 * EPS
    # q∘exp(u) is the target
    assert angle(mul(RUN.q, exp(u)), wanted).max() < 8 * EPS
    matrices = fa.quat_to_dcm(target)
    assert np.abs(RUN.pointing_error(matrices) - error).max() < 1e-14


def test_one_body():
    history = UNITS[:, 0]
    assert ONE.pointing_error(history[0]).shape == (11,)
    assert ONE.rotation_vector_to(history).shape == (11, 3)
    assert np.abs(ONE.pointing_error(history) - angle(ONE.q, history)).max() < 8 * EPS
    assert ONE.body_axis([0, 0, 1]).shape == (11, 3)


def test_another_run_is_a_target():
    assert (ONE.pointing_error(ONE) == 0.0).all()
    assert np.abs(RUN.pointing_error(ONE) - angle(RUN.q, ONE.q[:, None])).max() < 8 * EPS
    assert RUN.pointing_error(ONE)[:, 0].max() == 0.0
    assert np.abs(RUN.rotation_vector_to(RUN)).max() < 8 * EPS


def test_small_errors_keep_their_digits():
    """1e-9 rad about the body's y axis."""
    target = mul(ONE.q, exp(np.array([0.0, 1e-9, 0.0])))
    assert ONE.pointing_error(target) == pytest.approx(np.full(11, 1e-9), abs=4 * EPS)
    wanted = np.tile([0.0, 1e-9, 0.0], (11, 1))
    assert np.abs(ONE.rotation_vector_to(target) - wanted).max() < 4 * EPS


def test_directions_of_body_axes():
    axes = 7.0 * np.eye(3)
    for k, axis in enumerate(axes):
        assert np.abs(RUN.body_axis(axis) - RUN.dcm[..., :, k]).max() < 8 * EPS
    own = RNG.normal(size=(5, 3))
    unit = own / np.linalg.norm(own, axis=-1, keepdims=True)
    wanted = np.einsum("snij,nj->sni", RUN.dcm, unit)
    assert np.abs(RUN.body_axis(own) - wanted).max() < 8 * EPS


def test_precision_is_the_runs():
    run = fa.propagate(SCENE, Q0, W0, dtype="float32", **OPTIONS)
    assert run.pointing_error(UNITS[0, 0]).dtype == np.float32
    assert run.rotation_vector_to(run).dtype == np.float32
    assert run.body_axis([0.0, 1.0, 0.0]).dtype == np.float32


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: RUN.pointing_error(np.ones((3, 4))), r"target: has shape \(3, 4\), q"),
        (lambda: RUN.pointing_error([1.0, 0.0, 0.0]), r"target: has shape \(3,\); accepted"),
        (lambda: RUN.pointing_error(np.ones((2, 11, 5, 4))), "target: has shape"),
        (lambda: ONE.rotation_vector_to(UNITS), r"target: has shape \(11, 5, 4\), q \(11, 4\)"),
        (lambda: ONE.pointing_error(RUN), "target: has shape"),
        (lambda: RUN.body_axis([0.0, 0.0, 0.0]), "axis: its length"),
        (lambda: RUN.body_axis([np.nan, 0.0, 1.0]), "axis: its length"),
        (lambda: RUN.body_axis([1.0, 0.0]), r"axis: has shape \(2,\)"),
    ],
)
def test_what_does_not_fit_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_run_with_other_times_is_refused():
    other = fa.propagate(SCENE, Q0, W0, dt=0.05, n_steps=40, save_every=8)
    with pytest.raises(ValueError, match="target: found a run with other saved times"):
        RUN.rotation_vector_to(other)
