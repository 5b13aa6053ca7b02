"""Reading and writing gyro logs: every layout that is accepted, every refusal in one line."""

from __future__ import annotations

import io
import math
import sys
import time

import numpy as np
import pytest
from each import each
from exact import EPS

from fastatt.gyro.attitudes import write_attitudes
from fastatt.gyro.log import GyroLogError
from fastatt.gyro.read import read_gyro_log

RAD = "wx [rad/s],wy [rad/s],wz [rad/s]"
DEG = math.radians(1.0)
RATES = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [-0.7, 0.8, -0.9]])


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def read(text, **options):
    return read_gyro_log(io.StringIO(text), **options)


def rows(separator=",", firsts=()):
    """Lines of the rates, each behind what it begins with."""
    lines = (separator.join(map(str, r)) for r in RATES)
    return "".join(f"{x}{line}\n" for x, line in zip(firsts or [""] * 3, lines, strict=True))


NAMED = {"columns": ["2", "3", "4"], "time_column": "1", "unit": "rad/s"}


@each(
    ("stamps", "unit", "found"),
    [
        ([0, 1, 2], "ms", r"1 Hz in s or 1000 Hz in ms or 1e\+04 Hz in 100us or 1e\+06 Hz in us"),
        ([0, 0.5, 1.0], "s", r"2 Hz in s or 2000 Hz in ms or 2e\+04 Hz in 100us"),
        ([0, 1e-6, 2e-6, 1e3], "s", r"1e\+06 Hz in s"),
        ([1e9, 1e9 + 1, 1e9 + 2], "ms", "1 Hz in s or 1000 Hz in ms"),
        ([0, 5_000_000, 10_000_000], "ns", "0.2 Hz in us or 2 Hz in 100ns or 200 Hz in ns"),
        ([1_700_000_000_000_000_000 + k for k in (0, 2**40, 2**41)], "ns", "none fits"),
        ([7], "s", "none fits"),
    ],
)
def test_times_without_a_unit_are_refused_with_the_rates_of_each(tmp_path, stamps, unit, found):
    path = write(tmp_path / "a.csv", "\n".join(f"{t},1,2,3" for t in stamps))
    with pytest.raises(GyroLogError, match=rf"a.csv: column 1 has no unit; .*time_unit \({found}"):
        read_gyro_log(path, **NAMED)
    if len(stamps) > 1:
        log = read_gyro_log(path, **NAMED, time_unit=unit, max_gap=np.inf)
        assert "; column 2, column 3, column 4 in rad/s" in log.summary
        scale = {"s": 1.0, "ms": 1e-3, "ns": 1e-9}[unit]
        assert log.t == pytest.approx((np.array(stamps) - stamps[0]) * scale, rel=1e-15)


def test_axes_alone_need_a_name_of_their_file(tmp_path):
    """Sensor Logger's: a folder's name says nothing, and without the file's they are refused."""
    text = "seconds_elapsed,z,y,x\n0.0,1,2,3\n0.1,1,2,3\n"
    folder, path = tmp_path / "gyro", tmp_path / "Gyroscope.csv"
    folder.mkdir()
    assert read_gyro_log(write(path, text)).rates[0].tolist() == [3.0, 2.0, 1.0]
    for source in (
        io.StringIO(text), write(folder / "Accelerometer.csv", text),
        write(path, text.replace("seconds_elapsed", "time (s)")),
    ):  # fmt: skip
        with pytest.raises(GyroLogError, match="no three columns named like gyro x, y, z among"):
            read_gyro_log(source)


def test_the_unit_of_time_that_is_said_stands_above_a_name():
    log = read(f"time [s],{RAD}\n0,1,2,3\n2000,1,2,3\n", time_unit="us")
    assert log.dt == pytest.approx([2e-3], rel=1e-15)


GOOD = f"t [s],{RAD}\n0,1,2,3\n1,1,2,3\n2,1,2,3\n"


def test_large_numbers_are_numbers():
    text = f"{RAD}\n" + "1e308,1e308,1e308\n" * 2
    assert read(text, rate=1.0, unit="rad/s").rates.max() == 1e308


UNNAMED = {"rate": 1.0, "columns": ["1", "2", "3"], "unit": "rad/s"}


@each(
    ("text", "options"),
    [
        # data frames write an index: the names after it belong to the columns after it
        (f",{RAD}\n{rows(firsts=('0,', '1,', '2,'))}", {"rate": 1.0}),
        # units in brackets between blanks
        (
            "Time (s) Gyr_X [rad/s] Gyr_Y [rad/s] Gyr_Z [rad/s]\n" + rows(" ", ("0 ", "1 ", "3 ")),
            {},
        ),
        ("t_s wx_rad/s wy_rad/s wz_rad/s\n" + rows(" ", ("0 ", "1 ", "3 ")), {}),
        # a byte order mark, and quotes
        ("\ufeff" + rows(), UNNAMED),
        ('"' + rows('","').replace("\n", '"\n"')[:-1], UNNAMED),
        # a comment that names no gyro
        ("# a,b,deg/s,d\n" + rows(firsts=["7,"] * 3), UNNAMED | {"columns": ["2", "3", "4"]}),
    ],
)
def test_the_same_numbers_as_others_write_them(text, options):
    log = read(text, **options)
    assert np.array_equal(log.rates, RATES)
    assert log.t.tolist() == ([0.0, 1.0, 3.0] if options == {} else [*range(len(log.t))])


PER_SECOND = "dps °/s deg/sec degrees·per·second deg_s"
UNITS = [("mdps", 1e3, DEG), ("mrad/s", 1e3, 1.0), ("millidegrees/sec", 1e3, DEG)]
UNITS += [(u, 3600.0, DEG) for u in ("deg/h", "deg per hour", "°/hr", "arcsec/s", "arcseconds/s")]
UNITS += [(u.replace("·", " "), 1.0, DEG) for u in PER_SECOND.split()]
UNITS += [("°/min", 60.0, DEG), ("rpm", 60.0, math.tau), ("rev/s", 1.0, math.tau)]
UNITS += [("Hz", 1.0, math.tau)]


@each(("unit", "seconds", "turned"), UNITS)
def test_other_units(unit, seconds, turned):
    """So many seconds at 1 of the unit turn by an angle."""
    rates = read(f"wx ({unit}),wy ({unit}),wz ({unit})\n{rows()}", rate=1.0).rates
    assert np.abs(rates * seconds - turned * np.array(RATES)).max() <= 4 * EPS * turned * 3.0


def test_the_last_letter_of_a_unit_is_no_axis():
    log = read(f"gyro_x_hz,gyro_y_hz,gyro_z_hz\n{rows()}", rate=1.0)
    assert "; gyro_x_hz, gyro_y_hz, gyro_z_hz in Hz" in log.summary


@each(("said", "rate"), [("50.0Hz", 50.0), ("1e3 Hz", 1e3), ("100", 100.0)])
def test_sample_rates_in_comments(said, rate):
    assert read(f"# Sample rate: {said}\n{RAD}\n{rows()}").rate == rate


@each("other", ["mag sample rate: 20 Hz", "Accelerometer sampling rate = 20", "sample rate: 100"])
def test_sample_rates_of_others(other):
    """Of two rates none is the gyro's for certain; that of a filter or a magnetometer is none."""
    log = read(f"# gyro sample rate: 100 Hz\n# {other}\n{RAD}\n{rows()}")
    assert log.rate == pytest.approx(100.0)


@each("note", (" # a note", "  // 5", " % 5"))
def test_a_comment_after_a_row_is_left_out(note):
    log = read(f"{RAD}\n" + f"1,2,3{note}\n" * 6, rate=1.0)
    assert np.array_equal(log.rates, [[1.0, 2.0, 3.0]] * 6)


@each("run", ("1", "a", " ", "_", "-", "rs", "s/", "values", "mpu1l", "sensor ", "[", "deg_"))
def test_long_runs_in_a_header_cost_no_more_than_other_letters(run):
    """Where a pattern goes back over a run, 10^5 letters take minutes or years."""
    long = run * (100_000 // len(run))
    head = f"# {long}\n# sample rate: {long}!\nt [s],{RAD},{long}x,gyro{long},{long},time{long}!"
    start = time.process_time()
    log = read(f"{head}\n0,1,2,3,4,5,6,7 {' ' * 50000} # a\n1,1,2,3,4,5,6,7")
    assert log.rate == 1.0
    assert time.process_time() - start < 5.0


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_gyro_log(tmp_path / "none.csv")


def test_no_row_is_lost_after_blank_lines_and_comments():
    numbers = np.arange(60.0).reshape(20, 3)
    lines = [f"{k},{','.join(map(str, r))}" for k, r in enumerate(numbers)]
    lines[5:5] = ["", "# a note", "#9,1,2,3"]
    lines[12:12] = ["//"] * 8
    log = read("row,wx,wy,wz\n" + "\n".join(lines), rate=1.0, unit="rad/s")
    assert np.array_equal(log.rates, numbers)


def test_numbers_are_rounded_to_nearest():
    """Numbers at which a product of rounded parts is another double."""
    random = np.random.default_rng(3)
    numbers = random.standard_normal((500, 3)) * 10.0 ** random.integers(-12, 1, (500, 3))
    lines = [",".join(f"{x:.{d}g}" for x, d in zip(r, (15, 17, 20), strict=True)) for r in numbers]
    rates = read(f"{RAD}\n" + "\n".join(lines), rate=1.0).rates
    assert np.array_equal(rates, [[float(x) for x in line.split(",")] for line in lines])


def test_a_text_needs_pandas_and_a_table_none(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"of a text: needs pandas; .* 'fastatt\[logs\]'"):
        read(GOOD)
    table = {"t [s]": [0.0, 1.0], **{name: [1.0, 1.0] for name in RAD.split(",")}}
    assert read_gyro_log(table).rates.shape == (2, 3)


@pytest.mark.parametrize("suffix", [".csv", ".npy"])
def test_written_attitudes_come_back(tmp_path, suffix):
    rows = np.array([[0.0, 1.0, 0.0, 0.0, 0.0], [0.1, 0.6, 0.8, 0.0, 1e-300]])
    path = tmp_path / f"a{suffix}"
    for _ in range(2):  # over one that is there
        write_attitudes(path, rows)
    found = np.load(path) if suffix == ".npy" else np.loadtxt(path, delimiter=",", skiprows=1)
    assert np.array_equal(found, rows)
    assert [x.name for x in tmp_path.iterdir()] == [path.name]


def test_a_log_prints_a_summary(tmp_path):
    path = write(tmp_path / "log.csv", GOOD)
    log = read_gyro_log(path)
    assert str(log) == log.summary
    assert log.summary.startswith(f"{path}: 3 samples at 1 Hz")
