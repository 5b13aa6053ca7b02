"""The self-check: silent on every method that is right, loud on those broken on purpose."""

from __future__ import annotations

import importlib
import warnings
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

import fastatt as fa
from fastatt.columns import axpy
from fastatt.engine import tiles
from fastatt.kernels.vec3 import add, cross, dot, scale
from fastatt.kernels.vec3 import axpy as axpy3
from fastatt.methods.method import Kernels, register
from fastatt.motion import field, given, turning
from fastatt.rates import rate
from fastatt.representations import turn
from fastatt.self_check import OrderWarning

pytestmark = pytest.mark.slow

CONING = fa.Scene(rate=fa.rates.Coning(np.linspace(0.2, 1.2, 40), np.linspace(0.5, 2.0, 40)))
FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
Q40 = np.tile([1.0, 0.0, 0.0, 0.0], (40, 1))
W40 = np.random.default_rng(3).normal(size=(40, 3))


class WrongSign(NamedTuple):
    """Magnus-4 with the commutator of the other convention."""


def wrong_sign(method, rep, model, t, h, x, p):
    F = type(h)
    a = rate(model, t + F(0.21132486540518713) * h, p, h)
    b = rate(model, t + F(0.7886751345948129) * h, p, h)
    u = scale(h, axpy3(F(-0.14433756729740643) * h, cross(a, b), scale(F(0.5), add(a, b))))
    return turn(rep, x, u), dot(u, u)


class Stale(NamedTuple):
    """Magnus-4 with the rates of the step before."""


def stale(method, rep, model, t, h, x, p):
    F = type(h)
    a = rate(model, t - F(0.7886751345948129) * h, p, h)
    b = rate(model, t - F(0.21132486540518713) * h, p, h)
    u = scale(h, axpy3(F(0.14433756729740643) * h, cross(a, b), scale(F(0.5), add(a, b))))
    return turn(rep, x, u), dot(u, u)


class WrongWeight(NamedTuple):
    """RK4 with one weight too large by 2 %."""


def wrong_weight(method, rep, model, t, h, x, p):
    F = type(h)
    half = F(0.5) * h
    start = given(model, t, p, h)
    middle = given(model, t + half, p, h)
    k1 = field(rep, model, start, x, p)
    k2 = field(rep, model, middle, axpy(half, k1, x), p)
    k3 = field(rep, model, middle, axpy(half, k2, x), p)
    k4 = field(rep, model, given(model, t + h, p, h), axpy(h, k3, x), p)
    k = axpy(F(2.04), k2, k1)
    k = axpy(F(2.0), k3, k)
    k = axpy(F(1.0), k4, k)
    return axpy(F(1.0 / 6.0) * h, k, x), h * h * turning(rep, model, start, k1, x, p)


BROKEN = {
    "sign": ("magnus4", WrongSign(), Kernels(rate=wrong_sign), CONING, None),
    "stale rate": ("magnus4", Stale(), Kernels(rate=stale), CONING, None),
    "weight": ("rk4", WrongWeight(), Kernels(body=wrong_weight), FREE, W40),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_method_is_caught(monkeypatch, case):
    name, tag, kernels, scene, w0 = BROKEN[case]
    register(type(tag), kernels)
    records = {**fa.METHODS, "new": replace(fa.METHODS[name], name="new", tag=tag)}
    monkeypatch.setattr(importlib.import_module("fastatt.propagate"), "METHODS", records)
    monkeypatch.setattr(tiles, "cached_run_tiles", tiles.uncached_run_tiles)
    with pytest.warns(OrderWarning, match=r"new: order [0-3]\.\d\d, declared 4"):
        check = fa.self_check(scene, Q40, w0, dt=0.05, n_steps=100, method="new")
    assert not check.passed
    assert check.order < 2.5
    assert check.limited_by == "truncation"
    with pytest.warns(OrderWarning) as caught:
        run = fa.propagate(scene, Q40, w0, dt=0.05, n_steps=100, method="new", check=64)
    assert caught[0].filename == __file__
    assert run.check == check


RIGHT = [("coning", m) for m in ("lie_midpoint", "rk4", "magnus4", "magnus6")]
RIGHT += [("free", "rk4")]


@pytest.mark.parametrize(("scene", "method"), RIGHT)
def test_a_right_method_passes(scene, method):
    acting, w0 = (CONING, None) if scene == "coning" else (FREE, W40)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check = fa.self_check(acting, Q40, w0, dt=0.05, n_steps=100, method=method)
        run = fa.propagate(acting, Q40, w0, dt=0.05, n_steps=100, method=method, check=64)
    assert run.check == check
    assert str(check) in run.summary()
    assert check.passed
    assert check.order > fa.METHODS[method].order - 0.5
    assert (check.n_bodies, check.method, check.limited_by) == (40, method, "truncation")


def test_the_error_is_the_true_one():
    dt, n = 0.05, 100
    check = fa.self_check(CONING, Q40, dt=dt, n_steps=n, method="rk4")
    end = fa.propagate(CONING, Q40, dt=dt, n_steps=n, method="rk4").q[-1]
    angle, speed = CONING.rate
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    cone = [
        np.stack([c, s * np.cos(speed * t), s * np.sin(speed * t), 0 * c], axis=1)
        for t in (0.0, dt * n)
    ]
    exact = fa.quat_multiply(cone[0] * (1, -1, -1, -1), cone[1])
    true = fa.angle_between(end, exact).max()
    assert check.error == pytest.approx(true, rel=0.05)


def test_a_large_step_is_halved_until_its_order_shows():
    """At |w|h = 2 the first halvings of order 4 show less than 4: no fault of the method."""
    check = fa.self_check(CONING, Q40, dt=1.0, n_steps=10, method="rk4")
    assert check.passed
    assert check.order > 3.5


def test_rounding_alone_does_not_warn():
    scene = fa.Scene(rate=fa.rates.Constant((0.3, 0.2, -0.1)))
    check = fa.self_check(scene, Q40, dt=0.01, n_steps=100, method="lie_midpoint")
    assert check.passed
    assert (check.order, check.limited_by) == (None, "round-off")
    assert check.error < 1e-13


def test_a_closed_form_has_no_order():
    check = fa.self_check(FREE, Q40, W40, dt=0.1, n_steps=100, method="exact")
    assert (check.declared, check.order, check.passed) == (0, None, True)
    assert check.error < 1e-13


def test_a_history_with_kinks_warns_where_a_step_crosses_them():
    torques = np.random.default_rng(1).normal(scale=0.1, size=(40, 3))
    scene = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0), torque=fa.torques.Sampled(torques, dt=0.13))
    with pytest.warns(OrderWarning, match="not smooth"):
        fa.self_check(scene, Q40, W40, dt=0.05, n_steps=100, method="rk4")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check = fa.self_check(scene, Q40, W40, dt=0.065, n_steps=80, method="rk4")
    assert check.order > 3.5


def test_sample_takes_the_fastest():
    w0 = np.tile([0.1, 0.0, 0.1], (1000, 1))
    w0[777] = [0.0, 2.0, 1.0]
    few = fa.self_check(FREE, [1, 0, 0, 0], w0, dt=0.1, n_steps=50, method="rk4", sample=16)
    alone = fa.self_check(FREE, [1, 0, 0, 0], w0[777], dt=0.1, n_steps=50, method="rk4")
    assert few.n_bodies <= 16
    assert few.error == pytest.approx(alone.error, rel=1e-9)


def test_text_and_bad_input():
    text = str(fa.self_check(CONING, Q40, dt=0.05, n_steps=100, method="magnus4"))
    assert "magnus4: order 4.0" in text
    assert "declared 4" in text
    with pytest.raises(ValueError, match="n_steps: found 0"):
        fa.self_check(CONING, Q40, dt=0.05, n_steps=0)
    with pytest.raises(ValueError, match="sample: found 0"):
        fa.self_check(CONING, Q40, dt=0.05, n_steps=10, sample=0)
    one = fa.self_check(FREE, Q40[0], W40[0], dt=0.05, n_steps=10, method="rk4")
    assert one.n_bodies == 1
