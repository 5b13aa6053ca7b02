"""Bodies that advice was not measured on, or that nobody can know: what it says of them."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from scipy import stats

import fastatt as fa
from fastatt.propagation.ensemble import Ensemble
from fastatt.trade import search
from fastatt.trade.coverage import most_beyond
from fastatt.trade.measure import Problem
from fastatt.trade.search import Search

RNG = np.random.default_rng(3)
N = 700
Q0 = RNG.normal(size=(N, 4))
INERTIA = (2.0, 1.4, 1.0)
GRADIENT = fa.Scene(inertia=INERTIA, torque=fa.torques.GravityGradient(mean_motion=0.3))
# three bodies rotate far faster than the others
FAST = 0.3 * RNG.normal(size=(N, 3))
FAST[[5, 333, 699]] *= 30.0
OPTIONS = {"t_end": 6.0, "tol": 1e-6, "sample": 64}


def advised(function=fa.recommend, w0=FAST, **options):
    is_own = function is fa.per_body_steps
    methods = {"method": "rk8"} if is_own else {"methods": ["rk8"], "dtypes": ["float64"]}
    return function(GRADIENT, Q0, w0, **{**OPTIONS, **methods, **options})


def test_the_bodies_most_at_risk_are_in_the_sample(monkeypatch):
    """The fastest, the nearest to the separatrix, and the stiffest, where few can be screened."""
    monkeypatch.setattr(search, "_SCREENED", 3e4)
    damping = np.full((N, 1), 1e-3)
    damping[77] = 0.5
    w0 = np.tile([0.2, 0.02, 0.01], (N, 1)) * RNG.uniform(0.9, 1.0, (N, 1))
    w0[[3, 4]] = (0.0, 0.15, 1e-6), (0.9, 0.0, 0.0)
    scene = fa.Scene(inertia=INERTIA, torque=fa.torques.Damping(damping))
    chosen = Search(Problem(Ensemble(scene, Q0, w0), 30.0), 32, np.random.default_rng(1), 1e-3)
    assert {3, 4, 77} <= set(chosen.rows)
    assert chosen.rows.size < 50


@each(("beyond", "random"), [(0, 59), (0, 400), (3, 400), (20, 20), (1, 10_000)])
def test_the_share_is_that_of_clopper_and_pearson(beyond, random):
    known = 1.0 if beyond == random else stats.beta.ppf(0.95, beyond + 1, random - beyond)
    assert most_beyond(beyond, random, 10**6) == pytest.approx(known, rel=1e-9)
    assert most_beyond(beyond, random, random) == beyond / random


@pytest.mark.parametrize("function", [fa.recommend, fa.per_body_steps])
def test_a_share_of_bodies_may_exceed_the_tolerance_and_is_counted(function):
    """Three of 700: steps for 0.98 of the bodies are fewer, and leave them out."""
    of_all, of_most = (
        advised(function, quantile=part, all_bodies=True, sample=400) for part in (1.0, 0.98)
    )
    assert (of_all.exceeding, of_all.exceeding_share, of_all.measured) == (0, 0.0, N)
    assert np.max(of_most.n_steps) <= np.max(of_all.n_steps)
    run = fa.propagate(GRADIENT, Q0, FAST, **of_most.arguments)
    fine = fa.propagate(GRADIENT, Q0, FAST, dt=6.0 / 4000, n_steps=4000, method="rk8")
    errors = fa.angle_between(run.q[-1], fine.q[-1])
    assert of_most.exceeding == pytest.approx((errors > 1e-6).sum(), abs=2)
    if function is fa.recommend:
        assert of_most.n_steps < 0.5 * of_all.n_steps
        assert of_most.exceeding >= 3
        assert of_most.worst_body in {5, 333, 699}
        assert f"{of_most.exceeding} of 700 bodies exceed tol, beside a run" in str(of_most)


def test_what_is_unknown_of_others_is_told(monkeypatch):
    monkeypatch.setattr(search, "_VERIFIED", 0.0)
    found = advised(w0=0.1 * FAST)
    assert found.measured < N
    assert 0.01 < found.exceeding_share < 0.1
    share = f"at most {100 * found.exceeding_share:.2g} % of the bodies exceed tol, with 95 %"
    assert share in str(found)
    assert f"most of body {found.worst_body};" in str(found)


@pytest.mark.parametrize("function", [fa.recommend, fa.per_body_steps])
def test_chaotic_bodies_are_named_and_set_aside(function):
    """Whose end the last digits of the initial rate decide."""
    n, t_end = 8, 80.0
    rng = np.random.default_rng(3)
    q0, w0 = rng.normal(size=(40, 4))[8:16], rng.normal(0.0, 0.7, (40, 3))[8:16]
    scene = fa.Scene(inertia=INERTIA, torque=fa.torques.GravityGradient(1.0))
    methods = {"method": "rk8"} if function is fa.per_body_steps else {"methods": ["rk8"]}
    found = function(scene, q0, w0, t_end=t_end, tol=1e-4, **methods)
    assert 0 < len(found.undetermined) < n
    assert found.exceeding_share == len(found.undetermined) / n
    ends = [
        fa.propagate(scene, q0, w * w0, dt=t_end / 8000, n_steps=8000, method="rk8").q[-1]
        for w in (1.0, 1.0 + 1e-14)
    ]
    moved = fa.angle_between(*ends)
    lost = np.isin(np.arange(n), found.undetermined)
    assert moved[lost].min() > max(1e-5, moved[~lost].max())
    assert f"not determined by double precision: body {found.undetermined[0]}" in str(found)


@pytest.mark.parametrize("function", [fa.recommend, fa.per_body_steps])
def test_bad_input(function):
    for value in (0.0, 1.5):
        with pytest.raises(ValueError, match=rf"quantile: found {value}; accepted: a num"):
            advised(function, quantile=value)
