"""Pictures of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fastatt.arrays import angle_between, quat_rotate
from fastatt.invariants.drift import drift
from fastatt.invariants.energy import angular_momentum
from fastatt.plots.drawing import COLOURS, check_run, curve_on, save, sphere_on
from fastatt.scene.scene import Scene, as_scene

if TYPE_CHECKING:
    from fastatt.propagation.trajectory import Trajectory

# saves of an ensemble that are drawn
_SAVES = 500
_CURVES = 4  # bodies whose polhodes are drawn
_STYLES = ("-", "--", "-.")
# deg; where angles change by more from save to save the third axis has passed a pole
_JUMP = 120.0


def history(run: Trajectory, path: str | Path, scene: Scene | None = None) -> None:
    """Draw attitude, angular velocity and errors of conserved quantities over time.

    For one body, the picture shows the direction of its third axis along inertial axes, its 3-1-3
    Euler angles without jumps by 360°, and its angular velocity. For many bodies, it shows
    percentiles of the rotation angle since the first save and of |w|, at up to 500 saves. The last
    panel shows the norm error and, if the scene is passed, the drift of energy and angular
    momentum, as :func:`fastatt.drift` defines them, where the motion conserves them; for many
    bodies it shows the median and the largest value.

    Parameters
    ----------
    run : Trajectory
        A run with at least two saves.
    path : str or Path
        The file of the picture. Its suffix selects the format (png, pdf, svg).
    scene : Scene, optional
        The scene of the run, from which energy and angular momentum are computed.

    Raises
    ------
    ValueError
        If the run has only one save.
    TypeError
        If ``run`` is not a trajectory.

    Examples
    --------
    >>> import fastatt as fa
    >>> from fastatt import plots
    >>> body = fa.Scene(inertia=(3.0, 2.0, 1.0))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 1.0, 0.0], dt=0.1, n_steps=200, save_every=1)
    >>> plots.history(run, "run.png", body)  # doctest: +SKIP
    """
    check_run(run)
    many = run.status.size > 1
    if many:
        run = _thinned(run)
    figure = Figure(figsize=(9.0, 8.2 if many else 10.4), layout="constrained")
    figure.suptitle(_title(run))
    panels = figure.subplots(3 if many else 4, 1, sharex=True)
    for axes in panels:
        axes.grid(visible=True, alpha=0.3)
    panels[-1].set_xlabel("time, s")
    if many:
        rotated = np.degrees(angle_between(run.q, run.q[:1]))
        _percentiles(panels[0], run.t, rotated, "angle from the first save, deg")
        _percentiles(panels[1], run.t, np.linalg.norm(run.w, axis=-1), "|w|, rad/s")
        _legend(panels[0])
    else:
        _of_one(panels, run)
    _drifts(panels[-1], run, scene)
    save(figure, path)


def polhode(run: Trajectory, scene: Scene, path: str | Path) -> None:
    """Draw the polhode and the herpolhode of up to four bodies.

    Of an ensemble they are bodies without a flag, evenly spaced from the first to the last.

    The left panel shows the direction of the angular momentum along body axes on the unit sphere,
    faint on the far side. The right panel shows the angular velocity, projected onto the inertial
    plane that is perpendicular to the initial angular momentum. Without torque these curves are
    Poinsot's polhode and herpolhode.

    Parameters
    ----------
    run : Trajectory
        A run with at least two saves, which are close enough to be joined by curves.
    scene : Scene
        The scene of the run, with inertia.
    path : str or Path
        The file of the picture. Its suffix selects the format (png, pdf, svg).

    Raises
    ------
    ValueError
        If the scene has no inertia, the run has only one save, or all bodies have a flag.
    TypeError
        If ``run`` is not a trajectory.

    Examples
    --------
    >>> import fastatt as fa
    >>> from fastatt import plots
    >>> body = fa.Scene(inertia=(3.0, 2.0, 1.0))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 1.0, 0.0], dt=0.1, n_steps=200, save_every=1)
    >>> plots.polhode(run, body, "polhode.png")  # doctest: +SKIP
    """
    check_run(run)
    if as_scene(scene).inertia is None:
        raise ValueError("scene: found a rate; accepted: a scene with inertia")
    n = run.status.size
    fine = np.flatnonzero(run.status == 0)
    if not fine.size:
        raise ValueError("run: found flags of all bodies; accepted: a body without one")
    chosen = fine[np.unique(np.linspace(0, fine.size - 1, _CURVES).astype(int))]
    q, w = (x.reshape(len(run.t), n, -1)[:, chosen] for x in (run.q, run.w))
    m = angular_momentum(w, scene[chosen].inertia)  # type: ignore[arg-type]
    space, held = quat_rotate(q, w), quat_rotate(q[0], m[0])
    figure = Figure(figsize=(13.0, 6.8), layout="constrained")
    ball, plane = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    across = "angular velocity across the angular momentum, rad/s"
    plane.set(aspect="equal", xlabel=across, ylabel=across)
    plane.grid(visible=True, alpha=0.3)
    # a map for colour-blind readers
    tints = colormaps["viridis"](np.linspace(0.0, 0.9, chosen.size))
    view = sphere_on(ball)
    with np.errstate(invalid="ignore"):
        unit = m / np.linalg.norm(m, axis=-1, keepdims=True)
    for k, tint in enumerate(tints):
        curve_on(ball, unit[:, k], view, color=tint, lw=1.8)
        # two unit vectors orthogonal to the momentum and to each other
        normal = space[:, k] @ np.linalg.svd(held[k][None].astype(np.float64))[2][1:].T
        plane.plot(*normal.T, color=tint, lw=1.3, label=f"body {chosen[k]}")
        plane.plot(*normal[:1].T, color=tint, marker="o", ms=5)
    ball.set_title("Polhode: direction of the angular momentum\nin body axes")
    plane.set_title("Herpolhode: angular velocity\nin inertial axes, from the dot on")
    if chosen.size > 1:
        figure.legend(loc="outside lower center", ncols=chosen.size)
    figure.suptitle(_title(run))
    save(figure, path)


def _title(run: Trajectory) -> str:
    n = run.status.size
    flagged = np.count_nonzero(run.status)
    said = f", {flagged} flagged" if flagged else ""
    # per-body step sizes, if the run has them
    steps = dict.fromkeys(f"{x:g}" for x in (np.min(run.dt), np.max(run.dt)))
    return (
        f"{run.method}, {'1 body' if n == 1 else f'{n} bodies'}{said}, step {' to '.join(steps)} s"
    )


def _thinned(run: Trajectory) -> Trajectory:
    """Some saves of a run, the first and the last among them."""
    kept = np.unique(np.linspace(0, len(run.t) - 1, min(len(run.t), _SAVES)).astype(int))
    carried = {name: x[kept] for name, x in run.carried.items()}
    return replace(
        run, t=run.t[kept], state=run.state[kept], norm_error=run.norm_error[kept], carried=carried
    )


def _legend(axes: Any) -> None:
    """Draw the legend above the panel, where it covers nothing."""
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.99), "frameon": False}
    axes.legend(ncols=6, fontsize=9, columnspacing=1.4, handlelength=2.6, **place)


def _percentiles(axes: Any, t: NDArray[Any], values: NDArray[Any], name: str) -> None:
    """Bands over the bodies whose values are finite at every save."""
    kept = values[:, np.isfinite(values).all(axis=0)]
    if kept.size:
        low, quarter, middle, three, high = np.percentile(kept, (5, 25, 50, 75, 95), axis=1)
        axes.fill_between(t, low, high, color=COLOURS[0], alpha=0.2, lw=0, label="5 to 95 %")
        axes.fill_between(t, quarter, three, color=COLOURS[0], alpha=0.4, lw=0, label="25 to 75 %")
        axes.plot(t, middle, color=COLOURS[0], lw=1.8, label="median of the bodies")
    axes.set_ylabel(name)


def _of_one(panels: Sequence[Any], run: Trajectory) -> None:
    """Draw the third axis, the angles and the angular velocity of the only body."""
    axis, w = run.dcm[..., 2].reshape(-1, 3), run.w.reshape(-1, 3)
    angles = np.degrees(np.unwrap(run.euler313.reshape(-1, 3), axis=0))
    angles[1:][np.abs(np.diff(angles, axis=0)) > _JUMP] = np.nan
    drawn = (
        ("third body axis (unit vector)\nalong inertial X, Y, Z", axis, "XYZ"),
        ("3-1-3 Euler angles, deg", angles, "φθψ"),
        ("angular velocity\nalong body axes, rad/s", w, ("$w_x$", "$w_y$", "$w_z$")),
    )
    for axes, (label, values, names) in zip(panels, drawn, strict=False):
        for k, name in enumerate(names):
            axes.plot(run.t, values[:, k], color=COLOURS[k], ls=_STYLES[k], lw=1.4, label=name)
        axes.set_ylabel(label)
    panels[2].plot(run.t, np.linalg.norm(w, axis=-1), color="k", lw=1.8, label="|w|")
    panels[0].set_ylim(-1.1, 1.1)
    for axes in panels[:3]:
        _legend(axes)


def _drifts(axes: Any, run: Trajectory, scene: Scene | None) -> None:
    errors: dict[str, Any] = {"norm error": np.abs(run.norm_error)}
    if scene is not None and as_scene(scene).inertia is not None:
        measured = drift(run, scene)
        errors |= {
            "energy, relative": measured.energy,
            "angular momentum, relative": measured.momentum,
        }
    for k, (name, values) in enumerate(errors.items()):
        if values is None:
            continue
        each = values.reshape(len(run.t), -1)
        each = each[:, np.isfinite(each).all(axis=0)]
        curves: list[tuple[Any, ...]] = [(_STYLES[k], name, np.median)] if each.size else []
        if each.shape[1] > 1:
            curves.append((":", None, np.max))
        for style, label, of in curves:
            curve = of(each, axis=1)
            # a logarithm has no zero
            curve = np.where(curve > 0.0, curve, np.nan)
            axes.plot(run.t, curve, color=COLOURS[k], ls=style, lw=1.5, label=label)
    if run.status.size > 1:
        axes.plot([], [], color="0.3", ls=":", lw=1.5, label="largest (others: median)")
    axes.set(yscale="log", ylabel="drift, dimensionless")
    if not any((line.get_ydata() > 0.0).any() for line in axes.lines):
        axes.set_ylim(1e-17, 1e-15)
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center")
    _legend(axes)
