"""Files of histories: whole or not there, with the times beside; quaternions of one sign."""

import errno
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from each import each

import fastatt as fa

BODY = fa.Scene(inertia=(3.0, 2.0, 1.0))
START = [0.5, 0.5, -0.5, 0.5], [0.3, 2.0, 0.4]
RUN = {"dt": 0.05, "n_steps": 200, "save_every": 5, "method": "rk4"}


def test_times_are_beside_the_history(tmp_path):
    run = fa.propagate(BODY, *START, **RUN, on_save=fa.to_file(tmp_path / "history.npy"))
    numbers = np.load(tmp_path / "history.npy")
    assert np.array_equal(np.load(tmp_path / "history.times.npy"), run.t)
    assert np.array_equal(numbers[:, 0, :4], run.q)
    assert sorted(x.name for x in tmp_path.iterdir()) == ["history.npy", "history.times.npy"]


def test_a_full_disk_is_an_error_and_leaves_the_file_of_before(tmp_path, monkeypatch):
    path = tmp_path / "history.npy"
    fa.propagate(BODY, *START, **RUN, on_save=fa.to_file(path))
    before = path.read_bytes()

    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OSError, match="No space left"):
        fa.propagate(BODY, *START, **RUN, on_save=fa.to_file(path))
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 2


def test_an_error_on_the_way_leaves_the_file_of_before(tmp_path):
    path = tmp_path / "history.npy"
    fa.propagate(BODY, *START, **RUN, on_save=fa.to_file(path))
    before = path.read_bytes()

    def wrong(piece):
        if piece.t[-1] > 5.0:
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fa.propagate(BODY, *START, **RUN, on_save=[wrong, fa.to_file(path)])
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 2


def test_saves_that_an_interrupted_run_did_not_make_are_no_numbers(tmp_path):
    def stop(piece):
        if piece.t[-1] > 5.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as stopped:
        fa.propagate(BODY, *START, **RUN, on_save=[stop, fa.to_file(tmp_path / "history.npy")])
    numbers = np.load(tmp_path / "history.npy")
    made = len(stopped.value.trajectory.t)
    assert 0 < made < len(numbers) == 41
    assert np.isfinite(numbers[:made]).all()
    assert np.isnan(numbers[made:]).all()


KILLED = """
import os, signal, sys
import fastatt as fa

def stop(piece):
    if piece.t[-1] > 5.0:
        os.kill(os.getpid(), signal.SIGKILL)

fa.propagate(fa.Scene(inertia=(3.0, 2.0, 1.0)), [1, 0, 0, 0], [0.3, 2.0, 0.4], dt=0.05, n_steps=200,
             save_every=5, method="rk4", on_save=[stop, fa.to_file(sys.argv[1])])
"""


def test_a_killed_run_leaves_no_rows_that_look_like_results(tmp_path):
    path = tmp_path / "history.npy"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert not path.exists()
    assert len(list(tmp_path.iterdir())) == 1
    fa.propagate(BODY, *START, **RUN, on_save=fa.to_file(path))
    assert sorted(x.name for x in tmp_path.iterdir()) == ["history.npy", "history.times.npy"]


@each("representation", ("quat", "dcm", "dcm_rows", "mrp", "euler313"))
def test_attitudes_keep_their_sign_from_save_to_save(representation):
    """In the run and in what is written."""
    run = fa.propagate(
        BODY, [START[0]] * 3, START[1], dt=0.02, n_steps=3000, save_every=5, method="rk8",
        representation=representation,
    )  # fmt: skip
    assert ((run.q[1:] * run.q[:-1]).sum(axis=-1) > 0.5).all()
    other = fa.propagate(BODY, [START[0]] * 3, START[1], dt=0.02, n_steps=3000, save_every=5)
    # beside a pole, angles are less accurate
    assert fa.angle_between(run.q, other.q).max() < (0.1 if representation == "euler313" else 1e-3)
