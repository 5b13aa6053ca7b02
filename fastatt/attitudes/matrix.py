"""Direction cosine matrices: nine numbers."""

from fastatt.attitudes.attitude import Attitude, composed
from fastatt.tracing.formulas import dcm, quat

MATRIX = Attitude(
    name="dcm",
    size=9,
    stored=9,
    start=lambda q: dcm.from_quat(quat.normalise(q)),
    **composed(lambda x, q: dcm.mul(x, dcm.from_quat(q))),
    quaternion=dcm.to_quat,
    to_body=dcm.rotate_inverse,
    derivative=dcm.derivative,
    flip=dcm.transpose,
    finish=lambda x: (dcm.orthonormalise(dcm.orthonormalise(x)), dcm.norm_error(x)),
    restore=lambda x: (dcm.orthonormalise(x), dcm.norm_error(x)),
    rotate_first=dcm.rotate_first,
    rotate_third=dcm.rotate_third,
    to_dcm_array=lambda state: state.reshape((*state.shape[:-1], 3, 3)),
    family="matrix",
    is_usual=True,
    summary="direction cosine matrix, 9 numbers",
)
