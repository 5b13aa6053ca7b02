"""Angular velocity back from attitudes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import fastatt as fa
from fastatt.trade.ensembles import coning_rates
from fastatt.trade.reference import coning_attitudes

ANGLE, FREQUENCY = np.array([0.4, 1.1]), np.array([1.0, 1.7])


def history(t):
    return coning_attitudes(ANGLE, FREQUENCY, t), coning_rates(ANGLE, FREQUENCY, t).swapaxes(0, 1)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6, 8])
@pytest.mark.parametrize("uneven", [False, True])
def test_order(order, uneven):
    errors = []
    for n in (30, 60, 120, 240):
        x = np.linspace(0.0, 1.0, n + 1)
        t = 4.0 * (x + 0.05 * np.sin(2.0 * np.pi * x) if uneven else x)
        q, w = history(t)
        dt = np.diff(t) if uneven else t[1]
        errors.append(np.abs(fa.angular_velocity(q, dt, order=order) - w).max())
    slopes = [np.log2(a / b) for a, b in pairwise(errors) if b > 1e-11]
    assert slopes[-1] > order - 0.25


def test_signs_of_the_quaternions_do_not_matter():
    t = np.linspace(0.0, 1.0, 101)
    q, _ = history(t)
    signs = np.where(np.random.default_rng(0).random((101, 2, 1)) < 0.5, -1.0, 1.0)
    away = fa.angular_velocity(3.0 * signs * q, t[1]) - fa.angular_velocity(q, t[1])
    # one-sided weights sum to 10.7/h; of each q two roundings of 1.1e-16; twice, for w = 2 q*∘q̇
    assert np.abs(away).max() < 2 * 10.7 * 2 * 1.1e-16 / t[1]


def test_inertial_axes_are_the_body_ones_turned():
    t = np.linspace(0.0, 1.0, 101)
    q, _ = history(t)
    body = fa.angular_velocity(q, t[1])
    inertial = fa.angular_velocity(q, t[1], frame="inertial")
    turned = np.einsum("snij,snj->sni", fa.quat_to_dcm(q), body)
    # both drop the part of q̇ along q, which the difference formula leaves at its own error
    assert np.abs(turned - inertial).max() < 1e-6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.ones((4, 4)), 0.1), "q: has 4 attitudes; accepted with order 4: at least 5"),
        ((np.ones((9, 3)), 0.1), r"q: has shape \(9, 3\)"),
        ((np.ones((9, 4)), 0.0), "dt: found 0.0"),
        ((np.ones((9, 4)), np.zeros(8)), r"dt\[0\] is 0.0"),
        ((np.full((9, 4), np.nan), 0.1), r"q\[0, 0\] is nan"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ValueError, match=message):
        fa.angular_velocity(*arguments)


@pytest.mark.parametrize("order", [2, 4, 6])
def test_attitudes_that_nearly_coincide_do_not_magnify_noise(order):
    """Of a body at rest, but between the two attitudes themselves."""
    noise = 1e-6 * np.random.default_rng(3).normal(size=(60, 3))
    dt = np.full(59, 0.01)
    dt[30] = 1e-8
    w = fa.angular_velocity(fa.rotation_vector_to_quat(noise), dt, order=order)
    assert np.abs(w).max() < 100.0 * 1e-6 / 0.01
