"""Times: calls take turns, other processes count for nothing, and ties go to the smaller error."""

from __future__ import annotations

import numpy as np
import pytest

from fastatt.trade import timing
from fastatt.trade.measure import Case
from fastatt.trade.search import Point, ranked


class Clock:
    """CPU time that calls add to, each the next of its times."""

    def __init__(self, monkeypatch):
        self.now, self.called = 0.0, []
        monkeypatch.setattr(timing, "process_time", lambda: self.now)

    def call(self, name, times):
        rest = iter(times)

        def run():
            self.called.append(name)
            self.now += next(rest)

        return run


def test_calls_take_turns_in_five_rounds_at_least(monkeypatch):
    clock = Clock(monkeypatch)
    # the first of each tells how many calls one timing takes
    slow = clock.call("slow", [1.0, 1.0, 5.0, 2.0, 3.0, 4.0])
    slower = clock.call("slower", [9.0, 2.0, 2.0, 2.0, 2.0, 2.0])
    one, other = timing.time_in_turns([slow, slower])
    assert clock.called == ["slow", "slower"] * 6
    assert one == (1.0, 2.0, 4.0)
    assert other == (2.0, 2.0, 2.0)


def test_short_calls_are_timed_together_and_in_more_rounds(monkeypatch):
    clock = Clock(monkeypatch)
    short = clock.call("short", np.full(10_000, 1e-3))
    long = clock.call("long", np.full(10, 0.11))
    times = timing.time_in_turns([short, long])
    assert [x.least for x in times] == pytest.approx([1e-3, 0.11])
    assert clock.called.count("short") == 1 + 2 + 2 * 50
    assert clock.called.count("long") == 1 + 5


def test_a_tie_goes_to_the_smaller_error():
    def point(seconds, error):
        return Point(Case("rk8"), 10, error, 1, seconds)

    fast, near, far = point(1.0, 3e-7), point(1.09, 2e-7), point(1.11, 1e-7)
    assert ranked([far, fast, near]) == [near, fast, far]
