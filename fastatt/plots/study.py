"""Pictures of studies of methods: error against time, and drift against time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from fastatt.plots.drawing import save, styles_of

#: representations as titles of panels
NAMES = {"quat": "quaternion", "dcm": "matrix (DCM)"}
# drawn in place of smaller values and 0, which a logarithmic axis cannot show
_FLOOR = 1e-17
_TICKS = 8  # the most labels of an axis
_HANDLE, _LETTER = 0.7, 0.1  # inches of a legend's line and letter


@dataclass(frozen=True)
class Curve:
    """One method's values; ``leads`` is false where others are better everywhere.

    Panels have a row for each quantity and what it is drawn against, by their labels, and a column
    for each representation.
    """

    quantity: str
    against: str
    representation: str
    method: str
    x: Sequence[float]
    y: Sequence[float]
    leads: bool = True


def draw(curves: Sequence[Curve], heading: str, path: str | Path) -> None:
    """Draw curves on logarithmic axes, which the panels of a row share.

    Methods that lead nowhere are pale.
    """
    quantities = list(dict.fromkeys((x.quantity, x.against) for x in curves)) or [("", "")]
    names = list(dict.fromkeys(curve.representation for curve in curves)) or [""]
    size = 5.6 * len(names) + 0.6, 4.2 * len(quantities) + 1.6
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(heading)
    grid = figure.subplots(len(quantities), len(names), sharex="row", sharey="row", squeeze=False)
    for axes, place in zip(grid.ravel(), product(quantities, names), strict=True):
        (quantity, against), name = place
        axes.set(xscale="log", yscale="log", title=NAMES.get(name, name), xlabel=against)
        axes.grid(visible=True, alpha=0.3)
        shown = quantity, against, name
        drawn = [x for x in curves if (x.quantity, x.against, x.representation) == shown]
        styles = styles_of([curve.method for curve in drawn])
        for curve in sorted(drawn, key=lambda curve: curve.leads):
            pale = {"lw": 0.8, "ms": 3.5, "alpha": 0.45} if not curve.leads else {}
            y = np.maximum(np.asarray(curve.y, dtype=np.float64), _FLOOR)
            every = max(1, len(y) // 8)
            axes.plot(
                curve.x, y, **styles[curve.method] | pale, markevery=every, label=curve.method
            )
    for (label, _), row in zip(quantities, grid, strict=True):
        row[0].set_ylabel(label)
        _limits(row)
    _legend(figure)
    save(figure, path)


def _limits(row: Any) -> None:
    """Limits of the axes that a row of panels shares: one decade at least, with few labels."""
    lines = [line for axes in row for line in axes.lines]
    for k, name in enumerate("xy"):
        values = np.concatenate([line.get_data()[k] for line in lines] or [[1.0]])
        low, high = values.min(), values.max()
        middle = 0.5 * max(0.0, 1.0 - np.log10(high / low))
        ends = low / 10.0 ** (middle + 0.1), high * 10.0 ** (middle + 0.1)
        row[0].set(**{f"{name}lim": ends})
        axis = getattr(row[0], f"{name}axis")
        axis.set_major_locator(LogLocator(numticks=_TICKS))
        axis.set_minor_formatter(NullFormatter())


def _legend(figure: Figure) -> None:
    """One legend below all panels."""
    lines = [line for axes in figure.axes for line in axes.lines]
    # the legend shows the thickest curve of each method
    named = {str(line.get_label()): line for line in sorted(lines, key=lambda x: x.get_linewidth())}
    named = {name: named[name] for name in styles_of(list(named))}
    # as many columns as fit into the width
    inches = _HANDLE + _LETTER * max(map(len, named), default=0)
    columns = max(1, int(figure.get_figwidth() / inches))
    below: dict[str, Any] = {"loc": "outside lower center", "ncols": columns, "frameon": False}
    figure.legend(named.values(), named, **below)
