"""Two rows of the matrix, six numbers; the third is their cross product (the Darboux problem)."""

from __future__ import annotations

from typing import Any

from fastatt.attitudes import matrix
from fastatt.attitudes.attitude import Attitude, composed
from fastatt.tracing.formulas import Vector, dcm, quat, two_rows


def compose(x: Vector, q: Vector) -> Vector:
    r = dcm.from_quat(quat.conj(q))
    return (*dcm.rotate(r, x[:3]), *dcm.rotate(r, x[3:]))


def to_dcm(x: Vector) -> Any:
    return two_rows.close_rows(x[:3], x[3:])


def finish(x: Vector) -> Any:
    a, b = two_rows.orthonormalise_rows(*two_rows.orthonormalise_rows(x[:3], x[3:]))
    return two_rows.close_rows(a, b), dcm.norm_error(to_dcm(x))


def restore(x: Vector) -> Any:
    a, b = two_rows.orthonormalise_rows(x[:3], x[3:])
    return (*a, *b), dcm.norm_error(to_dcm(x))


def derivative(x: Vector, w: Vector) -> Vector:
    return (*dcm.derivative_row(x[:3], w), *dcm.derivative_row(x[3:], w))


ROWS = Attitude(
    name="dcm_rows",
    size=6,
    stored=9,
    start=lambda q: dcm.from_quat(quat.normalise(q))[:6],
    **composed(compose),
    quaternion=lambda x: dcm.to_quat(to_dcm(x)),
    nearby=lambda x, q: matrix.nearby(to_dcm(x), q),
    to_body=lambda x, v: dcm.rotate_inverse(to_dcm(x), v),
    derivative=derivative,
    flip=lambda x: dcm.transpose(to_dcm(x))[:6],
    finish=finish,
    restore=restore,
    raw=to_dcm,
    to_dcm_array=lambda state: state.reshape((*state.shape[:-1], 3, 3)),
    family="matrix",
    summary="two rows of the matrix, 6 numbers; the third by their cross product",
)
