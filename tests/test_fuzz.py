"""A little of bench/fuzz.py: hostile input is refused in one clear line, or its result is right."""

from __future__ import annotations

import numpy as np
import pytest
from exact import Motion

import fastatt as fa
from bench import fuzz


def rates(d):
    a, omega, c = (np.nan_to_num(d.numbers((2, *tail))) for tail in ((), (), (3, 3)))
    return Motion(a, omega, c).scene


def body(d):
    return fa.Scene(inertia=fuzz.moments(d, 2, 3))


# what other tests compile too
RUNS = (
    fuzz.Run(rates, "magnus4"),
    fuzz.Run(rates, "magnus4"),
    fuzz.Run(body, "rk4"),
    fuzz.Run(body, "strang2"),
    fuzz.Run(body, "exact"),
)
ELSEWHERE = ("propagate_directions", "methods_for, single_step")


def test_hostile_input(tmp_path):
    targets = [t for t in fuzz.targets(tmp_path, RUNS, ("hold",)) if t[0] not in ELSEWHERE]
    outcomes, counts, found = fuzz.fuzz(3000, 7, targets)
    assert not counts, "\n".join(f"{f.target}: {f.what}\n    {f.example}" for f in found)
    for name, own in outcomes.items():
        assert own["refused"] > 0, name
        assert own["returned"] > 0 or name == "drift", name


def nonsense(q):
    return np.full((1, 3, 3), np.nan)


def silent(q):
    return np.asarray(q) * 2.0


def wordy(q):
    raise ValueError("q: this\nand that")


def nameless(q):
    raise TypeError("wrong")


def other(q):
    raise ZeroDivisionError("q")


def warned(q):
    return np.float64(1.0) / np.zeros(1) * np.ones((2, 4)) / np.inf + np.eye(2, 4)


@pytest.mark.parametrize("function", [nonsense, silent, wordy, nameless, other, warned])
def test_what_the_fuzz_is_after_is_found(function):
    call = fuzz.Call(function, (np.array([1.0, 0.0, 0.0, 0.0]),), {}, fuzz.unit, ("q",))
    assert fuzz.tried(call)[1] is not None


def test_a_log_that_is_read_otherwise_than_written_is_found(tmp_path):
    path = fuzz.written(tmp_path, b"wx,wy,wz\n1,2,3\n4,5,6\n")
    log = fuzz.gyrolog.read_log(path, rate=10.0)
    meant = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    t = np.array([0.0, 0.1])
    assert fuzz.read_wrong(log, fuzz.Log(b"", {}, meant, t)) is None
    assert "other rates" in fuzz.read_wrong(log, fuzz.Log(b"", {}, 2.0 * meant, t))
    assert "other times" in fuzz.read_wrong(log, fuzz.Log(b"", {}, meant, 2.0 * t))
    assert "rows" in fuzz.read_wrong(log, fuzz.Log(b"", {}, meant[:1], t[:1]))
