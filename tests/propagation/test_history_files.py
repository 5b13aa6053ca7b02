"""Files of histories: their room, their times, and what is in them of a run that did not end."""

import os
import resource
import signal
from contextlib import contextmanager

import numpy as np
import pytest

import fastatt as fa
from fastatt.engine import run as engine_run
from fastatt.propagation import end

BODY = fa.Scene(inertia=(3.0, 2.0, 1.0))
START = [0.5, 0.5, -0.5, 0.5], [0.3, 2.0, 0.4]
RUN = {"dt": 0.05, "n_steps": 200, "save_every": 5, "method": "rk4"}
FILES = ["history.npy", "history.times.npy"]


def saved(path, *functions, **more):
    return fa.propagate(BODY, *START, **RUN, **more, on_save=[*functions, fa.to_file(path)])


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
def test_a_history_is_that_in_memory_with_its_times_beside_it(method, tmp_path):
    path, start = tmp_path / FILES[0], [np.tile(x, (3, 1)) for x in START]
    options = {**RUN, "method": method, "n_steps": 201}
    whole = fa.propagate(BODY, *start, **options)
    run = fa.propagate(BODY, *start, **options, on_save=fa.to_file(path))
    history = np.concatenate([whole.q, whole.w, whole.norm_error[..., None]], axis=-1)
    assert np.load(path).tobytes() == history.tobytes()
    assert np.load(tmp_path / FILES[1]).tobytes() == run.t.tobytes() == whole.t.tobytes()
    for name in ("state", "w", "norm_error", "status"):
        assert getattr(run, name).tobytes() == getattr(whole, name).tobytes()
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


def kill(*_):
    os.kill(os.getpid(), signal.SIGKILL)


def kill_at_a_save(piece):
    if piece.t[-1] > 5.0:
        kill()


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize("at", ["room", "save"])
def test_a_killed_run(at, tmp_path, monkeypatch):
    """No row looks like a result that is none; what is in the files goes on, to the bit."""
    path, checkpoint = tmp_path / FILES[0], tmp_path / "end"
    whole = saved(path)
    for module, name in ((end, "_WRITTEN"), (engine_run, "_OPERATIONS"), (engine_run, "_SECONDS")):
        monkeypatch.setattr(module, name, 0)  # a checkpoint after each block
    child = os.fork()
    if not child:
        signal.alarm(300)
        os.fsync = kill if at == "room" else os.fsync
        saved(path, kill_at_a_save, checkpoint=checkpoint)
        os._exit(1)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
    history, made = np.load(path), 41 if at == "room" else 17
    assert np.array_equal(history[:made, 0, :4], whole.q[:made])
    assert np.isnan(history[made:]).all()
    assert len(names(tmp_path)) == 3  # with a hidden part, or with the checkpoint
    if at == "save":
        done = end.loaded(checkpoint).options["done"]
        assert 0 < done < 128
        rest = fa.resume(BODY, checkpoint, t_end=10.0, checkpoint=checkpoint, save_every=5)
        assert rest.t[1:].tolist() == whole.t[done // 5 + 1 :].tolist()
        assert rest.state[1:].tobytes() == whole.state[done // 5 + 1 :].tobytes()
        # what is over is not done again
        assert end.loaded(checkpoint).options["done"] == 200
        assert fa.resume(BODY, checkpoint, t_end=10.0).q.tobytes() == whole.q[-1:].tobytes()
        checkpoint.unlink()
    saved(path)
    assert names(tmp_path) == FILES
