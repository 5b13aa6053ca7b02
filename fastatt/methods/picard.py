"""Picard: six intervals at a time, with the kinematic equation iterated on Gauss nodes.

A polynomial through the samples gives the rate at six Gauss nodes, where q ← 1 + ½∫q∘w is iterated.
The attitudes at the samples follow from a Legendre series, which keeps digits that powers of t
lose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import legendre

from fastatt.methods.samples import sampled_method
from fastatt.methods.windows import Iteration, Window
from fastatt.tracing.formulas import Vector, dot, quat, scale

SPAN = 6
# at the limits, noise takes some 70 passes, since its polynomial overshoots; a cone takes 20 or 30
PASSES = 128


def _collocation() -> tuple[Any, Any, Any]:
    """Gauss nodes on [0, 1], integration up to them, and Legendre coefficients from values."""
    x, w = legendre.leggauss(SPAN)
    values = legendre.legvander(x, SPAN)
    coefficients = (values[:, :SPAN] * w[:, None] * (np.arange(SPAN) + 0.5)).T
    k = np.arange(1, SPAN)
    rest = (values[:, 2:] - values[:, :-2]) / (4.0 * k + 2.0)
    integrals = np.concatenate([0.5 * (values[:, 1:2] + 1.0), rest], axis=1)
    return 0.5 * (x + 1.0), integrals @ coefficients, coefficients


def _table(values: Any) -> tuple[Vector, ...]:
    return tuple(map(tuple, values.tolist()))


_NODES, _INTEGRATION, _COEFFICIENTS = _collocation()
NODES: Vector = tuple(_NODES.tolist())
INTEGRATION, COEFFICIENTS = _table(_INTEGRATION), _table(_COEFFICIENTS)
# the state: T w/2 at the nodes, with the length T of the window, the attitudes there,
_RATES = 3 * SPAN
_ATTITUDES = _RATES + 4 * SPAN
# and the ends of the intervals as shares of T


def _parts(x: Vector, size: int) -> list[Vector]:
    return [x[i : i + size] for i in range(0, len(x), size)]


def _flat(vectors: list[Vector]) -> Vector:
    return tuple(x for vector in vectors for x in vector)


def _combined(table: tuple[Vector, ...], vectors: list[Vector]) -> list[Vector]:
    """A table over the nodes, applied to vectors there."""
    axes = list(zip(*vectors, strict=True))
    return [tuple(dot(row, axis) for axis in axes) for row in table]


def _instants(h: Vector) -> tuple[Any, Vector]:
    """T, and the times of the samples since the start of the window as shares of it."""
    times = [0.0]
    for interval in h:
        times.append(times[-1] + interval)
    return times[-1], (0.0, *(t / times[-1] for t in times[1:-1]), 1.0)


def _fitted(values: list[Any], instants: Vector) -> list[tuple[Any, Any]]:
    """(value, derivative) at each node of Newton's polynomial through values at given times."""
    d = list(values)
    for level in range(1, SPAN + 1):
        for i in range(SPAN, level - 1, -1):
            d[i] = (d[i] - d[i - 1]) / (instants[i] - instants[i - level])
    columns = []
    for node in NODES:
        p, slope = d[SPAN], 0.0
        for i in reversed(range(SPAN)):
            s = node - instants[i]
            slope = slope * s + p
            p = p * s + d[i]
        columns.append((p, slope))
    return columns


def rates(v: Vector, h: Vector) -> Vector:
    """The first state, from rates (rad/s)."""
    total, instants = _instants(h)
    axes = [_fitted([v[3 * i + axis] for i in range(SPAN + 1)], instants) for axis in range(3)]
    half = 0.5 * total
    return _begun([tuple(half * p for p, _ in node) for node in zip(*axes, strict=True)], instants)


def increments(v: Vector, h: Vector) -> Vector:
    """The first state, from increments (rad), whose polynomial has the derivative T w."""
    _, instants = _instants(h)
    axes = []
    for axis in range(3):
        running = [0.0]
        for i in range(SPAN):
            running.append(running[-1] + v[3 * i + axis])
        axes.append(_fitted(running, instants))
    return _begun([tuple(0.5 * d for _, d in node) for node in zip(*axes, strict=True)], instants)


def _begun(half_angles: list[Vector], instants: Vector) -> Vector:
    """The first state, with attitudes without coning: exponentials of the rates' integral."""
    turns = [scale(2.0, u) for u in _combined(INTEGRATION, half_angles)]
    return (*_flat(half_angles), *_flat([quat.exp(u) for u in turns]), *instants[1:-1])


def _slopes(state: Vector) -> list[Vector]:
    """T q̇ at the nodes."""
    attitudes, half_angles = _parts(state[_RATES:_ATTITUDES], 4), _parts(state[:_RATES], 3)
    return [quat.mul_vector(q, u) for q, u in zip(attitudes, half_angles, strict=True)]


def improve(state: Vector) -> Vector:
    """One pass: q ← 1 + ∫q̇ at the nodes."""
    integrals = _combined(INTEGRATION, _slopes(state))
    attitudes = [(1.0 + q0, *q) for q0, *q in integrals]
    return (*state[:_RATES], *_flat(attitudes), *state[_ATTITUDES:])


def read(state: Vector) -> Vector:
    """Attitudes at the ends of the intervals, from the Legendre series of the derivative."""
    series = list(zip(*_combined(COEFFICIENTS, _slopes(state)), strict=True))
    attitudes = []
    for t in (*state[_ATTITUDES:], 1.0):
        q = [dot(_integrals(t), axis) for axis in series]
        attitudes.append(quat.normalise((1.0 + q[0], *q[1:])))
    return _flat(attitudes)


def _integrals(t: Any) -> Vector:
    """Integrals to t of the Legendre polynomials shifted to [0, 1].

    With x = 2t − 1 they are (x + 1)/2, then (P_{k+1} − P_{k−1})/(4k + 2).
    """
    x = 2.0 * t - 1.0
    p = [1.0, x]
    for k in range(1, SPAN):
        p.append(((2 * k + 1) * x * p[k] - k * p[k - 1]) / (k + 1))
    return (t, *((p[k + 1] - p[k - 1]) / (4 * k + 2) for k in range(1, SPAN)))


METHOD = sampled_method(
    Window(
        history=0,
        span=SPAN,
        iteration=Iteration(rates, increments, improve, read, PASSES),
        uneven=2.0,
    ),
    name="picard",
    order=8,
    of_rates=1.0,
    of_increments=0.5,
    summary="six intervals at a time, iterated to rounding; least error for data without noise",
    source="Wu, IEEE Trans. AES 54 (2018) 735 (RodFIter); Hairer, Lubich, Wanner, §II.1.2",
)
