"""Direction cosine matrices: nine numbers."""

from typing import Any

from fastatt.attitudes.attitude import Attitude, composed
from fastatt.tracing.formulas import Vector, dcm, dot, quat


def nearby(c: Vector, q: Vector) -> Any:
    """The product of 4 q qᵀ, which is linear in the matrix, and a quaternion nearby."""
    a, b, d, t = c[7] - c[5], c[2] - c[6], c[3] - c[1], c[0] + c[4] + c[8]
    e, f, g = c[1] + c[3], c[2] + c[6], c[5] + c[7]
    x, y, z = (1.0 + (k + k - t) for k in (c[0], c[4], c[8]))
    rows = (1.0 + t, a, b, d), (a, x, e, f), (b, e, y, g), (d, f, g, z)
    return quat.normalise(tuple(dot(row, q) for row in rows))


MATRIX = Attitude(
    name="dcm",
    size=9,
    stored=9,
    start=lambda q: dcm.from_quat(quat.normalise(q)),
    **composed(lambda x, q: dcm.mul(x, dcm.from_quat(q))),
    quaternion=dcm.to_quat,
    nearby=nearby,
    to_body=dcm.rotate_inverse,
    derivative=dcm.derivative,
    flip=dcm.transpose,
    finish=lambda x: (dcm.orthonormalise(dcm.orthonormalise(x)), dcm.norm_error(x)),
    restore=lambda x: (dcm.orthonormalise(x), dcm.norm_error(x)),
    rotate_first=dcm.rotate_first,
    rotate_third=dcm.rotate_third,
    to_dcm_array=lambda state: state.reshape((*state.shape[:-1], 3, 3)),
    family="matrix",
    summary="direction cosine matrix, 9 numbers",
)
