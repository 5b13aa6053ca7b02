"""The representations of the attitude.

Those whose kernels a run seldom needs refer to them in lambdas, so that it does not import them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from fastatt import arrays
from fastatt.attitudes.attitude import Attitude, composed, coordinate_speed, same
from fastatt.tracing.formulas import (
    Vector,
    dcm,
    dot,
    euler313,
    kernels,
    mrp,
    opposite,
    plus,
    quat,
)
from fastatt.tracing.graph import apply, choose

compensated = kernels("compensated")


def norm_error(q: Vector) -> Any:
    return apply("sqrt", quat.dot(q, q)) - 1.0


QUATERNION = Attitude(
    name="quat",
    size=4,
    stored=4,
    start=quat.normalise,
    **composed(quat.mul),
    quaternion=same,
    to_body=quat.rotate_inverse,
    derivative=quat.derivative,
    half_derivative=quat.mul_vector,
    flip=quat.conj,
    finish=lambda q: (quat.normalise(q), norm_error(q)),
    restore=lambda q: (quat.renormalise(q), norm_error(q)),
    rotate_first=quat.rotate_first,
    rotate_third=quat.rotate_third,
    family="quaternion",
    to_quat_array=same,
)


# compensation of rounding: a quaternion and its low part


def both_finish(x: Vector) -> Any:
    q = x[:4]
    # |q|² − 1 of both parts; the rounding of the squares would hide an error of an ulp
    low = x[0] * x[4] + x[1] * x[5] + x[2] * x[6] + x[3] * x[7]
    n = quat.dot(q, q)
    return quat.normalise(q), 0.5 * ((n - 1.0) + (low + low))


def both_restore(x: Vector) -> Any:
    _, d = both_finish(x)
    # errors of 16 ulps and more; smaller ones are rounding of d, and removing them would rotate the
    # attitude in one direction, by 3e-20 rad at a time
    m = choose(0.03125 * abs(d) + 1.0 > 1.0, -d, 0.0)
    return compensated.add_quat(x, (m * x[0], m * x[1], m * x[2], m * x[3])), -m


COMPENSATED = Attitude(
    name="quat",
    size=8,
    stored=4,
    start=lambda q: (*quat.normalise(q), 0.0, 0.0, 0.0, 0.0),
    rotate=lambda x, u: compensated.rotate(x, u),
    rotate_short=lambda x, u: compensated.rotate_short(x, u),
    compose=lambda x, q: compensated.compose(x, q),
    quaternion=lambda x: x[:4],
    flip=lambda x: (*quat.conj(x[:4]), *quat.conj(x[4:])),
    finish=both_finish,
    restore=both_restore,
    raw=lambda x: x[:4],
    uncompensated=QUATERNION,
    add=lambda x, d: compensated.add_quat(x, d),
    add_vector=lambda x, d: compensated.add_vector(x, d),
    carry=lambda v: (*v, 0.0, 0.0, 0.0),
    family="quaternion",
    to_quat_array=same,
)


def nearby_quaternion(c: Vector, q: Vector) -> Any:
    """The product of 4 q qᵀ, which is linear in the matrix, and a quaternion nearby."""
    a, b, d, t = c[7] - c[5], c[2] - c[6], c[3] - c[1], c[0] + c[4] + c[8]
    e, f, g = c[1] + c[3], c[2] + c[6], c[5] + c[7]
    x, y, z = (1.0 + (k + k - t) for k in (c[0], c[4], c[8]))
    rows = (1.0 + t, a, b, d), (a, x, e, f), (b, e, y, g), (d, f, g, z)
    return quat.normalise(tuple(dot(row, q) for row in rows))


def to_dcm_array(stored: Any) -> Any:
    return stored.reshape((*stored.shape[:-1], 3, 3))


MATRIX = Attitude(
    name="dcm",
    size=9,
    stored=9,
    start=lambda q: dcm.from_quat(quat.normalise(q)),
    **composed(lambda x, q: dcm.mul(x, dcm.from_quat(q))),
    quaternion=dcm.to_quat,
    nearby=nearby_quaternion,
    to_body=dcm.rotate_inverse,
    derivative=dcm.derivative,
    flip=dcm.transpose,
    finish=lambda c: (dcm.orthonormalise(dcm.orthonormalise(c)), dcm.norm_error(c)),
    restore=lambda c: (dcm.orthonormalise(c), dcm.norm_error(c)),
    rotate_first=dcm.rotate_first,
    rotate_third=dcm.rotate_third,
    to_dcm_array=to_dcm_array,
    family="matrix",
)


# two rows of the matrix; the third is their cross product (the Darboux problem)


def closed(x: Vector) -> Any:
    return dcm.close_rows(x[:3], x[3:])


def rows_compose(x: Vector, q: Vector) -> Vector:
    r = dcm.from_quat(quat.conj(q))
    return (*dcm.rotate(r, x[:3]), *dcm.rotate(r, x[3:]))


def rows_restore(x: Vector) -> Any:
    a, b = dcm.orthonormalise_rows(x[:3], x[3:])
    return (*a, *b), dcm.norm_error(closed(x))


def rows_finish(x: Vector) -> Any:
    once, error = rows_restore(x)
    return closed(rows_restore(once)[0]), error


ROWS = Attitude(
    name="dcm_rows",
    size=6,
    stored=9,
    start=lambda q: dcm.from_quat(quat.normalise(q))[:6],
    **composed(rows_compose),
    quaternion=lambda x: dcm.to_quat(closed(x)),
    nearby=lambda x, q: nearby_quaternion(closed(x), q),
    to_body=lambda x, v: dcm.rotate_inverse(closed(x), v),
    derivative=lambda x, w: (*dcm.derivative_row(x[:3], w), *dcm.derivative_row(x[3:], w)),
    flip=lambda x: dcm.transpose(closed(x))[:6],
    finish=rows_finish,
    restore=rows_restore,
    raw=closed,
    to_dcm_array=to_dcm_array,
    family="matrix",
)

MRP = Attitude(
    name="mrp",
    size=3,
    stored=3,
    start=lambda q: mrp.from_quat(quat.normalise(q)),
    quaternion=lambda x: mrp.to_quat(x),
    derivative=lambda x, w: mrp.derivative(x, w),
    half_derivative=lambda x, v: mrp.half_derivative(x, v),
    # a step that ends beyond |σ| = 1 continues with the shadow set
    add=lambda x, d: mrp.inner(plus(x, d)),
    flip=opposite,
    family="mrp",
    to_quat_array=arrays.mrp_to_quat,
)

ANGLES = Attitude(
    name="euler313",
    size=3,
    stored=3,
    start=lambda q: euler313.from_quat(quat.normalise(q)),
    compose=lambda x, q: euler313.from_quat(quat.mul(euler313.to_quat(x), q)),
    quaternion=lambda x: euler313.to_quat(x),
    derivative=lambda x, w: euler313.derivative(x, w),
    speed_squared=coordinate_speed,
    family="coordinates",
    flip=lambda x: (math.pi - x[2], x[1], math.pi - x[0]),
    to_quat_array=lambda x: arrays.on_rows(euler313.to_quat, x, after=4),
    to_euler313_array=same,
)

#: one inertial direction along body axes: Poisson's equation for a vector
DIRECTION = Attitude(
    name="direction",
    size=3,
    stored=3,
    coordinates=3,
    start=same,
    **composed(lambda x, q: quat.rotate_inverse(q, x)),
    derivative=dcm.derivative_row,
    flip=same,
    finish=lambda x: (x, apply("sqrt", dot(x, x))),
    family="matrix",
)

_ALL = (QUATERNION, MATRIX, MRP, ROWS, ANGLES)
ATTITUDES: Mapping[str, Attitude] = MappingProxyType({a.name: a for a in _ALL})

#: the representations of the library by name
KNOWN = {**ATTITUDES, "compensated": COMPENSATED, "direction": DIRECTION}
