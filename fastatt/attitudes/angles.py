"""3-1-3 Euler angles, three numbers, singular at θ = 0 and π."""

import math

from fastatt import arrays
from fastatt.attitudes.attitude import Attitude, coordinate_speed, same
from fastatt.tracing.formulas import euler313, quat

ANGLES = Attitude(
    name="euler313",
    size=3,
    stored=3,
    start=lambda q: euler313.from_quat(quat.normalise(q)),
    compose=lambda x, q: euler313.from_quat(quat.mul(euler313.to_quat(x), q)),
    quaternion=euler313.to_quat,
    derivative=euler313.derivative,
    speed_squared=coordinate_speed,
    family="coordinates",
    flip=lambda x: (math.pi - x[2], x[1], math.pi - x[0]),
    to_quat_array=lambda x: arrays.on_rows(euler313.to_quat, x, after=4),
    to_euler313_array=same,
    summary="3-1-3 Euler angles, 3 numbers",
)
