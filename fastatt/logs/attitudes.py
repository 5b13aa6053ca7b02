"""Logs to files of attitudes, a chunk at a time: neither has to fit into memory."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import rounding
from fastatt.gyro.streaming import GyroIntegrator
from fastatt.logs.names import LogError
from fastatt.logs.reader import Reader
from fastatt.logs.stamps import Chunk

_NAMES = ("t", "q0", "q1", "q2", "q3")
_ZARR_ROWS = 1 << 17  # of a chunk
_UNIX = 1e8  # s, from which on stamps are Unix time: 1973
Write = Callable[[NDArray[np.float64]], object]


def integrate_chunks(
    reader: Reader, q0: ArrayLike, method: str, write: Write, keep: list[Chunk] | None = None
) -> None:
    """Attitudes of a log's samples, those of ``integrate_rates`` over each piece, bit for bit.

    ``write`` gets rows t, q0 ... q3, and with ``bad="split"`` the number of the piece, each of
    which begins at ``q0``; t is Unix time, s, where the log's stamps are, else s from the first
    sample. ``keep`` gets the chunks.
    """
    piece = _Piece(reader, q0, method, 0)
    with rounding.noted() as told:
        for chunk in reader.chunks():
            if keep is not None:
                keep.append(chunk)
            bounds = [0, *(k for k in chunk.cuts if k), len(chunk.t)]
            for first, last in pairwise(bounds):
                if first in chunk.cuts:
                    write(piece.close())
                    piece = _Piece(reader, q0, method, piece.number + 1)
                write(piece.push(chunk.t[first:last], chunk.values[first:last, :3]))
        write(piece.close())
    if told:
        rounding.warn(told[0])


class _Piece:
    """A stretch of a log without a break."""

    def __init__(self, reader: Reader, q0: ArrayLike, method: str, number: int) -> None:
        self.reader, self.q0, self.method, self.number = reader, q0, method, number
        self.flow: GyroIntegrator | None = None
        # times that wait for their attitudes, and the latest of all
        self.waiting = self.last = np.empty(0)

    def push(self, t: NDArray[np.float64], rates: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rows that are final with some more samples."""
        begun = len(self.last) > 0
        gaps = self.reader.dt(np.concatenate([self.last, t]))
        self.flow = self.flow or GyroIntegrator(
            self.q0, gaps if isinstance(gaps, float) else None, method=self.method, n_threads=1
        )
        equal = isinstance(gaps, float) or (not begun and len(t) == 1)
        q = self.flow.push(rates, None if equal else gaps)
        self.waiting, self.last = np.concatenate([self.waiting, t]), t[-1:]
        return self._rows(q)

    def close(self) -> NDArray[np.float64]:
        """The rows left."""
        return self._rows(np.empty((0, 4)) if self.flow is None else self.flow.close())

    def _rows(self, q: NDArray[Any]) -> NDArray[np.float64]:
        n = len(q)
        rows = np.empty((n, 6 if self.reader.options.bad == "split" else 5))
        begin = self.reader.start if self.reader.start > _UNIX else 0.0
        rows[:, 0], rows[:, 5:] = begin + self.waiting[:n], self.number
        for k in range(4):  # several times as fast as rows of four
            rows[:, 1 + k] = q[:, k]
        self.waiting = self.waiting[n:]
        return rows


@contextmanager
def writing(path: Path, pieces: bool = False) -> Iterator[Write]:
    """A file of rows t (s), q0 ... q3 (and a piece's number), whole or not there at all.

    ``.npy`` is an (n, 5) array, ``.csv`` has a line of names, ``.zarr`` is an array of Zarr.
    """
    names = (*_NAMES, "piece") if pieces else _NAMES
    kinds = {".npy": _npy, ".csv": _csv, ".zarr": _zarr}
    if path.suffix not in kinds:
        raise LogError(f"--out: found the ending {path.suffix!r}; accepted: .csv, .npy and .zarr")
    if path.is_dir() and not _replaceable(path):
        raise LogError(
            f"--out: found the directory {path}; accepted: a file, or one array of Zarr, which is "
            "replaced"
        )
    part = path.with_name(f"{path.name}.part")
    try:
        with kinds[path.suffix](part, names) as write, ThreadPoolExecutor(1) as pool:
            last: Future[object] = pool.submit(int)

            def behind(rows: NDArray[np.float64]) -> None:
                """Write while the next rows are made."""
                nonlocal last
                last.result()
                last = pool.submit(write, rows)

            yield behind
            last.result()
        if path.is_dir():
            shutil.rmtree(path)
        part.replace(path)
    finally:
        if part.is_dir():
            shutil.rmtree(part)
        part.unlink(missing_ok=True)


def _replaceable(path: Path) -> bool:
    """Whether a directory is an array of Zarr and nothing besides."""
    if path.suffix != ".zarr":
        return False
    with suppress(OSError, ValueError):
        node = json.loads((path / "zarr.json").read_text("utf-8"))
        return isinstance(node, dict) and node.get("node_type") == "array"
    return (path / ".zarray").is_file()


@contextmanager
def _npy(path: Path, names: Sequence[str]) -> Iterator[Write]:
    n = 0
    with path.open("wb", buffering=0) as file:

        def head() -> None:
            shape = (n, len(names))
            words = {"descr": "<f8", "fortran_order": False, "shape": shape}
            # has room for longer numbers: it can be written again
            np.lib.format.write_array_header_1_0(file, words)

        def write(rows: NDArray[np.float64]) -> None:
            nonlocal n
            data = rows.astype("<f8", copy=False).reshape(-1).view(np.uint8).data
            while len(data):
                data = data[file.write(data) :]
            n += len(rows)

        head()
        yield write
        file.seek(0)
        head()


@contextmanager
def _csv(path: Path, names: Sequence[str]) -> Iterator[Write]:
    with path.open("wb") as file:
        file.write((",".join(names) + "\n").encode())
        try:
            import pyarrow as pa
            from pyarrow import csv as fast

            options = fast.WriteOptions(include_header=False)

            def write(rows: NDArray[np.float64]) -> None:
                columns = dict(zip(names, np.ascontiguousarray(rows.T), strict=True))
                fast.write_csv(pa.table(columns), file, options)

        except ImportError:

            def write(rows: NDArray[np.float64]) -> None:
                file.writelines(f"{','.join(map(repr, row))}\n".encode() for row in rows.tolist())

        yield write


@contextmanager
def _zarr(path: Path, names: Sequence[str]) -> Iterator[Write]:
    try:
        import zarr
    except ImportError:
        raise ImportError(f"{path.stem}: needs zarr; pip install zarr") from None
    array: Any = zarr.open(
        str(path), mode="w", shape=(0, len(names)), chunks=(_ZARR_ROWS, len(names)), dtype="f8"
    )
    array.attrs["columns"] = list(names)
    yield array.append
