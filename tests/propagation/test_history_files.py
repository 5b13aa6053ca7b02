"""Files of histories: their room, their times, and what is in them of a run that did not end."""

import os
import resource
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import fastatt as fa

BODY = fa.Scene(inertia=(3.0, 2.0, 1.0))
START = [0.5, 0.5, -0.5, 0.5], [0.3, 2.0, 0.4]
RUN = {"dt": 0.05, "n_steps": 200, "save_every": 5, "method": "rk4"}
FILES = ["history.npy", "history.times.npy"]


def saved(path, *functions):
    return fa.propagate(BODY, *START, **RUN, on_save=[*functions, fa.to_file(path)])


def names(folder):
    return sorted(x.name for x in folder.iterdir())


@contextmanager
def files_of_at_most(size):
    """An error of the system, as on a disk that is full, at what is written beyond."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("method", ["rk4", "exact"])
def test_times_are_beside_the_history(method, tmp_path):
    path = tmp_path / FILES[0]
    run = fa.propagate(BODY, *START, **{**RUN, "method": method}, on_save=fa.to_file(path))
    assert np.array_equal(np.load(tmp_path / FILES[1]), run.t)
    assert np.array_equal(np.load(path)[:, 0, :4], run.q)
    assert names(tmp_path) == FILES


def test_without_room_the_file_of_before_stays(tmp_path):
    path = tmp_path / FILES[0]
    saved(path)
    before = [(tmp_path / name).read_bytes() for name in FILES]
    with files_of_at_most(2000), pytest.raises(OSError, match="File too large"):
        saved(path)
    assert [(tmp_path / name).read_bytes() for name in FILES] == before
    assert names(tmp_path) == FILES


def test_a_disk_that_fails_on_the_way_is_an_error(tmp_path):
    """No bus error; what was written before it stays."""
    path, limits = tmp_path / FILES[0], files_of_at_most(1500)

    def fail(piece):
        if piece.t[-1] > 5.0:
            limits.__enter__()

    try:
        with pytest.raises(OSError, match="File too large"):
            saved(path, fail)
    finally:
        limits.__exit__(None, None, None)
    history = np.load(path)
    assert np.isfinite(history[:17]).all()
    assert np.isnan(history[-1]).all()


def test_what_was_not_saved_is_no_number(tmp_path):
    """Of a run that Ctrl-C ended."""

    def stop(piece):
        if piece.t[-1] > 5.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as stopped:
        saved(tmp_path / FILES[0], stop)
    history, times = (np.load(tmp_path / name) for name in FILES)
    made = stopped.value.trajectory.t
    assert 0 < made.size < len(history) == times.size == 41
    assert np.array_equal(times[: made.size], made)
    assert np.array_equal(history[: made.size, 0, :4], stopped.value.trajectory.q)
    assert np.isnan(history[made.size :]).all()


KILLED = """
import os, signal, sys
import fastatt as fa

def kill(*_):
    os.kill(os.getpid(), signal.SIGKILL)

def at_a_save(piece):
    if piece.t[-1] > 5.0:
        kill()

if sys.argv[2] == "room":
    os.fsync = kill
fa.propagate(fa.Scene(inertia=(3.0, 2.0, 1.0)), [0.5, 0.5, -0.5, 0.5], [0.3, 2.0, 0.4], dt=0.05,
             n_steps=200, save_every=5, method="rk4", on_save=[at_a_save, fa.to_file(sys.argv[1])])
"""


@pytest.mark.parametrize("at", ["room", "save"])
def test_a_killed_run(at, tmp_path):
    """No row looks like a result that is none; the next run removes what this one left."""
    path = tmp_path / FILES[0]
    whole = saved(path)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    child = subprocess.run(
        [sys.executable, "-c", KILLED, path, at], check=False, env=environment, timeout=300
    )
    assert child.returncode == -signal.SIGKILL
    history, made = np.load(path), 41 if at == "room" else 17
    assert np.array_equal(history[:made, 0, :4], whole.q[:made])
    assert np.isnan(history[made:]).all()
    assert len(names(tmp_path)) == (3 if at == "room" else 2)  # with a hidden part
    saved(path)
    assert names(tmp_path) == FILES
