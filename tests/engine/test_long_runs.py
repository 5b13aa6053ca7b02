"""Round-off over many steps: carried along or not, and the return to the group."""

import warnings

import numpy as np
import pytest
from exact import EPS
from numpy.testing import assert_array_equal
from rigid_oracle import integrate

import fastatt as fa
from fastatt.attitudes import COMPENSATED
from fastatt.codegen.rows import rows

STEP = 1.0 / 128.0  # a power of two: products with it are exact
N = 64
TURN = 6e-3


def rates(dtype=np.float64):
    w = np.random.default_rng(1).normal(size=(N, 3))
    return (w * (TURN / STEP) / np.linalg.norm(w, axis=1, keepdims=True)).astype(dtype)


def steady(n_steps, dtype="float64", **options):
    """Attitude errors (N,) and departures from unit length (N,) of bodies at constant rates."""
    w = rates(dtype)
    start = np.zeros((N, 4), dtype=dtype)
    start[:, 0] = 1.0
    run = fa.propagate(
        fa.Scene(rate=fa.rates.Constant(w)), start, dt=STEP, n_steps=n_steps, method="magnus4",
        dtype=dtype, **options,
    )  # fmt: skip
    size = np.linalg.norm(w.astype(np.longdouble), axis=1)
    half = size * np.longdouble(n_steps * STEP) / 2
    exact = np.column_stack([np.cos(half), (np.sin(half) / size)[:, None] * w])
    found = run.q[-1].astype(np.longdouble)
    across = found[:, :1] * exact[:, 1:] - exact[:, :1] * found[:, 1:]
    across -= np.cross(found[:, 1:], exact[:, 1:])
    return 2.0 * np.linalg.norm(across.astype(np.float64), axis=1), run.norm_error[-1]


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def test_round_off_grows_with_the_root_of_the_steps_where_it_is_carried():
    """1e5 steps: biased rounding of the plain mode is 100 times what is left; single precision."""
    plain, _ = steady(100_000)
    few, _ = steady(6250, compensated=True)
    angle, norm = steady(100_000, compensated=True)
    # what is handed out is rounded: 1e-16 rad however few the steps
    growth = (rms(angle) ** 2 - rms(few) ** 2) / (rms(few) ** 2)
    assert growth < 2.0 * 16.0
    assert rms(angle) < 5.0 * EPS
    assert rms(angle) < rms(plain) / 50.0
    assert rms(norm) < EPS
    assert np.abs(norm).max() < 4.0 * EPS
    eps = float(np.finfo(np.float32).eps)
    plain, _ = steady(80_000, "float32")
    angle, norm = steady(80_000, "float32", compensated=True)
    assert rms(plain) > 50.0 * eps
    assert rms(angle) < 5.0 * eps
    assert np.abs(norm).max() < eps


def test_steps_that_are_too_small_to_register_are_said_so():
    scene = fa.Scene(rate=fa.rates.Constant((3e-8, 0.0, 0.0)))
    start = np.array([0.6, 0.8, 0.0, 0.0], dtype=np.float32)
    with pytest.warns(fa.StepWarning, match="float32 does not register"):
        stalled = fa.propagate(scene, start, dt=1.0, n_steps=100_000, method="magnus4")
    moved = fa.propagate(scene, start, dt=1.0, n_steps=100_000, method="magnus4", compensated=True)
    exact = fa.propagate(scene, start.astype(float), dt=1e5, n_steps=1, method="magnus4")
    assert fa.angle_between(stalled.q[-1], start) == 0.0
    assert fa.angle_between(moved.q[-1], exact.q[-1]) < 3e-7


def test_small_steps_of_a_long_run_are_said_so_before_it_unless_low_parts_are_carried():
    """So many steps that the first is looked at beforehand."""
    body = fa.Scene(inertia=(2.0, 1.0, 1.5))
    options = {"dt": 1e-17, "n_steps": 1_000_001, "method": "rk4"}
    with pytest.warns(fa.StepWarning, match="float64 does not register"):
        fa.propagate(body, [1, 0, 0, 0], [0.0, 0.0, 1.0], **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error", fa.StepWarning)
        run = fa.propagate(body, [1, 0, 0, 0], [0.0, 0.0, 1.0], compensated=True, **options)
    assert run.q[-1, 3] == pytest.approx(0.5e-17 * 1_000_001, rel=1e-3)


@pytest.fixture(scope="module")
def reference():
    return integrate((2.0, 1.0, 0.5), (1, 0, 0, 0), (0.3, 0.5, -0.4), 10.0)


@pytest.mark.parametrize("method", ["rk4", "rkmk4", "dmv10"])
def test_bodies_keep_their_order_and_lose_their_round_off(method, reference):
    inertia, w0 = (2.0, 1.0, 0.5), np.array([0.3, 0.5, -0.4])
    scene = fa.Scene(inertia=inertia, allow_unphysical=True)
    options = {"dt": STEP, "n_steps": 1280, "method": method}
    plain = fa.propagate(scene, [1, 0, 0, 0], w0, **options)
    carried = fa.propagate(scene, [1, 0, 0, 0], w0, compensated=True, **options)
    q, w = np.array(reference.q, dtype=float), np.array(reference.w, dtype=float)
    # the method's own error is the same, its round-off is not
    own = 1e-9 if method != "dmv10" else 0.0
    assert fa.angle_between(carried.q[-1], q) < own + 4.0 * EPS
    assert np.abs(carried.w[-1] - w).max() < own + 2.0 * EPS
    assert fa.angle_between(carried.q[-1], plain.q[-1]) < 1280 * EPS
    assert abs(float(carried.norm_error[-1, 0])) < (1e-9 if method == "rk4" else EPS)


@pytest.mark.parametrize("representation", ["quat", "dcm"])
def test_the_return_to_the_group(representation):
    """Every step, now and then, for output only, never: the same attitude, lengths as promised."""
    scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.6, 0.8)))
    options = {"dt": 0.3, "n_steps": 64, "method": "rk4", "representation": representation}
    start = fa.rotation_vector_to_quat([0.3, -0.2, 0.5])
    policies = ("output", "never", 8, 1)
    runs = {p: fa.propagate(scene, start, normalise=p, **options) for p in policies}
    shrunk = {policy: abs(float(run.norm_error[-1, 0])) for policy, run in runs.items()}
    assert shrunk["output"] == shrunk["never"]
    assert shrunk[1] < shrunk[8] < shrunk["never"]
    if representation == "quat":
        assert abs(np.linalg.norm(runs["output"].q[-1]) - 1.0) < 2 * EPS
        assert abs(np.linalg.norm(runs["never"].q[-1]) - 1.0) == pytest.approx(shrunk["never"])
        # the length of a quaternion does not touch its attitude
        for run in runs.values():
            unit = run.q[-1] / np.linalg.norm(run.q[-1])
            assert fa.angle_between(unit, runs["output"].q[-1]) < 64 * 4 * EPS
    else:
        handed = [np.linalg.norm(runs[p].dcm[-1] @ runs[p].dcm[-1].T - np.eye(3)) for p in runs]
        assert handed[1] == pytest.approx(shrunk["never"])
        # two of Newton's steps to the group leave the square of a square of the departure
        assert handed[0] < 1e-15 + shrunk["output"] ** 4


@pytest.mark.parametrize(
    ("representation", "turn"), [("quat", 1.65), ("dcm", 1.05), ("dcm_rows", 1.05)]
)
def test_a_return_to_the_group_hides_nothing(representation, turn):
    """RK4 below its limit, by steps whose departure is flagged; mended at once it would not be."""
    scene = fa.Scene(rate=fa.rates.Polynomial([[0.0, 0.6 * turn, 0.8 * turn]]))
    for policy in ("output", "never", 8, 1):
        run = fa.propagate(
            scene, [1, 0, 0, 0], dt=1.0, n_steps=8, method="rk4", normalise=policy,
            representation=representation,
        )  # fmt: skip
        assert run.status.tolist() == [fa.Status.NORM_LOST]
        assert policy != 1 or abs(float(run.norm_error[-1, 0])) < 1e-3


def test_low_parts_of_a_rate_along_inertial_axes():
    """The attitude that is stepped is the inverse one, low parts too."""
    scene = fa.Scene(rate=fa.rates.Coning(0.5, 1.0), frame="inertial")
    start = np.random.default_rng(4).normal(size=(5, 4))
    options = {"dt": STEP, "n_steps": 640, "save_every": 320, "method": "magnus6"}
    plain = fa.propagate(scene, start, **options)
    carried = fa.propagate(scene, start, compensated=True, **options)
    assert fa.angle_between(plain.q, carried.q).max() < 640 * 4 * EPS
    assert np.abs(carried.norm_error).max() < EPS


@pytest.mark.parametrize("kind", ["double", "single"])
def test_a_compensated_state_is_mended_from_16_ulps_on(kind):
    """Below that the departure is rounding's own, and a mend would turn the attitude."""
    eps = float(np.finfo("f8" if kind == "double" else "f4").eps)
    off = eps * np.array([1.0, -1.0, 8.0, -15.0, 17.0, -17.0, 100.0])
    x = np.zeros((off.size, 8), dtype="f8" if kind == "double" else "f4")
    x[:, 0], x[:, 4] = 1.0, off
    mended, removed = rows(COMPENSATED.restore, {"x": 8}, (8, None), kind)(x)
    assert_array_equal(removed, np.where(np.abs(off) > 16.0 * eps, x[:, 4], 0.0))
    left = mended[:, :4].astype(np.longdouble) + mended[:, 4:] - x[:, :4]
    assert_array_equal(left[:, 0], np.where(np.abs(off) > 16.0 * eps, 0.0, off))
    assert not left[:, 1:].any()
