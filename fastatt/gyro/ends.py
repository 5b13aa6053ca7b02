"""Samples beyond the ends of logs, and the windows that logs end within."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.gyro.windows import Window

Array = NDArray[Any]


def beyond(data: Array, spans: Any, window: Window, increments: bool) -> tuple[Array, Array]:
    """Samples (N, k, 3) before and after logs, by the polynomial of the nearest whole window."""
    return before(data, spans, window, increments), after(data, spans, window, increments)


def before(data: Array, spans: Any, window: Window, increments: bool) -> Array:
    """Samples before logs that begin with ``data (N, n, 3)``, as many as a window looks back."""
    near = min(window.samples(increments), data.shape[1])
    gaps = spans[: near - (not increments)][::-1] if np.ndim(spans) else near - (not increments)
    return _applied(gaps, window.history, increments, data[:, :near], -1)


def after(data: Array, spans: Any, window: Window, increments: bool) -> Array:
    """Samples after logs that end with ``data (N, n, 3)``, to the end of a window."""
    near = min(window.samples(increments), data.shape[1])
    count = data.shape[1] - (not increments)
    missing = 0 if window.iteration else -count % window.span
    gaps = spans[count - near + (not increments) :] if np.ndim(spans) else near - (not increments)
    return _applied(gaps, missing, increments, data[:, data.shape[1] - near :], 1)


def _applied(gaps: Any, n: int, increments: bool, samples: Array, step: int) -> Array:
    """``n`` further samples; one of zeros where none is needed."""
    if not n:
        return np.zeros((len(samples), 1, 3), dtype=samples.dtype)
    table = _equal(gaps, n, increments) if isinstance(gaps, int) else _table(gaps, n, increments)
    # a copy, so that a part of a log gives the bits of the whole
    near = np.array(samples, dtype=np.float64, order="C")
    return np.ascontiguousarray(table[::step, ::step] @ near, dtype=samples.dtype)


@functools.cache
def _equal(count: int, n: int, increments: bool) -> Array:
    return _table(np.ones(count), n, increments)


def _table(gaps: Array, n: int, increments: bool) -> Array:
    """What gives ``n`` further samples, spaced as the last, from those with ``gaps`` between."""
    gaps = gaps.astype(np.float64)
    nodes = np.concatenate([[0.0], np.cumsum(gaps)])
    return _interpolation(
        nodes, nodes[-1] + gaps[-1] * np.arange(not increments, n + 1), increments
    )


def _interpolation(nodes: Array, at: Array, increments: bool) -> Array:
    """Table from samples at nodes to those at other instants, or from increments to increments."""
    same = np.eye(len(nodes), dtype=bool)
    ratios = (at[:, None, None] - nodes) / np.where(same, 1.0, nodes[:, None] - nodes)
    lagrange: Array = np.where(same, 1.0, ratios).prod(axis=-1)
    if not increments:
        return lagrange
    # the polynomial is that of the running angle, from 0 at the first node
    return np.diff(lagrange[:, 1:] @ np.tri(len(nodes) - 1), axis=0)


def rest(
    data: Array, spans: Any, count: int, window: Window, increments: bool
) -> tuple[Array, Any, Array]:
    """Samples and intervals of a window over the last ``count`` intervals of logs.

    They are cut into as many as it has; the samples are those of the polynomial through the last
    whole window, or all there is: beyond a log's end it is soon so large that no iteration holds
    it. Equal intervals are one number. The third are the places where the logs' own intervals end.
    """
    near = min(window.samples(increments), data.shape[1])
    inside = near - (not increments)
    gaps = (spans[len(spans) - inside :] if np.ndim(spans) else np.full(inside, spans)).astype("f8")
    parts = window.span // count + (np.arange(count) < window.span % count)
    fine = np.repeat(gaps[-count:] / parts, parts)
    nodes = np.concatenate([[0.0], np.cumsum(gaps)])
    at = nodes[-1 - count] + np.concatenate([[0.0], np.cumsum(fine)])
    with np.errstate(over="ignore", invalid="ignore"):  # looked at in the result
        table = _interpolation(nodes, at, increments)
        values = table @ np.array(data[:, data.shape[1] - near :], dtype=np.float64, order="C")
        samples = values.astype(data.dtype)
    apart = fine.astype(data.dtype)
    return samples, apart[0] if np.ptp(apart) == 0.0 else apart, parts.cumsum()
