"""Logs as bytes: of some dialect, mutated, or no logs at all."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.draw import Draw

_ROWS = ("0,0.1,-2.5,3e-1", "10,0.2,1e1,0", "20,0.3,0.0,-1", "30,-0.4,1.5,2", "40,0,0,0.5")
_HEADS = (
    "t_ms,Gyr_X (deg/s),Gyr_Y (deg/s),Gyr_Z (deg/s)", "// Sample rate: 50.0Hz\nPacket,wx,wy,wz",
    "timestamp us,gyro x [mdps],gyro y [mdps],gyro z [mdps]", "# note\ntime [ns],omega_x,omega_y,b",
    ",gx\u2028,gy\x0b,gz",
)  # fmt: skip


def log_file(d: Draw) -> bytes:
    """A log of some dialect."""
    text = "\n".join((d.one(_HEADS), *_ROWS, ""))
    text = text.replace(",", d.one((",", ",", ";", "\t")))
    text = text.replace("\n", d.one(("\n", "\n", "\r\n", "\r")))
    return text.encode(d.one(("utf-8", "utf-8", "utf-8-sig", "latin-1", "utf-16")), "replace")


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


def hostile_log(d: Draw) -> bytes:
    kind, content = d.random.random(), log_file(d)
    if kind < 0.2:
        return content
    if kind < 0.88:
        return mutated(d, content)
    if kind < 0.9:
        return gzip.compress(content)
    return d.one(_BYTES) if kind < 0.96 else d.rng.bytes(d.random.randrange(300))


def written(folder: Path, content: bytes) -> Path:
    path = folder / "log.csv"
    path.write_bytes(content)
    return path


def read_wrong(log: Any) -> str | None:
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
    return None
