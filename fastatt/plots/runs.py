"""Pictures of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from fastatt import checks
from fastatt.arrays import angle_between, quat_rotate
from fastatt.plots.drawing import (
    COLOURS,
    axes_on,
    check_run,
    curve_on,
    save,
    sphere_and_plane,
    tints_of,
)
from fastatt.propagation.drift import drift
from fastatt.propagation.energy import angular_momentum
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene, as_scene

# saves of an ensemble that are drawn
_SAVES = 500
# bodies whose curves are drawn at most, and by default
_CURVES, _CHOSEN = 8, 4
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
    >>> body = fa.Scene(inertia=(3.0, 2.0, 1.0))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 1.0, 0.0], dt=0.1, n_steps=200, save_every=1)
    >>> fa.plots.history(run, "run.png", body)  # doctest: +SKIP
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
        _axis(panels[0], run)
        _angles(panels[1], run)
        _rates(panels[2], run)
    _drifts(panels[-1], run, scene)
    save(figure, path)


def polhode(
    run: Trajectory, scene: Scene, path: str | Path, *, bodies: Sequence[int] | None = None
) -> None:
    """Draw the polhode and the herpolhode of bodies.

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
    bodies : sequence of int, optional
        Up to 8 bodies of an ensemble. By default 4 bodies without a flag, evenly spaced from the
        first to the last.

    Raises
    ------
    ValueError
        If the scene has no inertia, the run has only one save, or a body is out of range or has a
        flag.
    TypeError
        If ``run`` is not a trajectory.

    Examples
    --------
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(3.0, 2.0, 1.0))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 1.0, 0.0], dt=0.1, n_steps=200, save_every=1)
    >>> fa.plots.polhode(run, body, "polhode.png")  # doctest: +SKIP
    """
    check_run(run)
    if as_scene(scene).inertia is None:
        raise ValueError("scene: found a rate; accepted: a scene with inertia")
    n = run.status.size
    if bodies is None:
        fine = np.flatnonzero(run.status == 0)
        if not fine.size:
            raise ValueError("run: found flags of all bodies; accepted: a body without one")
        chosen = fine[np.unique(np.linspace(0, fine.size - 1, min(fine.size, _CHOSEN)).astype(int))]
    else:
        chosen = np.array(
            [checks.whole("bodies", k, 0) for k in checks.several("bodies", bodies, "bodies")],
            dtype=int,
        )
        if not 0 < chosen.size <= _CURVES or chosen.max() >= n:
            raise ValueError(f"bodies: found {list(bodies)}; accepted: 1 to 8 of 0 to {n - 1}")
        if run.status[chosen].any():
            flagged = chosen[run.status[chosen] != 0]
            raise ValueError(f"bodies: found {flagged[0]}, which is flagged; accepted: others")
    q, w = (x.reshape(len(run.t), n, -1)[:, chosen] for x in (run.q, run.w))
    m = angular_momentum(w, scene[chosen].inertia)  # type: ignore[arg-type]
    space, held = quat_rotate(q, w), quat_rotate(q[0], m[0])
    figure, ball, view, plane = sphere_and_plane()
    tints = tints_of(chosen.tolist())
    with np.errstate(invalid="ignore"):
        unit = m / np.linalg.norm(m, axis=-1, keepdims=True)
    for k, body in enumerate(chosen.tolist()):
        curve_on(ball, unit[:, k], view, {"color": tints[body], "lw": 1.8})
        # two unit vectors orthogonal to the momentum and to each other
        across = space[:, k] @ np.linalg.svd(held[k][None].astype(np.float64))[2][1:].T
        plane.plot(*across.T, color=tints[body], lw=1.3)
        plane.plot(*across[:1].T, color=tints[body], marker="o", ms=5)
    axes_on(ball, "xyz")
    ball.set_title("Polhode: direction of the angular momentum\nin body axes")
    plane.set_title("Herpolhode: angular velocity\nin inertial axes, from the dot on")
    if chosen.size > 1:
        entries = [Line2D([], [], color=tints[k], lw=2.4) for k in chosen.tolist()]
        names = [f"body {k}" for k in chosen]
        figure.legend(entries, names, loc="outside lower center", ncols=len(names))
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


def _lines(axes: Any, run: Trajectory, values: NDArray[Any], names: Sequence[str]) -> None:
    for k, name in enumerate(names):
        axes.plot(run.t, values[:, k], color=COLOURS[k], ls=_STYLES[k], lw=1.4, label=name)


def _axis(axes: Any, run: Trajectory) -> None:
    _lines(axes, run, _of_one(run, run.dcm[..., 2]), ("X", "Y", "Z"))
    axes.set(ylabel="third body axis (unit vector)\nalong inertial X, Y, Z", ylim=(-1.1, 1.1))
    _legend(axes)


def _angles(axes: Any, run: Trajectory) -> None:
    angles = np.degrees(np.unwrap(_of_one(run, run.euler313), axis=0))
    angles[1:][np.abs(np.diff(angles, axis=0)) > _JUMP] = np.nan
    _lines(axes, run, angles, "φθψ")
    axes.set_ylabel("3-1-3 Euler angles, deg")
    _legend(axes)


def _rates(axes: Any, run: Trajectory) -> None:
    w = _of_one(run, run.w)
    _lines(axes, run, w, ("$w_x$", "$w_y$", "$w_z$"))
    axes.plot(run.t, np.linalg.norm(w, axis=-1), color="k", lw=1.8, label="|w|")
    axes.set_ylabel("angular velocity\nalong body axes, rad/s")
    _legend(axes)


def _of_one(run: Trajectory, values: NDArray[Any]) -> NDArray[Any]:
    """Values (S, 3) of the only body, without the axis of an ensemble of one."""
    return np.asarray(values).reshape(len(run.t), 3)


def _drifts(axes: Any, run: Trajectory, scene: Scene | None) -> None:
    found: dict[str, Any] = {"norm error": np.abs(run.norm_error)}
    if scene is not None and as_scene(scene).inertia is not None:
        measured = drift(run, scene)
        found |= {
            "energy, relative": measured.energy,
            "angular momentum, relative": measured.momentum,
        }
    for k, (name, values) in enumerate(found.items()):
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
