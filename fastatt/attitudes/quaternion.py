"""Unit quaternions, plain and with compensation of rounding."""

from __future__ import annotations

from typing import Any

from fastatt.attitudes.attitude import Attitude, composed, same
from fastatt.tracing.formulas import Vector, compensated, quat
from fastatt.tracing.graph import apply, choose


def norm_error(x: Vector) -> Any:
    return apply("sqrt", quat.dot(x, x)) - 1.0


QUATERNION = Attitude(
    name="quat",
    size=4,
    stored=4,
    start=quat.normalise,
    **composed(quat.mul),
    quaternion=lambda x: x,
    to_body=quat.rotate_inverse,
    derivative=quat.derivative,
    half_derivative=quat.mul_vector,
    flip=quat.conj,
    finish=lambda x: (quat.normalise(x), norm_error(x)),
    restore=lambda x: (quat.renormalise(x), norm_error(x)),
    rotate_first=quat.rotate_first,
    rotate_third=quat.rotate_third,
    family="quaternion",
    to_quat_array=same,
    summary="unit quaternion, 4 numbers",
)


def low_finish(x: Vector) -> Any:
    q = x[:4]
    # |q|² − 1 of both parts; the rounding of the squares would hide an error of an ulp
    low = x[0] * x[4] + x[1] * x[5] + x[2] * x[6] + x[3] * x[7]
    n = quat.dot(q, q)
    return quat.normalise(q), 0.5 * ((n - 1.0) + (low + low))


def low_restore(x: Vector) -> Any:
    _, d = low_finish(x)
    # errors of 16 ulps and more; smaller ones are rounding of d, and removing them would rotate the
    # attitude in one direction, by 3e-20 rad at a time
    m = choose(0.03125 * abs(d) + 1.0 > 1.0, -d, 0.0)
    return compensated.add_quat(x, (m * x[0], m * x[1], m * x[2], m * x[3])), d


COMPENSATED = Attitude(
    name="quat",
    size=8,
    stored=4,
    start=lambda q: (*quat.normalise(q), 0.0, 0.0, 0.0, 0.0),
    rotate=compensated.rotate,
    rotate_short=compensated.rotate_short,
    compose=compensated.compose,
    quaternion=lambda x: x[:4],
    flip=lambda x: (*quat.conj(x[:4]), *quat.conj(x[4:])),
    finish=low_finish,
    restore=low_restore,
    raw=lambda x: x[:4],
    uncompensated=QUATERNION,
    add=compensated.add_quat,
    add_vector=compensated.add_vector,
    carry=lambda v: (*v, 0.0, 0.0, 0.0),
    family="quaternion",
    to_quat_array=same,
    summary="quaternion and what rounding has left out of it, 8 numbers",
)
