"""The check of convergence: silent on methods that are right, it warns of those that are broken."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from each import in_tiers

import fastatt as fa
from fastatt.kernels.vec3 import cross
from fastatt.methods.explicit import Tableau, stepped
from fastatt.methods.method import Steps
from fastatt.propagation.choice_of_method import methods_for
from fastatt.trade.convergence import ConvergenceWarning

CONING = fa.Scene(rate=fa.rates.Coning(np.linspace(0.2, 1.2, 40), np.linspace(0.5, 2.0, 40)))
FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
Q40 = np.tile([1.0, 0.0, 0.0, 0.0], (40, 1))
W40 = np.random.default_rng(3).normal(size=(40, 3))
SPUN, TURNED = (FREE, Q40, W40), (CONING, Q40)
STEPS = {"dt": 0.05, "n_steps": 100}


def silently(*given, **options):
    """The check, which warns of nothing."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return fa.check_convergence(*given, **options)


def gauss(w, t, h, shift, sign):
    """Magnus-4, its nodes shifted by so many steps, its commutator of either sign."""
    a = w(t + (0.21132486540518713 - shift) * h)
    b = w(t + (0.7886751345948129 - shift) * h)
    c = sign * 0.14433756729740643 * h
    k = cross(a, b)
    return tuple(h * (c * k[i] + 0.5 * (a[i] + b[i])) for i in range(3))


def wrong_sign(w, t, h):
    return (gauss(w, t, h, 0.0, -1.0),)


def stale(w, t, h):
    return (gauss(w, t, h, 1.0, 1.0),)


# RK4 with one weight too large by 2 %
TABLEAU = Tableau(
    order=4,
    c=(0.0, 0.5, 0.5, 1.0),
    a=((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    b=(1 / 6, 2.04 / 6, 2 / 6, 1 / 6),
)
HEAVY = Steps(body=stepped(TABLEAU, first_turn=False))


BROKEN = {
    "sign": (fa.lie_group("new", order=4, exponents=wrong_sign), TURNED),
    "stale rate": (fa.lie_group("new", order=4, exponents=stale), TURNED),
    "weight": (replace(fa.METHODS["rk4"], name="new", steps=HEAVY), SPUN),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_method_is_caught(case):
    method, given = BROKEN[case]
    words = r"new: observed order [0-3]\.\d\d, declared 4.* where order 4 predicts 16"
    with pytest.warns(ConvergenceWarning, match=words) as caught:
        check = fa.check_convergence(*given, **STEPS, method=method)
    assert not check.passed
    assert check.order < 2.5
    assert check.limited_by == "truncation"
    assert check.divided == 2**7  # all halvings that there are
    assert caught[0].filename == __file__


# of an order that rounding lets show, at a step within the method's limit
RIGHT = [
    (given, m)
    for given in (TURNED, SPUN)
    for m in methods_for(given[0])
    if fa.METHODS[m].is_stepped and 2 <= fa.METHODS[m].order <= 6
]


@pytest.mark.parametrize(
    ("given", "method"),
    in_tiers([x for x in RIGHT if x[1] in ("rk4", "magnus4", "strang2", "dmv2")], RIGHT),
)
def test_a_right_method_passes(given, method):
    check = silently(*given, **STEPS, method=method)
    assert check.passed
    assert check.order > fa.METHODS[method].order - 0.5
    assert (check.measured, check.method, check.limited_by) == (40, method, "truncation")


def test_the_error_is_the_true_one():
    dt, n = 0.05, 100
    check = fa.check_convergence(CONING, Q40, dt=dt, n_steps=n, method="rk4")
    end = fa.propagate(CONING, Q40, dt=dt, n_steps=n, method="rk4").q[-1]
    angle, speed = CONING.rate.angle, CONING.rate.frequency
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    cone = [
        np.stack([c, s * np.cos(speed * t), s * np.sin(speed * t), 0 * c], axis=1)
        for t in (0.0, dt * n)
    ]
    exact = fa.quat_multiply(cone[0] * (1, -1, -1, -1), cone[1])
    true = fa.angle_between(end, exact).max()
    assert check.error == pytest.approx(true, rel=0.05)


@pytest.mark.parametrize("n_steps", in_tiers([600], [600, 4000]))
def test_what_settles_is_looked_at_on_the_way(n_steps):
    """A controller brings all to one attitude, whatever the step: the end alone shows no error."""
    scene = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=fa.torques.QuaternionPD(0.3, 0.5))
    q0 = fa.rotation_vector_to_quat(np.random.default_rng(1).uniform(-1.0, 1.0, (40, 3)))
    given = scene, q0, 0.05 * W40
    call = {"dt": 0.5, "n_steps": n_steps, "method": "rk4"}
    found = fa.propagate(*given, save_every=1, **call)
    check = fa.check_convergence(*given, **call)
    fine = fa.propagate(*given, dt=0.05, n_steps=6000, save_every=10, method="rk4")
    apart = fa.angle_between(found.q[:601], fine.q).max(axis=1)
    assert check.error == pytest.approx(apart.max(), rel=0.1)
    assert check.order > 3.5
    assert apart[-1] < 1e-9
    assert apart.max() > 1e-6


def test_a_large_step_is_halved_until_its_order_shows():
    """At |w|h = 2 the first halvings of order 4 show less than 4: no fault of the method."""
    check = fa.check_convergence(CONING, Q40, dt=1.0, n_steps=10, method="rk4")
    assert check.passed
    assert check.order > 3.5


def test_rounding_alone_does_not_warn():
    scene = fa.Scene(rate=fa.rates.Constant((0.3, 0.2, -0.1)))
    check = fa.check_convergence(scene, Q40, dt=0.01, n_steps=100, method="lie_midpoint")
    assert check.passed
    assert (check.order, check.limited_by) == (None, "round-off")
    assert check.error < 1e-13


def test_a_closed_form_has_no_order():
    check = fa.check_convergence(FREE, Q40, W40, dt=0.1, n_steps=100, method="exact")
    assert (check.declared, check.order, check.passed) == (0, None, True)
    assert check.error < 1e-13


def test_a_history_with_kinks_warns_where_a_step_crosses_them():
    torques = np.random.default_rng(1).normal(scale=0.1, size=(40, 3))
    history = fa.TimeSeries(0.13 * np.arange(40), torques, kind="linear")
    scene = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0), torque=lambda t, q, w, p: history(t))
    with pytest.warns(ConvergenceWarning, match="not smooth"):
        fa.check_convergence(scene, Q40, W40, **STEPS, method="rk4")
    assert silently(scene, Q40, W40, dt=0.065, n_steps=78, method="rk4").order > 3.5


def test_sample_takes_the_fastest():
    w0 = np.tile([0.1, 0.0, 0.1], (1000, 1))
    w0[777] = [0.0, 2.0, 1.0]
    few = fa.check_convergence(FREE, [1, 0, 0, 0], w0, dt=0.1, n_steps=50, method="rk4", sample=16)
    alone = fa.check_convergence(FREE, [1, 0, 0, 0], w0[777], dt=0.1, n_steps=50, method="rk4")
    assert few.measured <= 16
    assert few.error == pytest.approx(alone.error, rel=1e-9)


def test_text_and_one_body():
    text = str(fa.check_convergence(*TURNED, **STEPS, method="magnus4"))
    assert re.search("magnus4: observed order 4.0.*declared 4", text)
    one = fa.check_convergence(FREE, Q40[0], W40[0], dt=0.05, n_steps=10, method="rk4")
    assert one.measured == one.n_bodies == 1


def pulse(t, q, w, p):
    return (p[0] if 20.0 <= t < 20.0 + p[1] else 0.0), 0.0, 0.0


@pytest.mark.filterwarnings("ignore::fastatt.ConvergenceWarning")
def test_parts_of_a_step_between_breakpoints_do_not_fail():
    """A pulse of 3.5 s is one part of a step of 8 s and of 4 s; a wrong breakpoint still fails."""
    for length, right in ((3.5, True), (4.9, False)):
        torque = fa.torques.Custom(pulse, (0.02, length))
        scene = fa.Scene(inertia=(3.0, 2.0, 1.5), torque=torque, breakpoints=(20.0, 23.5))
        given = [1, 0, 0, 0], [5e-3, 9e-3, -4e-3]
        check = fa.check_convergence(scene, *given, dt=8.0, n_steps=15, method="rk8")
        assert (check.passed, check.error < 1e-6) == (right, right)


def jumping(t, p):
    return 0.3, 1.0 if t > p[0] else 0.0, 0.1 * math.sin(t)


@pytest.mark.parametrize("method", in_tiers(["magnus4"], ["magnus4", "magnus8"]))
def test_a_jump_that_two_step_sizes_do_not_show_is_found(method):
    start, rng = ([1.0, 0.0, 0.0, 0.0],), np.random.default_rng(1)
    for time in rng.uniform(0.2, 9.8, 12):
        given = {"dt": 0.1, "n_steps": 100, "method": method}
        with pytest.warns(fa.ConvergenceWarning, match="breakpoints"):
            found = fa.check_convergence(fa.Scene(rate=jumping, params=(time,)), *start, **given)
        assert not found.passed
    declared = fa.Scene(rate=jumping, params=(time,), breakpoints=(time,))
    assert fa.check_convergence(declared, *start, **given).passed


def test_whole_cycles_in_each_step_are_noticed():
    """A vibration of 16 cycles a step: steps of all halvings see the same phase."""
    turn = 2.0 * np.pi * 16.0 / 0.1
    scene = fa.Scene(
        rate=lambda t, p: (p[0] * np.sin(p[1] * t), 0.5 * p[0] * np.cos(p[1] * t), 0.3 + 0 * t),
        params=(0.02 * turn, turn),
    )
    with pytest.warns(ConvergenceWarning, match="no whole fraction of dt gives another motion"):
        found = fa.check_convergence(scene, [1, 0, 0, 0], dt=0.1, n_steps=100, method="rk4")
    assert not found.passed
    assert found.limited_by == "step"
    assert found.error > 1.0


@pytest.mark.parametrize("dt", in_tiers([0.5], [2.0, 0.5]))
def test_rounding_is_not_blamed_where_halving_helps(dt):
    """At 0.5 s the error is 5.7e-12 rad, at half the step 1e-13, which is rounding."""
    scene = fa.Scene(inertia=(3.0, 2.0, 1.0), torque=fa.torques.GravityGradient(1e-3))
    given = [1, 0, 0, 0], [0.1, 0.2, 0.3]
    n = round(300 / dt)
    found = fa.check_convergence(scene, *given, dt=dt, n_steps=n, method="rk8")
    assert found.limited_by == "truncation"
    fine = fa.check_convergence(scene, *given, dt=dt / 8, n_steps=8 * n, method="rk8")
    assert fine.limited_by == "round-off"
