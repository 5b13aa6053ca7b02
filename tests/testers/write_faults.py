"""Writes that fail, and processes that are killed while they write: no file is half of one."""

from __future__ import annotations

import errno
import os
import random
import signal
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path
from unittest import mock

import numpy as np

import fastatt as fa
from fastatt.propagation import end

SCENE = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=fa.torques.GravityGradient(0.3))
N = 64
Q0, W0 = np.tile([1.0, 0.0, 0.0, 0.0], (N, 1)), np.random.default_rng(1).normal(size=(N, 3))
PLAIN = {"dt": 0.01, "method": "rk4", "n_threads": 1}
EVERY = {**PLAIN, "n_steps": 64, "save_every": 1}


def run(**options) -> fa.Trajectory:
    return fa.propagate(SCENE, Q0, W0, **options)


WRITERS = {
    "end": lambda path, whole: whole.save_end(path),
    "table": lambda path, whole: whole.to_csv(path),
    "checkpoint": lambda path, whole: run(**PLAIN, n_steps=4, checkpoint=path),
    "history.npy": lambda path, whole: run(**EVERY, on_save=fa.to_file(path)),
}


class Full:
    """A file on a disk that is full after some bytes."""

    def __init__(self, file, room: int, code: int) -> None:
        self._file, self._room, self._code = file, room, code

    def __getattr__(self, name):
        return getattr(self._file, name)

    def __enter__(self):
        self._file.__enter__()
        return self

    def __exit__(self, *raised):
        return self._file.__exit__(*raised)

    def write(self, data):
        self._room -= len(data)
        if self._room < 0:
            raise OSError(self._code, os.strerror(self._code))
        return self._file.write(data)


def fault(place: str, r: random.Random, code: int):
    """A patch that makes a call of the system fail."""
    if place == "write":
        room, opened = r.choice((0, 1, 100)), Path.open

        def writes(self, mode="r", *args, **options):
            file = opened(self, mode, *args, **options)
            return file if mode.startswith("r") else Full(file, room, code)

        return mock.patch.object(Path, "open", writes)
    module, name = {"fsync": (os, "fsync"), "rename": (os, "replace"), "mmap": ("mmap", "mmap")}[
        place
    ]
    error = OSError(code, os.strerror(code))
    if module == "mmap":
        return mock.patch("mmap.mmap", side_effect=error)
    return mock.patch.object(module, name, side_effect=error)


def of_faults(seed: int, folder: Path) -> tuple[str, str]:
    """A write over an older file, or to a new one, that fails in the middle."""
    r = random.Random(seed)
    name, place = r.choice(sorted(WRITERS)), r.choice(("write", "fsync", "rename", "mmap"))
    path, code = folder / name, r.choice((errno.ENOSPC, errno.EIO))
    path.unlink(missing_ok=True)
    before = r.choice((None, b"old"))
    if before is not None:
        path.write_bytes(before)
    about = f"{name}, {errno.errorcode[code]} at {place}, before {before}"
    whole = run(**PLAIN, n_steps=4)
    raised = None
    with fault(place, r, code):
        try:
            WRITERS[name](path, whole)
        except OSError as error:
            raised = error
        except Exception as error:  # noqa: BLE001
            return name, f"{about}: {type(error).__name__}: {error}"
    if raised is None:
        return f"{name}: written", "" if place == "mmap" else f"{about}: no error"
    parts = [x.name for x in folder.iterdir() if x.suffix == ".part"]
    after = path.read_bytes() if path.exists() else None
    if parts or (after != before and not (place == "mmap" and is_whole(path))):
        return name, f"{about}: left {parts}, {after and after[:20]!r}"
    WRITERS[name](path, whole)
    return f"{name}: {place}", "" if is_whole(path) else f"{about}: not written afterwards"


def is_whole(path: Path) -> bool:
    """Whether a file is one that its writer has finished."""
    if path.suffix == ".npy":
        return np.load(path, mmap_mode="r").shape == (65, N, 8)
    if path.name == "table":
        return path.read_text(encoding="utf-8").count("\n") == N + 1
    fa.resume(SCENE, path, n_steps=1)
    return True


def write_for_ever(folder: Path) -> None:
    """Ends, tables and checkpoints, again and again."""
    end._WRITTEN = 0.0  # a checkpoint after each piece
    whole = run(**PLAIN, n_steps=4)
    k = 0
    while True:
        k += 1
        whole.save_end(folder / "end")
        whole.to_csv(folder / "table")
        run(**PLAIN, n_steps=2000, save_every=100, checkpoint=folder / "checkpoint")
        run(**EVERY, on_save=fa.to_file(folder / "history.npy"))
        source = f"def torque(t, q, w, p):\n    return 0.1 * w[0], {k}.5 * w[1], 0.0\n"
        scope: dict = {}
        exec(source, scope)
        scene = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=scope["torque"])
        fa.propagate(scene, Q0[:1], W0[:1], **PLAIN, n_steps=1)  # a program for the cache


def main(folder: Path, kills: int, seed: int) -> int:
    """Kill children at random moments; the number of files that were found, all of them whole."""
    warnings.simplefilter("ignore")
    wanted = run(**PLAIN, n_steps=8).q.tobytes()
    r, count = random.Random(seed), 0
    run(**EVERY)
    for _ in range(kills):
        child = os.fork()
        if not child:
            with suppress(BaseException):
                write_for_ever(folder)
            os._exit(1)
        time.sleep(r.uniform(0.0, 0.6))
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        if not os.WIFSIGNALED(status):
            raise AssertionError("a child ended by itself")
        for name in ("end", "table", "checkpoint", "history.npy"):
            if (folder / name).exists():
                count += 1
                if not is_whole(folder / name):
                    raise AssertionError(f"{name} is not whole")
        if (folder / "end").exists():
            on = fa.resume(SCENE, folder / "end", n_steps=4)
            if on.q.tobytes() != wanted:
                raise AssertionError("end: other numbers")
    return count


if __name__ == "__main__":
    print(main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])))
