"""Threads that stay: calls in their order, errors, calls within calls, forks, the end."""

import os
import subprocess
import sys
import threading
import time
from functools import partial

import numpy as np
import pytest

import fastatt as fa
from fastatt.threads import in_threads


def called(i):
    time.sleep(0.01)
    return i, threading.get_ident()


def test_results_are_in_order_and_threads_stay():
    first, second = (in_threads([partial(called, i) for i in range(8)], 3) for _ in "12")
    assert [i for i, _ in first] == list(range(8))
    idents = {ident for _, ident in [*first, *second]}
    assert 1 < len(idents) <= 3
    assert threading.get_ident() in idents


@pytest.mark.parametrize("at", [0, 5])
def test_an_error_is_raised_and_what_has_not_begun_is_dropped(at):
    begun = []

    def call(i):
        begun.append(i)
        time.sleep(0.01)
        if i == at:
            raise IndexError(f"call {i}")

    with pytest.raises(IndexError, match=f"call {at}"):
        in_threads([partial(call, i) for i in range(100)], 2)
    assert len(begun) < 20
    assert in_threads([lambda: 1, lambda: 2], 2) == [1, 2]


def test_calls_may_make_calls():
    """As a function does that propagates; no thread waits for one that cannot begin."""

    def inner(i):
        return sum(in_threads([partial(pow, i, k) for k in range(4)], 4))

    assert in_threads([partial(inner, i) for i in range(50)], 4) == [
        sum(i**k for k in range(4)) for i in range(50)
    ]


AROUND_FORK = """
import atexit, os, threading, time
from functools import partial
from fastatt.threads import in_threads
calls = [partial(pow, 2, k) for k in range(64)]
known = [2**k for k in range(64)]
naps = [lambda: time.sleep(0.02) or threading.get_ident()] * 10
assert len({*in_threads(naps, 4)}) > 1
time.sleep(0.1)
child = os.fork()
assert len({*in_threads(naps, 4)}) > 1
assert in_threads(calls, 4) == known
if child:
    assert os.waitpid(child, 0)[1] == 0
atexit.register(lambda: print(in_threads(calls, 4) == known, flush=True))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_after_a_fork_and_at_exit():
    command = [sys.executable, "-W", "ignore", "-c", AROUND_FORK]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert run.stdout.split() == ["True", "True"]


@pytest.mark.parametrize(
    ("method", "n_bodies", "n_steps", "several"),
    [
        ("rk4", 100, 100, False),
        ("rk4", 512, 1000, True),
        ("gbs16", 100, 10, False),
        ("gbs16", 100, 100, True),
        ("exact", 100, 10**6, False),
        ("exact", 10**5, 1, True),
    ],
)
def test_several_threads_are_taken_by_the_work(method, n_bodies, n_steps, several, monkeypatch):
    """By operations, not steps; the closed form is evaluated at saves only."""
    asked = []

    def default_threads():
        asked.append(True)
        return 2

    monkeypatch.setattr("fastatt.propagation.plan.default_threads", default_threads)
    w0 = np.tile([0.1, 0.2, 0.3], (n_bodies, 1))
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    fa.propagate(scene, (1, 0, 0, 0), w0, dt=1e-4, n_steps=n_steps, method=method)
    assert bool(asked) is several
