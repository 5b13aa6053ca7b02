"""Samples beyond the ends of logs, and the incomplete windows there."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.methods.windows import Window

Array = NDArray[Any]


def beyond(
    data: Array, spans: Any, window: Window, increments: bool, missing: int
) -> tuple[Array, Array]:
    """Samples that a window lacks before logs (N, history, 3), and ``missing`` ones after them.

    They are those of the polynomial of the nearest whole window, or of all samples.
    """
    before = after = data[:, :0]
    if not (window.history or missing):
        return before, after
    n, uneven = data.shape[1], isinstance(spans, np.ndarray)
    near = min(window.samples(increments), n)
    inside = near - (not increments)
    # samples that are not finite are refused after the run
    with np.errstate(over="ignore", invalid="ignore"):
        if window.history:
            gaps = spans[:inside][::-1] if uneven else inside
            table = _table(gaps, window.history, increments)[::-1, ::-1]
            before = (table @ data[:, :near]).astype(data.dtype, "C")
        if missing:
            gaps = spans[len(spans) - inside :] if uneven else inside
            table = _table(gaps, missing, increments)
            after = (table @ data[:, n - near :]).astype(data.dtype, "C")
    return before, after


def _table(gaps: Any, n: int, increments: bool) -> Array:
    """Table for ``n`` further samples, spaced as the last ones, from samples with given gaps."""
    if isinstance(gaps, int):
        return _equal(gaps, n, increments)
    gaps = gaps.astype(np.float64)
    nodes = np.concatenate([[0.0], np.cumsum(gaps)])
    return _interpolation(
        nodes, nodes[-1] + gaps[-1] * np.arange(not increments, n + 1), increments
    )


@functools.cache
def _equal(count: int, n: int, increments: bool) -> Array:
    return _table(np.ones(count), n, increments)


def _interpolation(nodes: Array, times: Array, increments: bool) -> Array:
    """Table from samples at nodes to those at other times, or from increments to increments."""
    same = np.eye(len(nodes), dtype=bool)
    ratios = (times[:, None, None] - nodes) / np.where(same, 1.0, nodes[:, None] - nodes)
    lagrange: Array = np.where(same, 1.0, ratios).prod(axis=-1)
    if not increments:
        return lagrange
    # the polynomial of the accumulated angle, which is 0 at the first node
    return np.diff(lagrange[:, 1:] @ np.tri(len(nodes) - 1), axis=0)


def rest(
    data: Array, spans: Any, count: int, window: Window, increments: bool
) -> tuple[Array, Any, Array]:
    """Samples and intervals of a window over the last ``count`` intervals of logs.

    These intervals are divided into as many as the window has. The samples follow from the
    polynomial through the last whole window, or through all samples if there are fewer; beyond the
    end of a log it grows so fast that iterations would not converge. Equal intervals are one
    number. The third result has the positions at which the log's intervals end.
    """
    near = min(window.samples(increments), data.shape[1])
    inside = near - (not increments)
    gaps = (spans[len(spans) - inside :] if np.ndim(spans) else np.full(inside, spans)).astype("f8")
    parts = window.span // count + (np.arange(count) < window.span % count)
    fine = np.repeat(gaps[-count:] / parts, parts)
    nodes = np.concatenate([[0.0], np.cumsum(gaps)])
    times = nodes[-1 - count] + np.concatenate([[0.0], np.cumsum(fine)])
    with np.errstate(over="ignore", invalid="ignore"):  # checked in the result
        table = _interpolation(nodes, times, increments)
        values = table @ np.array(data[:, data.shape[1] - near :], dtype=np.float64, order="C")
        samples = values.astype(data.dtype)
    apart = fine.astype(data.dtype)
    return samples, apart[0] if np.ptp(apart) == 0.0 else apart, parts.cumsum()
