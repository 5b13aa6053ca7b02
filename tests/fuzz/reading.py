"""The log reader."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import fastatt as fa
from fuzz.draw import ODD, Draw
from fuzz.judge import REFUSALS, Call
from fuzz.logs import hostile_log, read_wrong, written

READER = (
    "source", "time stamp", "columns", "unit", "rate", "time_column", "rows", "time_unit",
    "on_bad_rows", "max_gap", "bias_seconds", "time column", "log.csv",
)  # fmt: skip


def read(d: Draw, folder: Path) -> Call:
    path: Any = written(folder, hostile_log(d))
    options: dict[str, Any] = {"unit": "rad/s"}
    if d.chance(0.5):
        options["rate"] = 50.0
    if d.chance(0.2):
        options["columns"] = ["1", "2", "3"]
    if d.chance(0.1):
        for name, value in (
            ("rate", lambda: d.real(50.0)),
            ("unit", lambda: d.word("rad/s", "deg/s")),
            ("time_unit", lambda: d.word("s", "ms", "us", "ns")),
            ("on_bad_rows", lambda: d.word("drop", "split")),
            ("max_gap", lambda: d.real(1.0)),
            ("bias_seconds", lambda: d.real(1.0)),
            ("columns", lambda: _chosen(d, 3)),
            ("time_column", lambda: d.one(("1", "t", 1, 0, "", None, *ODD[:30]))),
            ("rows", lambda: d.one((("1", "x"), ("wx", 0.5), [("a", "b")], (), *ODD[:30]))),
        ):
            if d.chance(0.4):
                options[name] = value()
    if d.chance(0.01):
        path = d.one(
            (folder, folder / "none.csv", "", "a\x00b", str(path), os.fsencode(path), *ODD)
        )
        path = folder if isinstance(path, bool) else path  # no file descriptors

    return Call(fa.read_gyro_log, (path,), options, read_wrong, READER, (*REFUSALS, OSError))


def _chosen(d: Draw, n: int) -> Any:
    names = ("1", "2", "3", "4", "5", "wx", "wy", "wz", "0", "-1", "99", "²", "", 1, 2, 3, None)
    return d.one(
        ([d.one(names) for _ in range(n)], ["2", "3", "4", "5"][:n], "xyz", 5, [], *ODD[:9])
    )
