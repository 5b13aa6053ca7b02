"""What arguments are taken for: precision by the arrays given, durations, names on offer."""

import datetime as dt
import itertools
import re

import numpy as np
import pytest

import fastatt as fa

FREE = fa.Scene(inertia=(1.0, 1.1, 0.9))
KINDS = {"double": np.float64, "single": np.float32, "list": list}


@pytest.mark.parametrize("kinds", list(itertools.product(KINDS, repeat=2)))
def test_precision_is_single_where_every_array_is(kinds):
    """Lists of numbers have none of their own; no array in double is rounded unasked."""
    q0, w0 = (
        KINDS[k](x) if k == "list" else np.array(x, KINDS[k])
        for k, x in zip(kinds, ([1.0, 0, 0, 0], [0.1, 0.2, 0.3]), strict=True)
    )

    dtype = np.float32 if set(kinds) - {"list"} == {"single"} else np.float64
    traj = fa.propagate(FREE, q0, w0, dt=0.1, n_steps=1, method="exact")
    for found in (traj.q, traj.w, *fa.closed_form.free_body(q0, w0, FREE.inertia, 1.0)):
        assert found.dtype == dtype


DURATIONS = [np.timedelta64(10, "ms"), dt.timedelta(milliseconds=10), np.array([10, 20], "m8[ms]")]
TAKE_TIME = {
    "dt": lambda d: fa.propagate(FREE, [1, 0, 0, 0], [0, 0, 1], dt=d, n_steps=2),
    "t0": lambda d: fa.propagate(FREE, [1, 0, 0, 0], [0, 0, 1], dt=1.0, n_steps=2, t0=d),
    "t": lambda d: fa.closed_form.free_body([1, 0, 0, 0], [0, 0, 1], (1, 1, 1), d),
    "dt of samples": lambda d: fa.integrate_rates(np.ones((3, 3)), d),
}


@pytest.mark.parametrize("duration", DURATIONS, ids=["numpy", "datetime", "array"])
@pytest.mark.parametrize("name", TAKE_TIME)
def test_durations_are_refused_with_what_makes_them_seconds(name, duration):
    """Their numbers are of any unit: 10 ms would be ten seconds."""
    way = "of a duration in s: duration / np.timedelta64(1, 's')"
    with pytest.raises(TypeError, match=re.escape(way)) as caught:
        TAKE_TIME[name](duration)
    assert str(caught.value).startswith(f"{name.removesuffix(' of samples')}: found ")
    seconds = duration / np.timedelta64(1, "s")
    assert np.array_equal(seconds, [0.01, 0.02] if np.ndim(duration) else 0.01)


@pytest.mark.parametrize("module", [fa, fa.rates, fa.torques, fa.forces])
def test_names_on_offer_are_the_public_ones(module):
    assert dir(module) == sorted(module.__all__)
