"""Rows that are no samples, biases, tables in memory, and logs in chunks."""

from __future__ import annotations

import gzip
import io
import sys
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pandas as pd
import pytest
import xarray

import fastatt as fa
from fastatt.cli import main
from fastatt.gyro.log import GyroLogError

# bad rows are more than a hundredth of what is written here
pytestmark = pytest.mark.filterwarnings("ignore:.* rows are left out:fastatt.gyro.GyroLogWarning")

HEAD = "t [s],wx [rad/s],wy [rad/s],wz [rad/s]\n"
# a row of no number, one repeated, one back in time, a gap, one of too few columns, one of no time
BAD = """\
0.0,1,2,3
0.1,1.1,2,3
0.2,nan,2,3
0.3,1.3,2,3
0.3,9,9,9
0.1,9,9,9
0.4,1.4,2,3
5.0,1.5,2,3
5.1,1.6,2
5.2,1.7,2,3
x,9,9,9
5.3,1.8,2,3
"""
DROPPED = [0.0, 0.1, 0.3, 0.4, 5.0, 5.2, 5.3]


def text(content, name="log.csv"):
    file = io.BytesIO((HEAD + content).encode())
    file.name = name
    return file


def read(content, **options):
    return fa.read_gyro_log(text(content), **options)


def test_bad_rows_dropped():
    log = read(BAD, on_bad_rows="drop")
    assert log.t.tolist() == DROPPED
    assert log.rates[:, 0].tolist() == [1.0, 1.1, 1.3, 1.4, 1.5, 1.7, 1.8]
    assert log.dt.tolist() == np.diff(DROPPED).tolist()
    dropped = "line 4 at 0.1 s, line 6 at 0.3 s, line 7 at 0.3 s, ..."
    assert log.summary.endswith(f"; 5 rows dropped: {dropped}; 1 gap: line 9 at 0.4 s")


def test_at_a_rate_a_row_left_out_leaves_a_hole():
    content, options = "0,1,2,3\n0,nan,2,3\n0,1,2,3\n", {"rate": 4.0, "on_bad_rows": "drop"}
    dropped = read(content, **options)
    assert (dropped.t.tolist(), dropped.dt.tolist()) == ([0.0, 0.5], [0.5])
    assert dropped.rate == 2.0


CONTENT = "".join(f"{0.01 * k!r},{0.1 * k!r},{-0.2 * k!r},0.5\n" for k in range(40))
PLAIN = fa.read_gyro_log(text(CONTENT))


def same(log):
    return np.array_equal(log.rates, PLAIN.rates) and np.array_equal(log.t, PLAIN.t)


def test_gzip_and_open_files(tmp_path, monkeypatch):
    data = (HEAD + CONTENT).encode()
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(data))
    assert same(fa.read_gyro_log(path))
    assert same(fa.read_gyro_log(io.StringIO(data.decode())))
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    assert same(fa.read_gyro_log("-"))
    path.write_bytes(gzip.compress(data)[:-20])
    with pytest.raises(GyroLogError, match="damaged gzip data"):
        fa.read_gyro_log(path)
    source = text(CONTENT)
    assert same(fa.read_gyro_log(source))
    assert not source.closed


def test_data_frames():
    frame = pd.DataFrame(np.column_stack([PLAIN.t, PLAIN.rates]), columns=HEAD.strip().split(","))
    assert same(fa.read_gyro_log(frame))
    when = pd.to_datetime((frame.pop("t [s]") * 1e9).round().astype("int64"))
    dated = frame.set_index(pd.DatetimeIndex(when, name="when"))
    log = fa.read_gyro_log(dated, time_column="when")
    # whole ns
    assert np.abs(log.t - PLAIN.t).max() <= 0.5e-9
    for name in (None, "time_s", "t [ms]"):
        index = pd.TimedeltaIndex(when - when[0], name=name)
        assert np.array_equal(fa.read_gyro_log(frame.set_index(index)).t, log.t)
    frame.iloc[2, 1] = np.nan
    with pytest.raises(GyroLogError, match=r"row 2: wy \[rad/s\] is 'nan'; accepted: a finite n"):
        fa.read_gyro_log(frame, rate=1.0)
    assert len(fa.read_gyro_log(frame, rate=1.0, on_bad_rows="drop").t) == 39


def test_data_sets():
    turned = np.tile([1.0, 0.0, 0.0, 0.0], (40, 1))
    columns = {
        "angular_velocity": (("time", "axis"), PLAIN.rates),
        "orientation": (("time", "part"), turned),
    }
    data = xarray.Dataset(columns, coords={"time": PLAIN.t})
    assert same(fa.read_gyro_log(data, unit="rad/s", time_unit="s"))
    assert same(fa.read_gyro_log({"t_s": PLAIN.t, "gyro": PLAIN.rates}, unit="rad/s"))


@pytest.mark.parametrize("rate", [None, "100"])
def test_a_file_of_attitudes_is_that_of_the_log(tmp_path, rate, capsys):
    path, out = tmp_path / "log.csv", tmp_path / "q.npy"
    path.write_text(HEAD + CONTENT, encoding="utf-8")
    given = [] if rate is None else ["-r", rate]
    assert main(["integrate", str(path), "-m", "picard", "-o", str(out), *given]) == 0
    log = fa.read_gyro_log(path, rate=rate and float(rate))
    q = fa.integrate_rates(log.rates, log.dt, method="picard")
    assert np.array_equal(np.load(out), np.column_stack([log.t, q]))
    assert "40 samples at 100 Hz" in capsys.readouterr().out


def test_what_fails_leaves_no_file(tmp_path, capsys):
    path, out = tmp_path / "log.csv", tmp_path / "q.csv"
    path.write_text(HEAD + CONTENT + "9,1,2\n", encoding="utf-8")
    assert main(["integrate", str(path), "-o", str(out)]) == 2
    assert "line 42: found 3 columns" in capsys.readouterr().err
    assert [x.name for x in tmp_path.iterdir()] == ["log.csv"]


def test_masks_and_what_is_no_real_number_in_tables():
    """Of masked numbers those beneath the mask were read; truths and complex numbers as floats."""
    hidden, count = np.arange(5) == 2, np.arange(5)
    names = [f"gyro_{a} (rad/s)" for a in "xyz"]
    for t, unit in (
        (0.01 * count, "s"), (10_000_000 * count, "ns"), (count * np.timedelta64(1, "s"), None)
    ):  # fmt: skip
        masked = {"t": np.ma.masked_array(t, hidden), **dict.fromkeys(names, np.ones(5))}
        options = {"time_unit": unit, "on_bad_rows": "drop"}
        found = fa.read_gyro_log(masked, **options).t
        assert np.array_equal(found, fa.read_gyro_log({**masked, "t": t}, **options).t[~hidden])
    bad = {"t (s)": 0.01 * count, **dict.fromkeys(names, np.ma.masked_array(np.ones(5), hidden))}
    with pytest.raises(GyroLogError, match=r"row 2: gyro_x \(rad/s\) is .*; accepted: a fin"):
        fa.read_gyro_log(bad)


def test_columns_of_objects_are_read_cell_by_cell():
    """One cell without a number made all of a column NaN, a magnetometer's in silence."""
    count = np.arange(5.0).tolist()
    gyro = {f"gyro_{a} (rad/s)": count for a in "xyz"}
    mag = {f"mag_{a} (uT)": np.array([1.0, None, "x", 2.5, "3"], dtype=object) for a in "xyz"}
    moments = [datetime(2024, 1, 1, 0, 0, 0, 10_000 * k) for k in range(5)]  # noqa: DTZ001
    for stamps in (
        [f"{0.01 * k:g}" for k in range(5)],
        [str(m) + (".000000" if not m.microsecond else "") for m in moments],
    ):
        unit = "s" if stamps[0] == "0" else None
        log = fa.read_gyro_log({"t": np.array(stamps, dtype=object), **gyro, **mag}, time_unit=unit)
        assert np.allclose(log.t, 0.01 * np.arange(5), rtol=0.0, atol=1e-15)
        assert np.array_equal(log.mag[:, 0], [1.0, np.nan, np.nan, 2.5, 3.0], equal_nan=True)


def test_dates_in_zones():
    """A clock that goes from one zone to another, as text and in a table."""
    moments = [datetime(2024, 10, 27, 0, 59, 59, 950_000 + 20_000 * k, UTC) for k in range(3)]
    moments += [datetime(2024, 10, 27, 1, 0, 0, 10_000 + 20_000 * k, UTC) for k in range(3)]
    zones = [timezone(timedelta(hours=2))] * 3 + [timezone(timedelta(hours=1))] * 3
    local = [m.astimezone(z) for m, z in zip(moments, zones, strict=True)]
    expected = 0.02 * np.arange(6)
    for text in (datetime.isoformat, lambda m: m.strftime("%Y-%m-%d %H:%M:%S.%f%z")):
        log = fa.read_gyro_log(io.StringIO(HEAD + "".join(f"{text(m)},1,2,3\n" for m in local)))
        assert np.array_equal(log.t, expected)
        assert log.start == moments[0].timestamp()
    table = {"t": local, **dict.fromkeys(("wx [rad/s]", "wy [rad/s]", "wz [rad/s]"), np.ones(6))}
    assert np.array_equal(fa.read_gyro_log(table).t, expected)


def test_a_row_without_the_empty_cell_at_its_end():
    rows = "0.0,1,2,\n0.1,1,2\n0.2,1,2,3\n0.3,1,2,3\n"
    assert len(read(rows, on_bad_rows="drop").t) == 2
