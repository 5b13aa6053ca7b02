"""Common parts of pictures: colours, a sphere, files without a display."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fastatt import checks
from fastatt.files import target, writing
from fastatt.methods import METHODS
from fastatt.propagation.trajectory import Trajectory

# Okabe and Ito's colours, which colour-blind readers can distinguish
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
GREY = "0.6"
_MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*", "<", ">", "p", "h")


def styles_of(names: Sequence[str], grey: Container[str] = ()) -> dict[str, dict[str, Any]]:
    """Colour and marker of each name: those of a method are the same in all pictures.

    Methods stand in the library's order, and other names after them; those in ``grey`` are thin
    and grey.
    """
    single = " in float32"
    others = [x.removesuffix(single) for x in names if x.removesuffix(single) not in METHODS]
    numbers = {name: i for i, name in enumerate((*METHODS, *dict.fromkeys(others)))}
    found: dict[str, dict[str, Any]] = {}
    for name in sorted(dict.fromkeys(names), key=lambda x: numbers[x.removesuffix(single)]):
        i = numbers[name.removesuffix(single)]
        marker = _MARKERS[i % len(_MARKERS)]
        if name in grey:
            filled = {} if i // len(_MARKERS) % 2 else {"markerfacecolor": "white"}
            found[name] = {"color": GREY, "marker": marker, "ms": 3.5, "lw": 0.9} | filled
            continue
        found[name] = {"color": COLOURS[i % len(COLOURS)], "marker": marker, "ms": 5, "lw": 1.5}
        if name.endswith(single):
            found[name] |= {"ls": "--", "markerfacecolor": "white"}
    return found


def tints_of(values: Sequence[float]) -> dict[float, Any]:
    """A colour for each value, in order of size, from a map for colour-blind readers."""
    order = sorted(set(values))
    return dict(zip(order, colormaps["viridis"](np.linspace(0.0, 0.9, len(order))), strict=True))


def _sphere_on(axes: Any) -> NDArray[np.float64]:
    """Draw a faint unit sphere; returns the direction of view."""
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
    e, a = np.radians([elevation, azimuth])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def sphere_and_plane() -> tuple[Figure, Any, NDArray[np.float64], Any]:
    """A figure with the sphere of momenta, its direction of view, and a plane next to it."""
    figure = Figure(figsize=(13.0, 6.8), layout="constrained")
    sphere = figure.add_subplot(1, 2, 1, projection="3d")
    view = _sphere_on(sphere)
    plane = figure.add_subplot(1, 2, 2)
    across = "angular velocity across the angular momentum, rad/s"
    plane.set(aspect="equal", xlabel=across, ylabel=across)
    plane.grid(visible=True, alpha=0.3)
    return figure, sphere, view, plane


def axes_on(sphere: Any, names: Sequence[str]) -> None:
    """Draw three axes from the centre of a unit sphere, with their names."""
    for axis, name in zip(np.eye(3), names, strict=True):
        sphere.plot(*np.stack([axis, 1.4 * axis], axis=1), color="k", lw=1.2)
        sphere.text(*(1.6 * axis), name, fontsize=13, ha="center", va="center")


def curve_on(axes: Any, points: NDArray[Any], view: NDArray[Any], style: Mapping[str, Any]) -> None:
    """Draw a curve on the sphere: solid in front, faint behind."""
    front = (points @ view > 0.0)[:, None]
    axes.plot(*np.where(front, points, np.nan).T, **style)
    axes.plot(*np.where(front, np.nan, points).T, alpha=0.25, **style)


def check_run(run: object) -> None:
    """Refuse a run with fewer than two saves, or anything else.

    Raises ``TypeError`` or ``ValueError``.
    """
    if not isinstance(run, Trajectory):
        raise TypeError(f"run: found {checks.brief(run)}; accepted: a Trajectory")
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
