"""Logs that are damaged and tables of odd names: read right, refused, or read with a word.

Right is each row that is whole, with the numbers that it has. A row that is damaged may only be
read as what it says, where it still is a row of numbers.
"""

from __future__ import annotations

import gzip
import math
import random
import re
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

import fastatt as fa

HEAD = "time [s],gx [rad/s],gy [rad/s],gz [rad/s]"
NUMBER = r'\s*"*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"*\s*'
ROW = re.compile(",".join([NUMBER] * 4))


def of_damage(seed: int, folder: Path) -> tuple[str, str]:
    """A text log with one damage."""
    r = random.Random(seed)
    n = r.choice((20, 300, 5000))
    rows = [f"{k / 100},{math.sin(k / 50):.6f},{r.uniform(-1, 1):.4f},{k * 1e-3}" for k in range(n)]
    text = "\n".join([HEAD, *rows, ""]).encode()
    kind = r.choice(sorted(DAMAGES))
    at = r.randrange(len(HEAD) + 1, len(text))
    damaged = DAMAGES[kind](r, text, at)
    path = folder / r.choice(("log.csv", "log.txt", "log.csv.gz"))
    path.write_bytes(gzip.compress(damaged) if path.suffix == ".gz" else damaged)
    about = f"{kind} at byte {at} of {len(text)} ({path.name}), {damaged[at - 30 : at + 40]!r}"
    log, told = read(path)
    if isinstance(log, str):
        return f"{kind}: refused", log and f"{about}: {log}"
    if told:
        return f"{kind}: told", ""
    plain = [x for x in damaged.decode("utf-8", "replace").split("\n")[1:] if ROW.fullmatch(x)]
    known = {tuple(float(x.strip(' "')) for x in row.split(",")[1:]) for row in plain}
    strange = [k for k, x in enumerate(log.rates.tolist()) if tuple(x) not in known]
    if strange:
        return kind, f"{about}: row {strange[0]} is read as {log.rates[strange[0]]}, unsaid"
    lost = len(set(rows) & set(plain)) - len(log.rates)
    return f"{kind}: right", f"{about}: {lost} whole rows are lost, unsaid" if lost > 0 else ""


def read(path, **options):
    """(the log or what is wrong with its refusal, whether something was told)."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            log = fa.read_gyro_log(path, **options)
        except (TypeError, ValueError, OSError) as error:
            text = str(error)
            return "" if len(text.splitlines()) == 1 else f"refused in lines: {text!r}", False
        except Exception as error:  # noqa: BLE001
            return f"{type(error).__name__}: {error}", False
    return log, bool(told) or "left out" in log.summary


def put(new):
    """A damage that replaces some bytes."""
    return lambda r, text, at: text[:at] + new(r, text[at : at + 8]) + text[at + 8 :]


DAMAGES = {
    "a NUL more": lambda r, text, at: text[:at] + b"\0" + text[at:],
    "a NUL in place": lambda r, text, at: text[:at] + b"\0" + text[at + 1 :],
    "zeros in place": put(lambda r, x: b"\0" * len(x)),
    "many zeros more": lambda r, text, at: text[:at] + b"\0" * 4096 + text[at:],
    "cut": lambda r, text, at: text[:at],
    "a bit flipped": lambda r, text, at: (
        text[:at] + bytes([text[at] ^ 1 << r.randrange(8)]) + text[at + 1 :]
    ),
    "lines joined": lambda r, text, at: text[:at] + text[at:].replace(b"\n", b"", 1),
    "bytes in place": put(lambda r, x: r.randbytes(len(x))),
    "bytes lost": lambda r, text, at: text[:at] + text[at + r.randrange(1, 60) :],
    "a part twice": lambda r, text, at: text[:at] + text[max(0, at - 100) :],
    "carriage returns": lambda r, text, at: text[:at] + text[at:].replace(b"\n", b"\r\n"),
    "a head again": lambda r, text, at: (
        text[:at] + text[at:].replace(b"\n", b"\n" + HEAD.encode() + b"\n", 1)
    ),
}

# tables

UNITS = {
    "rad/s": 1.0, "rad_s": 1.0, "rad s-1": 1.0, "deg/s": math.pi / 180, "dps": math.pi / 180,
    "deg_s": math.pi / 180, "mrad/s": 1e-3, "mdps": math.pi / 180e3, "°/s": math.pi / 180,
}  # fmt: skip
STEMS = (
    "gyro", "Gyro", "GYRO", "gyr", "omega", "w", "g", "angular_velocity", "angular rate",
    "gyroscope", "imu_gyro", "body_rate", "rate",
)  # fmt: skip
SHAPES = (
    "{stem}_{axis} [{unit}]", "{stem}{axis} ({unit})", "{stem}.{axis} [{unit}]",
    "{stem} {axis} {unit}", "{stem}_{axis}_{unit}", "{axis}_{stem} [{unit}]", "{stem}_{axis}",
    "{stem}[{index}] [{unit}]", " {stem}_{axis} [{unit}] ", "{stem}_{axis}[{unit}]",
)  # fmt: skip
BESIDE = (
    "accel_x [m/s^2]", "mag_x [uT]", "temperature [degC]", "gyro_bias_x [rad/s]", "quality",
    "gyro_temp", "gx_raw", "wx_setpoint [rad/s]", "gyro_x_filtered [rad/s]", "Unnamed: 0",
    "angular_acceleration_x [rad/s^2]", "gyro_norm [rad/s]", "time_of_week [s]", "",
)  # fmt: skip
TIMES = {
    "time [s]": 1.0, "t": 1.0, "timestamp [ms]": 1e3, "time_us": 1e6, "Time (s)": 1.0,
    "timestamp_ns": 1e9, "elapsed": 1.0, "Time [ns]": 1e9,
}  # fmt: skip


def of_names(seed: int, folder: Path) -> tuple[str, str]:
    """A table whose columns have names of some style, with others between them."""
    r = random.Random(seed)
    unit, shape, stem, time = (r.choice([*x]) for x in (UNITS, SHAPES, STEMS, TIMES))
    axes = r.choice(("xyz", "XYZ", "xyz", "rpq"))
    rng = np.random.default_rng(seed)
    rates, t = rng.normal(size=(50, 3)), np.arange(50) * 0.01
    columns = {time: t * TIMES[time]}
    for k, axis in enumerate(axes):
        columns[shape.format(stem=stem, axis=axis, unit=unit, index=k)] = rates[:, k] / UNITS[unit]
    for name in r.sample(BESIDE, r.choice((0, 1, 3))):
        columns[name] = rng.normal(size=50)
    names = list(columns)
    if r.random() < 0.5:
        r.shuffle(names)
    table = pd.DataFrame({name: columns[name] for name in names})
    source = table
    if r.random() < 0.5:
        source = folder / "table.csv"
        table.to_csv(source, index=r.random() < 0.2)
    log, told = read(source)
    if isinstance(log, str):
        return "names: refused", log and f"{names}: {log}"
    if told:
        return "names: told", ""
    is_right = log.rates.shape == rates.shape and np.allclose(log.rates, rates, rtol=1e-9)
    is_right = is_right and np.allclose(np.diff(log.t), 0.01, rtol=1e-6)
    return (
        "names: right",
        "" if is_right else f"{names}: {log.rates[0]}, not {rates[0]}; {log.t[:2]}",
    )
