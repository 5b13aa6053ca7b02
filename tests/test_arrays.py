"""Conversions and angles over arrays."""

import mpmath as mp
import numpy as np
import pandas as pd
import pytest
from each import each
from exact import EPS, angle, exp, matrix, mul
from oracle import quat_angle, quat_exp, quat_mul

import fastatt as fa

rng = np.random.default_rng(11)
QUATS = rng.normal(size=(50, 4))
QUATS /= np.linalg.norm(QUATS, axis=1, keepdims=True)
TINY = 2.0**-24


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


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    "name", ["quat_to_dcm", "quat_to_euler313", "quat_to_mrp", "quat_rotate", "quat_rotate_inverse"]
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


LONG = [9.9e3, 1.1e4, 1e8, 1e15, 1e16, 9.7e17, 1e22, 3e38, 1e40, 1e50]


def _of_axes(angles, axes):
    """The product of rotations about axes, by many digits."""
    q = mp.matrix([1, 0, 0, 0])
    for x, axis in zip(angles, axes, strict=True):
        q = quat_mul(q, quat_exp([x * (axis == i) for i in range(3)]))
    return q


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    ("convert", "exact"),
    [
        (fa.rotation_vector_to_quat, quat_exp),
        (fa.euler313_to_quat, lambda angles: _of_axes(angles, (2, 0, 2))),
        (
            lambda angles: fa.euler_to_quat(angles, "ZYX"),
            lambda angles: _of_axes(angles, (2, 1, 0)),
        ),
    ],
    ids=["vector", "313", "ZYX"],
)
def test_long_angles_are_right(convert, exact, dtype):
    """As exact numbers, whatever an ulp of them is; up to a quaternion's sign."""
    with mp.workdps(120):
        for size in LONG:
            for row in ([size, 0.0, 0.0], [0.0, -size, 0.0], [0.3 * size, -0.4 * size, 0.5 * size]):
                if size > float(np.finfo(dtype).max):
                    continue
                row = np.array(row, dtype)
                known = np.array([float(x) for x in exact([mp.mpf(float(x)) for x in row])])
                # just below the largest angle that needs no care it may move by 1.5 ulps
                allowed = 16 * np.finfo(dtype).eps + 1.5 * EPS * 1e4
                assert (
                    min(np.abs(convert(row) - known).max(), np.abs(convert(row) + known).max())
                    < allowed
                )
    assert np.isnan(convert([np.inf, 0.0, 0.0])).any()


def test_read_only_and_broadcast_arrays_are_taken():
    start = QUATS[0]
    a, b = np.broadcast_to(start, (3, 4)), np.full((3, 4), 0.5)
    b.flags.writeable = False
    assert fa.angle_between(a, b).tolist() == [fa.angle_between(start, b[0])] * 3
    assert fa.quat_to_dcm(b).tolist() == fa.quat_to_dcm(b.copy()).tolist()
    assert fa.quat_multiply(a, b).tolist() == fa.quat_multiply(a.copy(), b.copy()).tolist()


def test_the_zero_quaternion_is_no_attitude():
    rows = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    for convert in (
        fa.quat_to_rotation_vector, fa.quat_to_mrp, fa.quat_to_euler313, fa.quat_to_dcm,
    ):  # fmt: skip
        first, second = convert(rows)
        assert np.isfinite(first).all()
        assert np.isnan(second).all()


# angles between attitudes


@each("turn", [0.0, 1e-300, 1e-160, 1e-15, 1e-8, 0.5, 3.0, np.pi - 1e-8, np.pi - 1e-15, np.pi])
def test_angle_between_any_two_quaternions(turn):
    """Where 2 acos |p·q| keeps half the digits or none; against 40 digits."""
    axis = np.array([0.6, -0.48, 0.64])
    first = QUATS[:10]
    second = mul(first, exp(turn * axis))
    for p, q in zip(first, second, strict=True):
        known = float(quat_angle(p, q))
        for b in (q, -q, 5e-30 * q):
            assert abs(fa.angle_between(p, b) - known) < 1e-15
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    found, known = (
        fa.angle_between(identity, exp(turn * axis)),
        quat_angle(identity, exp(turn * axis)),
    )
    if turn > 1e-150:  # to the last digits: from the identity no rounding hides a small turn
        assert found == pytest.approx(float(known), rel=8 * EPS)


@each("turn", [0.0, 1e-9, 0.5, 3.0, np.pi - 1e-9, np.pi])
def test_angle_between_matrices(turn):
    """A matrix rounds by some EPS before the angle is taken, quaternions and matrices mix."""
    q = mul(QUATS, exp(turn * np.array([0.6, -0.48, 0.64])))
    known = np.array([float(quat_angle(a, b)) for a, b in zip(QUATS, q, strict=True)])
    assert fa.angle_between(matrix(QUATS), matrix(q)) == pytest.approx(known, abs=12 * EPS)
    assert fa.angle_between(QUATS, matrix(q)) == pytest.approx(known, abs=12 * EPS)


@each(
    ("a", "b", "shape"),
    [
        ((4,), (7, 4), (7,)), ((3, 1, 4), (5, 4), (3, 5)), ((3, 3), (7, 4), (7,)),
        ((2, 3, 3), (2, 4), (2,)), ((0, 4), (4,), (0,)),
    ],
)  # fmt: skip
def test_angle_broadcasts(a, b, shape):
    def attitudes(s):
        if s[-1] == 4:
            return QUATS[: int(np.prod(s[:-1]))].reshape(s)
        return matrix(QUATS[: int(np.prod(s[:-2]))].reshape(*s[:-2], 4))

    assert fa.angle_between(attitudes(a), attitudes(b)).shape == shape
    assert type(fa.angle_between(QUATS[0], QUATS[1])) is float


def test_float32_angles():
    found = fa.angle_between(QUATS.astype(np.float32), QUATS[::-1].astype(np.float32))
    assert found.dtype == np.float32
    assert found == pytest.approx(angle(QUATS, QUATS[::-1]), abs=16 * TINY)


def test_every_reflection_is_refused():
    """Whichever side of -1 rounding leaves its determinant on."""
    for C in fa.quat_to_dcm(QUATS) * [1.0, 1.0, -1.0]:
        with pytest.raises(ValueError, match=r"C: found the determinant -1"):
            fa.dcm_to_quat(C)


def pushed(rates):
    flow = fa.GyroIntegrator([1.0, 0.0, 0.0, 0.0], 0.01, method="picard")
    return np.concatenate([flow.push(rates), flow.close()])


BODY = fa.Scene(inertia=(2.0, 1.0, 0.7))
TABLE = np.arange(600.0).reshape(200, 3) ** 0.5 % 1.0
ENTRIES = {
    "push": pushed,
    "integrate_rates": lambda x: fa.integrate_rates(x, 0.01, method="coning2"),
    "propagate": lambda x: fa.propagate(BODY, QUATS[0], x, dt=0.1, n_steps=3, method="rk4").q,
    "kinetic_energy": lambda x: fa.kinetic_energy(x, BODY.inertia),
    "rotate": lambda x: fa.quat_rotate(QUATS[0], x),
    "speeds": lambda x: fa.torques.ReactionWheels(np.eye(3), 0.1).speeds(np.ones(3), x),
    "TimeSeries": lambda x: fa.TimeSeries(np.arange(200.0), x).at([0.3, 77.7]),
}


@each("entry, dtype", [*((x, np.float64) for x in ENTRIES), ("rotate", np.float32)])
def test_bits_do_not_depend_on_the_order_in_memory(entry, dtype):
    """Nor on the order of bytes, strides, or a data frame."""
    plain = TABLE.astype(dtype)
    wide = np.zeros((200, 6), dtype)
    wide[:, ::2] = plain
    frames = pd.DataFrame(plain), pd.DataFrame({str(i): plain[:, i] for i in range(3)})
    swapped = plain.astype(plain.dtype.newbyteorder())
    expected = ENTRIES[entry](plain)
    for given in (np.asfortranarray(plain), wide[:, ::2], swapped, *frames):
        found = ENTRIES[entry](given)
        assert found.dtype == expected.dtype
        assert found.tobytes() == expected.tobytes()
