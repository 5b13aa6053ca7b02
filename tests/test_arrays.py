"""Conversions and angles over arrays."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from each import each
from exact import EPS, angle, conj, exp, matrix, mul

import fastatt as fa

rng = np.random.default_rng(11)
QUATS = rng.normal(size=(50, 4))
QUATS /= np.linalg.norm(QUATS, axis=1, keepdims=True)
TINY = 2.0**-24


def mp_angle(p, q):
    """2 atan2(|v|, |w|) of p*∘q in 40 digits, from the floats as they are."""
    with mp.workdps(40):
        a, b = [mp.mpf(float(c)) for c in p], [mp.mpf(float(c)) for c in q]
        w = mp.fsum(x * y for x, y in zip(a, b, strict=True))
        minors = [a[i] * b[j] - a[j] * b[i] for i in range(4) for j in range(i + 1, 4)]
        # |v|² = |p|²|q|² − (p·q)², without the cancellation (Lagrange)
        return 2 * mp.atan2(mp.sqrt(mp.fsum(m * m for m in minors)), abs(w))


@each(
    ("there", "back", "tail"),
    [
        (fa.quat_to_dcm, fa.dcm_to_quat, (3, 3)),
        (fa.quat_to_euler313, fa.euler313_to_quat, (3,)),
        (fa.quat_to_rotation_vector, fa.rotation_vector_to_quat, (3,)),
        (fa.quat_to_mrp, fa.mrp_to_quat, (3,)),
    ],
)
@each("lead", [(), (1,), (50,), (5, 10), (5, 2, 5), (0,)])
@each("dtype", [np.float64, np.float32])
def test_round_trip(there, back, tail, lead, dtype):
    q = QUATS[: int(np.prod(lead))].reshape(*lead, 4).astype(dtype)
    form = there(q)
    assert form.shape == (*lead, *tail)
    assert form.dtype == dtype
    again = back(form)
    assert again.shape == (*lead, 4)
    assert again.dtype == dtype
    if again.size:
        eps = EPS if dtype is np.float64 else 2 * TINY
        unit = q / np.linalg.norm(q.astype(float), axis=-1, keepdims=True)
        assert angle(unit, again.astype(float)).max() < 8 * eps


def test_matrices_are_those_of_the_conventions():
    """v_i = q∘v_b∘q* = C v_b, and the 3-1-3 angles turn about z, x, z."""
    assert np.abs(fa.quat_to_dcm(QUATS) - matrix(QUATS)).max() < 4 * EPS
    u = rng.normal(size=(50, 3)) * 3.0
    assert np.abs(fa.rotation_vector_to_quat(u) - exp(u)).max() < 4 * EPS
    angles = rng.uniform(-3.0, 3.0, size=(50, 3))
    e1, _, e3 = np.eye(3)
    q = mul(mul(exp(angles[:, :1] * e3), exp(angles[:, 1:2] * e1)), exp(angles[:, 2:] * e3))
    assert np.abs(fa.euler313_to_quat(angles) - q).max() < 8 * EPS


@pytest.mark.parametrize("turn", [0.0, 1e-300, 1e-9, 1.0, np.pi - 1e-9, np.pi])
def test_matrix_and_vector_at_their_hard_places(turn):
    axis = np.array([0.6, -0.48, 0.64])
    q = exp(turn * axis)
    assert angle(fa.dcm_to_quat(fa.quat_to_dcm(q)), q) < 4 * EPS
    u = fa.quat_to_rotation_vector(q)
    same = u if u @ axis >= 0.0 else -u  # at π both ends of the axis are right
    assert same == pytest.approx(turn * axis, rel=4 * EPS, abs=0.0 if turn < 3.0 else 4 * EPS)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    "name",
    ["quat_to_dcm", "quat_to_euler313", "quat_to_mrp", "quat_rotate", "quat_rotate_inverse"],
)
def test_length_of_a_quaternion_says_nothing(name, dtype):
    v = () if name.startswith("quat_to") else (np.array([1.0, -2.0, 3.0], dtype),)
    q = QUATS.astype(dtype)
    found, unit = (getattr(fa, name)(x, *v) for x in (dtype(1.7) * q, q))
    if name == "quat_to_euler313":  # of a length whose squares overflow
        large = dtype(1e30 if dtype is np.float32 else 1e200)
        assert np.abs(fa.quat_to_euler313(large * q) - unit).max() < 64 * np.finfo(dtype).eps
    assert found.dtype == dtype
    assert np.abs(found - unit).max() < 64 * np.finfo(dtype).eps


def test_views_that_are_not_contiguous():
    q = np.asfortranarray(QUATS)[::3, ::-1]
    assert (fa.quat_to_dcm(q) == fa.quat_to_dcm(q.copy())).all()


# angles between attitudes


@pytest.mark.parametrize(
    "turn",
    [
        0.0,
        1e-300,
        1e-160,
        1e-15,
        1e-9,
        1e-8,
        1e-4,
        0.5,
        2.0,
        3.0,
        np.pi - 1e-8,
        np.pi - 1e-15,
        np.pi,
    ],
)
def test_angle_between_any_two_quaternions(turn):
    """Where 2 acos |p·q| keeps half the digits or none; against 40 digits."""
    axis = np.array([0.6, -0.48, 0.64])
    first = QUATS[:10]
    second = mul(first, exp(turn * axis))
    for p, q in zip(first, second, strict=True):
        known = float(mp_angle(p, q))
        for b in (q, -q, 5e-30 * q):
            assert abs(fa.angle_between(p, b) - known) < 1e-15
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    found, known = (
        fa.angle_between(identity, exp(turn * axis)),
        mp_angle(identity, exp(turn * axis)),
    )
    if turn > 1e-150:  # to the last digits: from the identity no rounding hides a small turn
        assert found == pytest.approx(float(known), rel=8 * EPS)


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.5, 3.0, np.pi - 1e-9, np.pi])
def test_angle_between_matrices(turn):
    """A matrix rounds by some EPS before the angle is taken, quaternions and matrices mix."""
    q = mul(QUATS, exp(turn * np.array([0.6, -0.48, 0.64])))
    known = np.array([float(mp_angle(a, b)) for a, b in zip(QUATS, q, strict=True)])
    assert fa.angle_between(matrix(QUATS), matrix(q)) == pytest.approx(known, abs=12 * EPS)
    assert fa.angle_between(QUATS, matrix(q)) == pytest.approx(known, abs=12 * EPS)


def test_angle_is_a_distance():
    p, q, r = QUATS[:48].reshape(3, 16, 4)
    assert (fa.angle_between(p, q) == fa.angle_between(q, p)).all()
    assert (fa.angle_between(p, p) == 0.0).all()
    direct, around = fa.angle_between(p, r), fa.angle_between(p, q) + fa.angle_between(q, r)
    assert (direct <= around + 4 * EPS).all()
    turned = fa.angle_between(mul(QUATS[48], p), mul(QUATS[48], q))
    assert turned == pytest.approx(fa.angle_between(p, q), abs=8 * EPS)
    assert fa.angle_between(conj(p), conj(q)).shape == (16,)


@pytest.mark.parametrize(
    ("a", "b", "shape"),
    [
        ((4,), (7, 4), (7,)),
        ((7, 4), (4,), (7,)),
        ((3, 1, 4), (5, 4), (3, 5)),
        ((3, 3), (7, 4), (7,)),
        ((2, 3, 3), (2, 4), (2,)),
        ((0, 4), (4,), (0,)),
    ],
)
def test_angle_broadcasts(a, b, shape):
    def attitudes(s):
        if s[-1] == 4:
            return QUATS[: int(np.prod(s[:-1]))].reshape(s)
        return matrix(QUATS[: int(np.prod(s[:-2]))].reshape(*s[:-2], 4))

    assert fa.angle_between(attitudes(a), attitudes(b)).shape == shape


def test_one_angle_is_a_float():
    assert type(fa.angle_between(QUATS[0], QUATS[1])) is float
    assert fa.angle_between([1, 0, 0, 0], [0, 1, 0, 0]) == pytest.approx(np.pi)


def test_float32_angles():
    found = fa.angle_between(QUATS.astype(np.float32), QUATS[::-1].astype(np.float32))
    assert found.dtype == np.float32
    assert found == pytest.approx(angle(QUATS, QUATS[::-1]), abs=16 * TINY)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: fa.angle_between([1, 0, 0], [1, 0, 0, 0]), ValueError, r"a: has shape \(3,\)"),
        (lambda: fa.angle_between([1, 0, 0, 0], 3.0), ValueError, r"b: has shape \(\)"),
        (
            lambda: fa.angle_between(QUATS[:3], QUATS[:2]),
            ValueError,
            r"b: has shape \(2, 4\), a \(3",
        ),
        (lambda: fa.angle_between(["a"] * 4, QUATS[0]), TypeError, "a: found"),
        (
            lambda: fa.quat_to_dcm(np.zeros(3)),
            ValueError,
            r"q: has shape \(3,\); accepted: \(..., 4",
        ),
        (lambda: fa.quat_to_dcm(None), (TypeError, ValueError), "q: "),
        (lambda: fa.dcm_to_quat(np.eye(4)), ValueError, r"C: has shape \(4, 4\); accepted"),
        (
            lambda: fa.dcm_to_quat(np.stack([np.eye(3), np.diag([1.0, 1.0, -1.0])])),
            ValueError,
            r"C\[1\]: found the determinant -1, and .* by 0; accepted: rotations",
        ),
        (lambda: fa.dcm_to_quat(np.zeros((3, 3))), ValueError, "C: found the determinant 0"),
        (
            lambda: fa.dcm_to_quat([np.eye(3), 2.0 * np.eye(3)]),
            ValueError,
            r"C\[1\]: found the determinant 8, and CᵀC off the identity by 3; accepted: rot",
        ),
        (lambda: fa.dcm_to_quat(57.3 * np.eye(3)), ValueError, "C: found the determinant 1.88e"),
        (lambda: fa.dcm_to_quat(np.eye(3) + np.eye(3, k=1) * 0.011), ValueError, "identity by 0.0"),
        (lambda: fa.angle_between(2.0 * np.eye(3), [1, 0, 0, 0]), ValueError, "a: found the det"),
        (lambda: fa.euler313_to_quat([1, 2]), ValueError, r"angles: has shape \(2,\)"),
        (lambda: fa.rotation_vector_to_quat(1.0), ValueError, r"u: has shape \(\)"),
        (lambda: fa.quat_to_euler313([1j, 0, 0, 0]), TypeError, "q: found"),
    ],
)
def test_refusals_name_the_argument(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_every_reflection_is_refused():
    """Whichever side of -1 rounding leaves its determinant on."""
    for C in fa.quat_to_dcm(QUATS) * [1.0, 1.0, -1.0]:
        with pytest.raises(ValueError, match=r"C: found the determinant -1"):
            fa.dcm_to_quat(C)
