"""No number of a result is left as memory had it, and Ctrl-C leaves what was done."""

import itertools

import numpy as np
import pytest
from test_plan import BODY, Q0, SCENES, W0, bits
from test_resume import interrupted, stop

import fastatt as fa
from fastatt import closed_form
from fastatt.attitudes import ATTITUDES
from fastatt.engine import run as engine_run
from fastatt.engine.run import Run
from fastatt.propagation import plan
from fastatt.propagation.output import InterruptedRun

RK4 = {"dt": 0.05, "method": "rk4"}
WHEELS = fa.Scene(
    inertia=BODY, torque=lambda t, q, w, s, p: ((0.1 * s[0], 0.0, -0.1 * w[2]), (w[0],)), states=1,
    breakpoints=(0.13, 0.4), mass=2.0, force=(0.1, 0.0, 0.0),
)  # fmt: skip
MOVED = {"s0": [0.1], "v0": W0, "r0": W0}


def down(t, q, w, p):
    return w[0] - 0.1 * t


EVENTS = [fa.event(down), fa.event(lambda t, q, w, p: t - 0.31 - 0.2 * w[1], terminal=True)]


def seen(run):
    """All numbers of a run, of which none is NaN."""
    for values in (run.t, run.state, run.w, run.norm_error, *run.carried.values()):
        assert np.isfinite(values).all()
    times = run.first_crossings
    return [*bits(run), times is not None and times.tobytes()]


def handed_out(folder, **options):
    """Saves that a function gets, all of them in one; the arrays it leaves are no numbers."""
    pieces = []

    def take(piece):
        pieces.append([piece.state.copy(), piece.w.copy(), piece.norm_error.copy()])
        piece.state[:] = piece.norm_error[:] = np.nan

    fa.propagate(SCENES["torqued"], Q0, W0, on_save=take, **options)
    arrays = [np.concatenate(x) for x in zip(*pieces, strict=True)]
    assert all(np.isfinite(x).all() for x in arrays)
    return [x.tobytes() for x in arrays]


def to_file(folder, scene, **options):
    run = fa.propagate(scene, Q0, W0, on_save=fa.to_file(folder / "h.npy"), **options)
    assert np.isfinite(np.load(folder / "h.npy")).all()
    return seen(run)


def resumed(folder, first, **options):
    fa.propagate(SCENES["torqued"], Q0, W0, n_steps=first, checkpoint=folder / "end", **RK4)
    return seen(fa.resume(SCENES["torqued"], folder / "end", **options))


def run_of(scene, q0, *rates, **options):
    def way(folder):
        run = fa.propagate(scene, q0, *rates, **options)
        if options.get("t0") == NEAR[0]:  # no time has passed
            unit = run.q / np.linalg.norm(run.q, axis=-1, keepdims=True)
            assert fa.angle_between(unit, q0).max() < 1e-5
            assert all(np.abs(run.w - w).max() < 1e-5 for w in rates)
            assert not run.status.any()
        return seen(run)

    return way


def in_a_loop(folder):
    """To an end: the last run is as short as the rounding of its times, and tells of no step."""
    (q, w), t = (Q0[0], W0[0]), 0.0
    while t < 10.0:
        end = min(t + 0.1, 10.0)
        run = fa.propagate(SCENES["free"], q, w, t0=t, dt=0.05, t_end=end, method="rk8")
        q, w, t = run.q[-1], run.w[-1], end
    right, _ = fa.closed_form.free_body(Q0[0], W0[0], BODY, 10.0)
    assert fa.angle_between(q, right) < 1e-12
    return seen(run)


def after(function, *args, **options):
    return lambda folder: function(folder, *args, **options)


TORQUED, FREE = (SCENES["torqued"], Q0, W0), (SCENES["free"], Q0, W0)
# ends that rounding does not tell from the start
SOON = {"t0": 1.0, "t_end": np.nextafter(1.0, 2.0)}
NEAR = 9.99999999999998, 10.0
LATE = {"t0": NEAR[0], "t_end": NEAR[1]}
BACK = {"t0": NEAR[1], "t_end": NEAR[0], "dt": -0.05}
SAVES = (
    {"n_steps": 0}, {"n_steps": 7}, {"t_end": 0.52}, {"n_steps": 0, "save_every": 1},
    {"n_steps": 40, "save_every": 3}, {"t_end": 0.52, "save_every": 4},
    {"n_steps": 40, "save_at": [0.0, 0.02, 0.02, 0.05, 0.71, 2.0]},
    {**SOON, "save_every": 1}, {**SOON, "save_at": [1.0, 1.0]},
    LATE, {**LATE, "save_every": 1}, {**LATE, "save_at": NEAR}, {"t0": NEAR[0], "save_at": [10.0]},
    {"t0": NEAR[0], "save_at": [10.0], "t_end": 10.00001},
)  # fmt: skip
SIZES = np.array([0.05, 0.1, 0.05, 0.025, 0.1])
WAYS = [
    *(run_of(*TORQUED, **{**RK4, **saves}) for saves in SAVES),
    *(run_of(*FREE, **{**RK4, "method": "exact", **x}) for x in SAVES),
    *(run_of(*FREE, **{**RK4, "method": m, **x}) for m in ("rk8", "dmv10") for x in (LATE, BACK)),
    *(run_of(*FREE, **RK4, **LATE, **x)
      for x in ({"dtype": "float32"}, {"compensated": True, "normalise": 1})),
    run_of(*FREE, **{**RK4, **LATE, "dt": SIZES}), in_a_loop,
    *(run_of(SCENES["rate"], Q0, **{**RK4, "method": "magnus4", **x}) for x in SAVES),
    *(run_of(WHEELS, Q0, W0, **MOVED, **{**RK4, **saves}) for saves in SAVES),
    *(run_of(*TORQUED, **RK4, **x, events=EVENTS) for x in SAVES),
    *(run_of(*TORQUED, **RK4, n_steps=40, save_every=9, representation=x)
      for x in ATTITUDES if x != "quat"),
    run_of(*TORQUED, **RK4, n_steps=40, save_every=9, dtype=np.float32),
    run_of(*TORQUED, **RK4, n_steps=200, save_every=9, compensated=True),
    run_of(SCENES["free"], Q0, 20.0 * W0, dt=0.2, method="kahan_li8", n_steps=30, save_every=7),
    run_of(*TORQUED, **{**RK4, "dt": SIZES, "t_end": 0.5}),
    run_of(*TORQUED, **{**RK4, "dt": SIZES, "t_end": 0.52, "save_at": [0.0, 0.11, 0.52]}),
    run_of(*TORQUED, **{**RK4, "dt": -SIZES, "t_end": -0.52, "save_at": [0.0, -0.52]}),
    run_of(*TORQUED, **{**RK4, "dt": SIZES, "t_end": 0.5, "events": EVENTS}),
    after(handed_out, n_steps=40, save_every=1, **RK4),
    after(handed_out, n_steps=0, save_every=1, **RK4),
    after(handed_out, t0=NEAR[0], save_at=NEAR, **RK4),
    after(handed_out, t_end=2.02, save_at=np.linspace(0.0, 2.0, 40), **RK4, events=EVENTS),
    *(after(to_file, SCENES["torqued"], **RK4, **x) for x in SAVES if "save_" in str(x)),
    after(to_file, SCENES["free"], dt=0.05, method="exact", n_steps=40, save_every=1),
    after(resumed, 5, n_steps=0), after(resumed, 5, n_steps=0, save_every=1),
    after(resumed, 0, n_steps=9, save_every=2), after(resumed, 5, t_end=0.57, save_every=2),
    after(resumed, 5, n_steps=9, save_at=[0.25, 0.33]), after(resumed, 5, n_steps=9, events=EVENTS),
    lambda folder: [x.tobytes() for x in fa.closed_form.free_body(Q0, W0, BODY, [0.0, 1.0])],
    lambda folder: fa.integrate_rates(W0, 0.01).tobytes(),
    lambda folder: fa.integrate_rates(W0, 0.01, increments=True).tobytes(),
]  # fmt: skip


def unwritten(make):
    """A function that makes arrays, whose numbers are none, and whose flags are all."""

    def made(*args, **options):
        array = make(*args, **options)
        if array.dtype.kind == "f":
            array.fill(np.nan)
        elif array.dtype.kind == "u":
            array.fill(255)
        return array

    return made


@pytest.mark.parametrize("part", [plan.PART, 2], ids=["one group", "groups"])
def test_every_slot_is_written(part, tmp_path, monkeypatch):
    monkeypatch.setattr(plan, "PART", part)
    wanted = [way(tmp_path) for way in WAYS]
    for name in ("empty", "empty_like"):
        monkeypatch.setattr(np, name, unwritten(getattr(np, name)))
    for k, (way, right) in enumerate(zip(WAYS, wanted, strict=True)):
        assert way(tmp_path) == right, f"WAYS[{k}]"


def near(t, q, w, p):
    """Comes near to zero, and does not reach it: a false alarm, after which a piece is repeated."""
    return w[0] * w[0] + 1e-6


@pytest.fixture
def small_pieces(monkeypatch):
    monkeypatch.setattr(engine_run, "_OPERATIONS", 1)
    monkeypatch.setattr(engine_run, "_SECONDS", 0.0)


@pytest.mark.usefixtures("small_pieces")
@pytest.mark.parametrize("is_file", [False, True])
def test_ctrl_c_at_each_piece(is_file, tmp_path, monkeypatch):
    """While events begin, are looked for, and a piece is repeated."""
    events = [*EVENTS[:1], fa.event(near), fa.event(lambda t, q, w, p: t - 25.0 - q[0])]
    options = {**RK4, "n_steps": 600, "save_every": 10, "events": events}
    whole, perform, repeated = fa.propagate(SCENES["free"], Q0, W0, **options), Run.perform, []

    def noted(run, tape, rows=slice(None), *ends, **since):
        repeated.append(not isinstance(rows, slice))
        return perform(run, tape, rows, *ends, **since)

    monkeypatch.setattr(Run, "perform", noted)
    file, saves = {"on_save": fa.to_file(tmp_path / "h.npy")} if is_file else {}, []
    for call in itertools.count(1):
        with monkeypatch.context() as patch:
            interrupted(patch, call, stop)
            try:
                fa.propagate(SCENES["free"], Q0, W0, **options, **file)
                break
            except InterruptedRun as stopped:
                run = stopped.trajectory
        done = int(np.isfinite(run.w[:, 0, 0]).sum())
        saves.append(done)
        assert run.t.tobytes() == whole.t[: done if is_file else None].tobytes()
        if is_file:
            assert np.load(tmp_path / "h.times.npy").tobytes() == whole.t.tobytes()
        assert run.state[:done].tobytes() == whole.state[:done].tobytes()
        rest = np.load(tmp_path / "h.npy") if is_file else run.state
        assert np.isnan(rest[done:]).all()
        assert (run.status == fa.Status.UNFINISHED).all()
        found = np.isfinite(run.event_times)
        assert np.array_equal(run.event_times[found], whole.event_times[found])
    assert saves == sorted(saves)
    assert saves[0] == 0 < saves[-1]
    assert any(repeated)


@pytest.mark.parametrize("is_file", [False, True])
def test_ctrl_c_in_a_closed_form(is_file, tmp_path, monkeypatch):
    """All saves are made at once, or 16 at a time in a file."""
    options = {"dt": 0.05, "n_steps": 600, "save_every": 10, "method": "exact"}
    whole, evaluate = fa.propagate(SCENES["free"], Q0, W0, **options), closed_form.evaluate
    calls = iter(range(2 * is_file))

    def stopped(*args):
        if next(calls, None) is None:
            raise KeyboardInterrupt
        return evaluate(*args)

    monkeypatch.setattr(closed_form, "evaluate", stopped)
    file = {"on_save": fa.to_file(tmp_path / "h.npy")} if is_file else {}
    with pytest.raises(InterruptedRun) as error:
        fa.propagate(SCENES["free"], Q0, W0, **options, **file)
    run, done = error.value.trajectory, 33 * is_file
    assert len(run.t) == (done if is_file else len(whole.t))
    assert run.state[:done].tobytes() == whole.state[:done].tobytes()
    assert np.isnan(run.state[done:]).all()
    assert (run.status == fa.Status.UNFINISHED).all()
