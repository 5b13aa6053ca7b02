"""Angles and times that a precision does not hold: told, and flagged where the answer is lost."""

import warnings

import mpmath as mp
import numpy as np
import pytest
from each import each

import fastatt as fa
from fastatt import rounding

INERTIA = (2.0, 1.0, 0.7)
Q = np.array([[1.0, 0.0, 0.0, 0.0]] * 2)
EPS = {"float64": 2.0**-52, "float32": 2.0**-23}


def told(run):
    """What a call gives, and what it warned of, in this file."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = run()
    assert all(w.category is fa.StepWarning and w.filename == __file__ for w in found)
    return result, [str(w.message) for w in found]


def rates(w):
    return [[w, 0.0, 0.0], [1e-12, 0.0, 0.0]]


def spun(w, t):
    """Attitude of a spin about x, of many digits."""
    with mp.workdps(60):
        half = mp.mpf(float(w)) * mp.mpf(float(t)) / 2
        return np.array([float(mp.cos(half)), float(mp.sin(half)), 0.0, 0.0])


def off(q, truth):
    return 2.0 * min(np.linalg.norm(q - truth), np.linalg.norm(q + truth))


@each("dtype", EPS)
@each("way", ["exact", "exponential"])
@each("lost", [1e-2, 1e-1, 1e1, 1e3])
def test_a_turn_beyond_precision_is_flagged(way, dtype, lost):
    """At 0.1 rad of rounding; below that the error is what |w| t eps says."""
    t = float(np.float32(lost / EPS[dtype] / 1.7))
    w = float(np.float32(1.7 * (0.9 if lost == 0.1 else 1.0)))
    if way == "exact":
        scene, w0, method = fa.Scene(inertia=INERTIA), rates(w), "exact"
    else:
        scene, w0, method = fa.Scene(rate=fa.rates.Constant(rates(w))), None, "magnus4"
    run, texts = told(
        lambda: fa.propagate(scene, Q, w0, dt=t, n_steps=1, method=method, dtype=dtype)
    )
    assert list(run.status > 0) == [lost > 0.1, False]
    assert len(texts) == 1
    error = off(run.q[-1, 0], spun(w, t))
    # of the angle, of its half, and of its reduction by turns
    assert lost > 0.1 or error < 3.0 * lost


@pytest.mark.parametrize("dtype", EPS)
def test_half_the_digits_are_told_of(dtype):
    t = EPS[dtype] ** -0.5
    for factor, n in ((0.9, 0), (1.1, 1)):
        _, texts = told(
            lambda k=factor: fa.closed_form.free_body(
                Q, rates(1.0), (2.0, 1.0, 1.0), [0.0, -k * t], dtype=dtype
            )
        )
        assert len(texts) == n
        scene = fa.Scene(rate=fa.rates.Constant(rates(factor * t)))
        run, texts = told(
            lambda s=scene: fa.propagate(s, Q, dt=1.0, n_steps=1, method="magnus4", dtype=dtype)
        )
        assert len(texts) == n
        assert not run.status.any()


@pytest.mark.parametrize("dtype", EPS)
def test_a_clock_that_tells_steps_apart_no_more_is_told_of(dtype):
    """At Unix time, with steps of 0.1 ms; a constant rate does not ask for the time."""
    coning = fa.Scene(rate=fa.rates.Coning(0.1, 1.0))
    constant = fa.Scene(rate=fa.rates.Constant((0.1, 1.0, 0.0)))
    free = fa.Scene(inertia=INERTIA)
    for scene, h, t0, n in (
        (coning, 1e-2, 1.7e9, 0),
        (coning, 1e-4, 1.7e9, 1),
        (coning, -1e-4, -1.7e9, 1),
        (coning, 1e-4, 1.7e6, 0),
        (constant, 1e-4, 1.7e9, 0),
        (free, 1e-4, 1.7e9, 0),
        # per-body steps are counted too
        (coning, (1e-4, 5e-5), 1.7e9, 1),
        (constant, (1e-4, 5e-5), 1.7e9, 0),
    ):
        w0 = [0.1, 0.2, 0.3] if scene is free else None
        steps = {"dt": h, "n_steps": 2 if np.ndim(h) == 0 else (2, 4)}
        _, texts = told(
            lambda s=scene, o=steps, t0=t0, w=w0: fa.propagate(s, Q, w, t0=t0, dtype=dtype, **o)
        )
        assert [text[:3] for text in texts] == ["t0:"] * n


@each("dtype", EPS)
@each("kind", ["constant rate", "free body"])
def test_per_body_steps_without_the_time_do_not_depend_on_when_they_begin(kind, dtype):
    """Steps are counted: at Unix time, which tells these apart no more, the bits are those of 0."""
    scene, w0 = fa.Scene(inertia=INERTIA), [0.1, 0.2, 0.3]
    if kind == "constant rate":
        scene, w0 = fa.Scene(rate=fa.rates.Constant((0.1, 1.0, 0.0))), None
    steps = {"dt": (1e-4, 5e-5), "n_steps": (2, 4), "dtype": dtype, "method": "rk4"}
    early, late = (fa.propagate(scene, Q, w0, t0=t0, **steps) for t0 in (0.0, 1.7e9))
    assert early.q.tobytes() == late.q.tobytes()


def test_what_is_noted_is_listed_and_warned_of_afterwards_again():
    def integrate():
        fa.integrate_rates(np.full((3, 3), 5.0), 1.0)

    with rounding.noted() as said:
        integrate()
    (text,) = said
    assert "rotates by 8.66 rad" in text
    with pytest.warns(fa.StepWarning, match=r"rotates by 8\.66 rad"):
        integrate()
