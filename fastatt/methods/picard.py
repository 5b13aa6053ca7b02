"""Picard: six intervals at a time, the kinematic equation iterated on Gauss nodes.

A polynomial through the samples gives the rate at six Gauss nodes; q ← 1 + ½∫q∘w is iterated there,
and read off at the instants in a Legendre basis, which keeps the digits that powers of t lose.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre

from fastatt._jit import helper
from fastatt.columns import load, store
from fastatt.kernels import quat
from fastatt.kernels.vec3 import scale
from fastatt.methods.sampled import Window, sampled_method

SPAN = 6
# the start is right but for coning; each pass k takes off a factor |w|T/2k: 1e-15 at |w|T = 1
PASSES = 12


class Picard(NamedTuple):
    """Tag."""


def _collocation() -> tuple[Any, Any, Any]:
    """Gauss nodes on [0, 1], integration up to them, and Legendre coefficients from values."""
    x, w = legendre.leggauss(SPAN)
    values = legendre.legvander(x, SPAN)
    coefficients = (values[:, :SPAN] * w[:, None] * (np.arange(SPAN) + 0.5)).T
    k = np.arange(1, SPAN)
    rest = (values[:, 2:] - values[:, :-2]) / (4.0 * k + 2.0)
    integrals = np.concatenate([0.5 * (values[:, 1:2] + 1.0), rest], axis=1)
    return 0.5 * (x + 1.0), integrals @ coefficients, coefficients


NODES, INTEGRATION, COEFFICIENTS = _collocation()
_ROTATION_VECTOR = (0.0, 0.0, 0.0)
_QUATERNION = (0.0, 0.0, 0.0, 0.0)
_RATES = 0  # rows of the workspace: rates at the nodes,
_STATES = _RATES + 3 * SPAN  # attitudes at the nodes,
_SLOPES = _STATES + 4 * SPAN  # their derivatives,
_SERIES = _SLOPES + 4 * SPAN  # Legendre coefficients of those,
_DIFFERENCES = _SERIES + 4 * SPAN  # divided differences of one axis,
_INSTANTS = _DIFFERENCES + SPAN + 1  # and the instants from the start of the window
WORK_ROWS = _INSTANTS + SPAN + 1


@helper
def newton(work, j, node, is_rates):
    """The fitted rate at a node from the divided differences: the polynomial or its derivative."""
    F = type(work[0, 0])
    t = F(NODES[node]) * work[_INSTANTS + SPAN, j]
    p = work[_DIFFERENCES + SPAN, j]
    d = F(0.0)
    for i in range(SPAN - 1, -1, -1):
        s = t - work[_INSTANTS + i, j]
        d = d * s + p
        p = p * s + work[_DIFFERENCES + i, j]
    return p if is_rates else d


@helper
def fit(is_rates, v, base, h, first, work, lanes):
    """Rates at the nodes from the samples in rows ``base`` of v and intervals ``first`` of h."""
    F = type(work[0, 0])
    for j in range(lanes):
        work[_INSTANTS, j] = F(0.0)
    for i in range(SPAN):
        for j in range(lanes):
            work[_INSTANTS + i + 1, j] = work[_INSTANTS + i, j] + h[first + i, j]
    for axis in range(3):
        for j in range(lanes):
            work[_DIFFERENCES, j] = v[base + axis, j] if is_rates else F(0.0)
        for i in range(SPAN):
            for j in range(lanes):
                running = work[_DIFFERENCES + i, j] + v[base + 3 * i + axis, j]
                sample = v[base + (3 * i + 3 if is_rates else 0) + axis, j]
                work[_DIFFERENCES + i + 1, j] = sample if is_rates else running
        for level in range(1, SPAN + 1):
            for i in range(SPAN, level - 1, -1):
                for j in range(lanes):
                    gap = work[_INSTANTS + i, j] - work[_INSTANTS + i - level, j]
                    rise = work[_DIFFERENCES + i, j] - work[_DIFFERENCES + i - 1, j]
                    work[_DIFFERENCES + i, j] = rise / gap
        for node in range(SPAN):
            for j in range(lanes):
                work[_RATES + 3 * node + axis, j] = newton(work, j, node, is_rates)


@helper
def combine(work, table, row, source, target, lanes):
    """Row ``row`` of a table over the nodes, applied to quaternions at the nodes."""
    F = type(work[0, 0])
    for c in range(4):
        for j in range(lanes):
            total = F(0.0)
            for k in range(SPAN):
                total += F(table[row, k]) * work[source + 4 * k + c, j]
            work[target + c, j] = total


@helper
def slopes(work, lanes):
    """T q̇ at the nodes, T the length of the window."""
    for node in range(SPAN):
        for j in range(lanes):
            q = load(work, _STATES + 4 * node, j, _QUATERNION)
            w = load(work, _RATES + 3 * node, j, _ROTATION_VECTOR)
            d = quat.derivative(q, scale(work[_INSTANTS + SPAN, j], w))
            store(work, _SLOPES + 4 * node, j, d)


@helper
def tile(is_rates, v, base, h, first, out, row, work, lanes):
    """Attitudes at the six instants, rows row + 4 … of ``out``, from the one in row ``row``."""
    F = type(work[0, 0])
    fit(is_rates, v, base, h, first, work, lanes)
    # without coning: the exponential of the rates' integral
    for node in range(SPAN):
        for j in range(lanes):
            x = F(0.0)
            y = F(0.0)
            z = F(0.0)
            for k in range(SPAN):
                a = F(INTEGRATION[node, k]) * work[_INSTANTS + SPAN, j]
                x += a * work[_RATES + 3 * k, j]
                y += a * work[_RATES + 3 * k + 1, j]
                z += a * work[_RATES + 3 * k + 2, j]
            store(work, _STATES + 4 * node, j, quat.exp((x, y, z)))
    for _ in range(PASSES):
        slopes(work, lanes)
        for node in range(SPAN):
            combine(work, INTEGRATION, node, _SLOPES, _STATES + 4 * node, lanes)
            for j in range(lanes):
                work[_STATES + 4 * node, j] += F(1.0)
    slopes(work, lanes)
    for k in range(SPAN):
        combine(work, COEFFICIENTS, k, _SLOPES, _SERIES + 4 * k, lanes)
    for i in range(1, SPAN + 1):
        for j in range(lanes):
            x = F(2.0) * work[_INSTANTS + i, j] / work[_INSTANTS + SPAN, j] - F(1.0)
            # ∫ of the shifted Legendre polynomials: (x + 1)/2, then (P_{k+1} − P_{k−1})/(4k + 2)
            before = F(1.0)
            now = x
            weight = F(0.5) * (x + F(1.0))
            q0 = F(1.0)
            q1 = F(0.0)
            q2 = F(0.0)
            q3 = F(0.0)
            for k in range(SPAN):
                q0 += weight * work[_SERIES + 4 * k, j]
                q1 += weight * work[_SERIES + 4 * k + 1, j]
                q2 += weight * work[_SERIES + 4 * k + 2, j]
                q3 += weight * work[_SERIES + 4 * k + 3, j]
                n = F(k + 1)
                after = ((n + n + F(1.0)) * x * now - n * before) / (n + F(1.0))
                weight = (after - before) / (F(4.0) * n + F(2.0))
                before = now
                now = after
            q = quat.mul(load(out, row, j, _QUATERNION), quat.normalise((q0, q1, q2, q3)))
            store(out, row + 4 * i, j, q)


METHOD = sampled_method(
    Picard(),
    Window(history=0, span=SPAN, tile=tile, work_rows=WORK_ROWS),
    name="picard",
    order=8,
    exponentials=1,
    of_rates=1.0,
    of_increments=1.2,
    summary="six intervals at a time, iterated to round-off; for clean data and large turns",
    source="Wu, IEEE Trans. AES 54 (2018) 735 (RodFIter); Hairer, Lubich, Wanner, §II.1.2",
)
