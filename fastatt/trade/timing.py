"""CPU times of calls that are compared: they take turns, and the least of several times counts."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from time import process_time
from typing import Any, NamedTuple

import numpy as np

#: the fewest rounds
ROUNDS = 5
#: ratio of two times, below which one call is as fast as the other
TIE = 1.1
_MOST = 50  # rounds
_LEAST = 2e-3  # s of one timing, reached by repeating a call
_LONG = 0.1  # s of a call that takes part in the fewest rounds only
#: s of rounds, beyond which there are the fewest only
BUDGET = 2.0


class Times(NamedTuple):
    """The least of several times of a call, s, and their first and third quartile."""

    least: float
    lower: float
    upper: float


def once(call: Callable[[], Any], repeats: int = 1) -> tuple[float, Any]:
    """The CPU time of the process for a call, s, and its result."""
    begin = process_time()
    for _ in range(repeats):
        result = call()
    return (process_time() - begin) / repeats, result


def time_in_turns(
    calls: Sequence[Callable[[], Any]], rounds: int = ROUNDS, budget: float = BUDGET
) -> list[Times]:
    """Times of calls, of each once in every round, without what other processes take.

    Calls use one thread, and have run before, so that all is compiled. There are as many
    ``rounds``, or more of several calls as long as all take less than a ``budget``, s.
    """
    repeats = [_repeats(call) for call in calls]
    taken: list[list[float]] = [[] for _ in calls]
    begin = process_time()
    for done in range(max(rounds, _MOST if len(calls) > 1 else 0)):
        if done >= rounds and process_time() - begin > budget:
            break
        gc.disable()
        try:
            for call, n, times in zip(calls, repeats, taken, strict=True):
                if done < rounds or times[0] < _LONG:
                    times.append(once(call, n)[0])
        finally:
            gc.enable()
    return [Times(min(times), *map(float, np.quantile(times, (0.25, 0.75)))) for times in taken]


def _repeats(call: Callable[[], Any]) -> int:
    """How many calls one timing takes."""
    n = 1
    while once(call, n)[0] * n < _LEAST:
        n *= 2
    return n
