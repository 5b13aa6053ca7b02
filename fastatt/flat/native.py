"""Kernels that are an instruction or two in machine code: on bits, and of fused multiplications."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fastatt.flat.graph import _made, apply, choose
from fastatt.kernels import free_body, quat, trig


def _powers_of_two(k: Any) -> tuple[Any, Any]:
    return apply("power_of_two", k), apply("power_of_two", -k)


def _octaves(a: Any, b: Any) -> tuple[Any, Any]:
    n = apply("exponent", a) - apply("exponent", b)
    return n, apply("power_of_two", n) * b


def _scale(x: Any) -> tuple[Any, Any]:
    n = choose(x < free_body.least_scaled(x.rounded(1e-290)), -1.0, apply("exponent", x))
    return apply("power_of_two", -1.0 - n), apply("power_of_two", n + 1.0)


def _normalise(q: tuple[Any, ...]) -> tuple[Any, ...]:
    size = abs(q[0])
    for x in q[1:]:
        size = choose(abs(x) > size, abs(x), size)
    n, least = apply("exponent", size), -1000.0 if size.kind == "double" else -100.0
    s = apply("power_of_two", 1.0 - choose(n < least, least, n))
    q = tuple(s * x for x in q)
    s = 1.0 / apply("sqrt", sum(x * x for x in q))
    return tuple(s * x for x in q)


def _split_product(a: Any, b: Any) -> tuple[Any, Any]:
    high = a * b
    return high, _made(a.graph, "fms", a.kind, a.at, b.at, high.at)


#: what they give instead: as much, or more of it
INSTRUCTIONS: dict[Any, Callable[..., Any]] = {
    trig.powers_of_two: _powers_of_two,
    trig.octaves: _octaves,
    free_body.scale: _scale,
    free_body.split_product: _split_product,
    quat.normalise: _normalise,
}
