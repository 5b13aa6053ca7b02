"""Runs in two goes, in parts, to files, cut short: what an uninterrupted one gives, to the bit."""

import itertools
import json
import math
import pickle
import signal
import threading
import time
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from each import each
from exact import RALSTON3
from test_plan import BODY, OWN, Q0, RNG, SCENES, W0, bits, rates_of, swing

import fastatt as fa
from fastatt.codegen import memory
from fastatt.engine import run as engine_run
from fastatt.engine.tape import CALLING_LENGTH, Action
from fastatt.propagation import end, output, plan
from fastatt.propagation.output import InterruptedRun

UNFINISHED = fa.Status.UNFINISHED
MANY = 200  # bodies, three tiles and a part of one
RK4 = {"dt": 0.05, "method": "rk4"}
Q, W = RNG.normal(size=(MANY, 4)), RNG.normal(size=(MANY, 3))


def in_two(scene, *values, first=4, last=5, **options):
    """The whole run, its first part, and the second that goes on from it."""
    whole = fa.propagate(scene, *values, n_steps=first + last, t0=3.0, **options)
    begun = fa.propagate(scene, *values, n_steps=first, t0=3.0, **options)
    return whole, begun, fa.resume(scene, begun, n_steps=last)


def as_file(run, folder):
    path = folder / "end"
    run.save_end(path)
    return path


@pytest.mark.parametrize(("t0", "dt"), [(0.0, 0.05), (3.0, -0.05)])
def test_until_a_time(t0, dt):
    """Whose last step is shorter, or none of all."""
    options = {**RK4, "dt": dt, "t0": t0}
    begun = fa.propagate(SCENES["torqued"], Q0, W0, n_steps=4, **options)
    for steps in (4.0, 9.0, 9.3):
        t_end = t0 + steps * dt
        whole = fa.propagate(SCENES["torqued"], Q0, W0, t_end=t_end, **options)
        second = fa.resume(SCENES["torqued"], begun, t_end=t_end)
        assert bits(second) == bits(whole)
        assert (second.end is None) == (steps == 9.3)


def test_a_time_that_was_rounded_is_that_of_a_step():
    """Of 1.7e9 s a double has seven digits after the point."""
    options = {"dt": 0.01, "n_steps": 700, "method": "rk4", "t0": 1.7e9}
    begun = fa.propagate(SCENES["free"], Q0, W0, **options)
    assert bits(fa.resume(SCENES["free"], begun, t_end=begun.t[-1])) == bits(begun)
    on = fa.resume(SCENES["free"], begun, t_end=1.7e9 + 7.77)
    assert bits(on) == bits(fa.resume(SCENES["free"], begun, n_steps=77))


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("torqued", {"compensated": True}),
        ("torqued", {"representation": "dcm_rows", "save_every": 2}),
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
    run = fa.propagate(scene, Q0, *rates_of(scene), n_steps=4, **{**RK4, **options})
    for protocol in (2, pickle.HIGHEST_PROTOCOL):
        other = pickle.loads(pickle.dumps(run, protocol))
        assert other.summary() == run.summary()
        assert bits(other)[:5] == bits(run)[:5]
        assert other.attitude is run.attitude
        assert own or other.record is run.record
        if kind != "free":
            method = RALSTON3 if own else None
            ends = [fa.resume(scene, x, n_steps=5, method=method) for x in (run, other)]
            assert bits(ends[0]) == bits(ends[1])


GONE = fa.Scene(rate=lambda t, p: (p[0], 0.0, 1e-3 * math.sqrt(6.5 - t)), params=(3.1,))
GROWING = fa.Scene(inertia=BODY, torque=lambda t, q, w, p: (0.1 * w[0] * w[0], 0.0, 0.0))
DAMPED = fa.Scene(inertia=BODY, torque=fa.torques.Damping(4.0))
BOTH = fa.Status.STEP_TOO_LARGE | fa.Status.NON_FINITE


@each(
    ("scene", "w0", "method", "dt", "first", "wanted"),
    [
        (DAMPED, (0.0, 0.0, 40.0), "rk4", 0.05, 60, fa.Status.STEP_TOO_LARGE | fa.Status.NORM_LOST),
        *((GONE, None, m, 1.0, 4, BOTH) for m in ("lie_euler", "rk4", "magnus4")),
        (GROWING, (9.0, 1.0, 1.0), "cf4", 0.5, 5, BOTH),
    ],
)
@pytest.mark.filterwarnings("ignore::fastatt.StepWarning")
def test_what_went_wrong_is_remembered(scene, w0, method, dt, first, wanted):
    """Of a rate that is damped away; no NaN and no infinite rate hides the step before it."""
    given = [1, 0, 0, 0], *([] if w0 is None else [w0])
    whole, begun, second = in_two(scene, *given, first=first, dt=dt, method=method)
    assert begun.status & fa.Status.STEP_TOO_LARGE
    assert whole.status == wanted
    assert bits(second) == bits(whole)


def test_another_scene_is_refused_from_a_file_too(tmp_path):
    path = as_file(fa.propagate(OWN, Q0, W0, n_steps=2, **RK4), tmp_path)
    other = fa.Scene(inertia=BODY, torque=swing, params=(0.3, -0.2))
    with pytest.raises(ValueError, match=r"^scene: differs from that of the run"):
        fa.resume(other, path, n_steps=1)


@each(
    ("change", "told"),
    [
        ("none", None), ("a bit", "is damaged|is not the end"), ("a number", "is damaged"),
        ("a key", "is damaged"), ("a length", "is damaged|is not the end"),
        *((x, "has the format .* of another version") for x in (13, "fastatt end")),
        ("half", "is not the end"), ("text", "is not the end"), ("header", "has the format 0 of"),
    ],
)  # fmt: skip
def test_a_file_that_was_changed_is_refused(change, told, tmp_path):
    """With its own numbers it goes on; one of another format this version would misread."""
    path = as_file(fa.propagate(SCENES["free"], Q0, W0, n_steps=2, **RK4), tmp_path)
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(str(arrays["header"]))
    if change == "a number":
        arrays["states"][0, 0] += 1e-9
    elif change == "a key":
        header["done"] = 1
    elif told and "format .*" in told:
        header["format"] = change
    elif change == "a length":  # more memory than there is
        arrays["states"] = np.zeros((0, 7))
    arrays["header"] = np.array(json.dumps(header))
    if change == "header":
        arrays = {"header": np.array('{"format": 0}')}
    with path.open("wb") as file:
        np.savez(file, **arrays)
    content = bytearray(path.read_bytes())
    if change == "a bit":
        content[len(content) // 2] ^= 4
    elif change == "a length":
        content = content.replace(b"(0, 7), }        ", b"(10000000000, 7),}")
    path.write_bytes(
        {"half": content[: len(content) // 2], "text": b"nothing"}.get(change, content)
    )
    if told is None:
        fa.resume(SCENES["free"], path, n_steps=1)
        return
    with pytest.raises(ValueError, match=rf"run: .*({told})"):
        fa.resume(SCENES["free"], path, n_steps=1)


def test_what_can_not_go_on(tmp_path):
    with pytest.raises(ValueError, match="save_end: found a trajectory that does not hold"):
        fa.propagate(SCENES["free"], Q0, W0, t_end=0.12, **RK4).save_end(tmp_path / "none")
    with pytest.raises(FileNotFoundError):
        fa.resume(SCENES["free"], tmp_path / "none", n_steps=1)


def test_saves_go_on_at_chosen_times():
    """Of a run that ended between two of them."""
    free, first = SCENES["free"], fa.propagate(SCENES["free"], Q0, W0, **RK4, n_steps=7)
    times = np.array([0.5, 0.77, 1.0])
    whole = fa.propagate(free, Q0, W0, **RK4, save_at=times)
    assert bits(fa.resume(free, first, save_at=times))[:4] == bits(whole)[:4]


def test_checkpoints_on_the_way(tmp_path, monkeypatch):
    """With saves in memory; the last is before a shorter step."""
    monkeypatch.setattr(end, "_WRITTEN", 0.0)
    monkeypatch.setattr(engine_run, "_OPERATIONS", 1)
    monkeypatch.setattr(engine_run, "_SECONDS", 0.0)
    free, path = SCENES["free"], tmp_path / "job"
    saves = {"save_every": 7, **RK4}
    whole = fa.propagate(free, Q0, W0, t_end=40.02, **saves)
    run = fa.propagate(free, Q0, W0, t_end=40.02, checkpoint=path, **saves)
    assert bits(run) == bits(whole)
    assert end.loaded(path).options["done"] == 768
    rest = fa.resume(free, path, t_end=40.02)
    assert rest.t.tolist() == [40.02]
    assert rest.q.tobytes() == whole.q[-1:].tobytes()
    path.unlink()
    assert fa.propagate(free, Q0, W0, t_end=0.02, checkpoint=path, **RK4).end is None
    assert not path.exists()


def test_wrong_files(tmp_path):
    with pytest.raises(ValueError, match=r"run: found the directory .*; accepted: a file"):
        fa.resume(SCENES["free"], tmp_path, n_steps=2)
    file = fa.to_file(tmp_path / "h.npy")
    with pytest.raises(ValueError, match="on_save: found two of a kind"):
        fa.propagate(SCENES["free"], Q0, W0, n_steps=2, on_save=[file, file], save_every=1, **RK4)


def test_what_will_not_fit_is_said_before_it_begins(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "LITTLE", 1000)
    monkeypatch.setattr(memory, "available", lambda: 16_000)
    options = {"n_steps": 49, "save_every": 1, **RK4}
    told = "save_every: 50 saves of 5 bodies take 1.6e-05 GB, of 1.6e-05 GB of free memory"
    assert fa.propagate(SCENES["free"], Q0, W0, **options).t.size == 50
    monkeypatch.setattr(memory, "available", lambda: 15_999)
    with pytest.raises(MemoryError, match=told):
        fa.propagate(SCENES["free"], Q0, W0, **options)
    with pytest.raises(MemoryError, match="1000000000001 saves"):  # not even their numbers
        fa.propagate(SCENES["free"], Q0, W0, **{**options, "n_steps": 10**12})
    monkeypatch.setattr(output.shutil, "disk_usage", lambda path: SimpleNamespace(free=15_999))
    with pytest.raises(MemoryError, match="of free disk"):
        fa.propagate(
            SCENES["free"], Q0, W0, on_save=fa.to_file(tmp_path / "history.npy"), **options
        )
    assert not list(tmp_path.iterdir())


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(plan, "PART", 64)


def in_one(monkeypatch, *args, **options):
    with monkeypatch.context() as patch:
        patch.setattr(plan, "PART", 1 << 18)
        return caught(*args, **options)


def caught(*args, **options):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        run = fa.propagate(*args, **options)
    return run, [str(w.message) for w in found]


def test_parts_tell_what_the_whole_tells(monkeypatch, small_parts):
    """Of a body that is too fast in the third, and one of which no number is left."""
    w = W.copy()
    w[150], w[170] = 1e200, 900.0
    options = {"n_steps": 5, "save_every": 2, **RK4}
    one, told = in_one(monkeypatch, SCENES["free"], Q, w, **options)
    parts, said = caught(SCENES["free"], Q, w, **options)
    assert bits(parts) == bits(one)
    assert said == told
    assert "body 150" in said[0]
    assert np.flatnonzero(parts.status).tolist() == [150, 170]
    assert parts.end is None


def interrupted(monkeypatch, call, action):
    """Ctrl-C as a piece of a run begins, that of a number, and whatever comes after it."""
    perform, calls = engine_run.Run.perform, itertools.count(1)

    def counted(run, *args, **since):
        if next(calls) >= call:
            action()
        return perform(run, *args, **since)

    monkeypatch.setattr(engine_run.Run, "perform", counted)


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
    """In a thread that waits for others: they finish their tiles, and begin no more."""
    pressed = itertools.count()

    def press():
        if next(pressed) == 0:
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        time.sleep(0.3)  # for all that did not begin to be called off

    monkeypatch.setattr(engine_run, "_OPERATIONS", 1 << 24)  # several pieces
    rng = np.random.default_rng(1)
    q, w = rng.normal(size=(64 * 32, 4)), rng.normal(size=(64 * 32, 3))
    options = {"n_steps": 10_240, "save_every": 1024, "n_threads": 2, **RK4}
    whole = fa.propagate(SCENES["free"], q, w, **options)
    interrupted(monkeypatch, 19, press)
    with pytest.raises(KeyboardInterrupt) as stopped:
        fa.propagate(SCENES["free"], q, w, **options)
    run = stopped.value.trajectory
    saves = int(np.isfinite(run.q[:, 0, 0]).sum())
    assert 0 < saves < len(run.t)
    assert run.q[:saves].tobytes() == whole.q[:saves].tobytes()
    assert run.w[:saves].tobytes() == whole.w[:saves].tobytes()
    assert np.isnan(run.q[saves:]).all()
    assert np.isnan(run.norm_error[saves:]).all()
    assert run.status_counts() == {"UNFINISHED": 64 * 32}


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
    perform, pieces = engine_run.Run.perform, []

    def noted(run, tape, rows, first, last):
        steps = tape[tape["action"] == Action.STEPS]
        pieces.append((int((steps["end"] - steps["first"]).sum()), last - first))
        return perform(run, tape, rows, first, last)

    monkeypatch.setattr(engine_run.Run, "perform", noted)
    scene = fa.Scene(rate=rate, params=(0.3,))
    fa.propagate(scene, Q, n_steps=1000, n_threads=1, **RK4)
    assert pieces[0] == ((CALLING_LENGTH, 1) if is_called else (1000, 4))
    assert len(pieces) > 4 if is_called else len(pieces) == 1
    assert {n for _, n in pieces} == {1 if is_called else 4}


@pytest.mark.parametrize("own", [False, True])
def test_ctrl_c_in_parts(own, monkeypatch, small_parts):
    """Of step sizes of their own, bodies with most steps come first: those done are whole."""
    counts = RNG.permutation(np.arange(100, 100 + MANY)) if own else np.full(MANY, 6000)
    done = counts > 99 + MANY - 2 if own else np.arange(MANY) < 128
    steps = {"dt": 10.0 / counts, "n_steps": counts} if own else {"dt": 0.05, "n_steps": 6000}
    options = {**steps, "method": "rk4", "n_threads": 1}
    whole = fa.propagate(SCENES["free"], Q, W, **options)
    interrupted(monkeypatch, 3, stop)
    with pytest.raises(InterruptedRun) as stopped:
        fa.propagate(SCENES["free"], Q, W, **options)
    run = stopped.value.trajectory
    assert (run.status == UNFINISHED).tolist() == (~done).tolist()
    assert run.q[:, done].tobytes() == whole.q[:, done].tobytes()
    assert run.norm_error[:, done].tobytes() == whole.norm_error[:, done].tobytes()
    for x in (run.q, run.w, run.norm_error):
        assert np.isnan(x[:, ~done]).all()
