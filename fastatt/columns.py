"""Straight-line code on a column of a tile: load it as a tuple, store it, combine tuples.

A loop over a tuple leaves an indexed copy on the stack that stops LLVM's vectoriser, so the
few lines are written out for each length.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from numba import types

from fastatt._jit import hook


def load(a: Any, i: Any, j: Any, n: Any) -> Any:
    """(a[i, j], …, a[i+n−1, j]); n is the length of the tuple n, whose values are not used."""
    return tuple(a[i + k, j] for k in range(len(n)))


def store(a: Any, i: Any, j: Any, x: Any) -> None:
    """a[i + k, j] = x[k]."""
    for k, v in enumerate(x):
        a[i + k, j] = v


def unpack(a: Any, n: Any) -> Any:
    """(a[0], …, a[n−1]) with n as for ``load``."""
    return tuple(a[i] for i in range(len(n)))


def repeat(x: Any, n: Any) -> Any:
    """(x, …, x) with n as for ``load``."""
    return (x,) * len(n)


def axpy(k: Any, x: Any, y: Any) -> Any:
    """k x + y."""
    return tuple(k * a + b for a, b in zip(x, y, strict=True))


def select(condition: Any, x: Any, y: Any) -> Any:
    """x where the condition holds, else y."""
    return x if condition else y


def scale(k: Any, x: Any) -> Any:
    """k x."""
    return tuple(k * a for a in x)


def plus(x: Any, y: Any) -> Any:
    """x + y."""
    return tuple(a + b for a, b in zip(x, y, strict=True))


def largest(x: Any, y: Any) -> Any:
    """Of each two numbers the larger in size."""
    return tuple(a if abs(a) > abs(b) else b for a, b in zip(x, y, strict=True))


def weighted(h: Any, weights: Any, ks: Any) -> Any:
    """h Σ weights[i] ks[i]; a weight is a Python float and takes the type of h."""
    return tuple(
        h * sum(w * k[i] for w, k in zip(weights, ks, strict=True)) for i in range(len(ks[0]))
    )


def combine(h: Any, weights: Any, ks: Any, y: Any) -> Any:
    """y + h Σ weights[i] ks[i]; a weight is a Python float and takes the type of h."""
    return plus(y, weighted(h, weights, ks))


@cache
def _written_out(signature: str, item: str, n: int, first: str = "pass") -> Any:
    items = ", ".join(item.replace("{i}", str(i)) for i in range(n))
    source = (
        f"def straight({signature}):\n    {first}\n    return ({items}{',' if n == 1 else ''})\n"
    )
    scope: dict[str, Any] = {}
    exec(source, scope)
    return scope["straight"]


@cache
def _stores(n: int) -> Any:
    lines = "".join(f"    a[i + {k}, j] = x[{k}]\n" for k in range(n)) or "    pass\n"
    scope: dict[str, Any] = {}
    exec(f"def straight(a, i, j, x):\n{lines}", scope)
    return scope["straight"]


@hook(load)
def _load(a: types.Type, i: types.Type, j: types.Type, n: types.BaseTuple) -> Any:
    return _written_out("a, i, j, n", "a[i + {i}, j]", len(n))


@hook(unpack)
def _unpack(a: types.Type, n: types.BaseTuple) -> Any:
    return _written_out("a, n", "a[{i}]", len(n))


@hook(repeat)
def _repeat(x: types.Type, n: types.BaseTuple) -> Any:
    return _written_out("x, n", "x", len(n))


@hook(store)
def _store(a: types.Type, i: types.Type, j: types.Type, x: types.BaseTuple) -> Any:
    return _stores(len(x))


@hook(axpy)
def _axpy(k: types.Type, x: types.BaseTuple, y: types.BaseTuple) -> Any:
    return _written_out("k, x, y", "k * x[{i}] + y[{i}]", len(x))


@hook(select)
def _select(condition: types.Type, x: types.BaseTuple, y: types.BaseTuple) -> Any:
    return _written_out("condition, x, y", "x[{i}] if condition else y[{i}]", len(x))


@hook(scale)
def _scale(k: types.Type, x: types.BaseTuple) -> Any:
    return _written_out("k, x", "k * x[{i}]", len(x))


@hook(plus)
def _plus(x: types.BaseTuple, y: types.BaseTuple) -> Any:
    return _written_out("x, y", "x[{i}] + y[{i}]", len(x))


@hook(largest)
def _largest(x: types.BaseTuple, y: types.BaseTuple) -> Any:
    return _written_out("x, y", "x[{i}] if abs(x[{i}]) > abs(y[{i}]) else y[{i}]", len(x))


@hook(weighted)
def _weighted(h: types.Type, weights: types.BaseTuple, ks: types.BaseTuple) -> Any:
    terms = " + ".join(f"F(weights[{i}]) * ks[{i}][{{i}}]" for i in range(len(ks)))
    return _written_out("h, weights, ks", f"h * ({terms})", len(ks[0]), "F = type(h)")


@hook(combine)
def _combine(
    h: types.Type, weights: types.BaseTuple, ks: types.BaseTuple, y: types.BaseTuple
) -> Any:
    return lambda h, weights, ks, y: plus(y, weighted(h, weights, ks))
