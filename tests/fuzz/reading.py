"""The log reader and ``fastatt integrate``."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path
from typing import Any

import numpy as np

import fastatt as fa
from fastatt import cli
from fuzz.arrays import METHODS
from fuzz.draw import ODD, Draw
from fuzz.judge import REFUSALS, Call, Refused, unit
from fuzz.logs import Log, hostile_log, read_wrong, written

READER = (
    "source", "time stamp", "columns", "unit", "rate", "time_column", "attitude_columns",
    "time_unit", "on_bad_rows", "max_gap", "bias_seconds", "time column", "attitude columns",
    "log.csv",
)  # fmt: skip


def read(d: Draw, folder: Path) -> Call:
    meant = hostile_log(d)
    path: Any = written(folder, meant.content)
    options = dict(meant.options)
    if d.chance(0.1):
        meant = Log(b"", {}, None, None)
        for name, value in (
            ("rate", lambda: d.real(50.0)),
            ("unit", lambda: d.word("rad/s", "deg/s")),
            ("time_unit", lambda: d.word("s", "ms", "us", "ns")),
            ("on_bad_rows", lambda: d.word("drop", "split", "hold")),
            ("max_gap", lambda: d.real(1.0)),
            ("bias_seconds", lambda: d.real(1.0)),
            ("columns", lambda: _chosen(d, 3)),
            ("time_column", lambda: d.one(("1", "t", 1, 0, "", None, *ODD[:30]))),
            ("attitude_columns", lambda: _chosen(d, 4)),
        ):
            if d.chance(0.4):
                options[name] = value()
    if d.chance(0.01):
        path = d.one(
            (folder, folder / "none.csv", "", "a\x00b", str(path), os.fsencode(path), *ODD)
        )
        path = folder if isinstance(path, bool) else path  # no file descriptors

    def judge(log: Any) -> str | None:
        return read_wrong(log, meant)

    return Call(fa.read_gyro_log, (path,), options, judge, READER, (*REFUSALS, OSError))


def _chosen(d: Draw, n: int) -> Any:
    names = ("1", "2", "3", "4", "5", "wx", "wy", "wz", "0", "-1", "99", "²", "", 1, 2, 3, None)
    return d.one(
        ([d.one(names) for _ in range(n)], ["2", "3", "4", "5"][:n], "xyz", 5, [], *ODD[:9])
    )


def commanded(d: Draw, folder: Path, methods: tuple[str, ...] = METHODS) -> Call:
    meant = hostile_log(d)
    path = written(folder, meant.content)
    out = folder / d.one(("out.csv", "out.csv", "out.npy"))
    arguments = ["integrate", str(path), "-o", str(out), "--no-compare", "-q"]
    arguments += ["-m", d.one(methods)]
    for name, value in meant.options.items():
        arguments += [f"--{name}", ",".join(value) if name == "columns" else str(value)]
    odd = (
        "nan",
        "0",
        "-1",
        "1e-320",
        "1e308",
        "x",
        "",
        "1,2,3",
        "\x00",
        "0,0,0,0",
        "1,0,0,0",
        "inf",
    )
    for name in ("--rate", "--q0", "--max-gap", "--columns", "--unit", "-m", "-o", "--time-column"):
        if d.chance(0.04):
            meant = Log(b"", {}, None, None)
            arguments += (
                [name, d.one(odd)] if name != "-o" else ["-o", str(folder / d.one(odd[5:8]))]
            )
    if d.chance(0.02):
        arguments[1] = d.one((str(folder), str(folder / "none"), "a\x00b", ""))

    def run() -> int:
        said, failed = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(failed):
            try:
                code = cli.main(arguments)
            except SystemExit as left:  # argparse
                code = 2 if left.code == 2 and "error: " in failed.getvalue() else -1
                failed = io.StringIO("fastatt: refused")
        if code == 2:
            said = failed.getvalue().splitlines()
            text = "\n".join(x for x in said if not x.startswith("fastatt: warning: "))
            if not text.startswith("fastatt: ") or len(text.splitlines()) != 1 or len(text) > 2000:
                raise AssertionError(f"refusal: {text[:200]!r}")
        return Refused(code) if code == 2 else code

    def judge(code: Any) -> str | None:
        if code == 2:
            return None
        if code != 0:
            return f"code {code}"
        found = np.load(out) if out.suffix == ".npy" else np.loadtxt(out, delimiter=",", skiprows=1)
        wrong = unit(np.atleast_2d(found)[:, 1:])
        if (
            wrong is None
            and meant.rates is not None
            and len(np.atleast_2d(found)) != len(meant.rates)
        ):
            wrong = f"{len(found)} rows of {len(meant.rates)}"
        return wrong

    return Call(run, (), {}, judge, READER)
