"""Files that the library writes: whole or not at all, devices and links as they are."""

import functools
import os
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from each import in_tiers

import fastatt as fa
from fastatt.gyro.attitudes import write_attitudes

BODY = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
START = {"q0": [1.0, 0.0, 0.0, 0.0], "w0": [0.1, 0.2, 0.3], "dt": 0.1, "method": "rk4"}


@functools.cache
def run():
    return fa.propagate(BODY, **START, n_steps=20, save_every=5)


@functools.cache
def study():
    start = START["q0"], START["w0"]
    options = {"methods": ["rk4"], "dtypes": ("float64",), "repeats": 1, "max_seconds": 0.1}
    return fa.work_precision(BODY, *start, t_end=1.0, **options)


WRITERS = {
    "csv": lambda path: run().to_csv(path),
    "aem": lambda path: run().to_aem(path, epoch="2026-01-01", frame="ICRF"),
    "end": lambda path: run().save_end(path),
    "checkpoint": lambda path: fa.propagate(BODY, **START, n_steps=20, checkpoint=path),
    "picture": lambda path: run().plot(path),
    "study.png": lambda path: study().plot(path),
    "study.csv": lambda path: study().to_csv(path),
    "attitudes.csv": lambda path: write_attitudes(Path(path), np.ones((3, 5))),
    "attitudes.npy": lambda path: write_attitudes(Path(path), np.ones((3, 5))),
}
CLOCK = re.compile(rb"CREATION_DATE = .*|PK.*", re.DOTALL)  # an archive has times of its parts


@pytest.fixture(params=in_tiers([x for x in WRITERS if x != "study.png"], WRITERS))
def writer(request):
    return request.param, WRITERS[request.param]


def test_the_file_is_what_was_named(writer, tmp_path):
    """A regular file is replaced, a link's target, a pipe and a device are written to."""
    name, write = writer
    ending = Path(name).suffix
    path, target, link, pipe = (tmp_path / f"{x}{ending}" for x in ("new", "old", "link", "pipe"))
    write(path)
    content = CLOCK.sub(b"", path.read_bytes())
    target.write_text("before" * 100_000)
    target.chmod(0o640)
    link.symlink_to(target)
    os.mkfifo(pipe)
    write(link)
    with ThreadPoolExecutor(1) as thread:
        piped = thread.submit(pipe.read_bytes)
        write(pipe)
        assert CLOCK.sub(b"", piped.result()) == content
    assert link.is_symlink()
    assert pipe.is_fifo()
    assert CLOCK.sub(b"", target.read_bytes()) == content
    write(target)
    assert target.stat().st_mode & 0o777 == 0o640
    if not ending:
        write("/dev/null")
        assert Path("/dev/null").is_char_device()
    folder = tmp_path / f"folder{ending}"
    folder.mkdir()
    with pytest.raises(ValueError, match=r": found the directory .*; accepted: a file"):
        write(folder)
    with pytest.raises(FileNotFoundError, match=f"none/new{ending}"):
        write(tmp_path / "none" / f"new{ending}")


def test_a_file_that_fails_leaves_the_one_before_and_others(writer, tmp_path, monkeypatch):
    name, write = writer
    path, other = tmp_path / f"new{Path(name).suffix}", tmp_path / f"new{Path(name).suffix}.part"
    path.write_text("before")
    other.symlink_to(path)

    def full(*_):
        raise OSError("disk full")

    with monkeypatch.context() as context:
        context.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="disk full"):
            write(path)
    assert path.read_text() == "before"
    write(path)
    assert path.read_bytes() != b"before"
    assert other.is_symlink()
    assert set(tmp_path.iterdir()) == {path, other}


def test_a_history_leaves_the_map_of_the_one_before(tmp_path):
    """Its file takes the name when the run begins, since it may be read on the way."""

    def saved(path, steps):
        return fa.propagate(BODY, **START, n_steps=steps, save_every=1, on_save=fa.to_file(path))

    path, link = tmp_path / "run.npy", tmp_path / "link.npy"
    first = saved(path, 30)
    before = first.q.copy()
    saved(path, 10)
    assert np.array_equal(first.q, before)
    assert len(np.load(path)) == 11
    link.symlink_to(path)
    saved(link, 20)
    assert link.is_symlink()
    assert len(np.load(path)) == 21
    os.mkfifo(tmp_path / "pipe.npy")
    with pytest.raises(ValueError, match=r"on_save: found .*pipe.npy, which cannot be mapped"):
        saved(tmp_path / "pipe.npy", 10)
    assert not list(tmp_path.glob("*.part"))


def test_a_checkpoint_into_a_folder_is_refused_before_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr("fastatt.propagation.plan.Plan.run", lambda *_, **__: pytest.fail("begun"))
    with pytest.raises(ValueError, match="checkpoint: found the directory"):
        fa.propagate(BODY, **START, n_steps=20, checkpoint=tmp_path)


def test_a_name_as_long_as_folders_allow(tmp_path):
    path = tmp_path / f"{'n' * 251}.csv"
    run().to_csv(path)
    assert [path] == [*tmp_path.iterdir()]
