"""Names of curves, written next to the curves where they cover least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import ArrayLike, NDArray

# directions from a point in which a name may stand, the first ones preferred
_SIDES = ((1, 0), (1, -1), (1, 1), (0, -1), (0, 1), (-1, -1), (-1, 1), (-1, 0))
_GAP = 6.0  # pixels between a point and its name
_SPACING = 4.0  # pixels between the points that represent a curve
_MARKER = 5.0  # pixels from a marker's middle to its corners
_EVERY = 4  # of these points a name may stand next to
_CLEAR = 12.0  # pixels around a name within which another curve could be taken for its own
# costs of one pixel of another name, of one point of a curve, of one such point of another curve in
# the clearance, and of one point further from the end
_ON_NAME, _ON_CURVE, _NEAR, _FURTHER = 10.0, 6.0, 2.0, 0.4
_OUTSIDE = 1e6


@dataclass(frozen=True)
class Label:
    """The name of a curve through ``x`` and ``y`` (N,), in data coordinates."""

    name: str
    x: ArrayLike
    y: ArrayLike
    colour: Any
    size: float = 9.0


def write_labels(axes: Any, labels: Sequence[Label]) -> None:
    """Write each name at the end of its curve or, where that is taken, along it.

    Call it when everything is drawn and the axes have their scales and limits. The first names have
    the best places.
    """
    if not labels:
        return
    figure = axes.figure
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    frame = axes.get_window_extent()
    lines = [_pixels(line.get_transform(), *line.get_data()) for line in axes.lines]
    corners = _MARKER * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    marked = [points for points, line in zip(lines, axes.lines, strict=True) if _is_marked(line)]
    markers = [(points[:, None] + corners).reshape(-1, 2) for points in marked]
    curves = np.concatenate([*map(_dense, lines), *markers])
    taken: list[NDArray[np.float64]] = []
    for label in labels:
        own = _dense(_pixels(axes.transData, label.x, label.y))
        if not len(own):
            continue
        text = axes.text(
            0.0, 0.0, label.name, transform=axes.transAxes, fontsize=label.size,
            color=label.colour, ha="center", va="center", zorder=5,
            path_effects=[patheffects.withStroke(linewidth=2.5, foreground="white")],
        )  # fmt: skip
        text.set_in_layout(False)
        extent = text.get_window_extent()
        half = 0.5 * np.array([extent.width, extent.height])
        away = np.abs(curves[:, None] - own).max(axis=2).min(axis=1) > 1.0
        best = _best_place(own[::-1], half, curves, curves[away], taken, frame)
        taken.append(np.concatenate([best - half, best + half]))
        # in fractions of the panel: figures are saved at another resolution
        text.set_position((best - frame.p0) / (frame.p1 - frame.p0))


def _is_marked(line: Any) -> bool:
    return line.get_marker() not in {"", "None", None}


def _pixels(transform: Any, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Points (N, 2) of data as they lie in the figure."""
    points = np.stack([x, y], axis=1, dtype=np.float64)
    with np.errstate(all="ignore"):
        return np.asarray(transform.transform(points))


def _dense(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points on a polyline, no further apart than ``_SPACING``."""
    found = [points[np.isfinite(points).all(axis=1)][:1]]
    for a, b in pairwise(points):
        if np.isfinite([a, b]).all():
            n = max(1, int(np.hypot(*(b - a)) / _SPACING))
            found.append(a + (b - a) * np.linspace(0.0, 1.0, n + 1)[1:, None])
    return np.concatenate(found)


def _best_place(
    points: NDArray[np.float64],
    half: NDArray[np.float64],
    curves: NDArray[np.float64],
    others: NDArray[np.float64],
    taken: Sequence[NDArray[np.float64]],
    frame: Any,
) -> NDArray[np.float64]:
    """The centre of a box of half sizes ``half`` next to one of the points, the cheapest one."""
    found, least = points[0], np.inf
    for k, point in enumerate(points):
        if k % _EVERY:
            continue
        for rank, side in enumerate(_SIDES):
            centre = point + np.array(side) * (half + _GAP / np.hypot(*side))
            low, high = centre - half, centre + half
            cost = _FURTHER * k + 0.5 * rank
            if (low < frame.p0 + 2.0).any() or (high > frame.p1 - 2.0).any():
                cost += _OUTSIDE
            cost += _ON_CURVE * _inside(curves, low - 1.0, high + 1.0)
            cost += _NEAR * _inside(others, low - _CLEAR, high + _CLEAR)
            for box in taken:
                common = np.minimum(high, box[2:]) - np.maximum(low, box[:2]) + 2.0
                if (common > 0.0).all():
                    cost += _ON_NAME * common.prod()
            if cost < least:
                found, least = centre, cost
    return np.asarray(found)


def _inside(points: NDArray[Any], low: NDArray[Any], high: NDArray[Any]) -> int:
    """How many points (N, 2) lie in a box."""
    return int(np.count_nonzero(((points > low) & (points < high)).all(axis=1)))
