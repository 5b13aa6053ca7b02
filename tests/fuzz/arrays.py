"""Conversions, products, logs in memory, energies and lists."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

import fastatt as fa
from fuzz.draw import WORDS, Draw
from fuzz.judge import Call, floats, unit

CONVERSIONS: tuple[tuple[Callable[..., Any], tuple[tuple[int, ...], ...], str, str], ...] = (
    (fa.quat_to_dcm, ((4,), (5, 4), (2, 3, 4)), "q", ""),
    (fa.dcm_to_quat, ((3, 3), (2, 3, 3)), "C", ""),
    (fa.euler313_to_quat, ((3,), (2, 3)), "angles", "unit"),
    (fa.quat_to_euler313, ((4,), (2, 4)), "q", "finite"),
    (fa.rotation_vector_to_quat, ((3,), (2, 3)), "u", "unit"),
    (fa.quat_to_rotation_vector, ((4,), (2, 4)), "q", "turn"),
)


def converted(d: Draw) -> Call:
    function, shapes, name, promise = d.one(CONVERSIONS)
    x = d.array(*shapes)

    def judge(result: Any) -> str | None:
        given = floats(x)
        if given is None or not promise:
            return None
        if name == "q" and not np.abs(given).max(-1, initial=0.0).all():
            return None
        if promise == "finite" and unit(given, 1e-3):
            return None
        if promise == "unit":
            return unit(result)
        if not np.isfinite(result).all():
            return "not finite"
        most = np.linalg.norm(result.astype(float), axis=-1).max(initial=0.0)
        return f"{most} rad" if promise == "turn" and most > math.pi * (1.0 + 1e-6) else None

    return Call(function, (x,), {}, judge, (name,))


def combined(d: Draw) -> Call:
    function, names = d.one((
        (fa.quat_multiply, ("p", "q")),
        (fa.quat_rotate, ("q", "v")), (fa.quat_rotate_inverse, ("q", "v")),
        (fa.angle_between, ("a", "b")), (fa.angle_between, ("a", "b")),
    ))  # fmt: skip
    second = (3,) if "v" in names else (4,)
    shapes = ((4,), (2, 4), (3, 1, 4), (3, 3)) if names[0] == "a" else ((4,), (2, 4), (3, 1, 4))
    a = d.array(*shapes)
    b = d.array(second, (2, *second), (1, 2, *second))

    def judge(result: Any) -> str | None:
        given = floats(a), floats(b)
        if names[0] != "a" or any(x is None or x.shape[-1:] != (4,) for x in given):
            return None
        if not all(np.abs(x).max(-1, initial=0.0).all() for x in given):
            return None
        good = np.isfinite(result) & (result >= 0.0) & (result <= math.pi * (1.0 + 1e-6))
        return None if np.all(good) else f"angle {result}"

    return Call(function, (a, b), {}, judge, names)


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
