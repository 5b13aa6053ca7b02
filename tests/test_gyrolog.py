"""Reading and writing gyro logs: every layout that is accepted, every refusal in one line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fastatt import gyrolog
from fastatt.gyrolog import LogError, read_log, write_attitudes

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
    log = read_log(
        write(tmp_path / "a.txt", f"{head}\n{rows(separator)}"), rate=50.0, columns=columns
    )
    assert np.array_equal(log.rates, RATES)
    assert log.dt == 0.02
    assert log.t == pytest.approx([0.0, 0.02, 0.04])


def test_no_names_at_all(tmp_path):
    path = write(tmp_path / "a.csv", rows(",", "9,"))
    log = read_log(path, rate=10.0, columns=["2", "3", "4"])
    assert np.array_equal(log.rates, RATES)
    assert log.unit == "rad/s (assumed)"


def test_comments_and_their_sample_rate(tmp_path):
    text = "// Start: 0\n// Sample rate: 50.0Hz\n\nCounter\tGyr_X\tGyr_Y\tGyr_Z\t\n" + rows(
        "\t", "7\t"
    )
    log = read_log(write(tmp_path / "a.txt", text))
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
    log = read_log(write(tmp_path / "a.csv", f"{names}\n{rows(',')}"), rate=1.0, unit=unit)
    assert log.rates == pytest.approx(RATES * factor, rel=1e-15)


@pytest.mark.parametrize(
    ("name", "scale"), [("Time (s)", 1.0), ("t_ms", 1e-3), ("timestamp us", 1e-6)]
)
def test_time_stamps(tmp_path, name, scale):
    stamps = [5.0, 5.5, 7.0]
    lines = [f"{t},{','.join(map(str, r))}" for t, r in zip(stamps, RATES, strict=True)]
    path = write(tmp_path / "a.csv", "\n".join([f"{name},wx,wy,wz", *lines]))
    log = read_log(path)
    assert log.dt == pytest.approx([0.5 * scale, 1.5 * scale])
    assert log.t[0] == 0.0


def test_maker_orientation(tmp_path):
    lines = "\n".join(",".join(map(str, r)) + ",1,0,0,0" for r in RATES)
    path = write(tmp_path / "a.csv", "wx,wy,wz,Quat_w,Quat_x,Quat_y,Quat_z\n" + lines)
    assert read_log(path, rate=1.0).attitudes.tolist() == [[1.0, 0.0, 0.0, 0.0]] * 3


EUROC = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2]"
)
NANOSECONDS = [1403636579758555392 + 5_000_000 * k for k in range(3)]
STAMPED = "\n".join(
    ",".join(map(str, (t, *r, 9.8))) for t, r in zip(NANOSECONDS, RATES, strict=True)
)


def test_names_and_units_in_a_comment(tmp_path):
    """EuRoC's logs."""
    log = read_log(write(tmp_path / "a.csv", f"{EUROC}\n{STAMPED}\n"))
    assert np.array_equal(log.rates, RATES)
    assert log.unit == "rad/s"
    # stamps near 1.4e18 stand 256 apart in double precision
    assert np.abs(log.dt - 5e-3).max() <= 256e-9


def test_a_comment_that_names_no_gyro_is_none(tmp_path):
    path = write(tmp_path / "a.csv", f"# a,b,deg/s,d\n{rows(',', '7,')}")
    log = read_log(path, columns=["2", "3", "4"], rate=1.0)
    assert (log.unit, log.columns[0]) == ("rad/s (assumed)", "column 2")


NAMED = {"columns": ["2", "3", "4"], "time_column": "1"}


@pytest.mark.parametrize(
    ("stamps", "unit", "found"),
    [
        (NANOSECONDS, "ns", r"column 1 gives 2e-07 Hz in s; .*\(0\.2 Hz in us or 200 Hz in ns\)"),
        ([0, 20_000, 40_000], "us", r"5e-05 Hz in s; .*\(50 Hz in us or 5e\+04 Hz in ns\)"),
        ([0, 10, 20], "ms", r"0\.1 Hz in s; .*\(100 Hz in ms or 1e\+05 Hz in us\)"),
        # a gap of the log does not make it slow, nor does one short interval make it fast
        ([0, 0.5e-6, 1e-6, 1e3], "s", r"2e\+06 Hz in s; .*\(none fits\)"),
    ],
)
def test_rates_that_no_gyro_has_are_refused_unless_they_are_said(tmp_path, stamps, unit, found):
    text = "\n".join(f"{t},1,2,3" for t in stamps)
    path = write(tmp_path / "a.csv", text)
    with pytest.raises(LogError, match=f"a.csv: {found}" if "column" in found else found):
        read_log(path, **NAMED)
    log = read_log(path, **NAMED, time_unit=unit)
    scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    assert log.t == pytest.approx((np.array(stamps) - stamps[0]) * scale, abs=256e-9)
    assert read_log(path, columns=["2", "3", "4"], rate=2e-7).rate == pytest.approx(2e-7)


@pytest.mark.parametrize("stamps", [[0, 1e-6, 2e-6], [0, 9.9, 19.8], [0, 1, 2, 3, 1000]])
def test_rates_within_the_bounds(tmp_path, stamps):
    text = "\n".join(f"{t},1,2,3" for t in stamps)
    assert read_log(write(tmp_path / "a.csv", text), **NAMED).t[-1] == stamps[-1]


def test_the_unit_of_time_that_is_said_stands_above_a_name(tmp_path):
    path = write(tmp_path / "a.csv", "time [s],wx,wy,wz\n0,1,2,3\n2000,1,2,3\n")
    with pytest.raises(LogError, match=r"time \[s\] gives 0\.0005 Hz in s; .*0\.5 Hz in ms"):
        read_log(path)
    assert read_log(path, time_unit="us").dt == pytest.approx([2e-3], rel=1e-15)


GOOD = "t,wx,wy,wz\n0,1,2,3\n1,1,2,3\n2,1,2,3\n"


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", {}, "found no row of numbers"),
        ("a,b\nc,d\n", {}, "line 2: found 'c,d'; accepted: numbers"),
        ("a,b\n1,2\n", {"rate": 1.0}, "no three columns named like gyro"),
        ("wx,wy,wz\n1,2,3\n", {}, "no time column and no sample rate"),
        (GOOD.replace("2,1,2,3", "2,1,nan,3"), {}, "line 4: wy is 'nan'"),
        (GOOD.replace("2,1,2,3", "2,1,,3"), {}, "line 4: wy is ''"),
        (GOOD.replace("2,1,2,3", "2,1,x,3"), {}, "line 4: wy is 'x'"),
        (GOOD.replace("2,1,2,3", "2,1"), {}, "line 4: found 2 columns; accepted: 4, as in line 2"),
        (GOOD.replace("1,1,2,3", "1,2,3"), {}, "line 3: found 3 columns; accepted: 4, as in line"),
        (GOOD.replace("1,1,2,3", "1,9,1,2,3"), {}, "line 3: found 5 columns; accepted: 4, as in"),
        (GOOD.replace("t,wx", "wx"), {}, "among 4 columns under 3 names; name them with columns"),
        (
            GOOD.replace("2,1,2,3", "1e308,1,2,3").replace("\n0", "\n-1e308"),
            {},
            "t overflows in row",
        ),
        (GOOD.replace("wx", "x" * 9999), {"columns": ["a", "b", "c"]}, "columns: found 'a'"),
        (GOOD.replace("wz", "wx"), {"columns": ["wx", "wy", "t"]}, "columns: found 'wx'"),
        (GOOD, {"columns": ["2", "wx", "wy"]}, "3 different columns"),
        (GOOD, {"columns": [1, 1, 2]}, "3 different columns"),
        (GOOD, {"columns": "xyz"}, "columns: found 'xyz'; accepted: 3 different columns"),
        (GOOD, {"columns": ["1", "2", "9" * 9999]}, "columns: found '999"),
        (GOOD, {"rate": 1e-320}, "rate: found 1e-320; accepted"),
        (GOOD, {"rate": 1e-308}, "found 3 samples at the rate 1e-308 Hz; accepted: more"),
        (GOOD.replace("2,1,2,3", "1,1,2,3"), {}, "t is repeated after row 2"),
        (GOOD.replace("2,1,2,3", "0.5,1,2,3"), {}, "t is decreasing after row 2"),
        (GOOD, {"columns": ["wx", "wy", "nope"]}, "columns: found 'nope'"),
        (GOOD, {"columns": ["wx", "wy", "wy"]}, "3 different columns"),
        (GOOD, {"columns": ["1", "2", "9"]}, "a number from 1 to 4"),
        (GOOD, {"time_column": "T"}, "time column: found 'T'"),
        (GOOD, {"rate": 0.0}, "rate: found 0.0"),
        (GOOD, {"rate": float("nan")}, "rate: found nan"),
        (GOOD, {"unit": "rpm"}, "unit: found 'rpm'; accepted: rad/s, deg/s"),
        (GOOD, {"time_unit": "h"}, "time_unit: found 'h'; accepted: s, ms, us, ns"),
        (
            "# sample rate: 1e7 Hz\nwx,wy,wz\n1,2,3\n",
            {},
            "found 1e\\+07 Hz; accepted: above 0.1 Hz",
        ),
        ("# sample rate: 0.1 Hz\nwx,wy,wz\n1,2,3\n", {}, "found 0.1 Hz; accepted: above 0.1 Hz"),
        ("t,wx,wy,wz\n0,1,2,3\n", {}, "at least two"),
        (
            "// sample rate: 0 Hz\nwx,wy,wz\n1,2,3\n",
            {},
            "no time column and no sample rate|above 0",
        ),
    ],
)
def test_refusals(tmp_path, text, options, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_log(write(tmp_path / "a.csv", text), **options)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"path": None}, "path: found None"),
        ({"path": "a\0b"}, "path: found"),
        ({"rate": "9"}, "rate:"),
    ],
)
def test_arguments_of_another_type(tmp_path, options, message):
    options = {"path": write(tmp_path / "a.csv", GOOD), **options}
    with pytest.raises(TypeError, match=message):
        read_log(**options)


def test_an_index_without_a_name(tmp_path):
    """Data frames write one: the names after it belong to the columns after it."""
    lines = [f"{i},{','.join(map(str, r))}" for i, r in enumerate(RATES)]
    path = write(tmp_path / "a.csv", "\n".join([",wx,wy,wz", *lines]))
    assert np.array_equal(read_log(path, rate=1.0).rates, RATES)


@pytest.mark.parametrize(
    "head", ["Time (s) Gyr_X [rad/s] Gyr_Y [rad/s] Gyr_Z [rad/s]", "t wx wy wz"]
)
def test_units_in_brackets_between_blanks(tmp_path, head):
    lines = [f"{t} {' '.join(map(str, r))}" for t, r in zip((0, 1, 3), RATES, strict=True)]
    log = read_log(write(tmp_path / "a.txt", "\n".join([head, *lines])))
    assert np.array_equal(log.rates, RATES)
    assert log.t.tolist() == [0.0, 1.0, 3.0]


@pytest.mark.parametrize("unit", ["mdps", "deg/h", "mrad/s", "rpm", "deg per hour", "°/min"])
def test_units_that_are_not_known_are_not_guessed(tmp_path, unit):
    path = write(tmp_path / "a.csv", f"wx ({unit}),wy ({unit}),wz ({unit})\n{rows(',')}")
    with pytest.raises(LogError, match="found the unit"):
        read_log(path, rate=1.0)
    assert np.array_equal(read_log(path, rate=1.0, unit="rad/s").rates, RATES)


@pytest.mark.parametrize("unit", ["dps", "°/s", "deg/sec", "degrees per second", "deg_s"])
def test_degrees_by_other_names(tmp_path, unit):
    path = write(tmp_path / "a.csv", f"wx ({unit}),wy ({unit}),wz ({unit})\n{rows(',')}")
    assert read_log(path, rate=1.0).unit == "deg/s"


def test_units_that_differ_are_refused(tmp_path):
    path = write(tmp_path / "a.csv", f"wx (deg/s),wy (rad/s),wz (deg/s)\n{rows(',')}")
    with pytest.raises(LogError, match="one for all"):
        read_log(path, rate=1.0)


@pytest.mark.parametrize(
    ("said", "rate"),
    [("50.0Hz", 50.0), ("1e3 Hz", 1e3), ("100", 100.0)]
    + [(s, None) for s in ("1,000 Hz", "0.1 kHz", "1..5", ".", "-50 Hz", "50 per min")],
)
def test_sample_rates_in_comments(tmp_path, said, rate):
    path = write(tmp_path / "a.csv", f"# Sample rate: {said}\nwx,wy,wz\n{rows(',')}")
    if rate is None:
        with pytest.raises(LogError, match="no time column and no sample rate"):
            read_log(path)
    else:
        assert read_log(path).rate == rate


@pytest.mark.parametrize(
    "text", ["\ufeff" + rows(","), '"' + rows('","').replace("\n", '"\n"')[:-1]]
)
def test_byte_order_mark_and_quotes(tmp_path, text):
    path = write(tmp_path / "a.csv", text)
    assert np.array_equal(read_log(path, rate=1.0, columns=["1", "2", "3"]).rates, RATES)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_log(tmp_path / "none.csv")


def test_blocks_join(tmp_path, monkeypatch):
    monkeypatch.setattr(gyrolog, "_ROWS", 7)
    numbers = np.arange(60.0).reshape(20, 3)
    text = "wx,wy,wz\n" + "\n".join(",".join(map(str, r)) for r in numbers)
    seen: list[int] = []
    path = write(tmp_path / "a.csv", text)
    assert np.array_equal(read_log(path, rate=1.0, progress=seen.append).rates, numbers)
    assert len(seen) == 3
    assert sum(seen) == path.stat().st_size - len("wx,wy,wz\n")


@pytest.mark.parametrize("block", [1, 2, 3, 7])
def test_no_row_is_lost_after_blank_lines_and_comments(tmp_path, monkeypatch, block):
    monkeypatch.setattr(gyrolog, "_ROWS", block)
    numbers = np.arange(60.0).reshape(20, 3)
    lines = [",".join(map(str, r)) for r in numbers]
    lines[5:5] = ["", "# a note"]
    lines[12:12] = ["//"] * 8
    path = write(tmp_path / "a.csv", "wx,wy,wz\n" + "\n".join(lines))
    assert np.array_equal(read_log(path, rate=1.0).rates, numbers)


@pytest.mark.parametrize("block", [1, 3, 100])
def test_the_line_of_a_bad_row_in_any_block(tmp_path, monkeypatch, block):
    monkeypatch.setattr(gyrolog, "_ROWS", block)
    path = write(tmp_path / "a.csv", "wx,wy,wz\n" + "1,2,3\n\n" * 6 + "1,inf,3\n1,2,x\n")
    with pytest.raises(LogError, match="line 14: wy is 'inf'"):
        read_log(path, rate=1.0)


@pytest.mark.parametrize("suffix", [".csv", ".npy"])
def test_written_attitudes_come_back(tmp_path, suffix):
    t, q = np.array([0.0, 0.1]), np.array([[1.0, 0.0, 0.0, 0.0], [0.6, 0.8, 0.0, 1e-300]])
    path = tmp_path / f"a{suffix}"
    write_attitudes(path, t, q)
    found = np.load(path) if suffix == ".npy" else np.loadtxt(path, delimiter=",", skiprows=1)
    assert np.array_equal(found, np.column_stack([t, q]))


def test_unknown_ending(tmp_path):
    with pytest.raises(LogError, match=r"found the ending '.xls'; accepted: .csv and .npy"):
        write_attitudes(tmp_path / "a.xls", np.zeros(1), np.ones((1, 4)))


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
        log = read_log(path, columns=["1", "2", "3"], rate=1.0)
    except LogError as error:
        message = str(error)
    else:
        message = "" if log.rates.shape[1] == 3 and np.isfinite(log.rates).all() else "read\nwrong"
    assert "\n" not in message
