"""Files of attitudes with rows t (s), q0 ... q3 and, for a log in pieces, the piece's number."""

from __future__ import annotations

import csv
import json
import math
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import rounding
from fastatt.gyro.integrate import integrate_rates
from fastatt.logs.log import GyroLog
from fastatt.logs.names import GyroLogError

Rows = NDArray[np.float64]
_NAMES = ("t", "q0", "q1", "q2", "q3", "piece")
_CHUNK = 1 << 17  # rows
_UNIX = 1e8  # s (1973); larger time stamps are Unix time


def attitude_rows(log: GyroLog, q0: ArrayLike, method: str, *, pieces: bool = False) -> Rows:
    """Times and attitudes of a log, (n, 5), with each piece integrated from ``q0``.

    Times are Unix time, s, if the log's stamps are, else s from the first sample. With ``pieces`` a
    sixth column has the number of the piece.
    """
    rows = np.empty((len(log.t), 5 + pieces))
    rows[:, 0] = log.t + (log.start if log.start > _UNIX else 0.0)
    with rounding.noted() as texts:
        for k, piece in enumerate(log.pieces):
            dt = log.dt[piece.start : piece.stop - 1]
            rates = log.rates[piece]
            rows[piece, 1:5] = integrate_rates(rates, dt, q0, method=method, max_gap=math.inf)
            rows[piece, 5:] = k
    if texts:
        rounding.warn(texts[0])
    return rows


def attitude_file(path: Path) -> Callable[[Rows], None]:
    """A function that writes rows to a file, completely or not at all.

    ``.npy`` is an array, ``.csv`` has a line of names, ``.zarr`` is a Zarr array.

    Raises ``GyroLogError`` for another ending, and for a directory that is not such an array.
    """
    kinds = {".npy": _npy, ".csv": _csv, ".zarr": _zarr}
    if path.suffix not in kinds:
        raise GyroLogError(
            f"--out: found the ending {path.suffix!r}; accepted: .csv, .npy and .zarr"
        )
    if path.is_dir() and not _is_zarr_array(path):
        raise GyroLogError(
            f"--out: found the directory {path}; accepted: a file, or one array of Zarr, which is "
            "replaced"
        )
    part = path.with_name(f"{path.name}.part")

    def write(rows: Rows) -> None:
        try:
            kinds[path.suffix](part, rows)
            if path.is_dir():
                shutil.rmtree(path)
            part.replace(path)
        finally:
            if part.is_dir():
                shutil.rmtree(part)
            part.unlink(missing_ok=True)

    return write


def _is_zarr_array(path: Path) -> bool:
    """Whether a directory is a Zarr array, not a group of them."""
    if path.suffix != ".zarr":
        return False
    with suppress(OSError, ValueError):
        node = json.loads((path / "zarr.json").read_text("utf-8"))
        return isinstance(node, dict) and node.get("node_type") == "array"
    return (path / ".zarray").is_file()


def _npy(path: Path, rows: Rows) -> None:
    with path.open("wb") as file:
        np.save(file, rows)


def _csv(path: Path, rows: Rows) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_NAMES[: rows.shape[1]])
        for k in range(0, len(rows), _CHUNK):
            writer.writerows(rows[k : k + _CHUNK].tolist())


def _zarr(path: Path, rows: Rows) -> None:
    try:
        import zarr
    except ImportError:
        raise ImportError(f"{path.stem}: needs zarr; pip install zarr") from None
    shape = (_CHUNK, rows.shape[1])
    array: Any = zarr.open(str(path), mode="w", shape=rows.shape, chunks=shape, dtype="f8")
    array[:] = rows
    array.attrs["columns"] = list(_NAMES[: rows.shape[1]])
