"""A slew by wheels, with PID control, friction, a pulse and events, beside SciPy's DOP853."""

import numpy as np
import pytest
from each import slow
from wheels import errors, slew_of, truth

import fastatt as fa


# of the table of bench/wheels.py. Where a motor reaches its limit between two samples of a
# step, that step has a corner: what is left by the controller at all times, and by a held one not
@pytest.mark.parametrize(
    ("is_sampled", "bodies", "bounds"),
    [
        slow(False, 10, {0.25: (1e-7, 5e-6, 5e-3), 0.05: (5e-9, 2e-7, 2e-4)}),
        (True, 5, {0.25: (1e-12, 1e-11, 1e-8), 0.07: (1e-12, 1e-11, 1e-11)}),
    ],
    ids=["at all times", "sampled"],
)
def test_ten_bodies_beside_dop853(is_sampled, bodies, bounds):
    slew = slew_of(10, is_sampled=is_sampled)
    wanted = [truth(slew, body) for body in range(bodies)]
    for dt, largest in bounds.items():
        run = slew.run(dt)
        assert not run.status.any()
        assert np.isfinite(run.event_times).all()
        assert (np.array(errors(slew, run, wanted)) < largest).all()
    # a thruster that is not seen, or friction that is, would be off by far more
    assert fa.angle_between(run.q[-1], [1, 0, 0, 0]).max() < 1e-3
    assert np.ptp(run.event_times[:, 0]) == 0.0
