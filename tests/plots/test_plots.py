"""Pictures of runs: what they show, and what they say that they show."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

import fastatt as fa
from fastatt import plots
from fastatt.plots import runs, study
from fastatt.plots.drawing import styles_of

BODY = fa.Scene(inertia=(3.0, 2.0, 1.0))
RATE = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 1.0)))
TUMBLE = fa.Scene(rate=fa.rates.Constant((1.0, 0.0, 0.0)))


def run_of(bodies=1, n_steps=40, **options):
    rng = np.random.default_rng(3)
    w0 = rng.normal(size=(bodies, 3))
    q0 = np.tile([1.0, 0.0, 0.0, 0.0], (bodies, 1))
    if bodies == 1:
        q0, w0 = q0[0], [0.1, 1.0, 0.0]
    given = {"dt": 0.1, "n_steps": n_steps, "save_every": 1, "method": "rk4"} | options
    return fa.propagate(BODY, q0, w0, **given)


def curves(axes):
    return {line.get_label(): line for line in axes.lines}


def drawn(draw, run, **options):
    """The figure that is drawn to a file."""
    with pytest.MonkeyPatch.context() as patch:
        figures = []
        patch.setattr(runs, "save", lambda figure, path: figures.append(figure))
        draw(run, path="", **options)
    return figures[0]


def labels(figure):
    return [axes.get_ylabel() for axes in figure.axes]


def test_one_body():
    run = run_of()
    figure = drawn(plots.history, run, scene=BODY)
    axis, angles, rates, drifts = figure.axes
    assert labels(figure) == [
        "third body axis (unit vector)\nalong inertial X, Y, Z", "3-1-3 Euler angles, deg",
        "angular velocity\nalong body axes, rad/s", "drift, dimensionless",
    ]  # fmt: skip
    assert drifts.get_xlabel() == "time, s"
    assert np.array_equal(curves(axis)["Z"].get_ydata(), run.dcm[:, 2, 2])
    theta = curves(angles)["θ"]
    assert np.array_equal(theta.get_xdata(), run.t)
    assert np.allclose(theta.get_ydata(), np.degrees(run.euler313[:, 1]))
    assert np.array_equal(curves(rates)["$w_y$"].get_ydata(), run.w[:, 1])
    assert np.array_equal(curves(rates)["|w|"].get_ydata(), np.linalg.norm(run.w, axis=1))
    energy = curves(drifts)["energy, relative"].get_ydata()
    assert np.array_equal(energy[1:], fa.drift(run, BODY).energy[1:])
    alone = drawn(plots.history, run, scene=None).axes
    assert set(curves(alone[3])) == {"norm error"}


OWN = {"dt": [0.1, 0.05], "n_steps": [40, 80], "save_at": [0, 0.5, 0.7]}


@pytest.mark.parametrize(
    ("bodies", "options", "title"),
    [(1, {"save_at": [0.0, 0.5, 0.55]}, "rk4, 1 body, step 0.1 s"), (2, OWN, "step 0.05 to 0.1 s")],
)
def test_runs_with_saves_at_given_times(bodies, options, title):
    """Whose steps are an array."""
    run = run_of(bodies, save_every=None, **options)
    for draw in (plots.history, plots.polhode):
        assert title in drawn(draw, run, scene=BODY).get_suptitle()


def euler_lines(scene):
    """Of a body that rotates by 10 rad."""
    run = fa.propagate(scene, [0.8, 0.6, 0, 0], dt=0.1, n_steps=100, save_every=1)
    return run, drawn(plots.history, run, scene=None).axes[1]


def test_angles_go_on_past_180_degrees():
    """About the third axis."""
    run, axes = euler_lines(RATE)
    psi = curves(axes)["ψ"].get_ydata()
    assert np.allclose(psi - psi[0], np.degrees(run.t), rtol=0.0, atol=1e-9)


def test_angles_break_where_the_third_axis_passes_the_pole():
    values = np.stack([line.get_ydata() for line in euler_lines(TUMBLE)[1].lines])
    assert np.isnan(values).any()
    with np.errstate(invalid="ignore"):
        assert np.nanmax(np.abs(np.diff(values))) <= 120.0


def test_many_bodies_are_percentiles_and_bad_ones_do_not_matter():
    run = run_of(9)
    figure = drawn(plots.history, run, scene=BODY)
    assert labels(figure) == [
        "angle from the first save, deg",
        "|w|, rad/s",
        "drift, dimensionless",
    ]
    middle = curves(figure.axes[1])["median of the bodies"].get_ydata()
    assert np.allclose(middle, np.median(np.linalg.norm(run.w, axis=-1), axis=1), rtol=1e-15)
    assert "9 bodies" in figure.get_suptitle()
    w0 = run.w[0].copy()
    w0[4] = 1e100
    steps = {"dt": 0.1, "n_steps": 40, "save_every": 1, "method": "rk4"}
    with pytest.warns(fa.StepWarning):
        run = fa.propagate(BODY, run.q[0], w0, **steps)
    figure = drawn(plots.history, run, scene=BODY)
    assert "1 flagged" in figure.get_suptitle()
    assert np.isfinite(curves(figure.axes[2])["angular momentum, relative"].get_ydata()[1:]).all()
    assert len(drawn(plots.polhode, run, scene=BODY).axes[1].lines) == 2 * 4
    assert np.isfinite(curves(figure.axes[1])["median of the bodies"].get_ydata()).all()


def test_of_long_histories_of_many_some_saves_are_drawn(monkeypatch):
    monkeypatch.setattr(runs, "_SAVES", 11)
    run = run_of(3)
    t = curves(drawn(plots.history, run, scene=None).axes[1])["median of the bodies"].get_xdata()
    assert t.size == 11
    assert (t[0], t[-1]) == (run.t[0], run.t[-1])


def test_polhode_is_poinsots():
    """The momentum keeps its size and its energy; the herpolhode stays between two circles."""
    run = run_of()
    ball, plane = drawn(plots.polhode, run, scene=BODY).axes
    m = np.stack([line.get_data_3d() for line in ball.lines[3:5]])  # after the three axes
    m = np.where(np.isfinite(m[0]), m[0], m[1]).T
    assert np.abs(np.linalg.norm(m, axis=1) - 1.0).max() < 1e-12
    energy = (m**2 / np.array([3.0, 2.0, 1.0])).sum(axis=1)
    assert np.ptp(energy) < 1e-5  # rk4's own drift
    across = np.stack(plane.lines[0].get_data(), axis=1)
    held = fa.quat_rotate(run.q[0], np.array([3.0, 2.0, 1.0]) * run.w[0])
    along = fa.quat_rotate(run.q, run.w) @ held / np.linalg.norm(held)
    size = np.hypot(np.linalg.norm(across, axis=1), along)
    assert np.abs(size - np.linalg.norm(run.w, axis=1)).max() < 1e-12
    assert "rad/s" in plane.get_xlabel()
    assert "rad/s" in plane.get_ylabel()


def test_no_polhode_of_a_flagged_body():
    """Steps too large for it: its curve would be another motion's."""
    w0 = np.array([[0.3, 0.2, 0.5], [30.0, 20.0, 50.0], [0.1, 0.4, 0.2]])
    steps = {"dt": 0.1, "n_steps": 50, "save_every": 1, "method": "rk4"}
    with pytest.warns(fa.StepWarning):
        run = fa.propagate(BODY, (1, 0, 0, 0), w0, **steps)
    assert run.status.astype(bool).tolist() == [False, True, False]
    assert len(drawn(plots.polhode, run, scene=BODY).axes[1].lines) == 2 * 2
    (legend,) = drawn(plots.polhode, run, scene=BODY).legends
    assert [text.get_text() for text in legend.get_texts()] == ["body 0", "body 2"]


def test_files(tmp_path):
    run = run_of(n_steps=8)
    run.plot(tmp_path / "run.png", BODY)
    with Image.open(tmp_path / "run.png") as picture:
        assert picture.size == (990, 1144)


def study_figure(monkeypatch, drawn, heading):
    figures = []
    monkeypatch.setattr(study, "save", lambda figure, path: figures.append(figure))
    study.draw(drawn, heading, "")
    return figures[0]


def test_a_picture_of_errors_says_what_it_shows(monkeypatch):
    drawn = [
        study.Curve("error", "time, µs", name, *values)
        for name in ("quat", "dcm")
        for values in (
            ("rk4", [1.0, 2.0], [1e-3, 1e-5]),
            ("exact", [3.0], [0.0]),
            ("cf4", [5.0, 6.0], [1e-2, 1e-4], False),
        )
    ]
    figure = study_figure(monkeypatch, drawn, "all")
    assert figure.get_suptitle() == "all"
    assert [axes.get_title() for axes in figure.axes] == ["quaternion", "matrix (DCM)"]
    assert {axes.get_xlabel() for axes in figure.axes} == {"time, µs"}
    assert labels(figure) == ["error", ""]
    for axes in figure.axes:
        lines = curves(axes)
        assert np.array_equal(lines["rk4"].get_ydata(), [1e-3, 1e-5])
        assert axes.get_ylim()[0] < lines["exact"].get_ydata()[0] > 0.0
        low, high = axes.get_xlim()
        assert low < 1.0
        assert high > 6.0
        assert high / low >= 10.0
        assert lines["cf4"].get_alpha() < 1.0
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["rk4", "cf4", "exact"]


def test_a_picture_of_drifts_has_a_row_for_each_quantity(monkeypatch):
    values = "steps", "quat", "rk4", [1.0, 1e5], [1e-9, 1e-4]
    drawn = [study.Curve(quantity, *values) for quantity in ("norm", "energy")]
    figure = study_figure(monkeypatch, drawn, "drift")
    assert labels(figure) == ["norm", "energy"]
    assert all(axes.get_xscale() == axes.get_yscale() == "log" for axes in figure.axes)


def test_a_legend_of_ten_methods_is_whole(monkeypatch):
    """With the longest names, in the narrowest picture."""
    names = [*list(fa.METHODS)[:9], "kahan_li8 in float32"]
    drawn = [study.Curve("error", "time", "quat", name, [1.0, 2.0], [1e-3, 1e-5]) for name in names]
    figure = study_figure(monkeypatch, drawn, "all")
    FigureCanvasAgg(figure).draw()
    (legend,) = figure.legends
    box, (width, height) = legend.get_window_extent(), figure.get_size_inches() * figure.dpi
    assert min(box.x0, box.y0, width - box.x1, height - box.y1) >= 0.0
    assert len(legend.get_texts()) == 10


def test_a_method_looks_the_same_in_all_pictures():
    alone, among = styles_of(["rk8"]), styles_of(["exact", "mine", "rk8", "rk4"])
    assert alone["rk8"] == among["rk8"]
    every = styles_of(list(fa.METHODS))
    looks = {(style["color"], style["marker"]) for style in every.values()}
    assert len(looks) == len(fa.METHODS)
    single = styles_of(["rk4 in float32"])["rk4 in float32"]
    assert (single["color"], single["marker"]) == (every["rk4"]["color"], every["rk4"]["marker"])


def test_without_matplotlib_the_extra_is_named():
    hidden = "import sys; sys.modules['matplotlib'] = None; import fastatt.plots"
    command = [sys.executable, "-c", hidden]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.stderr.splitlines()[-1] == (
        "ImportError: pictures: needs matplotlib; install it with pip install 'fastatt[plot]'"
    )
