"""Windows of gyro samples: their shape, their loops on any processor, what is compiled when."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import TypingError

import fastatt as fa
from fastatt.codegen import emitter
from fastatt.codegen.processor import processor
from fastatt.gyro import program
from fastatt.gyro.loops import CHUNK, LANES
from fastatt.methods.windows import Window

LOG = np.random.default_rng(2).normal(size=(3000, 3))
SAMPLED = [
    (m.name, increments)
    for m in fa.METHODS.values()
    if m.window is not None
    for increments in (False, True)
    if m.window.takes(increments)
]


@pytest.fixture
def fresh():
    """No program made before the test is used, and none of its own after it."""
    program.program.cache_clear()
    yield
    program.program.cache_clear()


@pytest.mark.parametrize(("span", "history"), [(0, 0), (5, 0), (96, 0), (1, -1), (1, 9)])
def test_windows_that_a_chunk_does_not_hold_are_refused(span, history):
    with pytest.raises(ValueError, match=r"^(span|history): found"):
        Window(history=history, span=span)


# bytes of the vectors of other processors than this one
OTHERS = [vector for vector in (16, 32, 64) if vector != processor().vector]


@pytest.mark.parametrize(("method", "increments"), SAMPLED)
def test_samples_of_a_window(method, increments):
    """As many as its formula takes: one more is never looked at, one less is missed."""
    window = fa.METHODS[method].window
    assert CHUNK % window.span == 0
    n = 3 * window.samples(increments)
    rng = np.random.default_rng(0)
    v, h = tuple(rng.normal(size=n).tolist()), (0.1,) * window.intervals
    formula = window.formula(increments)
    if formula is None:
        iteration = window.iteration
        formula = lambda v, h: iteration.read(iteration.begin(increments, v, h)[:-1])  # noqa: E731
    found = formula(v, h)
    assert len(found) == (4 if window.iteration else 3) * window.span
    assert formula((*v, 1e300), h) == found
    if (method, increments) != ("hold", False):  # which leaves out that at the interval's end
        with pytest.raises((IndexError, TypingError)):
            formula(v[:-1], h)


@pytest.mark.parametrize(("vector", "dtype"), list(zip(OTHERS, ("f8", "f4"), strict=True)))
@pytest.mark.parametrize(
    ("method", "increments"), [("hold", True), ("previous", False), ("picard", True)]
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
    other = processor()._replace(vector=vector)
    for module in (emitter, program):
        monkeypatch.setattr(module, "processor", lambda: other)
    program.program.cache_clear()
    for (data, dt), one in zip(cases, expected, strict=True):
        assert fa.integrate_rates(data, dt, **options).tobytes() == one.tobytes()


def forms_made(monkeypatch):
    """Whether they are for small rotation angles, of the forms that are compiled from now on."""
    made, compiled = [], program.GyroProgram._compiled

    def compile_form(self, *, small_angle):
        made.append(small_angle)
        return compiled(self, small_angle=small_angle)

    monkeypatch.setattr(program.GyroProgram, "_compiled", compile_form)
    return made


@pytest.mark.parametrize("n", [397, 2995])
def test_windows_for_any_angle_are_compiled_when_one_turns_past_a_half(fresh, monkeypatch, n):
    """Turns of at most π a window need them not; picard has one form."""
    made = forms_made(monkeypatch)
    fa.integrate_rates(0.01 * LOG[:n], 1.0, method="coning2")
    assert made == [True]
    fast = 0.01 * LOG[:n]
    fast[n // 2] = 2.0
    q = fa.integrate_rates(fast, 1.0, method="coning2")
    assert made == [True, False]
    assert np.array_equal(fa.integrate_rates(fast, 1.0, method="coning2", n_threads=1), q)
    fa.integrate_rates(0.01 * LOG[:n], 1.0, method="picard")
    assert made == [True, False, True]


def test_threads_that_need_a_program_together_make_it_once(fresh, monkeypatch):
    made = forms_made(monkeypatch)
    logs = np.tile(LOG[:20], (4000, 1, 1))
    fa.integrate_rates(logs, 1.0, method="coning3", n_threads=8)
    assert made == [True, False]


@pytest.mark.parametrize("fast", [False, True])
def test_both_exponentials_give_small_turns_the_same_bits(fresh, monkeypatch, fast):
    """What lets a chunk go from one to the other for the sake of one lane."""
    data = LOG * (0.9 if fast else 0.2)
    for dtype in ("f8", "f4"):
        short = fa.integrate_rates(data.astype(dtype), 0.1, method="coning3")
        near = property(lambda window: 1e-9)
        with monkeypatch.context() as patched:
            patched.setattr(Window, "near", near)
            program.program.cache_clear()
            wide = fa.integrate_rates(data.astype(dtype), 0.1, method="coning3")
        program.program.cache_clear()
        assert wide.tobytes() == short.tobytes()


# lengths within a chunk, of whole chunks, of less than a window; a log, and logs side by side
PLAIN = [(1, 2), (1, 50), (1, 97), (3, 20), (LANES + 1, 5)]


def attitudes_of_plain_logs():
    """Attitudes of small logs by every method, some of rotations beyond π."""
    found = {}
    for method, increments in SAMPLED:
        for dtype in ("f8", "f4") if method in ("hold", "picard") else ("f8",):
            for n_logs, n in PLAIN:
                for uneven in (False, True)[: 1 + (not fa.METHODS[method].window.even)]:
                    data = 0.1 * LOG[: n_logs * n].reshape(n_logs, n, 3)
                    data[-1, n // 2] *= 20.0 if method != "picard" else 1.0
                    count = n - (not increments)
                    dt = np.linspace(0.8, 1.2, count) if uneven else 1.0
                    name = f"{method} {increments} {dtype} {n_logs} {n} {uneven}"
                    found[name] = fa.integrate_rates(
                        data.astype(dtype), dt, method=method, increments=increments, n_threads=2
                    )
    return found


@pytest.mark.filterwarnings("ignore::fastatt.StepWarning")
def test_python_gives_what_machine_code_gives(tmp_path):
    """But for fused products, of some roundings an interval."""
    root, path = Path(fa.__file__).resolve().parents[1], tmp_path / "plain.npz"
    settings = {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", __file__, str(path)],
        env={**os.environ, **settings}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with np.load(path) as in_python:
        for name, q in attitudes_of_plain_logs().items():
            assert in_python[name].dtype == q.dtype
            assert np.abs(in_python[name] - q).max() <= 8 * q.shape[1] * np.finfo(q.dtype).eps


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
    limit = fa.METHODS["coning2"].limit("rates")
    spans[9] = 0.2  # beside samples at rest
    if long is None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            fa.integrate_rates(rates, spans, method="coning2", max_gap=1.0)
        return
    spans[long] = 0.1
    assert 0.01 * 30.0 < limit < 0.1 * 30.0
    with pytest.warns(
        fa.StepWarning, match=f"interval {long} of log {n_logs - 1} rotates by 3 rad"
    ) as said:
        fa.integrate_rates(rates, spans, method="coning2", max_gap=1.0)
    assert len(said) == 1


if __name__ == "__main__":
    np.savez(sys.argv[1], **attitudes_of_plain_logs())
