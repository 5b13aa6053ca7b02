"""Reading and writing gyro logs: every layout that is accepted, every refusal in one line."""

from __future__ import annotations

import io
import math
import sys
from contextlib import nullcontext

import numpy as np
import pytest
from each import each
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fastatt.logs import GyroLogError, read_gyro_log
from fastatt.logs import log as log_module
from fastatt.logs import text as texts
from fastatt.logs.attitudes import attitude_file

# units that are taken from the size of numbers have tests of their own
pytestmark = pytest.mark.filterwarnings("ignore::fastatt.GyroLogWarning")

EPS = 2.0**-52
DEG = math.radians(1.0)
RATES = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [-0.7, 0.8, -0.9]])


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def rows(separator, first=""):
    return "\n".join(first + separator.join(map(str, r)) for r in RATES) + "\n"


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("names", ["gx{0}gy{0}gz", "Gyr_X{0}Gyr_Y{0}Gyr_Z", "gyro x,gyro y,gyro z"])
def test_layouts(tmp_path, separator, names):
    head = names.format(separator)
    columns = None if "gyr" in head.lower() else ["gx", "gy", "gz"]
    log = read_gyro_log(
        write(tmp_path / "a.txt", f"{head}\n{rows(separator)}"), rate=50.0, columns=columns
    )
    assert np.array_equal(log.rates, RATES)
    assert log.dt.tolist() == [0.02, 0.02]
    assert log.t == pytest.approx([0.0, 0.02, 0.04])


def test_no_names_at_all(tmp_path):
    path = write(tmp_path / "a.csv", rows(",", "9,"))
    log = read_gyro_log(path, rate=10.0, columns=["2", "3", "4"])
    assert np.array_equal(log.rates, RATES)
    assert log.unit == "rad/s (assumed)"


def test_comments_and_their_sample_rate(tmp_path):
    text = "// Start: 0\n// Sample rate: 50.0Hz\n\nCounter\tGyr_X\tGyr_Y\tGyr_Z\t\n" + rows(
        "\t", "7\t"
    )
    log = read_gyro_log(write(tmp_path / "a.txt", text))
    assert log.rate == 50.0
    assert np.array_equal(log.rates, RATES)


@pytest.mark.parametrize(
    ("names", "unit", "factor"),
    [
        ("Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s)", None, np.pi / 180),
        ("wx,wy,wz", "deg/s", np.pi / 180),
        ("wx [rad/s],wy [rad/s],wz [rad/s]", None, 1.0),
        ("omega_x,omega_y,omega_z", None, 1.0),
    ],
)
def test_units(tmp_path, names, unit, factor):
    log = read_gyro_log(write(tmp_path / "a.csv", f"{names}\n{rows(',')}"), rate=1.0, unit=unit)
    assert log.rates == pytest.approx(RATES * factor, rel=1e-15)


@pytest.mark.parametrize(
    ("name", "scale"), [("Time (s)", 1.0), ("t_ms", 1e-3), ("timestamp us", 1e-6)]
)
def test_time_stamps(tmp_path, name, scale):
    stamps = [5.0, 5.5, 7.0]
    lines = [f"{t},{','.join(map(str, r))}" for t, r in zip(stamps, RATES, strict=True)]
    path = write(tmp_path / "a.csv", "\n".join([f"{name},wx,wy,wz", *lines]))
    log = read_gyro_log(path)
    assert log.dt == pytest.approx([0.5 * scale, 1.5 * scale])
    assert log.t[0] == 0.0


def test_maker_orientation(tmp_path):
    lines = "\n".join(",".join(map(str, r)) + ",1,0,0,0" for r in RATES)
    path = write(tmp_path / "a.csv", "wx,wy,wz,Quat_w,Quat_x,Quat_y,Quat_z\n" + lines)
    assert read_gyro_log(path, rate=1.0).attitudes.tolist() == [[1.0, 0.0, 0.0, 0.0]] * 3


EUROC = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2]"
)
NANOSECONDS = [1403636579758555392 + 5_000_000 * k for k in range(3)]
STAMPED = "\n".join(
    ",".join(map(str, (t, *r, 9.8))) for t, r in zip(NANOSECONDS, RATES, strict=True)
)


def test_names_and_units_in_a_comment(tmp_path):
    """EuRoC's logs."""
    log = read_gyro_log(write(tmp_path / "a.csv", f"{EUROC}\n{STAMPED}\n"))
    assert np.array_equal(log.rates, RATES)
    assert log.unit == "rad/s"
    # stamps near 1.4e18 stand 256 apart in double precision: they are whole numbers here
    assert log.dt.tolist() == [0.005, 0.01 - 0.005]


def test_a_comment_that_names_no_gyro_is_none(tmp_path):
    path = write(tmp_path / "a.csv", f"# a,b,deg/s,d\n{rows(',', '7,')}")
    log = read_gyro_log(path, columns=["2", "3", "4"], rate=1.0)
    assert (log.unit, log.columns[0]) == ("rad/s (assumed)", "column 2")


NAMED = {"columns": ["2", "3", "4"], "time_column": "1"}


@pytest.mark.parametrize(
    ("stamps", "unit", "found"),
    [
        # seconds at 1 Hz, or milliseconds at 1 kHz
        ([0, 1, 2], "ms", r"interval 1 is .* \(1 Hz in s or 1000 Hz in ms or 1e\+06 Hz in us\)"),
        ([0, 0.5, 1.0], "s", r"interval 0\.5 is .* \(2 Hz in s or 2000 Hz in ms"),
        # a gap of the log does not make it slow, nor does one short interval make it fast
        ([0, 1e-6, 2e-6, 1e3], "s", r"interval 1e-06 is .* \(1e\+06 Hz in s\)"),
        # one in 1970, and none in 1990
        ([1e9, 1e9 + 1, 1e9 + 2], "ms", ""),
    ],
)
def test_times_that_fit_no_rate_or_two_are_refused_unless_they_are_said(
    tmp_path, stamps, unit, found
):
    path = write(tmp_path / "a.csv", "\n".join(f"{t},1,2,3" for t in stamps))
    if found:
        with pytest.raises(GyroLogError, match=f"a.csv: column 1 has no unit, and its {found}"):
            read_gyro_log(path, **NAMED)
    log = read_gyro_log(path, **NAMED, time_unit=unit, max_gap=np.inf)
    scale = {"s": 1.0, "ms": 1e-3}[unit]
    assert log.t == pytest.approx((np.array(stamps) - stamps[0]) * scale, rel=1e-15)
    assert read_gyro_log(path, columns=["2", "3", "4"], rate=2e-7).rate == pytest.approx(2e-7)


@pytest.mark.parametrize("scale", [1, 1000, 10**6])
def test_dates_at_a_slow_rate_are_not_taken_for_another_unit(tmp_path, scale):
    """Seconds from 1970, a sample a minute: in ms it would be 16.7 Hz."""
    path = write(
        tmp_path / "a.csv", "\n".join(f"{(1_700_000_000 + 60 * k) * scale},1,2,3" for k in range(9))
    )
    with pytest.raises(GyroLogError, match="column 1 has no unit, and its interval 6"):
        read_gyro_log(path, **NAMED)
    unit = {1: "s", 1000: "ms", 10**6: "us"}[scale]
    assert read_gyro_log(path, **NAMED, time_unit=unit).dt.tolist() == [60.0] * 8
    path = write(
        tmp_path / "b.csv", "\n".join(f"{1.7e9 * scale + 0.06 * scale * k},1,2,3" for k in range(9))
    )
    assert read_gyro_log(path, **NAMED).rate == pytest.approx(16.7, rel=2e-3)


def test_the_update_rate_tells_the_unit_of_sample_time_fine():
    """1000 counts are 100 ms of an MTi, or 1 ms of a DOT."""
    text = "SampleTimeFine,Gyr_X,Gyr_Y,Gyr_Z\n" + "".join(f"{k}000,1,2,3\n" for k in range(9))
    for rate in (10.0, 1000.0):
        log = read_gyro_log(io.StringIO(f"// Update Rate: {rate}Hz\n{text}"))
        assert log.rate == pytest.approx(rate)
    with pytest.raises(GyroLogError, match=r"SampleTimeFine has no unit, .* more than one; accept"):
        read_gyro_log(io.StringIO(text))
    assert read_gyro_log(io.StringIO(text), time_unit="100us").rate == pytest.approx(10.0)


def test_axes_alone_need_a_name_of_their_file(tmp_path):
    """Sensor Logger's and PX4's: a folder's name says nothing, and without it they are refused."""
    text = "seconds_elapsed,z,y,x\n0.0,1,2,3\n0.1,1,2,3\n"
    folder = tmp_path / "gyro"
    folder.mkdir()
    for source in (io.StringIO(text), write(folder / "Accelerometer.csv", text)):
        with pytest.raises(GyroLogError, match=r"'x', 'y', 'z' do not name their.*Gyroscope\.csv"):
            read_gyro_log(source)
    log = read_gyro_log(write(tmp_path / "Gyroscope.csv", text))
    assert log.rates[0].tolist() == [3.0, 2.0, 1.0]
    assert "; a gyro's, as the file's name or its comments say" in log.summary


@pytest.mark.parametrize("rate", [None, 10.0])
@pytest.mark.parametrize("how", ["refuse", "drop", "hold"])
def test_intervals_are_an_array(rate, how):
    for n in (2, 3):
        data = {"t [s]": 0.1 * np.arange(n), "gyro": np.ones((n, 3))}
        log = read_gyro_log(data, rate=rate, unit="rad/s", on_bad_rows=how)
        assert isinstance(log.dt, np.ndarray)
        assert np.allclose(log.dt, [0.1] * (n - 1), rtol=1e-15, atol=0.0)
        assert log.rate == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("stamps", "scale"),
    [
        (NANOSECONDS, 1e-9),
        ([x // 1000 for x in NANOSECONDS], 1e-6),
        ([x / 1e9 for x in NANOSECONDS], 1.0),
        ([0, 20_000, 40_000], 1e-6),
        ([0, 10, 20], 1e-3),
        ([0, 0.1, 0.2], 1.0),
        ([0, 5_000_000, 10_000_000], 1e-9),
    ],
)
def test_times_without_a_unit_by_their_size(tmp_path, stamps, scale):
    path = write(tmp_path / "a.csv", "\n".join(f"{t},1,2,3" for t in stamps))
    log = read_gyro_log(path, **NAMED)
    # seconds near 1.4e9 stand 2.4e-7 apart
    assert log.t == pytest.approx((np.array(stamps) - stamps[0]) * scale, rel=1e-15, abs=1.2e-7)


def test_the_unit_of_time_that_is_said_stands_above_a_name(tmp_path):
    path = write(tmp_path / "a.csv", "time [s],wx,wy,wz\n0,1,2,3\n2000,1,2,3\n")
    with pytest.raises(GyroLogError, match=r"time \[s\] gives 0\.0005 Hz in s; .*0\.5 Hz in ms"):
        read_gyro_log(path)
    assert read_gyro_log(path, time_unit="us").dt == pytest.approx([2e-3], rel=1e-15)


GOOD = "t [s],wx,wy,wz\n0,1,2,3\n1,1,2,3\n2,1,2,3\n"


@each(
    ("text", "options", "message"),
    [
        ("", {}, "found no row of numbers"),
        ("a,b\nc,d\n", {}, "found no row of numbers"),
        ("t,wx,wy,wz\na,b,c,this is no unit\n1,2,3,4\n", {}, "line 2: found 'a,b,c,this"),
        ("a,b\n1,2\n", {"rate": 1.0}, "no three columns named like gyro"),
        ("wx,wy,wz\n1,2,3\n", {}, "no time column and no sample rate"),
        (GOOD.replace("2,1,2,3", "2,1,nan,3"), {}, "line 4: wy is 'nan'"),
        (GOOD.replace("2,1,2,3", "2,1,,3"), {}, "line 4: wy is ''"),
        (GOOD.replace("2,1,2,3", "2,1,x,3"), {}, "line 4: wy is 'x'"),
        (GOOD.replace("2,1,2,3", "2,1"), {}, "line 4: found 2 columns; accepted: 4, as in line 2"),
        (GOOD.replace("1,1,2,3", "1,2,3"), {}, "line 3: found 3 columns; accepted: 4, as in line"),
        (GOOD.replace("1,1,2,3", "1,9,1,2,3"), {}, "line 3: found 5 columns; accepted: 4, as in"),
        (
            GOOD.replace("t [s],wx", "wx"),
            {},
            "among 4 columns under 3 names; name them",
        ),
        (
            GOOD.replace("2,1,2,3", "1e308,1,2,3").replace("\n0", "\n-1e308"),
            {"time_unit": "s", "unit": "deg/s"},
            "t .s. in line 4, or a number beside it, overflows",
        ),
        (GOOD.replace("wx", "x" * 9999), {"columns": ["a", "b", "c"]}, "columns: found 'a'"),
        (GOOD.replace("wz", "wx"), {"columns": ["wx", "wy", "1"]}, "columns: found 'wx'"),
        (GOOD, {"columns": ["2", "wx", "wy"]}, "3 different columns"),
        (GOOD, {"columns": [1, 1, 2]}, "3 different columns"),
        (GOOD, {"columns": "xyz"}, "columns: found 'xyz'; accepted: 3 different columns"),
        (GOOD, {"columns": ["1", "2", "9" * 9999]}, "columns: found '999"),
        (GOOD, {"rate": 1e-320}, "rate: found 1e-320; accepted"),
        (GOOD, {"rate": 1e-308}, "rate: found 1e-308; accepted"),
        (GOOD.replace("2,1,2,3", "1,1,2,3"), {}, "line 4 is repeated .1 s after"),
        (GOOD.replace("2,1,2,3", "0.5,1,2,3"), {}, "line 4 is decreasing"),
        (GOOD, {"columns": ["wx", "wy", "nope"]}, "columns: found 'nope'"),
        (GOOD, {"columns": ["wx", "wy", "wy"]}, "3 different columns"),
        (GOOD, {"columns": ["1", "2", "9"]}, "a number from 1 to 4"),
        (GOOD, {"time_column": "T"}, "time column: found 'T'"),
        (GOOD, {"rate": 0.0}, "rate: found 0.0"),
        (GOOD, {"rate": float("nan")}, "rate: found nan"),
        (GOOD, {"unit": "rps"}, "unit: found 'rps'; accepted: rad/s, deg/s"),
        (GOOD, {"time_unit": "h"}, "time_unit: found 'h'; accepted: s, ms, 100us, us, ns"),
        (
            "# sample rate: 1e7 Hz\nwx,wy,wz\n1,2,3\n",
            {},
            "found 1e\\+07 Hz; accepted: above 0.1 Hz",
        ),
        ("# sample rate: 0.1 Hz\nwx,wy,wz\n1,2,3\n", {}, "found 0.1 Hz; accepted: above 0.1 Hz"),
        ("t,wx,wy,wz\n0,1,2,3\n", {}, "at least two"),
        (GOOD, {"max_gap": 0.5}, "line 3: a gap of 1 s; accepted: at most 0.5 s"),
        (GOOD, {"max_gap": 0.0}, "max_gap: found 0.0; accepted: a number above 0"),
        (
            GOOD,
            {"on_bad_rows": "keep"},
            "on_bad_rows: found 'keep'; accepted: refuse, drop, split, hold",
        ),
        (
            GOOD,
            {"bias_seconds": 9.0},
            "bias_seconds: found all of the log in the first 9 s; accepted",
        ),
        (GOOD.replace("1,2,3", ".1,0,0"), {"bias_seconds": 0.1}, "found one sample in the first"),
        (GOOD, {"bias_seconds": 1.5}, "not at rest in the first 1.5 s .mean rate 3 rad/s"),
        (GOOD.replace("[s]", "[min]"), {}, "t .min.: found the unit 'min'"),
        (GOOD.replace("wx,wy,wz", "gx,gy,gz,wx,wy,wz").replace(",3", ",3,1,2,3"), {}, "one gyro"),
        (
            GOOD.replace("t [s]", "t,time").replace("\n", "\n0,")[:-2],
            {},
            "than one time column",
        ),
        (GOOD.replace("2,3", "2,9000"), {}, "no unit and reach 9000; accepted: unit"),
        ("x,y,z\n1,2,3\n", {"rate": 1.0}, "no three columns named like gyro"),
        (
            "// sample rate: 0 Hz\nwx,wy,wz\n1,2,3\n",
            {},
            "no time column and no sample rate|above 0",
        ),
    ],
)
def test_refusals(tmp_path, text, options, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_gyro_log(write(tmp_path / "a.csv", text), **options)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"source": None}, "source: found None"),
        ({"source": "a\0b"}, "source: found"),
        ({"rate": "9"}, "rate:"),
    ],
)
def test_arguments_of_another_type(tmp_path, options, message):
    options = {"source": write(tmp_path / "a.csv", GOOD), **options}
    with pytest.raises(TypeError, match=message):
        read_gyro_log(**options)


def test_large_numbers_are_numbers(tmp_path):
    path = write(tmp_path / "a.csv", "wx,wy,wz\n" + "1e308,1e308,1e308\n" * 2)
    assert read_gyro_log(path, rate=1.0, unit="rad/s").rates.max() == 1e308


def test_an_index_without_a_name(tmp_path):
    """Data frames write one: the names after it belong to the columns after it."""
    lines = [f"{i},{','.join(map(str, r))}" for i, r in enumerate(RATES)]
    path = write(tmp_path / "a.csv", "\n".join([",wx,wy,wz", *lines]))
    assert np.array_equal(read_gyro_log(path, rate=1.0).rates, RATES)


@pytest.mark.parametrize(
    "head", ["Time (s) Gyr_X [rad/s] Gyr_Y [rad/s] Gyr_Z [rad/s]", "t_s wx wy wz"]
)
def test_units_in_brackets_between_blanks(tmp_path, head):
    lines = [f"{t} {' '.join(map(str, r))}" for t, r in zip((0, 1, 3), RATES, strict=True)]
    log = read_gyro_log(write(tmp_path / "a.txt", "\n".join([head, *lines])))
    assert np.array_equal(log.rates, RATES)
    assert log.t.tolist() == [0.0, 1.0, 3.0]


@pytest.mark.parametrize("unit", ["rps", "udps", "rad/day", "mrpm", "turns/s", "rad/min", "kHz"])
def test_units_that_are_not_known_are_not_guessed(tmp_path, unit):
    path = write(tmp_path / "a.csv", f"wx ({unit}),wy ({unit}),wz ({unit})\n{rows(',')}")
    with pytest.raises(GyroLogError, match="found the unit"):
        read_gyro_log(path, rate=1.0)
    assert np.array_equal(read_gyro_log(path, rate=1.0, unit="rad/s").rates, RATES)


@pytest.mark.parametrize(
    ("unit", "seconds", "turned"),
    [("mdps", 1e3, DEG), ("mrad/s", 1e3, 1.0), ("millidegrees/sec", 1e3, DEG)]
    + [(u, 3600.0, DEG) for u in ("deg/h", "deg per hour", "°/hr", "arcsec/s", "arcseconds/s")]
    + [("Hz", 1.0, math.tau)]
    + [("°/min", 60.0, DEG), ("rpm", 60.0, math.tau), ("rev/s", 1.0, math.tau)],
)
def test_other_units(tmp_path, unit, seconds, turned):
    """So many seconds at 1 of the unit turn by an angle."""
    path = write(tmp_path / "a.csv", f"wx ({unit}),wy ({unit}),wz ({unit})\n{rows(',')}")
    rates = read_gyro_log(path, rate=1.0).rates
    assert np.abs(rates * seconds - turned * np.array(RATES)).max() <= 4 * EPS * turned * 3.0


@pytest.mark.parametrize("unit", ["dps", "°/s", "deg/sec", "degrees per second", "deg_s"])
def test_degrees_by_other_names(tmp_path, unit):
    path = write(tmp_path / "a.csv", f"wx ({unit}),wy ({unit}),wz ({unit})\n{rows(',')}")
    assert read_gyro_log(path, rate=1.0).unit == "deg/s"


def test_the_last_letter_of_a_unit_is_no_axis(tmp_path):
    path = write(tmp_path / "a.csv", f"gyro_x_hz,gyro_y_hz,gyro_z_hz\n{rows(',')}")
    log = read_gyro_log(path, rate=1.0)
    assert log.columns == ("gyro_x_hz", "gyro_y_hz", "gyro_z_hz")
    assert log.unit == "Hz"


def test_units_that_differ_are_refused(tmp_path):
    path = write(tmp_path / "a.csv", f"wx (deg/s),wy (rad/s),wz (deg/s)\n{rows(',')}")
    with pytest.raises(GyroLogError, match="one for all"):
        read_gyro_log(path, rate=1.0)


@pytest.mark.parametrize(
    ("said", "rate"),
    [("50.0Hz", 50.0), ("1e3 Hz", 1e3), ("100", 100.0)]
    + [(s, None) for s in ("1,000 Hz", "0.1 kHz", "1..5", ".", "-50 Hz", "50 per min")],
)
def test_sample_rates_in_comments(tmp_path, said, rate):
    path = write(tmp_path / "a.csv", f"# Sample rate: {said}\nwx,wy,wz\n{rows(',')}")
    if rate is None:
        with pytest.raises(GyroLogError, match="no time column and no sample rate"):
            read_gyro_log(path)
    else:
        assert read_gyro_log(path).rate == rate


def test_sample_rates_of_others():
    """Of two rates none is the gyro's for certain; that of a filter or a magnetometer is none."""
    table = f"# gyro sample rate: 100 Hz\n# {{}}\ngx (rad/s),gy (rad/s),gz (rad/s)\n{rows(',')}"
    for other in ("mag sample rate: 20 Hz", "Accelerometer sampling rate = 20", "sample rate: 100"):
        assert read_gyro_log(io.StringIO(table.format(other))).rate == pytest.approx(100.0)
    with pytest.raises(GyroLogError, match="found the sample rates 100 and 20 Hz; accepted: one"):
        read_gyro_log(io.StringIO(table.format("sample rate: 20 Hz")))
    only = table.format("cutoff frequency: 20 Hz").split("\n", 1)[1]
    with pytest.raises(GyroLogError, match="no time column and no sample rate"):
        read_gyro_log(io.StringIO(only))


@pytest.mark.parametrize(
    "text", ["\ufeff" + rows(","), '"' + rows('","').replace("\n", '"\n"')[:-1]]
)
def test_byte_order_mark_and_quotes(tmp_path, text):
    path = write(tmp_path / "a.csv", text)
    assert np.array_equal(read_gyro_log(path, rate=1.0, columns=["1", "2", "3"]).rates, RATES)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_gyro_log(tmp_path / "none.csv")


def test_blocks_join(tmp_path, monkeypatch, reader):
    monkeypatch.setattr(texts, "BYTES", 50)
    numbers = np.arange(60.0).reshape(20, 3)
    text = "wx,wy,wz\n" + "\n".join(",".join(map(str, r)) for r in numbers)
    path = write(tmp_path / "a.csv", text)
    seen: list[int] = []

    def bar(wanted, total, unit):
        assert (wanted, total, unit) == (True, path.stat().st_size, "B")
        return nullcontext(seen.append)

    monkeypatch.setattr(log_module, "progress_bar", bar)
    found = read_gyro_log(path, rate=1.0, unit="rad/s", progress=True)
    assert np.array_equal(found.rates, numbers)
    assert sum(seen) == path.stat().st_size - len("wx,wy,wz\n")


@pytest.mark.parametrize("size", [1, 10, 40, 150])
def test_no_row_is_lost_after_blank_lines_and_comments(tmp_path, monkeypatch, size, reader):
    monkeypatch.setattr(texts, "BYTES", size)
    numbers = np.arange(60.0).reshape(20, 3)
    lines = [f"{k},{','.join(map(str, r))}" for k, r in enumerate(numbers)]
    lines[5:5] = ["", "# a note", "#9,1,2,3"]
    lines[12:12] = ["//"] * 8
    path = write(tmp_path / "a.csv", "row,wx,wy,wz\n" + "\n".join(lines))
    assert np.array_equal(read_gyro_log(path, rate=1.0, unit="rad/s").rates, numbers)


@pytest.mark.parametrize("size", [1, 20, 1000])
def test_the_line_of_a_bad_row_in_any_block(tmp_path, monkeypatch, size, reader):
    monkeypatch.setattr(texts, "BYTES", size)
    monkeypatch.setattr(texts, "_HEAD", 3)
    path = write(tmp_path / "a.csv", "wx,wy,wz\n" + "1,2,3\n\n" * 6 + "1,inf,3\n1,2,x\n")
    with pytest.raises(GyroLogError, match="line 14: wy is 'inf'"):
        read_gyro_log(path, rate=1.0)


def test_both_readers_round_to_nearest(tmp_path, monkeypatch):
    """Numbers at which a product of rounded parts is another double."""
    pytest.importorskip("pyarrow")
    random = np.random.default_rng(3)
    numbers = random.standard_normal((500, 3)) * 10.0 ** random.integers(-12, 1, (500, 3))
    lines = [",".join(f"{x:.{d}g}" for x, d in zip(r, (15, 17, 20), strict=True)) for r in numbers]
    path = write(tmp_path / "a.csv", "wx,wy,wz\n" + "\n".join(lines))
    first = read_gyro_log(path, rate=1.0).rates
    assert np.array_equal(first, [[float(x) for x in line.split(",")] for line in lines])
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert np.array_equal(read_gyro_log(path, rate=1.0).rates, first)


@pytest.mark.parametrize("suffix", [".csv", ".npy", ".zarr"])
@pytest.mark.parametrize("columns", [5, 6])
def test_written_attitudes_come_back(tmp_path, suffix, columns, reader):
    rows = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.1, 0.6, 0.8, 0.0, 1e-300, 1.0]])
    rows = rows[:, :columns]
    path = tmp_path / f"a{suffix}"
    if suffix == ".zarr":
        zarr = pytest.importorskip("zarr")
    for _ in range(2):  # over one that is there
        attitude_file(path)(rows)
    if suffix == ".zarr":
        found = zarr.open(str(path), mode="r")[:]
    else:
        found = np.load(path) if suffix == ".npy" else np.loadtxt(path, delimiter=",", skiprows=1)
    assert np.array_equal(found, rows)
    assert [x.name for x in tmp_path.iterdir()] == [path.name]


def test_a_file_that_fails_leaves_the_one_before(tmp_path):
    path = write(tmp_path / "a.csv", "before")
    with pytest.raises(AttributeError):
        attitude_file(path)(None)
    assert path.read_text(encoding="utf-8") == "before"
    assert [x.name for x in tmp_path.iterdir()] == [path.name]


def test_unknown_ending(tmp_path):
    with pytest.raises(GyroLogError, match=r"found the ending '.xls'; accepted: .csv, .npy and .z"):
        attitude_file(tmp_path / "a.xls")


@pytest.mark.parametrize("name", ["a.csv", "a.npy", "a.zarr"])
def test_a_directory_is_not_replaced(tmp_path, name):
    """But for an array of Zarr: a group holds more than what is written."""
    kept = tmp_path / name / "kept"
    kept.parent.mkdir()
    write(kept, "mine")
    with pytest.raises(GyroLogError, match=rf"--out: found the directory .*{name}; accepted: a f"):
        attitude_file(kept.parent)
    assert kept.read_text(encoding="utf-8") == "mine"


@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.one_of(st.binary(max_size=200), st.text("0123456789.,;\t -+enaif/#\nwxyzt\"'", max_size=120))
)
def test_hostile_files(tmp_path, content):
    """Read, or refused in one line: no other error, no hang."""
    path = tmp_path / "hostile.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    try:
        log = read_gyro_log(path, columns=["1", "2", "3"], rate=1.0)
    except GyroLogError as error:
        message = str(error)
    else:
        message = "" if log.rates.shape[1] == 3 and np.isfinite(log.rates).all() else "read\nwrong"
    assert "\n" not in message


def test_columns_of_other_sensors_can_be_named():
    table = {"t [s]": [0.0, 0.1], **{f"gyro_{a} [rad/s]": [0.1, 0.1] for a in "xyz"}}
    table |= {f"f{a}": [9.8, 9.8] for a in "NED"} | {f"B{k}": [k, k] for k in (1, 2, 3)}
    assert read_gyro_log(table).accel is None
    log = read_gyro_log(table, accel_columns=["fN", "fE", "fD"], mag_columns=["B3", "B2", "B1"])
    assert log.accel.tolist() == [[9.8] * 3] * 2
    assert log.mag.tolist() == [[3.0, 2.0, 1.0]] * 2
    with pytest.raises(GyroLogError, match=r"mag_columns: found .*; accepted: 3 different columns"):
        read_gyro_log(table, mag_columns=["B3", "B2"])


@pytest.mark.parametrize("unit", ["mps2", "m/s2", "m_s2", "ms2"])
def test_units_at_the_end_of_an_accelerometers_names(unit):
    table = {"t [s]": [0.0, 0.1], **{f"gyro_{a} [rad/s]": [0.1, 0.1] for a in "xyz"}}
    log = read_gyro_log(table | {f"acc_{a}_{unit}": [3.0, 3.0] for a in "xyz"})
    assert log.accel.tolist() == [[3.0] * 3] * 2
    assert "accelerometer in m/s²" in log.summary
