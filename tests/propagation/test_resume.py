"""Runs in two goes, in parts, to files, cut short: what an uninterrupted one gives, to the bit."""

from __future__ import annotations

import itertools
import json
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from test_plan import BODY, OWN, PAIRS, Q0, RNG, SCENES, W0, bits, rates_of, swing

import fastatt as fa
from fastatt.engine import run as engine_run
from fastatt.engine.pool import InterruptedRun
from fastatt.engine.run import CALLING_LENGTH
from fastatt.propagation import execute, histories, resume

UNFINISHED = fa.Status.UNFINISHED
MANY = 200  # bodies, three tiles and a part of one
RALSTON3 = fa.runge_kutta(
    "ralston3", order=3, c=(0, 1 / 2, 3 / 4), a=((1 / 2,), (0, 3 / 4)), b=(2 / 9, 1 / 3, 4 / 9)
)
RK4 = {"dt": 0.05, "method": "rk4"}
Q, W = RNG.normal(size=(MANY, 4)), RNG.normal(size=(MANY, 3))


def in_two(scene, *values, first=4, last=5, **options):
    """The whole run, its first part, and the second that goes on from it."""
    whole = fa.propagate(scene, *values, n_steps=first + last, t0=3.0, **options)
    begun = fa.propagate(scene, *values, n_steps=first, t0=3.0, **options)
    options = {k: x for k, x in options.items() if k not in ("method", "dtype")}
    return whole, begun, fa.propagate(scene, resume=begun, n_steps=last, **options)


def as_file(run, folder):
    path = folder / "end"
    run.save_end(path)
    return path


@pytest.mark.parametrize(("kind", "method"), [p for p in PAIRS if p[1] != "exact"])
def test_every_method(kind, method):
    """Bit for bit, the largest turns too."""
    scene = SCENES[kind]
    whole, _, second = in_two(scene, Q0, *rates_of(scene), dt=0.05, method=method)
    assert bits(second) == bits(whole)
    assert second.end.states.tobytes() == whole.end.states.tobytes()
    assert second.end.diagnostics[0].tobytes() == whole.end.diagnostics[0].tobytes()
    assert second.end.done == 9


@pytest.mark.parametrize(
    "options",
    [
        {"compensated": True},
        {"compensated": True, "normalise": 3},
        {"dtype": np.float32},
        {"representation": "dcm"},
        {"representation": "euler313"},
        {"normalise": 3},
        {"normalise": "never"},
        {"dt": -0.05},
    ],
    ids=str,
)
def test_every_option(options):
    whole, begun, second = in_two(SCENES["torqued"], Q0, W0, **{**RK4, **options})
    assert bits(second) == bits(whole)
    assert bits(begun) != bits(whole)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("torqued", {"compensated": True}),
        ("torqued", {"representation": "dcm_rows", "save_every": 2}),
        ("own rate", {}),
        ("own rate", {"method": RALSTON3}),
        ("free", {"method": "exact"}),
    ],
)
def test_a_pickled_run_is_the_run(kind, options):
    """What a process pool sends back, and what goes on from there; of a function of one's own too.

    Methods and representations of the library are themselves again.
    """
    own = kind == "own rate"
    scene = fa.Scene(rate=lambda t, p: (p[0], t, 0.1), params=(2.0,)) if own else SCENES[kind]
    options = {**RK4, **options}
    values = (Q0, *rates_of(scene))
    run = fa.propagate(scene, *values, n_steps=4, **options)
    for protocol in (2, pickle.HIGHEST_PROTOCOL):
        other = pickle.loads(pickle.dumps(run, protocol))
        assert other.summary() == run.summary()
        for name in ("t", "q", "w", "dcm", "status", "norm_error"):
            assert np.array_equal(getattr(other, name), getattr(run, name))
        assert other.attitude is run.attitude
        if options["method"] is not RALSTON3:
            assert other.record is run.record
        if options["method"] != "exact":
            ends = [
                fa.propagate(
                    scene, resume=x, n_steps=5,
                    **{k: v for k, v in options.items() if k != "save_every"},
                )
                for x in (run, other)
            ]  # fmt: skip
            assert bits(ends[0]) == bits(ends[1])


def test_further_than_a_block():
    whole, _, second = in_two(SCENES["free"], Q0, W0, first=300, last=700, **RK4)
    assert bits(second) == bits(whole)


def test_with_mass():
    scene = fa.Scene(inertia=BODY, mass=2.0, force=(0.1, 0.2, 0.3))
    values = {"v0": W0 + 1.0, "r0": W0 - 1.0, **RK4}
    whole = fa.propagate(scene, Q0, W0, n_steps=3, **values)
    begun = fa.propagate(scene, Q0, W0, n_steps=1, **values)
    assert bits(fa.propagate(scene, resume=begun, n_steps=2, dt=0.05)) == bits(whole)


def test_saves_go_on():
    """Counted from where the run goes on, whose state comes first."""
    scene = SCENES["torqued"]
    whole, begun, second = in_two(scene, Q0, W0, first=4, last=5, save_every=2, **RK4)
    assert second.t.tolist() == whole.t[2:].tolist()
    assert second.q.tobytes() == whole.q[2:].tobytes()
    assert second.w.tobytes() == whole.w[2:].tobytes()
    assert second.q[0].tobytes() == begun.q[-1].tobytes()
    found = []
    last = fa.propagate(scene, resume=begun, n_steps=5, dt=0.05, save_every=2, on_save=found.append)
    assert last.q.tobytes() == whole.q[-1:].tobytes()
    assert [piece.t.size for piece in found] == [4]


@pytest.mark.parametrize("first", [3, 262])
def test_saves_are_counted_from_where_the_run_goes_on(first):
    """After a number of steps that is none of the saves of a run from the begin."""
    scene = SCENES["torqued"]
    every = fa.propagate(scene, Q0, W0, n_steps=first + 9, save_every=1, **RK4)
    begun = fa.propagate(scene, Q0, W0, n_steps=first, **RK4)
    options = {"n_steps": 9, "dt": 0.05, "save_every": 4}
    wanted = first + np.array([0, 4, 8, 9])
    rest = fa.propagate(scene, resume=begun, **options)
    pieces = []
    fa.propagate(scene, resume=begun, on_save=pieces.append, **options)
    for t, q in ((rest.t, rest.q), (pieces[0].t, pieces[0].q)):
        assert t.tolist() == every.t[wanted].tolist()
        assert q.tobytes() == every.q[wanted].tobytes()


def test_from_a_file(tmp_path):
    """Two more times, the second to the same file."""
    scene = SCENES["torqued"]
    whole = fa.propagate(scene, Q0, W0, n_steps=9, t0=3.0, **RK4)
    path = as_file(fa.propagate(scene, Q0, W0, n_steps=4, t0=3.0, **RK4), tmp_path)
    as_file(fa.propagate(scene, resume=path, n_steps=3, dt=0.05), tmp_path)
    second = fa.propagate(scene, resume=str(path), n_steps=2, dt=0.05)
    assert bits(second) == bits(whole)
    assert [p.name for p in tmp_path.iterdir()] == ["end"]


def test_what_went_wrong_is_remembered():
    """A body that was too fast before, and whose rate is damped away."""
    scene = fa.Scene(inertia=BODY, torque=fa.torques.Damping(4.0))
    w = W0.copy()
    w[2] = (0.0, 0.0, 40.0)
    whole, begun, second = in_two(scene, Q0, w, first=60, last=5, **RK4)
    assert begun.status.tolist() == whole.status.tolist()
    assert whole.status[2] & fa.Status.STEP_TOO_LARGE
    assert bits(second) == bits(whole)


@pytest.mark.parametrize("method", ["lie_euler", "rk4", "magnus4"])
def test_what_went_wrong_before_nan_is_remembered(method):
    """A NaN hides no large step that came before it in the same block."""
    scene = fa.Scene(rate=lambda t, p: (p[0], 0.0, 1e-3 * math.sqrt(6.5 - t)), params=(3.1,))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fa.StepWarning)
        whole, begun, rest = in_two(scene, [1, 0, 0, 0], dt=1.0, method=method, invalid="flag")
    assert begun.status & fa.Status.STEP_TOO_LARGE
    assert whole.status == rest.status == fa.Status.STEP_TOO_LARGE | fa.Status.NON_FINITE


def test_what_went_wrong_before_an_overflow_is_remembered():
    """Nor does an infinite angular velocity, by large steps under a torque that grows with it."""
    scene = fa.Scene(inertia=BODY, torque=lambda t, q, w, p: (0.1 * w[0] * w[0], 0.0, 0.0))
    options = {"dt": 0.5, "n_steps": 10, "method": "cf4"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fa.StepWarning)
        run = fa.propagate(scene, [1, 0, 0, 0], [9.0, 1.0, 1.0], **options)
    assert run.status == fa.Status.STEP_TOO_LARGE | fa.Status.NON_FINITE


def other_swing(t, q, w, p):
    return (p[0] * np.cos(t), p[1] * w[1], 0.0)


def thrust(size):
    pulse = fa.TimeSeries([0.0, 1.0, 2.0], [[0.0] * 3, [size, 0.0, 0.0], [0.0] * 3])
    return fa.Scene(inertia=BODY, torque=fa.torques.Constant(pulse))


BEGUN = {"own": OWN, "free": SCENES["free"], "thrust": thrust(0.1)}


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize(
    ("begun", "scene", "options", "message"),
    [
        ("free", SCENES["torqued"], {}, "scene: differs"),
        ("free", fa.Scene(inertia=(3.0, 2.0, 1.5)), {}, "scene: differs"),
        ("own", fa.Scene(inertia=BODY, torque=other_swing, params=(0.3, -0.1)), {}, "scene: diff"),
        ("own", fa.Scene(inertia=BODY, torque=swing, params=(0.3, -0.2)), {}, "scene: differs"),
        ("thrust", thrust(0.2), {}, "scene: differs"),
        ("free", None, {"dt": 0.1}, r"dt: found 0\.1; accepted: 0\.05"),
        ("free", None, {"method": "rkmk4"}, "method: found rkmk4; accepted: rk4"),
        ("free", None, {"representation": "dcm"}, "representation: found dcm; accepted: quat"),
        ("free", None, {"normalise": 3}, "normalise: found 3; accepted: output"),
        ("free", None, {"dtype": "f4"}, "dtype: found 'f4' with resume; accepted: float64"),
        ("free", None, {"q0": Q0}, "q0: found with resume"),
        ("free", None, {"t0": 1.0}, r"t0: found with resume"),
    ],
)
def test_another_run_is_refused(begun, scene, options, message, stored, tmp_path):
    end = fa.propagate(BEGUN[begun], Q0, W0, n_steps=2, **RK4)
    if stored:
        end = as_file(end, tmp_path)
    with pytest.raises(ValueError, match=message):
        fa.propagate(scene or BEGUN[begun], resume=end, **{"dt": 0.05, "n_steps": 1, **options})


@pytest.mark.parametrize(
    ("begun", "now", "message"),
    [
        ("never", "output", "normalise: found output; accepted: never, as in the earlier run"),
        ("output", "never", "normalise: found never; accepted: output, as in the earlier run"),
        (3, 4, "normalise: found 4; accepted: 3, as in the earlier run"),
    ],
)
def test_a_state_goes_on_as_it_was_brought_back(begun, now, message):
    end = fa.propagate(SCENES["free"], Q0, W0, n_steps=2, normalise=begun, **RK4)
    with pytest.raises(ValueError, match=message):
        fa.propagate(SCENES["free"], resume=end, dt=0.05, n_steps=1, normalise=now)


def test_a_file_of_another_format_is_refused(tmp_path):
    """One that this version would misread; with its own number the same contents go on."""
    path = as_file(fa.propagate(SCENES["free"], Q0, W0, n_steps=2, **RK4), tmp_path)
    with np.load(path) as file:
        kept = dict(file)
    about = json.loads(str(kept["header"]))
    for number in (about["format"] - 1, about["format"], about["format"] + 1):
        with path.open("wb") as file:
            np.savez(file, **{**kept, "header": np.array(json.dumps({**about, "format": number}))})
        if number == about["format"]:
            fa.propagate(SCENES["free"], resume=path, dt=0.05, n_steps=1)
            continue
        with pytest.raises(ValueError, match="is not the end of a run"):
            fa.propagate(SCENES["free"], resume=path, dt=0.05, n_steps=1)


def test_what_can_not_go_on(tmp_path):
    free, path = SCENES["free"], tmp_path / "file"
    for run in (
        fa.propagate(free, Q0, W0, dt=0.05, n_steps=2, method="exact"),
        fa.propagate(free, Q0, W0, n_steps=2, save_at=[0.1], **RK4),
    ):
        with pytest.raises(ValueError, match="resume: found a trajectory that does not hold"):
            fa.propagate(free, resume=run, dt=0.05, n_steps=1)
        with pytest.raises(ValueError, match="end: this trajectory does not hold it"):
            run.save_end(path)
    begun = fa.propagate(free, Q0, W0, n_steps=2, **RK4)
    for options in ({"save_at": [0.12]}, {"t0": 1.0}, {"w0": W0}):
        with pytest.raises(ValueError, match=f"{next(iter(options))}: found .*with resume"):
            fa.propagate(free, resume=begun, dt=0.05, n_steps=1, **options)
    with pytest.raises(TypeError, match="resume: found 3"):
        fa.propagate(free, resume=3, dt=0.05, n_steps=1)
    assert not path.exists()
    with path.open("wb") as file:
        np.savez(file, header=np.array('{"format": 0}'))
    short = tmp_path / "short"
    short.write_bytes(path.read_bytes()[:50])
    text = tmp_path / "text"
    text.write_text("nothing")
    for bad in (path, short, text):
        with pytest.raises(ValueError, match=r"resume: .* is not the end of a run"):
            fa.propagate(free, resume=bad, dt=0.05, n_steps=1)
    with pytest.raises(FileNotFoundError):
        fa.propagate(free, resume=tmp_path / "none", dt=0.05, n_steps=1)


KILLED = """
import os, signal, sys, warnings
import numpy as np
import fastatt as fa
from fastatt.propagation import execute, resume

execute._WRITTEN, execute._CHECKED = 0.0, 5 * 64  # always; body-steps
folder = sys.argv[1]
free = fa.Scene(inertia={body})
rng = np.random.default_rng(7)
q, w = rng.normal(size=(5, 4)), rng.normal(size=(5, 3))
save = resume.End.save


def killed_in_a_file(end, path):
    if end.done == 512:
        with open(path + "-torn", "wb") as file:
            file.write(b"half")
        os.kill(os.getpid(), signal.SIGKILL)
    save(end, path)


def killed_at_a_save(piece):
    if piece.t[-1] > 4.0:
        os.kill(os.getpid(), signal.SIGKILL)


for name in ("states", "saves"):
    child = os.fork()
    if not child:
        options = dict(dt=0.05, n_steps=640, method="rk4",
                       resume=fa.checkpoint(folder + "/" + name))
        if name == "states":
            resume.End.save = lambda end, path: killed_in_a_file(end, str(path))
            fa.propagate(free, q, w, **options)
        fa.propagate(free, q, w, save_every=3,
                     on_save=[killed_at_a_save, fa.to_file(folder + "/history.npy")], **options)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL
"""


def test_killed_and_called_again(tmp_path):
    """By SIGKILL, while a checkpoint is written or between two pieces of a history."""
    root = str(Path(__file__).resolve().parents[2])
    environment = {**os.environ, "PYTHONPATH": root, "PYTHONWARNINGS": "ignore"}
    script = KILLED.format(body=BODY)
    subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=True, env=environment)
    rng = np.random.default_rng(7)
    q, w = rng.normal(size=(5, 4)), rng.normal(size=(5, 3))
    free, options = SCENES["free"], {"n_steps": 640, **RK4}
    assert 0 < resume.loaded(tmp_path / "states").done < 512
    again = fa.propagate(free, q, w, resume=fa.checkpoint(tmp_path / "states"), **options)
    assert bits(again) == bits(fa.propagate(free, q, w, **options))
    assert resume.loaded(tmp_path / "states").done == 640

    kept = {"save_every": 3, "resume": fa.checkpoint(tmp_path / "saves")}
    history = fa.to_file(tmp_path / "history.npy")
    assert 0 < resume.loaded(tmp_path / "saves").done < 640
    pieces = []
    again = fa.propagate(free, q, w, on_save=[pieces.append, history], **options, **kept)
    whole = fa.propagate(free, q, w, save_every=3, **options)
    assert bits(again) == bits(whole)
    assert 1 < len(pieces) < 14
    # of a run that was finished nothing is done again
    pieces.clear()
    assert bits(
        fa.propagate(free, q, w, on_save=[pieces.append, history], **options, **kept)
    ) == bits(whole)
    assert not pieces
    kept["save_every"] = 4
    for other, message in (
        ({**kept, "on_save": fa.to_file(tmp_path / "other.npy")}, "other.npy"),
        (
            {**kept, "on_save": print, "n_steps": 700, "save_every": 7},
            "saved after step 640",
        ),
        ({"n_steps": 600, "resume": kept["resume"]}, "n_steps: found 600; accepted: at"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            fa.propagate(free, q, w, **{**options, **other})


def test_checkpoints_of_other_runs_are_refused(tmp_path):
    path = tmp_path / "end"
    free, options = SCENES["free"], {"n_steps": 2, "resume": fa.checkpoint(path), **RK4}
    fa.propagate(free, Q0, W0, **options)
    for values, more in (((Q0, 2.0 * W0), {}), ((Q0, W0), {"t0": 1.0}), ((Q0[0], W0), {})):
        with pytest.raises(ValueError, match="resume: the checkpoint is of a run from other"):
            fa.propagate(free, *values, **options, **more)
    with pytest.raises(ValueError, match="resume: found a checkpoint and save_every"):
        fa.propagate(free, Q0, W0, save_every=1, **options)


def test_a_file_that_can_not_be_written_leaves_the_last(tmp_path, monkeypatch):
    run = fa.propagate(SCENES["free"], Q0, W0, n_steps=2, **RK4)
    before = as_file(run, tmp_path).read_bytes()

    def full(file, **arrays):
        file.write(b"half")
        raise OSError("no space")

    monkeypatch.setattr(resume.np, "savez", full)
    with pytest.raises(OSError, match="no space"):
        as_file(run, tmp_path)
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [before]


@pytest.mark.parametrize("suffix", ["npy", "zarr"])
def test_histories_in_files(suffix, tmp_path):
    """As in memory; with the departures last."""
    if suffix == "zarr":
        zarr = pytest.importorskip("zarr")
    path = tmp_path / f"history.{suffix}"
    options = {"n_steps": 100, "save_every": 3, **RK4}
    whole = fa.propagate(SCENES["free"], Q0, W0, **options)
    run = fa.propagate(SCENES["free"], Q0, W0, on_save=fa.to_file(path), **options)
    wanted = np.concatenate([whole.q, whole.w, whole.norm_error[..., None]], axis=-1)
    found = np.load(path) if suffix == "npy" else zarr.open_array(str(path), mode="r")[:]
    assert found.tobytes() == wanted.tobytes()
    if suffix == "npy":
        assert bits(run) == bits(whole)
    else:
        assert run.q.tobytes() == whole.q[-1:].tobytes()


def test_the_closed_form_in_a_file(tmp_path):
    options = {"dt": 0.05, "n_steps": 100, "save_every": 3, "method": "exact"}
    whole = fa.propagate(SCENES["free"], Q0, W0, **options)
    run = fa.propagate(
        SCENES["free"], Q0, W0, on_save=fa.to_file(tmp_path / "history.npy"), **options
    )
    assert bits(run) == bits(whole)


def test_wrong_files(tmp_path):
    for path, wrong, message in (
        (3, TypeError, "path: found 3; accepted: a path"),
        (tmp_path / "history.csv", ValueError, r"path: found 'history\.csv'; accepted: \*\.npy"),
    ):
        with pytest.raises(wrong, match=message):
            fa.to_file(path)
    with pytest.raises(TypeError, match="path: found 3; accepted: a path"):
        fa.checkpoint(3)
    file = fa.to_file(tmp_path / "h.npy")
    for on_save, options, message in (
        (file, {}, "on_save: found without save_every"),
        ([file, file], {"save_every": 1}, "on_save: found two of a kind"),
    ):
        with pytest.raises(ValueError, match=message):
            fa.propagate(SCENES["free"], Q0, W0, n_steps=2, on_save=on_save, **options, **RK4)


def test_what_will_not_fit_is_said_before_it_begins(monkeypatch, tmp_path):
    monkeypatch.setattr(histories, "_LITTLE", 1000)
    monkeypatch.setattr(histories, "_available", lambda: 16_000)
    options = {"n_steps": 49, "save_every": 1, **RK4}
    told = "save_every: 50 saves of 5 bodies take 1.6e-05 GB, of 1.6e-05 GB of free memory"
    assert fa.propagate(SCENES["free"], Q0, W0, **options).t.size == 50
    monkeypatch.setattr(histories, "_available", lambda: 15_999)
    with pytest.raises(MemoryError, match=told):
        fa.propagate(SCENES["free"], Q0, W0, **options)
    with pytest.raises(MemoryError, match="1000000000001 saves"):  # not even their numbers
        fa.propagate(SCENES["free"], Q0, W0, **{**options, "n_steps": 10**12})
    monkeypatch.setattr(histories, "_free_on_disk", lambda path: 15_999)
    with pytest.raises(MemoryError, match="of free disk"):
        fa.propagate(
            SCENES["free"], Q0, W0, on_save=fa.to_file(tmp_path / "history.npy"), **options
        )
    assert not list(tmp_path.iterdir())


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(execute, "PART", 64)


def in_one(monkeypatch, *args, **options):
    with monkeypatch.context() as patch:
        patch.setattr(execute, "PART", 1 << 18)
        return caught(*args, **options)


def caught(*args, **options):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        run = fa.propagate(*args, **options)
    return run, [str(w.message) for w in found]


def moments(n):
    return np.sort(RNG.uniform(1.0, 1.5, (n, 3)))[:, ::-1]


@pytest.mark.parametrize(
    "scene",
    [
        SCENES["free"],
        fa.Scene(inertia=moments(MANY)),
        fa.Scene(inertia=BODY, torque=swing, params=RNG.normal(size=(MANY, 2))),
    ],
    ids=["shared", "own moments", "own params"],
)
def test_parts_are_the_whole(scene, monkeypatch, small_parts):
    """With a body that is too fast in the third, and one of no numbers."""
    w = W.copy()
    w[150], w[170] = 900.0, np.nan
    options = {"n_steps": 5, "save_every": 2, "invalid": "flag", **RK4}
    one, told = in_one(monkeypatch, scene, Q, w, **options)
    parts, said = caught(scene, Q, w, **options)
    assert bits(parts) == bits(one)
    assert said == told
    assert "body 150" in said[0]
    assert np.flatnonzero(parts.status).tolist() == [150, 170]
    assert parts.end is None
    with pytest.raises(ValueError, match=r"w0\[170, 0\] is nan"):
        fa.propagate(scene, Q, w, n_steps=5, **RK4)


def test_parts_of_rows_given_once(monkeypatch, small_parts):
    cone = fa.Scene(rate=fa.rates.Coning(RNG.uniform(0.2, 1.0, MANY), 1.0))
    options = {"dt": 0.05, "n_steps": 3, "method": "magnus4"}
    for scene, values in ((SCENES["free"], (Q[0], W)), (SCENES["free"], (Q, W[0])), (cone, (Q,))):
        some = {**options, "method": "rk4"} if len(values) == 2 else options
        one, _ = in_one(monkeypatch, scene, *values, **some)
        assert bits(fa.propagate(scene, *values, **some)) == bits(one)


def interrupted(monkeypatch, call, action):
    """Ctrl-C as a piece of a run begins, that of a number, and whatever comes after it."""
    part, calls = engine_run.Run.part, itertools.count(1)

    def counted(run, *args):
        if next(calls) >= call:
            action()
        part(run, *args)

    monkeypatch.setattr(engine_run.Run, "part", counted)


def stop():
    raise KeyboardInterrupt


@pytest.fixture
def heard():
    """Ctrl-C, which a shell's jobs in the background ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heard")
def test_ctrl_c_keeps_what_is_done(monkeypatch):
    """In a thread that waits for others: they finish their pieces, and begin no more."""
    pressed = itertools.count()

    def press():
        if next(pressed) == 0:
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        time.sleep(0.3)  # for all that did not begin to be called off

    rng = np.random.default_rng(1)
    q, w = rng.normal(size=(64 * 32, 4)), rng.normal(size=(64 * 32, 3))
    options = {"n_steps": 640, "save_every": 64, "n_threads": 2, **RK4}
    whole = fa.propagate(SCENES["free"], q, w, **options)
    interrupted(monkeypatch, 3, press)
    with pytest.raises(KeyboardInterrupt) as stopped:
        fa.propagate(SCENES["free"], q, w, **options)
    run = stopped.value.trajectory
    left = run.status == UNFINISHED
    assert 0 < left.sum() < left.size
    assert run.q[:, ~left].tobytes() == whole.q[:, ~left].tobytes()
    assert run.w[:, ~left].tobytes() == whole.w[:, ~left].tobytes()
    assert np.isnan(run.q[:, left]).all()
    assert np.isnan(run.norm_error[:, left]).all()
    assert run.status_counts() == {"UNFINISHED": left.sum()}


def stepwise(t, p):  # no straight line
    x = 0.0
    while x < p[0]:
        x += 0.25
    return x, 0.0, 0.0


@pytest.mark.parametrize(
    ("rate", "is_called"), [(stepwise, True), (lambda t, p: (p[0],) * 3, False)]
)
def test_ctrl_c_is_looked_for_before_a_called_function_took_long(rate, is_called, monkeypatch):
    """A block of one tile comes first: nobody knows how long a function takes."""
    part, pieces = engine_run.Run.part, []

    def noted(run, span, first, last):
        pieces.append((span.last - span.first, last - first))
        part(run, span, first, last)

    monkeypatch.setattr(engine_run.Run, "part", noted)
    scene = fa.Scene(rate=rate, params=(0.3,))
    fa.propagate(scene, Q, n_steps=1000, n_threads=1, **RK4)
    assert pieces[0] == ((CALLING_LENGTH, 1) if is_called else (1000, 4))
    assert len(pieces) > 4 if is_called else len(pieces) == 1
    assert {n for _, n in pieces} == {1 if is_called else 4}
    pieces.clear()
    counts = np.full(len(Q), 1000)
    fa.propagate(scene, Q, dt=1.0 / counts, n_steps=counts, n_threads=1, method="rk4")
    stops = 1000 // CALLING_LENGTH if is_called else 1
    assert sum(stops for stops, _ in pieces) == stops * (4 if is_called else 1)
    assert pieces[0] == (1, 1 if is_called else 4)


def test_ctrl_c_is_looked_for_on_the_way(monkeypatch):
    """Of one tile too: the saves of the steps that were done stay."""
    options = {"n_steps": 10**9, "save_every": 10**5, **RK4}
    interrupted(monkeypatch, 4, stop)
    with pytest.raises(InterruptedRun) as stopped:
        fa.propagate(SCENES["free"], Q0, W0, **options)
    run = stopped.value.trajectory
    kept = np.isfinite(run.q).all(axis=(1, 2))
    assert 1 < kept.sum() < kept.size
    assert kept[: kept.sum()].all()
    assert (run.status == UNFINISHED).all()
    monkeypatch.undo()
    steps = int(kept.sum() - 1) * 10**5
    wanted = fa.propagate(SCENES["free"], Q0, W0, **{**options, "n_steps": steps})
    assert run.q[kept].tobytes() == wanted.q.tobytes()


def test_ctrl_c_in_parts(monkeypatch, small_parts):
    options = {"n_steps": 6000, "n_threads": 1, **RK4}
    whole = fa.propagate(SCENES["free"], Q, W, **options)
    interrupted(monkeypatch, 3, stop)
    with pytest.raises(InterruptedRun) as stopped:
        fa.propagate(SCENES["free"], Q, W, **options)
    run = stopped.value.trajectory
    assert (run.status == UNFINISHED).tolist() == [False] * 128 + [True] * 72
    assert run.q[:, :128].tobytes() == whole.q[:, :128].tobytes()
    assert np.isnan(run.w[:, 128:]).all()
    assert run.norm_error[:, :128].tobytes() == whole.norm_error[:, :128].tobytes()
    assert np.isnan(run.norm_error[:, 128:]).all()


def test_ctrl_c_with_per_body_step_sizes(monkeypatch, small_parts):
    """Bodies with most steps come first: those of the parts that were done are whole."""
    counts = RNG.permutation(np.arange(100, 100 + MANY))
    options = {"dt": 10.0 / counts, "n_steps": counts, "method": "rk4", "n_threads": 1}
    whole = fa.propagate(SCENES["free"], Q, W, **options)
    interrupted(monkeypatch, 3, stop)
    with pytest.raises(InterruptedRun) as stopped:
        fa.propagate(SCENES["free"], Q, W, **options)
    run = stopped.value.trajectory
    done = counts > 99 + MANY - 128
    assert (run.status == UNFINISHED).tolist() == (~done).tolist()
    assert run.q[:, done].tobytes() == whole.q[:, done].tobytes()
    assert np.isnan(run.q[:, ~done]).all()
    assert np.isnan(run.norm_error[:, ~done]).all()


def test_ctrl_c_with_a_file(monkeypatch, tmp_path):
    """The saves that are in it."""
    options = {"n_steps": 100, "save_every": 1, **RK4}
    whole = fa.propagate(SCENES["free"], Q0, W0, **options)
    interrupted(monkeypatch, 3, stop)
    with pytest.raises(InterruptedRun) as stopped:
        fa.propagate(
            SCENES["free"], Q0, W0, on_save=fa.to_file(tmp_path / "history.npy"), **options
        )
    run = stopped.value.trajectory
    assert run.t.tolist() == whole.t[:33].tolist()
    assert run.q.tobytes() == whole.q[:33].tobytes()
    assert (run.status == UNFINISHED).all()
