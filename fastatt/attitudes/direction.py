"""One inertial direction along body axes, three numbers: Poisson's equation for a vector."""

from fastatt.attitudes.attitude import Attitude, composed
from fastatt.tracing.formulas import dcm, dot, quat
from fastatt.tracing.graph import apply

DIRECTION = Attitude(
    name="direction",
    size=3,
    stored=3,
    coordinates=3,
    start=lambda v: v,
    **composed(lambda x, q: quat.rotate_inverse(q, x)),
    derivative=dcm.derivative_row,
    flip=lambda x: x,
    finish=lambda x: (x, apply("sqrt", dot(x, x))),
    family="matrix",
    summary="a fixed direction seen from the body, 3 numbers",
)
