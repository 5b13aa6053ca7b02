"""Pictures of studies: work against precision, recordings, families of motions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from fastatt.plots.drawing import (
    axes_on,
    curve_on,
    save,
    sphere_and_plane,
    styles_of,
    tints_of,
)

_LINES: dict[str, Any] = {"quat": "-", "dcm": ":", "quat in float32": (0, (6, 2))}
_KINDS = {"quat": "quaternion", "dcm": "matrix", "quat in float32": "quaternion, float32"}
_ENTRY = 1.2  # inches, the width of a legend's entry below the panels


@dataclass(frozen=True)
class MethodCurve:
    """One method's errors (rad) against its times per body (s) over a ladder of steps."""

    method: str
    kind: str
    seconds: Sequence[float]
    errors: Sequence[float]


@dataclass(frozen=True)
class Panel:
    """The ladders of an ensemble over ``t_end`` (s), and the best of all their rungs."""

    title: str
    t_end: float
    ladders: Sequence[MethodCurve]
    frontier: MethodCurve


@dataclass(frozen=True)
class Departures:
    """One recording: each method's angle (deg) from the reference over time (s)."""

    title: str
    t: NDArray[Any]
    methods: Mapping[str, NDArray[Any]]
    maker: NDArray[Any] | None


@dataclass(frozen=True)
class Polhode:
    """Curves of one kinetic energy (J) on the sphere of momenta of size 1, (T, 3) each."""

    energy: float
    curves: Sequence[NDArray[Any]]
    separatrix: bool


def work_precision(panels: Sequence[Panel], heading: str, path: Path) -> None:
    """Error against time per body, both logarithmic, a panel for each ensemble or input."""
    width = max(8.0, 5.8 * len(panels))
    figure = Figure(figsize=(width, 6.4), layout="constrained")
    drawn = np.atleast_1d(figure.subplots(1, len(panels), sharey=True))
    styles = styles_of([ladder.method for panel in panels for ladder in panel.ladders])
    for axes, panel in zip(drawn, panels, strict=True):
        best = panel.frontier
        x = np.array(best.seconds) * 1e6
        axes.plot(x, best.errors, color="k", lw=7, alpha=0.12, zorder=0)
        for ladder in panel.ladders:
            x = np.array(ladder.seconds) * 1e6
            axes.plot(x, ladder.errors, ls=_LINES[ladder.kind], **styles[ladder.method])
        axes.set(xscale="log", yscale="log", title=panel.title)
        axes.set_xlabel(f"time per body for {panel.t_end:g} s of motion, µs")
        axes.grid(visible=True, alpha=0.3)
    entries = {name: Line2D([], [], **style) for name, style in styles.items()}
    entries["frontier"] = Line2D([], [], color="k", lw=7, alpha=0.12)
    kinds = {ladder.kind for panel in panels for ladder in panel.ladders}
    if len(kinds) > 1:
        for kind, name in _KINDS.items():
            if kind in kinds:
                entries[name] = Line2D([], [], color="k", ls=_LINES[kind], lw=1.4)
    lines = math.ceil(len(entries) * _ENTRY / width)
    columns = math.ceil(len(entries) / lines)
    figure.legend(
        entries.values(), entries.keys(), loc="outside lower center", fontsize=9, ncols=columns
    )
    drawn[0].set_ylabel("attitude error, median over bodies, rad")
    figure.suptitle(heading)
    save(figure, path)


def polhodes(
    polhodes: Sequence[Polhode], herpolhodes: Mapping[float, NDArray[Any]], path: Path
) -> None:
    """Polhodes on the momentum sphere in body axes; herpolhodes in the plane fixed in space.

    The latter are angular velocities across the momentum, (T, 2), rad/s, by the kinetic energy (J).
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
    sphere.set_title("Polhodes: the momentum seen from the body, faint on the far side")
    for energy, curve in herpolhodes.items():
        plane.plot(*curve.T, **{**styles[energy], "lw": 1.3})
    plane.set_title("Herpolhodes: the angular velocity in space over 40 s")
    entries = [Line2D([], [], **style) for style in styles.values()]
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": len(names)}
    figure.legend(entries, names.values(), title="kinetic energy", **place)
    figure.suptitle("A free body with a momentum of 1 N·m·s and moments $I_1 > I_2 > I_3$")
    save(figure, path)


def recordings(logs: Sequence[Departures], reference: str, path: Path) -> None:
    """Each method's angle from the reference over time, a panel for each recording."""
    columns = min(2, len(logs))
    lines = -(-len(logs) // columns)
    figure = Figure(figsize=(6 * columns, 3.4 * lines), layout="constrained")
    panels = np.atleast_1d(figure.subplots(lines, columns)).ravel()
    for axes, log in zip(panels, logs, strict=False):
        styles = styles_of(list(log.methods))
        every = max(1, len(log.t) // 12)
        for name, angle in log.methods.items():
            axes.plot(log.t, angle, label=name, markevery=every, **styles[name])
        if log.maker is not None:
            axes.plot(log.t, log.maker, color="0.5", lw=2.5, label="maker's orientation")
        axes.set(yscale="log", xlabel="time, s", ylabel=f"angle from {reference}, deg")
        axes.set_ylim(bottom=1e-4)
        axes.set_title(log.title, fontsize=10)
        axes.grid(visible=True, alpha=0.3)
        if log.methods or log.maker is not None:
            axes.legend(fontsize=7, ncols=2)
    for axes in panels[len(logs) :]:
        axes.remove()
    save(figure, path)
