"""Poisson's equation for single directions, against the rows of the whole attitude."""

import numpy as np
import pytest
from exact import EPS, conj, exp, generic, matrix, observed_order, rotate, steady

import fastatt as fa

BODIES = generic(3)
# a derivative, one exponential, two, and a rotation: the direction knows no more of a method
SOME_METHODS = ["rk4", "magnus4", "cf4", "gauss12"]
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
rng = np.random.default_rng(5)
VECTORS = rng.normal(size=(3, 4, 3)) * np.array([1.0, 1e-3, 1e3, 1.0])[:, None]
N, H = 100, 0.02


def run(v0, scene=None, n=N, h=H, method="magnus6", **options):
    scene = BODIES.scene if scene is None else scene
    return fa.propagate_directions(scene, v0, dt=h, n_steps=n, method=method, **options)


def seen(bodies, t, v, frame="body"):
    """q*∘v∘q with the reference attitude that starts at the identity."""
    q = bodies.attitude(0.0, t, IDENTITY, frame=frame)
    return rotate(q[:, None] if frame == "inertial" else conj(q)[:, None], v)


def test_observed_order():
    v = VECTORS / np.linalg.norm(VECTORS, axis=-1, keepdims=True)
    end = seen(BODIES, 2.0, v)

    def error(n):
        found = run(v, n=n, h=2.0 / n, method="magnus4")[1][-1]
        return np.linalg.norm(found - end, axis=-1).max()

    assert observed_order(error) == pytest.approx(4.0, abs=0.25)


@pytest.mark.parametrize("method", SOME_METHODS)
def test_directions_are_the_rows_of_the_matrix(method):
    """The inertial axes seen from the body; the same step, so round-off is all the difference."""
    axes = np.broadcast_to(np.eye(3), (3, 3, 3))
    _, rows = run(axes, method=method, save_every=20)
    traj = fa.propagate(
        BODIES.scene, np.tile(IDENTITY, (3, 1)), dt=H, n_steps=N, method=method,
        representation="dcm", save_every=20,
    )  # fmt: skip
    # the matrix is brought back to the group for output, RK4's rows are not
    allowed = 1e-7 if method == "rk4" else 12 * EPS * N
    assert np.abs(rows - traj.dcm).max() < allowed


def test_shapes_and_times():
    options = {"scene": BODIES.shared, "save_every": 30, "t0": 0.5}
    t, one = run(VECTORS[0, 0], **options)
    assert t.tolist() == [0.5 + k * H for k in (0, 30, 60, 90, 100)]
    many, all_bodies = run(VECTORS[0], **options)[1], run(VECTORS, **options)[1]
    assert (one.shape, many.shape, all_bodies.shape) == ((5, 3), (5, 4, 3), (5, 3, 4, 3))
    assert (many[:, 0] == one).all()
    assert (all_bodies[:, 0] == many).all()
    assert run(VECTORS)[1].shape == (1, 3, 4, 3)


def test_each_body_has_its_own_rate():
    """Also with more directions than a tile holds."""
    many = np.repeat(VECTORS, 30, axis=1)
    _, found = run(many)
    assert np.abs(found[-1] - seen(BODIES, N * H, many)).max() < 1e-9 * 1e3
    for b in range(3):
        _, alone = run(many[[b]], BODIES.take([b]).scene)
        assert (alone[:, 0] == found[:, b]).all()


def test_inertial_rate_carries_body_vectors_outwards():
    """v fixed in the body, seen from inertial axes: v_i = q∘v∘q*."""
    scene = fa.Scene(rate=BODIES.model, frame="inertial")
    error = np.abs(run(VECTORS, scene)[1][-1] - seen(BODIES, N * H, VECTORS, "inertial"))
    assert error.max() < 1e-9 * 1e3


def test_a_turn_about_z_brings_x_to_minus_y():
    """Seen from a body that has turned by a quarter, the inertial x axis lies at −y."""
    quarter = steady([[0.0, 0.0, np.pi / 2]]).scene
    _, v = run([[[1.0, 0.0, 0.0]]], quarter, n=1, h=1.0, method="magnus4")
    assert v[-1, 0, 0] == pytest.approx([0.0, -1.0, 0.0], abs=4 * EPS)
    assert v[-1, 0, 0] == pytest.approx(matrix(exp([0, 0, np.pi / 2]))[0], abs=4 * EPS)


def test_float32():
    _, v = run(VECTORS.astype(np.float32), method="magnus4")
    assert v.dtype == np.float32
    size = np.linalg.norm(VECTORS, axis=-1, keepdims=True)
    assert (np.abs(v[-1] - seen(BODIES, N * H, VECTORS)) / size).max() < 2.0**-24 * 4 * N
