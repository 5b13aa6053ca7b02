"""What pictures share: colours, a sphere, files without a display."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fastatt.files import target, writing
from fastatt.interchange import run_tables
from fastatt.methods import METHODS

# Okabe and Ito's colours, which colour-blind readers can distinguish
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
_MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*", "<", ">", "p", "h")


def styles_of(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Colour and marker of each name: those of a method are the same in all pictures.

    Methods are in the library's order, and other names after them.
    """
    single = " in float32"
    others = [x.removesuffix(single) for x in names if x.removesuffix(single) not in METHODS]
    numbers = {name: i for i, name in enumerate((*METHODS, *dict.fromkeys(others)))}
    styles: dict[str, dict[str, Any]] = {}
    for name in sorted(dict.fromkeys(names), key=lambda x: numbers[x.removesuffix(single)]):
        i = numbers[name.removesuffix(single)]
        colour, marker = COLOURS[i % len(COLOURS)], _MARKERS[i % len(_MARKERS)]
        styles[name] = {"color": colour, "marker": marker, "ms": 5, "lw": 1.5}
        if name.endswith(single):
            styles[name] |= {"ls": "--", "markerfacecolor": "white"}
    return styles


def sphere_on(axes: Any) -> NDArray[np.float64]:
    """Draw a faint unit sphere and its axes x, y, z; returns the direction of view."""
    elevation, azimuth = 24.0, 35.0  # deg
    axes.view_init(elev=elevation, azim=azimuth)
    axes.set_proj_type("ortho")
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=1.05)
    axes.set(xlim=(-1.0, 1.0), ylim=(-1.0, 1.0), zlim=(-1.0, 1.0))
    axes.set_axis_off()
    around = np.linspace(0.0, 2.0 * np.pi, 73)
    up = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 37)[:, None]
    x, y, z = np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up) + 0.0 * around
    axes.plot_wireframe(x, y, z, rstride=3, cstride=6, color="0.6", lw=0.3)
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        axes.plot(*np.stack([axis, 1.4 * axis], axis=1), color="k", lw=1.2)
        axes.text(*(1.6 * axis), name, fontsize=13, ha="center", va="center")
    e, a = np.radians([elevation, azimuth])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def curve_on(axes: Any, points: NDArray[Any], view: NDArray[Any], **style: Any) -> None:
    """Draw a curve on the sphere: solid in front, faint behind."""
    front = (points @ view > 0.0)[:, None]
    axes.plot(*np.where(front, points, np.nan).T, **style)
    axes.plot(*np.where(front, np.nan, points).T, alpha=0.25, **style)


def check_run(run: Any) -> None:
    """Refuse a run with fewer than two saves, or anything else.

    Raises ``TypeError`` or ``ValueError``.
    """
    run_tables.check_run(run)
    if len(run.t) < 2:
        raise ValueError("run: has 1 save; accepted: two or more (save_every=)")


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure to a file, in the format of its ending; without one as PNG.

    Raises ``ValueError`` for another ending.
    """
    FigureCanvasAgg(figure)
    contents = BytesIO()
    figure.savefig(contents, format=target("path", path).suffix[1:] or "png", dpi=110)
    with writing("path", path) as file:
        file.write(contents.getbuffer())
