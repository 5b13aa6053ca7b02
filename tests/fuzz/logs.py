"""Logs as bytes: of some dialect, mutated, or no logs at all."""

from __future__ import annotations

import gzip
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzz.draw import Draw

# logs


class Log(NamedTuple):
    """A log as written: its bytes, how it is read, and what was meant (None: not known)."""

    content: bytes
    options: Mapping[str, Any]
    rates: NDArray[np.float64] | None
    t: NDArray[np.float64] | None


_NAMES = (
    ("Gyr_X", "Gyr_Y", "Gyr_Z"), ("gyro x", "gyro y", "gyro z"), ("wx", "wy", "wz"),
    ("Gyroscope X (deg/s)", "Gyroscope Y (deg/s)", "Gyroscope Z (deg/s)"),
    ("Gyr_X [mdps]", "Gyr_Y [mdps]", "Gyr_Z [mdps]"), ("wx (deg/h)", "wy (deg/h)", "wz (deg/h)"),
    ("omega_x", "omega_y", "omega_z"), ("rate_x (rad/s)", "rate_y (rad/s)", "rate_z (rad/s)"),
    ("gx\u2028", "gy\x0b", "gz"), ("a", "b", "c"),
)  # fmt: skip
_CLOCKS = {"t [s]": 1.0, "Time (s)": 1.0, "t_ms": 1e-3, "timestamp us": 1e-6, "time [ns]": 1e-9}
_DEGREES = math.pi / 180.0
# rad/s, where the names say
_SCALES = {"deg/s": _DEGREES, "mdps": 1e-3 * _DEGREES, "deg/h": _DEGREES / 3600.0}


def log_file(d: Draw) -> Log:
    """A log of some dialect, that means what it says."""
    n = d.one((2, 3, 5, 12, 17))
    rates = np.round(d.rng.standard_normal((n, 3)), d.one((2, 6, 17)))
    names = d.one(_NAMES)
    clock = d.one((*_CLOCKS, None))
    stamps = np.cumsum(d.rng.integers(1, 4, size=n)) * d.one((1.0, 10.0, 0.25))
    columns = [list(map(repr, x.tolist())) for x in rates.T]
    head = list(names)
    if clock:
        head.insert(0, clock)
        columns.insert(0, list(map(repr, stamps.tolist())))
    if d.chance(0.15):  # an index without a name, as data frames write it
        head.insert(0, "")
        columns.insert(0, [str(i) for i in range(n)])
    if d.chance(0.15):
        head.append("note")
        columns.append([d.one(("1", "", "0.0")) for _ in range(n)])
    # between blanks a column without a name or a number does not show
    whole = "" not in head and "note" not in head
    separator = d.one((",", ",", ";", "\t", " ", "  ") if whole else (",", ";", "\t"))
    quote = '"' if d.chance(0.1) else ""
    lines = [
        separator.join(f"{quote}{x}{quote}" for x in row) for row in zip(*columns, strict=True)
    ]
    if d.chance(0.05):
        lines = [x.replace(".", ",") for x in lines]
    if d.chance(0.2):
        lines = [x + separator for x in lines]
    for _ in range(d.one((0, 0, 1, 5))):
        lines.insert(d.random.randrange(len(lines)), d.one(("", "# note", "   ", "// x", "%")))
    has_names = d.chance(0.9)
    if has_names:
        lines.insert(0, separator.join(f"{quote}{x}{quote}" for x in head))
    rate = None
    if d.chance(0.2):
        text, rate = d.one(_RATES)
        lines.insert(0, f"// Sample rate: {text}")
    end = d.one(("\n", "\n", "\r\n", "\r"))
    text = end.join(lines) + (end if d.chance(0.7) else "")
    encoding = d.one(("utf-8", "utf-8", "utf-8", "utf-8-sig", "latin-1", "utf-16"))
    options: dict[str, Any] = {}
    if d.chance(0.3) or (clock is None and rate is None):
        options["rate"], rate = 50.0, 50.0
    elif clock:
        rate = None
    t = stamps * _CLOCKS[clock] if clock and rate is None else None
    if t is None and rate:
        t = np.arange(n) / rate
    scale = next((k for name, k in _SCALES.items() if name in names[0]), 1.0)
    if not has_names or not any(unit in names[0] for unit in (*_SCALES, "rad/s")):
        options["unit"], scale = "rad/s", 1.0
    return Log(text.encode(encoding, "replace"), options, rates * scale, t)


_RATES = (
    ("50.0Hz", 50.0), ("100 Hz", 100.0), ("1e3 Hz", 1e3), ("1,000 Hz", 1e3), ("0.1 kHz", 100.0),
    ("1..5", None), (".", None), ("fast", None), ("0", None), ("-50 Hz", None),
    ("\u0665\u0660", 50.0), ("9" * 400, None),
)  # fmt: skip
_BYTES = (
    b"", b"\x00", b"\n", b"\x00" * 300, b"\xff\xfe", b"\xef\xbb\xbf", b"1", b"1,2,3",
    b"1,2,3\n" * 2,
    b"nan,nan,nan\n", b"1e999,1,1\n", b",,,\n,,,\n", b"#\n" * 50, b'"1","2","3"\n', b"1;2;3\r1;2;3",
    b"1\n2\n3\n", b"\x1f\x8b" + bytes(40), b"1,2,3\n# end", b"1_0,2,3\n", b"0x1p3,2,3\n",
    "١,٢,٣\n".encode(), b"1e308,-1e308,1e308\n" * 3, b"wx,wy,wz\n", b"a" * 100_000,
    b"1," * 20_000 + b"1\n", b"t,wx,wy,wz\n-1e308,0,0,0\n1e308,0,0,0\n",
    b"t,wx,wy,wz\n0,0,0,0\n5e-324,0,0,0\n", b"t_ns,wx,wy,wz\n0,0,0,0\n1e-320,0,0,0\n",
    b"t,wx,wy,wz\n1,0,0,0\n1.0000000000000001,0,0,0\n",
)  # fmt: skip


def mutated(d: Draw, content: bytes) -> bytes:
    x = bytearray(content)
    for _ in range(d.one((1, 1, 2, 5))):
        how = d.random.randrange(7)
        at = d.random.randrange(len(x) + 1)
        to = min(len(x), at + d.one((1, 1, 3, 20)))
        if how == 0 and at < len(x):
            x[at] ^= 1 << d.random.randrange(8)
        elif how == 1:
            del x[at:to]
        elif how == 2:
            del x[at:]
        elif how == 3:
            x[at:at] = x[at:to]
        elif how == 4:
            x[at:at] = d.one((b",", b"\n", b'"', b"\x00", b"#", b"-", b"e", b"nan", b"\r", b"\t"))
        elif how == 5:
            x[at:at] = d.one(_BYTES)[:50]
        else:
            x[at:to] = bytes(d.random.randrange(256) for _ in range(to - at))
    return bytes(x)


def hostile_log(d: Draw) -> Log:
    kind = d.random.random()
    if kind < 0.45:
        return log_file(d)
    log = log_file(d)
    if kind < 0.9:
        content = mutated(d, log.content)
    elif kind < 0.92:
        content = gzip.compress(log.content)
    elif kind < 0.96:
        content = d.one(_BYTES)
    else:
        content = d.rng.bytes(d.random.randrange(300))
    options = dict(log.options)
    if d.chance(0.2):
        options["columns"] = ["1", "2", "3"]
    return Log(content, options, None, None)


def written(folder: Path, content: bytes) -> Path:
    path = folder / "log.csv"
    path.write_bytes(content)
    return path


def read_wrong(log: Any, meant: Log) -> str | None:  # noqa: PLR0911
    """What is wrong with a log that was read."""
    n = len(log.rates)
    if log.rates.shape != (n, 3) or not np.isfinite(log.rates).all():
        return "rates not finite"
    dt = np.asarray(log.dt)
    if not (np.isfinite(dt).all() and (dt > 0.0).all()) or dt.shape not in ((), (n - 1,)):
        return "intervals not finite or not above 0"
    if log.t.shape != (n,) or not np.isfinite(log.t).all():
        return "times not finite"
    if not log.rate > 0.0:
        return "sample rate not above 0"
    if meant.rates is None:
        return None
    if log.rates.shape != meant.rates.shape:
        return f"{n} rows of {len(meant.rates)}"
    if not np.allclose(log.rates, meant.rates, rtol=1e-14, atol=0.0):
        return "other rates than written"
    if meant.t is None or not np.allclose(log.t, meant.t - meant.t[0], rtol=1e-9, atol=1e-15):
        return "other times than written"
    return None
