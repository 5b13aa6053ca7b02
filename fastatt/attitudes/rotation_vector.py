"""Rotation vector from the reference attitude, singular at multiples of 2π (Bortz)."""

from fastatt import arrays
from fastatt.attitudes.attitude import Attitude, coordinate_speed
from fastatt.tracing.formulas import opposite, quat, so3

ROTATION_VECTOR = Attitude(
    name="rotation_vector",
    size=3,
    stored=3,
    start=quat.log,
    quaternion=quat.exp,
    derivative=so3.dexpinv,
    speed_squared=coordinate_speed,
    family="coordinates",
    flip=opposite,
    to_quat_array=lambda x: arrays.on_rows(quat.exp, x, after=4),
    summary="rotation vector, 3 numbers",
)
