"""Windows of gyro samples: their shape, their loops on any processor, what is compiled when."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import fastatt as fa
from fastatt.codegen import emitter
from fastatt.codegen.processor import processor
from fastatt.gyro import window_loops
from fastatt.gyro.loops import CHUNK
from fastatt.methods.windows import Window

LOG = np.random.default_rng(2).normal(size=(3000, 3))


@pytest.fixture
def fresh():
    """No program made before the test is used, and none of its own after it."""
    window_loops.program.cache_clear()
    yield
    window_loops.program.cache_clear()


# bytes of the vectors of other processors than this one
OTHERS = [vector for vector in (16, 32, 64) if vector != processor().vector]


@pytest.mark.parametrize(
    ("method", "increments", "vector", "dtype"),
    [("hold", True, 0, "f8"), ("previous", False, 1, "f4"), ("picard", True, 0, "f4")],
)
def test_width_of_vectors_changes_no_bit(fresh, monkeypatch, method, increments, vector, dtype):
    """The lanes of a processor with other vectors, on this one."""
    logs = LOG.reshape(30, 100, 3) * 0.02, LOG * 0.02
    spans = 0.1, np.linspace(0.09, 0.11, 100 - (not increments))
    options = {"method": method, "increments": increments}
    cases = [
        (data.astype(dtype), dt)
        for data, dt in ((logs[0], spans[0]), (logs[0], spans[1]), (logs[1], 0.1))
    ]
    expected = [fa.integrate_rates(data, dt, **options) for data, dt in cases]
    other = processor()._replace(vector=OTHERS[vector])
    for module in (emitter, window_loops):
        monkeypatch.setattr(module, "processor", lambda: other)
    window_loops.program.cache_clear()
    for (data, dt), one in zip(cases, expected, strict=True):
        assert fa.integrate_rates(data, dt, **options).tobytes() == one.tobytes()


def forms_made(monkeypatch):
    """Whether they are for small rotation angles, of the forms that are compiled from now on."""
    made, compiled = [], window_loops.GyroProgram._compiled

    def compile_form(self, *, small_angle):
        made.append(small_angle)
        return compiled(self, small_angle=small_angle)

    monkeypatch.setattr(window_loops.GyroProgram, "_compiled", compile_form)
    return made


def test_windows_for_any_angle_are_compiled_when_one_turns_past_a_half(fresh, monkeypatch):
    """Turns of at most π a window need them not; picard has one form."""
    made = forms_made(monkeypatch)
    for n in (397, 2995):
        fa.integrate_rates(0.01 * LOG[:n], 1.0, method="coning2")
    assert made == [True]
    for n in (397, 2995):
        fast = 0.01 * LOG[:n]
        fast[n // 2] = 2.0
        q = fa.integrate_rates(fast, 1.0, method="coning2")
        assert np.array_equal(fa.integrate_rates(fast, 1.0, method="coning2", n_threads=1), q)
    assert made == [True, False]
    fa.integrate_rates(0.01 * LOG[:n], 1.0, method="picard")
    assert made == [True, False, True]


def test_threads_that_need_a_program_together_make_it_once(fresh, monkeypatch):
    made = forms_made(monkeypatch)
    logs = np.tile(LOG[:20], (4000, 1, 1))
    fa.integrate_rates(logs, 1.0, method="coning2", n_threads=8)
    assert made == [True, False]


@pytest.mark.parametrize("dtype", ["f8", "f4"])
def test_both_exponentials_give_small_turns_the_same_bits(fresh, monkeypatch, dtype):
    """What lets a chunk go from one to the other for the sake of one lane."""
    logs = [(size * LOG).astype(dtype) for size in (0.2, 0.9)]
    short = [fa.integrate_rates(log, 0.1, method="coning2") for log in logs]
    monkeypatch.setattr(Window, "near", property(lambda window: 1e-9))
    window_loops.program.cache_clear()
    for log, q in zip(logs, short, strict=True):
        assert fa.integrate_rates(log, 0.1, method="coning2").tobytes() == q.tobytes()


# rates for which every product rounds to the same side
STEADY = np.array([[0.1, 0.2, 0.3], [0.013, 0.02, -0.03], [1e-3, 2e-3, 0.0]])


@pytest.mark.parametrize("dtype", ["f8", "f4"])
@pytest.mark.parametrize("shape", [(18, 20_000), (3, 400_000)])
@pytest.mark.parametrize("n_threads", [1, 2])
def test_attitudes_stay_at_unit_length(shape, dtype, n_threads):
    """Of long logs, side by side and one at a time: mended with every chunk of 48 intervals."""
    n_logs, n = shape
    turns = np.repeat(np.tile(STEADY, (n_logs // 3, 1)).astype(dtype)[:, None], n, axis=1)
    q = fa.integrate_rates(turns, 1.0, method="hold", increments=True, n_threads=n_threads)
    # an exponential and a product an interval, of some three ulps together; else thousands
    far = np.abs(np.einsum("...i,...i->...", q, q, dtype=np.float64) - 1.0).max()
    assert far <= 2.0 * 3.0 * CHUNK * np.finfo(dtype).eps


# the warning of steps that are too long


@pytest.mark.parametrize("n_logs", [1, 20])
@pytest.mark.parametrize("long", [4, 5, None])
def test_a_sample_counts_for_the_intervals_before_and_after_it(long, n_logs):
    """Sample 5 turns fast; only a long interval beside it makes that too far for the method."""
    spans = np.full(11, 0.01)
    rates = np.zeros((n_logs, 12, 3))
    rates[-1, 5] = 30.0, 0.0, 0.0
    spans[9] = 0.2  # beside samples at rest
    spans[[] if long is None else long] = 0.1
    assert 0.01 * 30.0 < fa.METHODS["coning2"].limit("rates") < 0.1 * 30.0
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        fa.integrate_rates(rates, spans, method="coning2", max_gap=1.0)
    words = f"interval {long} of log {n_logs - 1} rotates by 3 rad"
    assert [words in str(w.message) for w in said] == [True] * (long is not None)
