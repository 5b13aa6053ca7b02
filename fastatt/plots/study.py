"""Pictures of studies: error against time, recordings, families of motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from fastatt.plots.drawing import (
    GREY,
    axes_on,
    curve_on,
    save,
    sphere_and_plane,
    styles_of,
    tints_of,
)
from fastatt.plots.labels import Label, write_labels

_LINES: dict[str, Any] = {"quat": "-", "dcm": ":", "quat in float32": (0, (6, 2))}
_KINDS = {
    "quat": "quaternion",
    "dcm": "matrix",
    "quat in float32": "quaternion in float32",
}
_FRONTIER: dict[str, Any] = {"color": "k", "lw": 7, "alpha": 0.12}
_LEAST = 1e-17  # rad, drawn in place of an error of 0, which a logarithmic axis cannot show


@dataclass(frozen=True)
class MethodCurve:
    """One method's errors against its times over a ladder of step sizes.

    Parameters
    ----------
    method : str
        Name of the method.
    kind : str
        Representation and precision.
    seconds : sequence of float
        Times per body, s.
    errors : sequence of float
        Errors, rad.
    leads : bool, default True
        Whether it is the fastest method for some error.
    """

    method: str
    kind: str
    seconds: Sequence[float]
    errors: Sequence[float]
    leads: bool = True


@dataclass(frozen=True)
class Panel:
    """One panel of :func:`work_precision`.

    Parameters
    ----------
    title : str
        Title of the panel.
    t_end : float
        Duration of the runs, s.
    ladders : sequence of MethodCurve
        The curves.
    frontier : MethodCurve
        The best points of all curves.
    """

    title: str
    t_end: float
    ladders: Sequence[MethodCurve]
    frontier: MethodCurve


@dataclass(frozen=True)
class Departures:
    """One panel of :func:`recordings`.

    Parameters
    ----------
    title : str
        Name of the recording.
    t : ndarray, shape (n,)
        Times, s.
    methods : mapping of str to ndarray
        Each method's angle from the reference, deg.
    maker : ndarray, shape (n,), or None
        The angle of the manufacturer's orientation from the reference, deg.
    """

    title: str
    t: NDArray[Any]
    methods: Mapping[str, NDArray[Any]]
    maker: NDArray[Any] | None


@dataclass(frozen=True)
class Polhode:
    """Polhodes of one kinetic energy.

    Parameters
    ----------
    energy : float
        Kinetic energy, J.
    curves : sequence of ndarray of shape (T, 3)
        Curves on the sphere of angular momenta of size 1.
    separatrix : bool
        Whether they are the separatrix.
    """

    energy: float
    curves: Sequence[NDArray[Any]]
    separatrix: bool


def work_precision(panels: Sequence[Panel], heading: str, path: Path) -> None:
    """Plot error against time per body, both logarithmic, with a panel for each ensemble or input.

    In a panel where a method leads nowhere it is grey, and drawn for quaternions only.

    Parameters
    ----------
    panels : sequence of Panel
        The panels.
    heading : str
        Title of the picture.
    path : Path
        The picture's file.
    """
    columns = min(2, len(panels))
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(max(8.0, 5.6 * columns), 5.2 * lines + 1.0), layout="constrained")
    figure.suptitle(heading)
    grid = figure.subplots(lines, columns, sharey=True, squeeze=False)
    drawn, free = np.split(grid.ravel(), [len(panels)])
    for axes in grid[:, 0]:
        axes.set_ylabel("attitude error at the end, median over bodies, rad")
    ladders = [ladder for panel in panels for ladder in panel.ladders]
    leading = styles_of([ladder.method for ladder in ladders if ladder.leads])
    grey = [ladder.method for ladder in ladders if not ladder.leads]
    others = styles_of(grey, grey=grey)
    kinds = {ladder.kind for ladder in ladders if ladder.leads}
    entries = {_KINDS[kind]: {"color": "k", "ls": _LINES[kind]} for kind in _KINDS if kind in kinds}
    shown = {"frontier": _FRONTIER, **(entries if len(entries) > 1 else {})}
    if grey:
        shown["dominated by other methods"] = {"color": GREY, "lw": 0.9}
    samples = [Line2D([], [], **style) for style in shown.values()]
    if free.size:
        free[0].set_axis_off()
        free[0].legend(samples, shown, loc="center", frameon=False)
    else:
        figure.legend(samples, shown, loc="outside lower center", ncols=len(shown), frameon=False)
    for axes, panel in zip(drawn, panels, strict=True):
        axes.set(xscale="log", yscale="log", title=panel.title)
        axes.set_xlabel(f"time per body for {panel.t_end:g} s of motion, µs")
        axes.grid(visible=True, alpha=0.3)
        axes.margins(x=0.08, y=0.06)
        axes.plot(*_points(panel.frontier), **_FRONTIER, zorder=0)
    for axes, panel in zip(drawn, panels, strict=True):
        _ladders(axes, panel, leading, others)
    save(figure, path)


def _ladders(
    axes: Any,
    panel: Panel,
    leading: Mapping[str, dict[str, Any]],
    others: Mapping[str, dict[str, Any]],
) -> None:
    """One panel's curves, each method's name next to the first of its curves."""
    labels: dict[str, Label] = {}
    for ladder in sorted(panel.ladders, key=lambda ladder: not ladder.leads):
        if not ladder.leads and ladder.kind != "quat":
            continue
        style = (leading if ladder.leads else others)[ladder.method]
        points = _points(ladder)
        axes.plot(*points, **style, ls=_LINES[ladder.kind], zorder=2 if ladder.leads else 1)
        colour, size = (style["color"], 9.0) if ladder.leads else ("0.4", 7.5)
        labels.setdefault(ladder.method, Label(ladder.method, *points, colour, size))
    write_labels(axes, list(labels.values()))


def _points(ladder: MethodCurve) -> tuple[NDArray[Any], NDArray[Any]]:
    """Times per body, µs, and errors, rad."""
    return np.array(ladder.seconds) * 1e6, np.maximum(ladder.errors, _LEAST)


def polhodes(
    polhodes: Sequence[Polhode], herpolhodes: Mapping[float, NDArray[Any]], path: Path
) -> None:
    """Plot polhodes on the sphere of angular momenta in body axes, and herpolhodes.

    Parameters
    ----------
    polhodes : sequence of Polhode
        The polhodes.
    herpolhodes : mapping of float to ndarray of shape (T, 2)
        Angular velocities orthogonal to the angular momentum, rad/s, by kinetic energy, J.
    path : Path
        The picture's file.
    """
    figure, sphere, view, plane = sphere_and_plane()
    tints = tints_of([p.energy for p in polhodes])
    styles = {p.energy: {"color": tints[p.energy], "lw": 1.8} for p in polhodes}
    styles |= {p.energy: {"color": "k", "lw": 2.4} for p in polhodes if p.separatrix}
    names = {p.energy: f"{p.energy:.3f} J{', separatrix' * p.separatrix}" for p in polhodes}
    for polhode in polhodes:
        for curve in polhode.curves:
            curve_on(sphere, curve, view, styles[polhode.energy])
    axes_on(sphere, ("$I_1$", "$I_2$", "$I_3$"))
    sphere.set_title("Polhodes: the angular momentum in body axes,\nfaint on the far side")
    for energy, curve in herpolhodes.items():
        plane.plot(*curve.T, **{**styles[energy], "lw": 1.3})
    plane.set_title("Herpolhodes: the angular velocity\nin inertial axes over 40 s")
    entries = [Line2D([], [], **style) for style in styles.values()]
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": len(names)}
    figure.legend(entries, names.values(), title="kinetic energy", **place)
    figure.suptitle(
        "A free body with an angular momentum of 1 N·m·s and principal moments $I_1 > I_2 > I_3$"
    )
    save(figure, path)


def recordings(logs: Sequence[Departures], reference: str, path: Path) -> None:
    """Plot each method's angle from the reference over time, with a panel for each recording.

    Parameters
    ----------
    logs : sequence of Departures
        The recordings.
    reference : str
        Name of the reference method.
    path : Path
        The picture's file.
    """
    columns = min(2, len(logs))
    lines = -(-len(logs) // columns)
    figure = Figure(figsize=(max(7.0, 5.6 * columns), 3.8 * lines + 0.6), layout="constrained")
    figure.suptitle(f"Gyro recordings: difference of each method from {reference}")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    styles = styles_of([name for log in logs for name in log.methods])
    for axes, log in zip(panels, logs, strict=False):
        every = max(1, len(log.t) // 12)
        labels = []
        for name, angle in log.methods.items():
            axes.plot(log.t, angle, markevery=every, **styles[name])
            labels.append(_spread(name, log.t, angle, styles[name]["color"]))
        if log.maker is not None:
            axes.plot(log.t, log.maker, color="0.5", lw=2.5)
            labels.append(_spread("maker's orientation", log.t, log.maker, "0.4"))
        axes.set(yscale="log", xlabel="time, s", ylabel=f"difference from {reference}, deg")
        drawn = np.concatenate([*log.methods.values(), [1.0] if log.maker is None else log.maker])
        axes.set_ylim(bottom=max(1e-4, 0.5 * float(np.nanquantile(drawn, 0.02))))
        axes.set_title(log.title, fontsize=10)
        axes.grid(visible=True, alpha=0.3)
        write_labels(axes, labels)
    for axes in panels[len(logs) :]:
        axes.remove()
    save(figure, path)


def _spread(name: str, t: NDArray[Any], values: NDArray[Any], colour: Any) -> Label:
    """A label next to one of 25 points of a curve, none of them at its beginning."""
    some = np.linspace(len(t) // 5, len(t) - 1, 25).astype(int)
    return Label(name, t[some], values[some], colour)
