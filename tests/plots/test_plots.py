"""Pictures of runs: what they show, and what they say that they show."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from PIL import Image

import fastatt as fa
from fastatt import plots
from fastatt.plots import animated, runs, study
from fastatt.plots.drawing import COLOURS, GREY, styles_of

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
    figure = drawn(fa.plots.history, run, scene=BODY)
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
    alone = drawn(fa.plots.history, run, scene=None).axes
    assert set(curves(alone[3])) == {"norm error"}


@pytest.mark.parametrize(
    ("bodies", "options", "title"),
    [
        (1, {"save_at": [0.0, 0.5, 0.55]}, "rk4, 1 body, step 0.1 s"),
        (
            2,
            {"dt": [0.1, 0.05], "n_steps": [40, 80], "save_at": [0, 0.5, 0.7]},
            "step 0.05 to 0.1 s",
        ),
    ],
)
def test_runs_with_saves_at_given_times(bodies, options, title, tmp_path):
    """Whose steps are an array."""
    run = run_of(bodies, save_every=None, **options)
    assert title in drawn(fa.plots.history, run, scene=BODY).get_suptitle()
    assert title in drawn(fa.plots.polhode, run, scene=BODY).get_suptitle()
    fa.plots.animation(run, tmp_path / "run.gif", seconds=0.1, fps=20)


def test_angles_go_on_past_180_degrees():
    """A body that rotates about its third axis by 10 rad."""
    run = fa.propagate(RATE, [0.8, 0.6, 0, 0], dt=0.1, n_steps=100, save_every=1)
    psi = curves(drawn(fa.plots.history, run, scene=None).axes[1])["ψ"].get_ydata()
    assert np.allclose(psi - psi[0], np.degrees(run.t), rtol=0.0, atol=1e-9)


def test_angles_break_where_the_third_axis_passes_the_pole():
    run = fa.propagate(TUMBLE, [0.8, 0.6, 0, 0], dt=0.1, n_steps=100, save_every=1)
    lines = drawn(fa.plots.history, run, scene=None).axes[1].lines
    values = np.stack([line.get_ydata() for line in lines])
    assert np.isnan(values).any()
    with np.errstate(invalid="ignore"):
        assert np.nanmax(np.abs(np.diff(values))) <= 120.0


def test_many_bodies_are_percentiles_and_bad_ones_do_not_matter():
    run = run_of(9)
    figure = drawn(fa.plots.history, run, scene=BODY)
    assert labels(figure) == [
        "angle from the first save, deg",
        "|w|, rad/s",
        "drift, dimensionless",
    ]
    middle = curves(figure.axes[1])["median of the bodies"].get_ydata()
    assert np.allclose(middle, np.median(np.linalg.norm(run.w, axis=-1), axis=1), rtol=1e-15)
    assert "9 bodies" in figure.get_suptitle()
    w0 = run.w[0].copy()
    w0[4] = np.nan
    run = fa.propagate(
        BODY, run.q[0], w0, dt=0.1, n_steps=40, save_every=1, method="rk4", invalid="flag"
    )
    figure = drawn(fa.plots.history, run, scene=BODY)
    assert "1 flagged" in figure.get_suptitle()
    assert np.isfinite(curves(figure.axes[2])["angular momentum, relative"].get_ydata()[1:]).all()
    assert len(drawn(fa.plots.polhode, run, scene=BODY).axes[1].lines) == 2 * 4
    assert np.isfinite(curves(figure.axes[1])["median of the bodies"].get_ydata()).all()


def test_of_long_histories_of_many_some_saves_are_drawn(monkeypatch):
    monkeypatch.setattr(runs, "_SAVES", 11)
    run = run_of(3)
    t = curves(drawn(fa.plots.history, run, scene=None).axes[1])["median of the bodies"].get_xdata()
    assert t.size == 11
    assert (t[0], t[-1]) == (run.t[0], run.t[-1])


def test_polhode_is_poinsots():
    """The momentum keeps its size and its energy; the herpolhode stays between two circles."""
    run = run_of()
    ball, plane = drawn(fa.plots.polhode, run, scene=BODY).axes
    m = np.stack([line.get_data_3d() for line in ball.lines[:2]])
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
    with pytest.warns(fa.StepWarning):
        run = fa.propagate(
            BODY, (1, 0, 0, 0), w0, dt=0.1, n_steps=50, save_every=1, method="rk4", invalid="flag"
        )
    assert run.status.astype(bool).tolist() == [False, True, False]
    assert len(drawn(fa.plots.polhode, run, scene=BODY).axes[1].lines) == 2 * 2
    with pytest.raises(ValueError, match="bodies: found 1, which is flagged"):
        fa.plots.polhode(run, BODY, "a.png", bodies=[0, 1])


def test_polhodes_of_some_bodies():
    run = run_of(9)
    figure = drawn(fa.plots.polhode, run, scene=BODY, bodies=[2, 5])
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["body 2", "body 5"]


def test_colours_are_apart_in_grey():
    """Lines that are told apart by colour have a style besides, or shades of their own."""
    figure = drawn(fa.plots.history, run_of(), scene=BODY)
    for axes in figure.axes:
        seen = {(to_hex(line.get_color()), line.get_linestyle()) for line in axes.lines}
        assert len({style for _, style in seen}) >= min(3, len(axes.lines))
        assert all(colour.upper() in {*COLOURS, "#000000"} for colour, _ in seen)


def test_files(tmp_path):
    run = run_of(n_steps=8)
    run.plot(tmp_path / "run.png", BODY)
    fa.plots.animation(run, tmp_path / "run.gif", seconds=0.15, fps=20)
    with Image.open(tmp_path / "run.png") as picture:
        assert picture.size == (990, 1144)
    with Image.open(tmp_path / "run.gif") as film:
        assert film.n_frames == 3
        assert film.info["duration"] == 50
        pictures = []
        for k in (0, 2):
            film.seek(k)
            pictures.append(np.asarray(film.convert("RGB"), dtype=int))
    assert np.abs(pictures[0] - pictures[1]).max() > 100


def test_the_film_turns_the_box(monkeypatch):
    stage = animated._Stage(Figure())
    seen = []
    monkeypatch.setattr(stage.faces, "set_verts", seen.append)
    C = fa.quat_to_dcm([0.5, 0.5, -0.5, 0.5])
    stage.show(C, "t")
    centres = np.mean(seen[0], axis=1)  # of the faces, two an axis, the negative one first
    assert np.abs(centres[1::2] - (C * [0.75, 0.5, 0.2]).T).max() <= 1e-15
    assert np.abs(centres[::2] + centres[1::2]).max() <= 1e-15
    for k, arm in enumerate(stage.arms):
        assert np.allclose(np.transpose(arm.get_data_3d())[1], 1.15 * C[:, k])


@pytest.mark.parametrize(
    ("draw", "given", "message"),
    [
        ("history", {"saves": None}, "run: has 1 save; accepted: two or more"),
        ("polhode", {"scene": RATE}, "scene: found a rate; accepted: a scene with inertia"),
        ("polhode", {"scene": BODY, "bodies": [1]}, r"bodies: found \[1\]; accepted: 1 to 8 of 0"),
        ("animation", {"body": 1}, "body: found 1; accepted: 0 to 0"),
        ("animation", {"path": "x.txt"}, "path: found x.txt; accepted here: .gif"),
        ("animation", {"seconds": 0.0}, "seconds: found 0.0; accepted: above 0"),
    ],
)
def test_refusals(draw, given, message, tmp_path):
    run = run_of(save_every=given.get("saves", 1), n_steps=2)
    options = {"path": "x.gif"} | {name: x for name, x in given.items() if name != "saves"}
    options["path"] = tmp_path / options["path"]
    with pytest.raises(ValueError, match=message):
        getattr(fa.plots, draw)(run, **options)


def test_what_is_no_run_is_refused(tmp_path):
    for draw in (fa.plots.history, fa.plots.animation):
        with pytest.raises(TypeError, match=r"run: found .run\.csv.; accepted: a Trajectory"):
            draw("run.csv", tmp_path / "x.gif")


def study_figure(monkeypatch, draw, *arguments):
    figures = []
    monkeypatch.setattr(study, "save", lambda figure, path: figures.append(figure))
    draw(*arguments, "")
    return figures[0]


def texts(axes):
    return {text.get_text(): text for text in axes.texts}


def test_work_precision_says_what_it_shows(monkeypatch):
    rk4 = plots.MethodCurve("rk4", "quat", [1e-6, 2e-6], [1e-3, 1e-5])
    exact = plots.MethodCurve("exact", "quat", [3e-6], [0.0])
    slow = plots.MethodCurve("slow", "quat", [5e-6, 6e-6], [1e-2, 1e-4], leads=False)
    slow_matrix = plots.MethodCurve("slow", "dcm", [5e-6, 6e-6], [1e-2, 1e-4], leads=False)
    ladders = [rk4, exact, slow, slow_matrix]
    panels = [plots.Panel(title, 20.0, ladders, rk4) for title in ("cones", "tops")]
    figure = study_figure(monkeypatch, plots.work_precision, panels, "all")
    assert figure.get_suptitle() == "all"
    assert [axes.get_title() for axes in figure.axes] == ["cones", "tops"]
    x_labels = {axes.get_xlabel() for axes in figure.axes}
    assert x_labels == {"time per body for 20 s of motion, µs"}
    assert labels(figure) == ["attitude error at the end, median over bodies, rad", ""]
    best, method, closed, dominated = figure.axes[0].lines
    assert np.allclose(method.get_xdata(), [1.0, 2.0])
    assert np.array_equal(method.get_ydata(), [1e-3, 1e-5])
    assert np.array_equal(best.get_ydata(), [1e-3, 1e-5])
    assert figure.axes[0].get_ylim()[0] < closed.get_ydata()[0] > 0.0
    assert dominated.get_color() == GREY not in {method.get_color(), closed.get_color()}
    assert set(texts(figure.axes[0])) == {"rk4", "exact", "slow"}
    shown = [text.get_text() for text in figure.legends[0].get_texts()]
    assert shown == ["frontier", "dominated by other methods"]


def test_recordings_have_no_truth(monkeypatch):
    t = np.linspace(0.0, 10.0, 200)
    log = plots.Departures("log", t, {"hold": 0.1 + t, "previous": 0.01 + 0.1 * t}, 2.0 + t)
    figure = study_figure(monkeypatch, plots.recordings, [log], "coning3")
    assert labels(figure) == ["difference from coning3, deg"]
    assert set(texts(figure.axes[0])) == {"hold", "previous", "maker's orientation"}
    shown = [line.get_ydata() for line in figure.axes[0].lines]
    np.testing.assert_array_equal(shown, [*log.methods.values(), log.maker])


def test_no_style_twice():
    styles = styles_of([str(k) for k in range(60)], grey=[str(k) for k in range(0, 48, 2)])
    looks = {tuple(sorted((k, v) for k, v in s.items() if k != "lw")) for s in styles.values()}
    assert len(looks) == 60


def test_names_cover_neither_each_other_nor_the_curves(monkeypatch):
    """Of seven curves that end within a few pixels of each other."""
    x = np.array([1e-6, 1e-5])
    ladders = [plots.MethodCurve(f"method{k}", "quat", x, [1e-2, 1e-8 * 1.05**k]) for k in range(7)]
    ladders.append(plots.MethodCurve("far, with a long name", "quat", x, [1.0, 1e-1]))
    panel = plots.Panel("cones", 20.0, ladders, ladders[0])
    (axes,) = study_figure(monkeypatch, plots.work_precision, [panel], "all").axes
    boxes = [text.get_window_extent() for text in axes.texts]
    assert len(boxes) == 8
    frame = axes.get_window_extent()
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:k])
        assert frame.containsx(box.x0)
        assert frame.containsx(box.x1)
    end, far = axes.transData.transform((10.0, 1e-1)), boxes[-1]
    assert np.abs(np.clip(end, far.p0, far.p1) - end).max() < 30.0
