"""Modified Rodrigues parameters with their shadow set, three numbers, nowhere singular."""

from fastatt import arrays
from fastatt.attitudes.attitude import Attitude
from fastatt.tracing.formulas import mrp, opposite, plus, quat

MRP = Attitude(
    name="mrp",
    size=3,
    stored=3,
    start=lambda q: mrp.from_quat(quat.normalise(q)),
    quaternion=mrp.to_quat,
    derivative=mrp.derivative,
    half_derivative=mrp.half_derivative,
    # a step that ends beyond |σ| = 1 continues with the shadow set
    add=lambda x, d: mrp.inner(plus(x, d)),
    flip=opposite,
    family="mrp",
    to_quat_array=arrays.mrp_to_quat,
    summary="modified Rodrigues parameters with their shadow set, 3 numbers",
)
