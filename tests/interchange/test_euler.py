"""Euler angles of all sequences, against SciPy's and products of rotations about axes."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from exact import EPS, angle, exp, mul
from scipy.spatial.transform import Rotation

import fastatt as fa
from fastatt.interchange import from_scipy
from fastatt.interchange.euler import SEQUENCES

RNG = np.random.default_rng(5)
QUATS = RNG.normal(size=(500, 4))
ANGLES = RNG.uniform(-3.1, 3.1, size=(500, 3))
AXES = dict(zip("xyz", np.eye(3), strict=True))


def ends(sequence):
    """Where the second angle is at gimbal lock."""
    return np.array([0.0, np.pi] if sequence[0] == sequence[2] else [-np.pi / 2, np.pi / 2])


def apart(a, b):
    """Largest difference of angles, whole turns apart."""
    gap = np.abs(a - b)
    return np.minimum(gap, 2.0 * np.pi - gap).max()


def test_there_are_24():
    assert len(SEQUENCES) == len(set(SEQUENCES)) == 24


@each("sequence", SEQUENCES)
def test_rotations_about_axes(sequence):
    """Each letter of a sequence turns about that axis: a body's own from the right."""
    q = np.array([1.0, 0.0, 0.0, 0.0])
    for letter, a in zip(sequence, ANGLES.T, strict=True):
        turn = exp(a[:, None] * AXES[letter.lower()])
        q = mul(q, turn) if letter.isupper() else mul(turn, q)
    assert angle(fa.euler_to_quat(ANGLES, sequence), q).max() < 8 * EPS


@each("sequence", SEQUENCES)
def test_as_scipy(sequence):
    theirs = Rotation.from_quat(np.roll(QUATS, -1, axis=-1))
    assert apart(fa.quat_to_euler(QUATS, sequence), theirs.as_euler(sequence)) < 64 * EPS
    made = from_scipy(Rotation.from_euler(sequence, ANGLES))
    assert angle(fa.euler_to_quat(ANGLES, sequence), made).max() < 8 * EPS


@each("sequence", SEQUENCES)
@pytest.mark.filterwarnings("ignore:Gimbal lock")
def test_gimbal_lock(sequence):
    """The third angle is 0, the attitude kept, and the first is SciPy's."""
    locked = ANGLES.copy()
    locked[:, 1] = np.tile(ends(sequence), 250)
    q = fa.euler_to_quat(locked, sequence)
    found = fa.quat_to_euler(q, sequence)
    assert (found[:, 2] == 0.0).all()
    assert angle(fa.euler_to_quat(found, sequence), q).max() < 16 * EPS
    theirs = Rotation.from_quat(np.roll(q, -1, axis=-1)).as_euler(sequence)
    assert apart(found, theirs) < 64 * EPS


@each("sequence", SEQUENCES)
@each("miss", [1e-3, 1e-7, 1e-9, 1e-13])
def test_next_to_gimbal_lock_the_attitude_is_kept(sequence, miss):
    """Where SciPy sets the third angle to 0 from 1e-7 rad on, and loses as much."""
    near = ANGLES.copy()
    near[:, 1] = np.tile(ends(sequence) + np.array([miss, -miss]), 250)
    q = fa.euler_to_quat(near, sequence)
    found = fa.quat_to_euler(q, sequence)
    assert angle(fa.euler_to_quat(found, sequence), q).max() < 16 * EPS


@each("sequence", SEQUENCES)
@each("dtype", [np.float64, np.float32])
def test_ranges_shapes_and_precision(sequence, dtype):
    q = (1.7 * QUATS).astype(dtype).reshape(5, 100, 4)
    found = fa.quat_to_euler(q, sequence)
    assert found.shape == (5, 100, 3)
    assert found.dtype == dtype
    low, high = ends(sequence)
    slack = 4.0 * np.finfo(dtype).eps
    assert (np.abs(found) <= np.pi + slack).all()
    assert (found[..., 1] >= low - slack).all()
    assert (found[..., 1] <= high + slack).all()
    again = fa.euler_to_quat(found, sequence)
    assert again.dtype == dtype
    assert angle(again.astype(float), q.astype(float)).max() < 16 * np.finfo(dtype).eps


def test_313_and_aircraft_angles():
    assert angle(fa.euler_to_quat(ANGLES, "ZXZ"), fa.euler313_to_quat(ANGLES)).max() < 8 * EPS
    yaw, pitch, roll = fa.quat_to_euler(fa.euler_to_quat([0.4, -0.2, 0.1], "ZYX"), "ZYX")
    assert (yaw, pitch, roll) == pytest.approx((0.4, -0.2, 0.1), abs=4 * EPS)
