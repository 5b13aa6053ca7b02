"""Single windows of gyro samples beside the engine, from Python and jitted code."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from allocations import counted, is_made_in
from each import each
from exact import EPS, START, generic
from numba import njit

import fastatt as fa
from fastatt.gyro import gyro_steps as steps

H = 0.05
ULPS = 4 * EPS
MOTION = generic(3)
SAMPLED = [
    (m.name, inc)
    for m in fa.METHODS.values()
    for inc in (False, True)
    if m.window and m.window.iteration is None and m.window.takes(inc)
]


@pytest.fixture
def allocations():
    with counted() as number:
        yield number


def sample_log(method, increments, n):
    t = np.arange(n + 1) * H
    values = MOTION.increments(t) if increments else MOTION.rate(t)
    return np.ascontiguousarray(np.moveaxis(values, 0, 1)[0])


def of_engine(method, increments):
    """The window of a method, the samples of its first whole one, and the engine's attitudes."""
    window = fa.METHODS[method].window
    log = sample_log(method, increments, window.history + window.span)
    engine = fa.integrate_rates(log, H, START, method=method, increments=increments)
    return log, engine[window.history :]


@pytest.mark.parametrize(("method", "increments"), SAMPLED)
def test_windows_of_samples_are_the_engines(method, increments, allocations):
    """In tuples and in arrays."""
    window = steps.sample_step(method, increments=increments)
    log, engine = of_engine(method, increments)
    out = np.empty((window.span + 1, 4))
    gaps = np.full(window.history + window.span, H)
    assert log.shape == (window.samples, 3)
    for _ in range(2):
        before = allocations()
        out[0] = engine[0]
        window.step_into(log, gaps, out)
    assert allocations() == before + 3  # Numba's own, of each array handed over
    assert np.abs(out - engine).max() <= ULPS
    if method == "coning2":  # the named functions call the same kernel for the others
        flat = window.step(tuple(out[0]), tuple(log.ravel().tolist()), tuple(gaps.tolist()))
        assert np.array_equal(np.reshape(flat, (-1, 4)), out[1:])


CALLS = {
    ("hold", False): lambda q, v: steps.hold(q, v[0], H),
    ("hold", True): lambda q, v: steps.hold_increments(q, v[0]),
    ("trapezoid", False): lambda q, v: steps.trapezoid(q, *v, H),
    ("previous", False): lambda q, v: steps.previous(q, *v, H, H),
    ("previous", True): lambda q, v: steps.previous_increments(q, *v, H, H),
    ("coning2", False): lambda q, v: steps.coning2(q, *v, H, H),
    ("coning2", True): lambda q, v: steps.coning2_increments(q, *v, H, H),
}


def test_every_method_of_samples_has_its_functions():
    assert set(CALLS) == {*SAMPLED}


@each(("method", "increments"), CALLS)
def test_functions_of_samples(method, increments):
    log, engine = of_engine(method, increments)
    samples = [tuple(row) for row in log.tolist()]
    found = CALLS[method, increments](tuple(engine[0].tolist()), samples)
    assert np.abs(np.reshape(found, (-1, 4)) - engine[1:]).max() <= ULPS


def test_large_angles_of_samples():
    u = (4.0, -3.0, 2.0)
    q = fa.integrate_rates([u], 1.0, START, method="hold", increments=True)[-1]
    assert np.abs(steps.hold_increments(tuple(START), u) - q).max() <= ULPS
    assert np.abs(steps.hold(tuple(START), (8.0, -6.0, 4.0), 0.5) - q).max() <= ULPS


# from a user's own code


@njit(nogil=True)
def with_samples(q, rates, h):
    for i in range(rates.shape[0] - 1):
        a = (rates[i, 0], rates[i, 1], rates[i, 2])
        b = (rates[i + 1, 0], rates[i + 1, 1], rates[i + 1, 2])
        q = steps.trapezoid(steps.hold(q, a, h), a, b, h)
    return q


def test_from_jitted_code(allocations):
    rates = sample_log("trapezoid", False, 8)
    with_samples(tuple(START), rates, H)
    before = allocations()
    q = with_samples(tuple(START), rates, H)
    assert allocations() == before + 1  # Numba's own, of the array handed over
    slow = tuple(START)
    for a, b in pairwise(rates):
        slow = steps.trapezoid(steps.hold(slow, tuple(a), H), tuple(a), tuple(b), H)
    assert np.abs(np.subtract(q, slow)).max() <= 16 * ULPS
    for text in with_samples.inspect_llvm().values():
        assert not is_made_in(text)
