"""Units of data sheets."""

from __future__ import annotations

import math

import numpy as np
import pytest
from each import each
from numpy.testing import assert_allclose
from oracle import EPS

from fastatt import estimation as es

H = 0.05


# units


@each(
    ("value", "unit", "found"),
    [
        # 1°/√h is 1/60 °/√s
        (60.0, "deg/sqrt(h)", math.radians(1.0)),
        (60.0, "°/√h", math.radians(1.0)),
        (60.0, "° / √(h)", math.radians(1.0)),
        (3600.0, "deg/h", math.radians(1.0)),
        (216000.0, "deg/h/sqrt(h)", math.radians(1.0)),
        # a density in °/h/√Hz is 60 times the random walk in °/√h
        (60.0, "deg/h/sqrt(Hz)", math.radians(1.0) / 60.0),
        (5.0, "mdps/√Hz", math.radians(0.005)),
        (60.0, "m/s/sqrt(h)", 1.0),
        (1000.0, "µg/√Hz", 9.80665e-3),
        (40.0, "mg", 0.392266),
        (40.0, "mg/sqrt(Hz)", 0.392266),
        (40.0, "mg/√Hz", 0.392266),
        (40.0, "ug", 0.392266e-3),
        (2.0, "g", 19.6133),
        (1.0, "m/s²/√Hz", 1.0),
    ],
)
def test_units(value, unit, found):
    assert es.from_data_sheet(value, unit) == pytest.approx(found, rel=4 * EPS)
    assert es.to_data_sheet(found, unit) == pytest.approx(value, rel=4 * EPS)
    assert_allclose(es.from_data_sheet([value, 0.0], unit), [found, 0.0], rtol=4 * EPS)


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


def test_refusals():
    with pytest.raises(ValueError, match=r"unit: found 'deg/sqrt.min.'; accepted"):
        es.from_data_sheet(1.0, "deg/sqrt(min)")
    with pytest.raises(ValueError, match="value is nan"):
        es.from_data_sheet(np.nan, "deg/h")
