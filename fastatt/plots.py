"""Pictures with matplotlib, drawn to files without a display."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

# Okabe and Ito's colours, told apart by colour-blind readers; markers tell them apart in grey
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#999999")
_MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*")
_LINES = {"quat": "-", "dcm": ":"}


@dataclass(frozen=True)
class Ladder:
    """One method's errors (rad) against its times per body (s) over a ladder of steps."""

    method: str
    representation: str
    seconds: Sequence[float]
    errors: Sequence[float]


@dataclass(frozen=True)
class Departures:
    """One recording: each method's angle (deg) from the reference over time (s)."""

    title: str
    t: NDArray[Any]
    methods: Mapping[str, NDArray[Any]]
    maker: NDArray[Any] | None


def work_precision(
    panels: Mapping[str, Sequence[Ladder]],
    frontiers: Mapping[str, Ladder],
    t_end: float,
    path: Path,
) -> None:
    """Error against time per body, both logarithmic, a panel for each kind of input."""
    figure = Figure(figsize=(6 * len(panels), 5.6), layout="constrained")
    drawn = np.atleast_1d(figure.subplots(1, len(panels), sharey=True))
    for axes, (title, ladders) in zip(drawn, panels.items(), strict=True):
        styles = _styles([ladder.method for ladder in ladders])
        for ladder in ladders:
            x = np.array(ladder.seconds) * 1e6
            label = ladder.method if ladder.representation == "quat" else None
            line = _LINES[ladder.representation]
            axes.plot(x, ladder.errors, line, label=label, **styles[ladder.method])
        best = frontiers[title]
        x = np.array(best.seconds) * 1e6
        axes.plot(x, best.errors, color="k", lw=7, alpha=0.12, label="frontier", zorder=0)
        if any(ladder.representation == "dcm" for ladder in ladders):
            axes.plot([], [], "k-", lw=1.4, label="quaternion")
            axes.plot([], [], "k:", lw=1.4, label="matrix")
        axes.set(xscale="log", yscale="log", title=title)
        axes.set_xlabel(f"time per body for {t_end:g} s of motion, µs")
        axes.grid(visible=True, alpha=0.3)
        axes.legend(fontsize=8, ncols=2)
    drawn[0].set_ylabel("attitude error, median over bodies, rad")
    figure.suptitle("Ensemble of coning bodies: what accuracy costs")
    _save(figure, path)


def recordings(logs: Sequence[Departures], reference: str, path: Path) -> None:
    """Each method's angle from the reference over time, a panel for each recording."""
    columns = min(2, len(logs))
    lines = -(-len(logs) // columns)
    figure = Figure(figsize=(6 * columns, 3.4 * lines), layout="constrained")
    panels = np.atleast_1d(figure.subplots(lines, columns)).ravel()
    for axes, log in zip(panels, logs, strict=False):
        styles = _styles(list(log.methods))
        every = max(1, len(log.t) // 12)
        for name, angle in log.methods.items():
            axes.plot(log.t, angle, label=name, markevery=every, **styles[name])
        if log.maker is not None:
            axes.plot(log.t, log.maker, color="0.5", lw=2.5, label="maker's orientation")
        axes.set(yscale="log", xlabel="time, s", ylabel=f"angle from {reference}, deg")
        axes.set_ylim(bottom=1e-4)
        axes.set_title(log.title, fontsize=10)
        axes.grid(visible=True, alpha=0.3)
        axes.legend(fontsize=7, ncols=2)
    for axes in panels[len(logs) :]:
        axes.remove()
    _save(figure, path)


def _styles(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    return {
        name: {"color": _COLOURS[i % 8], "marker": _MARKERS[i % 8], "ms": 5, "lw": 1.4}
        for i, name in enumerate(dict.fromkeys(names))
    }


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
