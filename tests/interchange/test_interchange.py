"""Conversions to the conventions of others, beside the libraries that use them."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import scipy
from exact import EPS, angle, matrix, mul, rotate

import fastatt as fa
from fastatt import interchange as ic
from fastatt.interchange import from_scipy, to_scipy

RNG = np.random.default_rng(3)
Q = RNG.normal(size=(50, 4))
Q /= np.linalg.norm(Q, axis=1, keepdims=True)
V = RNG.normal(size=(50, 3))


def same(p, q, tol=8 * EPS):
    assert p.shape == q.shape
    assert angle(p, q).max() <= tol


def test_scipy_there_and_back():
    rotation = to_scipy(Q)
    assert np.abs(rotation.apply(V) - rotate(Q, V)).max() <= 16 * EPS
    assert np.abs(rotation.as_matrix() - matrix(Q)).max() <= 8 * EPS
    same(from_scipy(rotation), Q)
    same(from_scipy(to_scipy(Q[0])), Q[0])
    # their product is ours
    same(from_scipy(rotation * rotation[::-1]), mul(Q, Q[::-1]))
    assert np.abs(rotation.as_rotvec() - fa.quat_to_rotation_vector(Q)).max() <= 16 * EPS


def test_scipy_takes_attitudes_of_any_length():
    for size in (1e-320, 1e-200, 1e200):
        assert to_scipy([size, 0.0, 0.0, size]).magnitude() == pytest.approx(np.pi / 2)


def test_initial_attitudes_as_rotations():
    """One or stacked, of any Euler sequence."""
    body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    angles = np.array([[0.3, -0.4, 1.1], [2.0, 0.1, -0.7]])
    for q0 in (
        scipy.spatial.transform.Rotation.from_euler("ZYX", angles[0]),
        scipy.spatial.transform.Rotation.from_euler("xzx", angles),
    ):
        given = {"w0": [0.1, 0.2, 0.3], "dt": 0.1, "n_steps": 2, "method": "exact"}
        run = fa.propagate(body, q0, **given)
        assert np.array_equal(run.q, fa.propagate(body, from_scipy(q0), **given).q)


def test_the_scalar_last_trap():
    last = to_scipy(Q).as_quat()
    assert np.abs(last - ic.to_scalar_last(Q)).max() <= 2 * EPS
    assert np.array_equal(ic.from_scalar_last(ic.to_scalar_last(Q)), Q)
    # what a transposed order would do
    assert angle(last, Q).max() > 1.0


def test_jpl():
    """C(q) = (2 q4² − 1) − 2 q4 [v×] + 2 v vᵀ takes inertial components to body ones."""
    v, w = ic.to_jpl(Q)[:, :3], ic.to_jpl(Q)[:, 3, None, None]
    cross = np.cross(np.eye(3), v[:, None, :])  # rows e_i × v: the cross-product matrix of v
    c = (2 * w * w - 1) * np.eye(3) - 2 * w * cross + 2 * v[:, :, None] * v[:, None, :]
    assert np.abs(c - np.swapaxes(matrix(Q), 1, 2)).max() <= 8 * EPS
    assert np.array_equal(ic.from_jpl(ic.to_jpl(Q)), Q)


def test_modified_rodrigues_parameters():
    """[BN] = 1 + (8 [σ×]² − 4 (1 − σ²) [σ×])/(1 + σ²)²: Schaub and Junkins, eq. 3.147."""
    s = fa.quat_to_mrp(Q)
    z = (s * s).sum(1)[:, None, None]
    assert z.max() <= 1.0 + EPS
    cross = np.cross(np.eye(3), s[:, None, :])
    c = np.eye(3) + (8 * cross @ cross - 4 * (1 - z) * cross) / (1 + z) ** 2
    assert np.abs(c - np.swapaxes(matrix(Q), 1, 2)).max() <= 32 * EPS
    assert np.abs(s - to_scipy(Q).as_mrp()).max() <= 8 * EPS
    same(fa.mrp_to_quat(s), Q)
    same(fa.mrp_to_quat(-s / z[:, 0]), Q)  # the shadow set


def test_parameters_of_numbers_whose_squares_overflow():
    large = 1e200 * np.array([0.5, 0.5, -0.5, 0.5])
    assert fa.quat_to_mrp(large) == pytest.approx(fa.quat_to_mrp(large / 1e200), abs=EPS)
    for size in (1e153, 1e154, 1e155, 1e200, 1e308):
        for x in (np.array([1.0, 0.0, 0.0]), np.array([0.3, -0.7, 0.2])):
            # ((1 − σ²), 2σ)/(1 + σ²), where 1 is nothing beside σ²
            wanted = [-1.0, *(2.0 * x / (x @ x) / size)]
            assert np.allclose(fa.mrp_to_quat(size * x), wanted, rtol=8 * EPS, atol=5e-324)


# a run as a table


def run_of(bodies, **options):
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    w0 = np.random.default_rng(4).normal(size=(bodies, 3))
    q0 = Q[:bodies]
    if bodies == 1:
        q0, w0 = q0[0], w0[0]
    return fa.propagate(scene, q0, w0, dt=0.1, n_steps=4, save_every=2, method="exact", **options)


@pytest.mark.parametrize("bodies", [1, 3])
def test_tables_hold_every_number_to_its_last_bit(bodies, tmp_path):
    run = run_of(bodies)
    run.to_csv(tmp_path / "run.csv")
    frame = run.to_dataframe()
    written = tmp_path / "run.csv"
    assert written.read_text().partition("\n")[0] == ",".join(frame)
    assert np.array_equal(np.loadtxt(written, delimiter=",", skiprows=1), frame)
    names = ["t", "body", "q0", "q1", "q2", "q3", "wx", "wy", "wz", "status"]
    assert list(frame) == [name for name in names if bodies > 1 or name != "body"]
    assert np.array_equal(frame[["q0", "q1", "q2", "q3"]], run.q.reshape(-1, 4))
    assert np.array_equal(frame[["wx", "wy", "wz"]], run.w.reshape(-1, 3))
    if bodies > 1:
        last = frame[frame.body == 2]
        assert np.array_equal(last.t, run.t)
        assert np.array_equal(last[["q0", "q1", "q2", "q3"]], run.q[:, 2])


@pytest.mark.parametrize(
    ("package", "call", "source"),
    [
        ("pandas", lambda: run_of(1).to_dataframe(), "to_dataframe: .*'fastatt\\[logs\\]'"),
        ("scipy", lambda: ic.to_scipy([1, 0, 0, 0]), "to_scipy: .*'scipy'"),
    ],
)
def test_a_missing_package_is_named_with_what_installs_it(monkeypatch, package, call, source):
    monkeypatch.setitem(sys.modules, "scipy.spatial.transform", None)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=source):
        call()


def test_long_tables_are_written_in_pieces(tmp_path, monkeypatch):
    run = run_of(3)
    run.to_csv(tmp_path / "whole.csv")
    monkeypatch.setattr("fastatt.interchange.run_tables._ROWS", 4)
    run.to_csv(tmp_path / "pieces.csv")
    assert (tmp_path / "pieces.csv").read_text() == (tmp_path / "whole.csv").read_text()


def test_a_run_shows_itself():
    run = run_of(7)
    assert repr(run) == run.summary()
    assert "exact on quat" in repr(run)
