"""Units of data sheets."""

from __future__ import annotations

import math

import numpy as np
import pytest
from each import each

from fastatt import estimation as es

H = 0.05


# units


@each("name", ["angle_noise", "bias_noise"])
@each("value", [-1e-300, 1.01e150, math.inf, math.nan])
def test_noise_whose_square_is_no_number_is_refused(name, value):
    accepted = rf"{name}: found .*; accepted: (at least 0, up to 1e\+150|.*finite)"
    P = np.eye(6)
    for call in (
        lambda noise: es.simulate_gyro(np.zeros((4, 3)), H, **noise),
        lambda noise: es.MEKF([1, 0, 0, 0], P, **{"angle_noise": 1e-4, "bias_noise": 0.0, **noise}),
    ):
        with pytest.raises(ValueError, match=accepted):
            call({name: value})
        for good in (0.0, 1e-6):
            call({name: good})
