"""Each model of the angular velocity against its formula."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from exact import EPS, START, angle, exp, mul

import fastatt as fa
from fastatt.codegen.rows import rows
from fastatt.scene import rates
from fastatt.scene.models import pack
from fastatt.scene.rates import Rate

TIMES = [0.0, 0.3, 1.7, -2.4, 60.0]
A, B, C, D = np.array([[0.3, -0.2, 0.5], [1.0, 0.4, -0.7], [2.0, 0.5, 3.1], [0.1, 2.0, -1.0]])


def at(model, t):
    """w(t) from the compiled model."""
    law, params, _ = pack(model, Rate, None)
    assert params.ndim == 1
    inputs = {"t": None, "p": law.count}
    (found,) = rows(law.formula, inputs, (3,), key=law)(float(t), params)
    return found


def versine(t, rotation, duration, start):
    x = np.clip((t - start) / duration, 0.0, 1.0)
    return np.asarray(rotation) / duration * (1.0 - np.cos(2.0 * np.pi * x))


def coned(t):
    x, y = np.sin(0.4) * np.sin(1.3 * t), np.sin(0.4) * np.cos(1.3 * t)
    return 1.3 * np.array([-x, y, -2.0 * np.sin(0.2) ** 2])


SINES = rates.Sinusoidal(A, B, C, D)
CASES = {
    "constant": (rates.Constant(A), lambda t: A),
    "sinusoidal": (SINES, lambda t: A + B * np.sin(C * t + D)),
    "no phase": (rates.Sinusoidal(A, B, C), lambda t: A + B * np.sin(C * t)),
    "coning": (rates.Coning(0.4, 1.3), coned),
    "precession": (
        rates.Precession(0.7, 0.4, 1.1, 0.3),
        lambda t: np.array([0.7 * np.cos(1.1 * t + 0.3), 0.7 * np.sin(1.1 * t + 0.3), 0.4]),
    ),
    "slew": (rates.Slew(A, 3.0, 0.2), lambda t: versine(t, A, 3.0, 0.2)),
    "slew from 0 on": (rates.Slew(A, 3.0), lambda t: versine(t, A, 3.0, 0.0)),
    "sum": (
        rates.Sum((SINES, rates.Polynomial([B, C]), rates.Constant(D))),
        lambda t: A + B * np.sin(C * t + D) + B + C * t + D,
    ),
    "sum of one": (rates.Sum((rates.Constant(A),)), lambda t: A),
    "sum of sums": (
        rates.Sum((rates.Sum((rates.Constant(A), rates.Constant(B))), rates.Constant(C))),
        lambda t: A + B + C,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_model_is_its_formula(name):
    """The argument of a sine rounds by half an ulp of it, its value by a few."""
    model, formula = CASES[name]
    for t in TIMES:
        assert np.abs(at(model, t) - formula(t)).max() < 4 * EPS * (1.0 + 4.0 * abs(t)), t


@pytest.mark.parametrize("degree", range(6))
def test_polynomial_of_any_degree(degree):
    c = np.random.default_rng(degree).normal(size=(degree + 1, 3))
    for t in TIMES[:-1]:
        expected = sum(c[k] * t**k for k in range(degree + 1))
        size = sum(np.abs(c[k]) * abs(t) ** k for k in range(degree + 1))
        error = np.abs(at(rates.Polynomial(c), t) - expected)
        assert (error <= (degree + 1) * 2 * EPS * size).all()


@pytest.mark.parametrize("start", [0.0, 0.5])
def test_slew_turns_by_its_rotation_and_stops(start):
    """To round-off: the axis stands still, and Gauss nodes over whole periods miss nothing."""
    scene = fa.Scene(rate=rates.Slew(A, 2.0, start))
    done = fa.propagate(scene, START, dt=0.01, n_steps=400, save_every=25, method="magnus6")
    assert angle(done.q[-1], mul(START, exp(A))) < 400 * 4 * EPS
    x = np.clip((done.t - start) / 2.0, 0.0, 1.0)
    share = x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi)
    assert angle(done.q, mul(START, exp(share[:, None] * A))).max() < 1e-12
    assert np.abs(done.w[done.t >= start + 2.0]).max() < EPS**2


# parameters of each body


@each(
    ("make", "rows"),
    [
        (lambda a, c: rates.Sinusoidal(a, C, c, D), [(A, D), (B, A)]),
        (lambda f: rates.Coning(0.4, f), [(1.0,), (2.0,)]),
        (lambda a, t: rates.Slew(a, 2.0, t), [(A, 0.0), (B, 1.0)]),
        (lambda x: rates.Sum((rates.Constant(A), rates.Precession(x, 0.3, 0.4))), [(0.1,), (0.2,)]),
        (rates.Polynomial, [([A, B],), ([C, D],)]),
    ],
)
def test_rows_of_bodies_broadcast_with_numbers_for_all(make, rows):
    packed = pack(make(*map(list, zip(*rows, strict=True))), Rate, 2)
    alone = [pack(make(*row), Rate, None) for row in rows]
    assert packed.params.tolist() == [p.params.tolist() for p in alone]
    assert {packed.structure} == {p.structure for p in alone}


@pytest.mark.parametrize("kind", [list, tuple, np.asarray, np.float32])
def test_numbers_may_be_any_sequence(kind):
    value = np.asarray([0.5, 1.0, 2.0], np.float32) if kind is np.float32 else kind([0.5, 1, 2])
    assert at(rates.Constant(value), 0.0).tolist() == [0.5, 1.0, 2.0]
