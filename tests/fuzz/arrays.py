"""Logs in memory."""

from __future__ import annotations

from typing import Any

import numpy as np

import fastatt as fa
from fuzz.draw import WORDS, Draw
from fuzz.judge import Call, unit

METHODS = ("hold", "trapezoid", "previous", "coning2", "picard")


def integrated(d: Draw, methods: tuple[str, ...] = METHODS) -> Call:
    n = d.one((1, 2, 3, 5, 8))
    rates = d.array((n, 3), (n, 3), (2, n, 3))
    options: dict[str, Any] = {"n_threads": 1, "dtype": np.float64}
    options["method"] = d.one(methods) if d.chance(0.95) else d.one((*WORDS, "rk4"))
    if options["method"] not in methods:
        options["method"] = d.one(("rk4", "", None, 3, "x\ny"))
    dt = d.real() if d.chance(0.6) else d.array((n - 1,), (n,))
    for name, p, value in (
        ("q0", 0.3, lambda: d.array((4,), (2, 4))),
        ("max_gap", 0.2, lambda: d.real(10.0)),
        ("n_threads", 0.05, d.whole),
        ("dtype", 0.03, lambda: d.one((int, "x", "f2"))),
        ("out", 0.1, lambda: d.one((np.empty((n, 4)), np.empty((n, 4), "f4"), 3, [], "x"))),
        ("increments", 0.05, lambda: d.one((0, None, False))),
    ):
        if d.chance(p):
            options[name] = value()
    names = ("rates", "dt", "q0", "method", "dtype", "n_threads", "max_gap", "out", "increments")
    return Call(fa.integrate_rates, (rates, dt), options, unit, names)
