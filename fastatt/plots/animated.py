"""An animation of a body's motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import animation as writers
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from fastatt import checks
from fastatt.arrays import quat_to_dcm
from fastatt.plots.drawing import COLOURS, check_run, space_on
from fastatt.propagation.interpolation import interpolate
from fastatt.propagation.trajectory import Trajectory

# half lengths of the box: no two equal, so that no two attitudes are drawn alike
_BOX = np.array([0.75, 0.5, 0.2])
_LONGEST = 10.0
_MOST_FRAMES = 100_000
# elevation and azimuth, deg
_SEEN_FROM = (22.0, 35.0)


def animation(
    run: Trajectory, path: str | Path, *, body: int = 0, seconds: float | None = None, fps: int = 20
) -> None:
    """Write an animation of a body, drawn as a box with its axes, against inertial axes.

    :func:`fastatt.interpolate` computes the attitudes between saves.

    Parameters
    ----------
    run : Trajectory
        A run with at least two saves, between which the body rotates by at most 180°.
    path : str or Path
        The file of the animation: .gif, or .mp4 if ffmpeg is installed.
    body : int, default 0
        Index of the body in an ensemble.
    seconds : float, optional
        Duration of the animation, s. By default it lasts as long as the motion, at most 10 s.
    fps : int, default 20
        Pictures per second.

    Raises
    ------
    ValueError
        If an argument is out of range, no writer exists for the file format, or the saves are too
        far apart.
    TypeError
        If ``run`` is not a trajectory.

    Examples
    --------
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(3.0, 2.0, 1.0))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 1.0, 0.0], dt=0.1, n_steps=200, save_every=1)
    >>> fa.plots.animation(run, "run.gif")  # doctest: +SKIP
    """
    check_run(run)
    n = run.status.size
    if checks.whole("body", body, 0) >= n:
        raise ValueError(f"body: found {body}; accepted: 0 to {n - 1}")
    rate = checks.whole("fps", fps, 1)
    span = abs(float(run.t[-1] - run.t[0]))
    lasts = min(span, _LONGEST) if seconds is None else seconds
    lasts = checks.above_zero("seconds", lasts, "above 0")
    if lasts * rate > _MOST_FRAMES:
        raise ValueError(
            f"seconds: found {lasts:g} at {rate} frames per second; accepted: up to "
            f"{_MOST_FRAMES} frames"
        )
    place = checks.path("path", path)
    kinds: dict[str, Any] = {".gif": writers.PillowWriter, ".mp4": writers.FFMpegWriter}
    kind = kinds.get(place.suffix.lower())
    if kind is None or not kind.isAvailable():
        able = [ending for ending, writer in kinds.items() if writer.isAvailable()]
        raise ValueError(f"path: found {place.name}; accepted here: {', '.join(able)}")
    q, w = (x if run.one_body else x[:, body] for x in (run.q, run.w))
    times = np.linspace(run.t[0], run.t[-1], max(2, round(lasts * rate)))
    attitudes, _ = interpolate(run.t, q, w, times)
    figure = Figure(figsize=(4.8, 4.8))
    FigureCanvasAgg(figure)
    stage = _Stage(figure)
    writer = kind(fps=rate)
    pace = f", {span / lasts:.3g} × real time"
    with writer.saving(figure, str(place), dpi=100):
        for t, C in zip(times, quat_to_dcm(attitudes), strict=True):
            stage.show(C, f"t = {t:.2f} s{pace}")
            writer.grab_frame()


class _Stage:
    """A box and its axes, drawn at one attitude after another."""

    def __init__(self, figure: Any) -> None:
        self.axes = figure.add_axes((0.0, 0.0, 1.0, 0.94), projection="3d", computed_zorder=False)
        self.view = space_on(self.axes, *_SEEN_FROM, zoom=1.25, reach=1.2)
        for axis, name in zip(np.eye(3), "XYZ", strict=True):
            self.axes.plot(*np.stack([0 * axis, 1.3 * axis], axis=1), color="0.6", lw=1.0, ls=":")
            self.axes.text(*(1.4 * axis), name, color="0.4", ha="center", va="center")
        self.faces = Poly3DCollection(_faces(), edgecolor="k", lw=0.8, zorder=2)
        self.faces.set_facecolor([c for c in COLOURS[:3] for _ in range(2)])
        self.axes.add_collection3d(self.faces)
        self.arms = [self.axes.plot([], [], [], color="k", lw=2.0)[0] for _ in range(3)]
        self.names = [
            self.axes.text(0, 0, 0, name, fontsize=13, ha="center", va="center") for name in "xyz"
        ]
        self.title = figure.text(0.5, 0.95, "", ha="center", fontsize=12)

    def show(self, C: NDArray[Any], text: str) -> None:
        """The body at an attitude, v_i = C v_b."""
        self.faces.set_verts(list(_faces() @ C.T))
        for k, (arm, name) in enumerate(zip(self.arms, self.names, strict=True)):
            arm.set_data_3d(*np.stack([_BOX[k] * C[:, k], 1.15 * C[:, k]], axis=1))
            name.set_position_3d(1.25 * C[:, k])
            # in front of the box, or behind it
            for artist in (arm, name):
                artist.set_zorder(3 if self.view @ C[:, k] > 0.0 else 1)
        self.title.set_text(text)


def _faces() -> NDArray[np.float64]:
    """Corners (6, 4, 3) of the box's faces, two of each axis."""
    square = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
    faces = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            face = np.full((4, 3), side)
            face[:, [(axis + 1) % 3, (axis + 2) % 3]] = square
            faces.append(face * _BOX)
    return np.array(faces)
