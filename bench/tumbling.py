"""The animation of the pages: a T-handle that spins about its intermediate axis flips over.

python bench/tumbling.py      # fastatt/docs/pictures/tumbling.gif, half a minute

The handle floats free of torques: its angular momentum keeps its direction in space, its attitude
does not (Dzhanibekov's effect). The attitudes are those of the closed form.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LightSource, to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray
from PIL import Image

import fastatt as fa
from fastatt.plots.drawing import COLOURS, space_on

PICTURES = Path(__file__).parents[1] / "fastatt" / "docs" / "pictures"
# the bar along body x and the stem along body y: half lengths, m, and centres of the boxes
BOXES = (
    (np.array([0.060, 0.009, 0.009]), np.array([0.0, 0.0, 0.0])),
    (np.array([0.007, 0.030, 0.007]), np.array([0.0, 0.039, 0.0])),
)
DENSITY = 2700.0  # kg/m³, aluminium
SPIN, TIP = 4.0, 4e-3  # rad/s about the stem, and rad/s about the bar
SECONDS, RATE = 14.0, 15  # of motion, shown as fast as it is; pictures a second
_FINER = 4  # attitudes computed for each picture: the stem's path is smoother than the film
_TRAIL = 30  # pictures for which the stem's path is shown
_REACH = 0.075  # m, what the picture shows of space in each direction
_SIZE = 3.6  # inches


def handle() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Principal moments, kg·m², and the centre of mass, m, of the two boxes."""
    masses = np.array([DENSITY * np.prod(2.0 * half) for half, _ in BOXES])
    middles = np.array([middle for _, middle in BOXES])
    centre = masses @ middles / masses.sum()
    inertia = np.zeros((3, 3))
    for mass, (half, middle) in zip(masses, BOXES, strict=True):
        square, away = half**2, middle - centre
        inertia += mass / 3.0 * np.diag(square.sum() - square)
        inertia += mass * (away @ away * np.eye(3) - np.outer(away, away))
    return np.diag(inertia), centre


def motion(n_steps: int) -> fa.Trajectory:
    """The handle's motion, with its angular momentum along the inertial Z axis."""
    moments, _ = handle()
    w0 = np.array([TIP, SPIN, 0.0])
    across, along = np.cross(moments * w0, (0.0, 0.0, 1.0)), (moments * w0)[2]
    angle = np.arctan2(np.linalg.norm(across), along)
    q0 = fa.rotation_vector_to_quat(angle * across / np.linalg.norm(across))
    return fa.propagate(
        fa.Scene(inertia=moments), q0, w0, dt=SECONDS / n_steps, n_steps=n_steps, save_every=1,
        method="exact",
    )  # fmt: skip


def frames(run: fa.Trajectory) -> list[Image.Image]:
    """A picture of every fourth attitude of a run."""
    _, centre = handle()
    stem = np.array([0.0, 0.069, 0.0]) - centre
    path = fa.quat_rotate(run.q, np.broadcast_to(stem, (len(run.t), 3)))
    rates = fa.quat_rotate(run.q, run.w)
    found, matrices = [], run.dcm
    for k in range(0, len(run.t), _FINER):
        C = matrices[k]
        figure = Figure(figsize=(_SIZE, _SIZE))
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.0, -0.06, 1.0, 1.0), projection="3d", computed_zorder=False)
        view = space_on(axes, 12.0, -60.0, zoom=1.4, reach=_REACH)
        _arrow(axes, np.array([0.0, 0.0, 1.0]), COLOURS[0], "L")
        _arrow(axes, rates[k] / SPIN, COLOURS[1], "w")
        trail = path[max(0, k - _FINER * _TRAIL) : k + 1]
        axes.plot(*trail.T, color="0.6", lw=1.2, zorder=1)
        for half, middle in sorted(BOXES, key=lambda box: view @ C @ (box[1] - centre)):
            axes.add_collection3d(_box(half, middle - centre, C))
        figure.text(0.5, 0.955, f"t = {run.t[k]:.1f} s", ha="center", fontsize=10)
        figure.text(0.03, 0.02, "L: angular momentum", color=COLOURS[0], fontsize=9)
        figure.text(0.97, 0.02, "w: angular velocity", color=COLOURS[1], fontsize=9, ha="right")
        canvas.draw()
        found.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    return found


def _arrow(axes: Any, direction: NDArray[np.float64], colour: str, name: str) -> None:
    tip = 0.075 * direction
    axes.plot(*np.stack([0 * tip, tip], axis=1), color=colour, lw=2.0, zorder=0)
    axes.plot(*tip[:, None], color=colour, marker="o", ms=5, zorder=0)
    shift = np.array([-0.006 if name == "L" else 0.006, 0.0, 0.006])
    axes.text(*(1.04 * tip + shift), name, color=colour, fontsize=12, ha="center", va="center")


def _box(half: NDArray[Any], middle: NDArray[Any], C: NDArray[Any]) -> Poly3DCollection:
    """A box of the body at an attitude, v_i = C v_b, its faces lit from above."""
    square = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
    light = LightSource(azdeg=200.0, altdeg=50.0).direction
    faces, colours = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            face = np.full((4, 3), side)
            face[:, [(axis + 1) % 3, (axis + 2) % 3]] = square
            faces.append((face * half + middle) @ C.T)
            shade = 0.65 + 0.35 * side * (C[:, axis] @ light)
            colours.append(shade * np.array(to_rgb("#c9b68c")))
    return Poly3DCollection(
        faces, facecolors=np.clip(colours, 0.0, 1.0), edgecolor="0.25", lw=0.6, zorder=2
    )


def _in_palette(picture: Image.Image, palette: Image.Image) -> Image.Image:
    """A picture in few colours, its background white: Pillow takes the next best colour there."""
    found = picture.quantize(palette=palette, dither=Image.Dither.NONE)
    indices = np.array(found)
    indices[(np.asarray(picture) == 255).all(axis=-1)] = palette.getpixel((0, 0))
    found.putdata(indices.ravel().tolist())
    return found


def main() -> None:
    path = Path(sys.argv[1]) if sys.argv[1:] else PICTURES / "tumbling.gif"
    n = 3 if os.environ.get("FASTATT_SMOKE") else round(SECONDS * RATE)
    pictures = frames(motion(_FINER * n))
    some = np.concatenate([np.asarray(picture) for picture in pictures[:: max(1, n // 12)]])
    palette = Image.fromarray(some).quantize(64)
    small = [_in_palette(picture, palette) for picture in pictures]
    small[0].save(
        path, save_all=True, append_images=small[1:], duration=round(1000 / RATE), loop=0,
        optimize=True,
    )  # fmt: skip


if __name__ == "__main__":
    main()
