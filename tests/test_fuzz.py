"""Hostile input is refused in one line that names the argument, or its result is right."""

from __future__ import annotations

import numpy as np
from each import each
from exact import Motion
from fuzz import judge, runs, trying


def rates(d):
    a, omega, c = (np.nan_to_num(d.numbers((2, *tail))) for tail in ((), (), (3, 3)))
    return Motion(a, omega, c).scene


RUNS = (*runs.RUNS, runs.Run(rates, "magnus4"))


def test_hostile_input(tmp_path):
    outcomes, counts, found = trying.fuzz(1500, 7, trying.targets(tmp_path, RUNS))
    assert not counts, "\n".join(f"{f.target}: {f.what}\n    {f.example}" for f in found)
    for name, own in outcomes.items():
        assert own["refused"] > 0, name
        assert own["returned"] > 0, name


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


@each("function", [nonsense, silent, wordy, nameless, other, warned])
def test_what_the_fuzz_is_after_is_found(function):
    call = judge.Call(function, (np.array([1.0, 0.0, 0.0, 0.0]),), {}, judge.unit, ("q",))
    assert trying.tried(call)[1] is not None
