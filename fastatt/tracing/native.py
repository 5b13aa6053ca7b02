"""Shorter forms of some kernels: bit operations, fused operations, and sines of phases."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from fastatt._jit import plain
from fastatt.kernels import trig
from fastatt.tracing.graph import (
    Double,
    Number,
    Single,
    apply,
    choose,
    composed_of,
    flattened,
    recorded,
)


def _powers_of_two(k: Any) -> tuple[Any, Any]:
    return apply("power_of_two", k), apply("power_of_two", -k)


def _octaves(a: Any, b: Any) -> tuple[Any, Any]:
    n = apply("exponent", a) - apply("exponent", b)
    return n, apply("power_of_two", n) * b


def _scale(x: Any) -> tuple[Any, Any]:
    from fastatt.kernels import free_body

    n = choose(x < free_body.least_scaled(x.rounded(free_body.TINY)), -1.0, apply("exponent", x))
    return apply("power_of_two", -1.0 - n), apply("power_of_two", n + 1.0)


def _normalise(q: tuple[Any, ...]) -> tuple[Any, ...]:
    size = abs(q[0])
    for x in q[1:]:
        size = choose(abs(x) > size, abs(x), size)
    n, least = apply("exponent", size), -1000.0 if size.precision == "double" else -100.0
    s = apply("power_of_two", 1.0 - choose(n < least, least, n))
    q = tuple(s * x for x in q)
    s = 1.0 / apply("sqrt", sum(x * x for x in q))
    return tuple(s * x for x in q)


def _split_product(a: Any, b: Any) -> tuple[Any, Any]:
    high = a * b
    return high, recorded(a.graph, "fms", a.precision, a.at, b.at, high.at)


def _in_machine_code(formula: Callable[..., Any]) -> Callable[..., Any]:
    """The formula in graphs that are for machine code only; None in any other."""

    def shorter(*args: Any) -> Any:
        numbers = flattened(args)
        is_native = all(isinstance(x, Number) and x.graph.native for x in numbers)
        return formula(*args) if is_native else None

    return shorter


def _of_phase(x: Any) -> tuple[Any, Any] | None:
    """``trig.sincos`` in single precision, for which only the angle needs double precision.

    None unless the angle grows with time and its sine is needed in single precision.
    """
    if not (isinstance(x, Double) and x.graph.narrow and x.graph.of_time(x.at)[0]):
        return None
    quarters = x * (2.0 / math.pi)
    k = apply("rint", quarters)
    r = Single(quarters - k) * (0.5 * math.pi)
    s, c = plain(trig.short_waves)(r, r * r)
    C, S = plain(trig.within_a_turn)(Single(k - 4.0 * apply("rint", 0.25 * k)))
    return s * C + c * S, c * C - s * S


#: functions that are at least as accurate as a kernel, by its module and its name; they return None
#: where they don't apply
_SHORTER: dict[tuple[str, str], Callable[..., Any]] = {
    ("fastatt.kernels.trig", "powers_of_two"): _in_machine_code(_powers_of_two),
    ("fastatt.kernels.trig", "octaves"): _in_machine_code(_octaves),
    ("fastatt.kernels.free_body", "scale"): _in_machine_code(_scale),
    ("fastatt.kernels.free_body", "split_product"): _in_machine_code(_split_product),
    ("fastatt.kernels.quat", "normalise"): _in_machine_code(_normalise),
    ("fastatt.kernels.trig", "sincos"): _of_phase,
}


def called(formula: Callable[..., Any], function: Any, args: tuple[Any, ...]) -> Any:
    """``formula(*args)``, the traced form of ``function``, or a shorter equivalent."""
    composed = composed_of(*args)
    if composed is not None:
        return composed.called(formula, function, args)
    shorter = _SHORTER.get((function.__module__, function.__name__))
    result = None if shorter is None else shorter(*args)
    return formula(*args) if result is None else result
