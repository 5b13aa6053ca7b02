"""Logs as loggers write them: a few lines in each format, read right; what they lack asked for."""

from __future__ import annotations

import io
import re
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
import xarray
from each import each

import fastatt as fa
from fastatt.gyro import GyroLogWarning, text

W = np.array([[0.1, -0.2, 0.3], [0.4, 0.5, -0.6], [-0.7, 0.8, 0.9]])
A = np.array([[0.5, -0.25, 9.75], [0.25, 0.5, 9.5], [-0.5, 0.25, 9.25]])
DEG = np.pi / 180.0


def table(head, first, *blocks, separator=",", more=()):
    """Text of a table: lines of a head, time stamps, and blocks of columns beside them."""
    columns = [[*row] for row in zip(first, *(b.tolist() for b in blocks), strict=True)]
    lines = [
        separator.join([str(t), *(repr(x) for b in rest for x in b), *more]) for t, *rest in columns
    ]
    return "\n".join([head, *lines]) + "\n"


class Case(NamedTuple):
    """A log's text, what it means, and what has to be said of it."""

    text: str
    dt: float
    scale: float = 1.0  # rad/s in its unit
    accel: float | None = None  # m/s² in its unit
    said: dict[str, Any] = MappingProxyType({})
    name: str = "log.csv"


RAD, US_STAMPS = {"unit": "rad/s"}, {"time_unit": "us"}
XYZ = {"columns": ["xyz[0]", "xyz[1]", "xyz[2]"], "time_column": "timestamp"}


NS = [1403636579758555392 + 5_000_000 * k for k in range(3)]
US = [38_512_305 + 4000 * k for k in range(3)]
SECONDS = [0.0, 0.01, 0.02]
ZYX = [2, 1, 0]


def xyz(names, separator=",", axes="xyz"):
    return separator.join(names.format(axis) for axis in axes)


def lines(rows):
    return "".join(",".join(x if isinstance(x, str) else repr(x) for x in r) + "\n" for r in rows)


def column(*numbers):
    return np.array(numbers)[:, None]


ROS = xyz("field.angular_velocity.{}") + xyz(",field.angular_velocity_covariance{}", "", range(9))
ROS_ROWS = [
    [t + 3_000_000, k, t, "imu_link", *w, *[0.0] * 9, *a]
    for k, (t, w, a) in enumerate(zip(NS, W.tolist(), A.tolist(), strict=True))
]
PX4 = "gyro_integral_dt,accelerometer_timestamp_relative"
XSENS = xyz("Acc_{}", "\t", "XYZ") + "\t" + xyz("Gyr_{}", "\t", "XYZ")

CASES = {
    "EuRoC": Case(
        table(
            f"#timestamp [ns],{xyz('w_RS_S_{} [rad s^-1]')},{xyz('a_RS_S_{} [m s^-2]')}", NS, W, A
        ),
        0.005, accel=1.0,
    ),
    "PX4 sensor_combined": Case(
        table(
            f"timestamp,{xyz('gyro_rad[{}]', axes='012')},{PX4},"
            f"{xyz('accelerometer_m_s2[{}]', axes='012')},accelerometer_integral_dt",
            US, W, np.full((3, 2), [4000.0, 0.0]), A, np.full((3, 1), 4000.0),
        ),
        0.004, accel=1.0,
    ),
    "PX4 vehicle_angular_velocity": Case(
        table(
            f"timestamp,timestamp_sample,{xyz('xyz[{}]', axes='012')},"
            f"{xyz('xyz_derivative[{}]', axes='012')}",
            US, column(*US) - 100, W, 9 * W,
        ),
        0.004, said=RAD | US_STAMPS | XYZ, name="flight_vehicle_angular_velocity_0.csv",
    ),
    "rostopic echo -p": Case(
        f"%time,field.header.seq,field.header.stamp,field.header.frame_id,{ROS},"
        f"{xyz('field.linear_acceleration.{}')}\n" + lines(ROS_ROWS),
        0.005, accel=1.0,
    ),
    "PlotJuggler": Case(
        table(
            f"__time,{xyz('/imu/angular_velocity/{}')},{xyz('/imu/linear_acceleration/{}')}",
            SECONDS, W, A,
        ),
        0.01, accel=1.0,
    ),
    "bagpy": Case(
        table(
            f"Time,header.seq,header.stamp.secs,header.stamp.nsecs,{xyz('angular_velocity.{}')}",
            [1.6e9, 1.6e9 + 0.3, 1.6e9 + 0.6],
            np.array([[7, 1600000000, 250000000 * k] for k in range(3)]), W,
        ).replace(".0,", ","),
        0.25,
    ),
    "phyphox": Case(
        '"Time (s)",' + xyz('"Gyroscope {} (rad/s)"') + ',"Absolute (rad/s)"'
        + table("", SECONDS, W, np.ones((3, 1))),
        0.01,
    ),
    "phyphox with decimal commas": Case(
        f"Time (s);{xyz('Gyroscope {} (rad/s)', ';')}"
        + table("", SECONDS, W, separator=";").replace(".", ","),
        0.01,
    ),
    "Sensor Logger": Case(
        table("time,seconds_elapsed,z,y,x", NS, column(*SECONDS), W[:, ZYX]), 0.01,
        name="Gyroscope.csv",
    ),
    "Betaflight": Case(
        table(
            f"loopIteration, time (us), {xyz('gyroADC[{}] (deg/s)', ', ', '012')}, "
            f"{xyz('accSmooth[{}]', ', ', '012')}, debug[0]",
            [0, 4, 8], column(55158008, 55158508, 55159008), W, 2048 * A, W[:, :1],
        ),
        0.0005, DEG,
    ),
    "ax ay az gx gy gz": Case(
        table("t_ms ax ay az gx gy gz", [5, 15, 25], A / 10, 100 * W, separator=" "),
        0.01, 100 * DEG, said={"unit": "deg/s"},
    ),
    "SensorLog": Case(
        table(
            "loggingTime(txt),gyroTimestamp_sinceReboot(s),"
            + xyz("motionRotationRate{}(rad/s)", axes="XYZ"),
            [f"2021-03-04 10:00:00.{k}00" for k in range(3)], np.ones((3, 1)), W,
        ),
        0.1,
    ),
    "x-io": Case(
        table(
            f"Time (s),{xyz('Gyroscope {} (deg/s)', axes='XYZ')},"
            f"{xyz('Accelerometer {} (g)', axes='XYZ')}",
            SECONDS, W, A / 9.80665,
        ),
        0.01, DEG, accel=1.0,
    ),
    "Xsens": Case(
        "// Start Time: Unknown\n// Sample rate: 50.0Hz\n// Scenario: 4.9\n"
        + table(f"Counter\t{XSENS}\t", [7, 8, 9], A, W, separator="\t", more=("",)),
        0.02, said=RAD,
    ),
    "UZH-FPV": Case(
        table(f"# timestamp {xyz('ang_vel_{}', ' ')} {xyz('lin_acc_{}', ' ')}",
              [1540113186.25, 1540113186.5, 1540113186.75], W, A, separator=" "),
        0.25, said=RAD | {"time_unit": "s"},
    ),
    "ArduPilot": Case(
        table("timestamp,TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", [1.6e9, 1.6e9 + 1, 1.6e9 + 2],
              np.array([[7_000_000, 0], [7_002_500, 0], [7_005_000, 0]]), W, A),
        0.0025, said=RAD,
    ),
    "ROS 2": Case(
        table(
            f"header.stamp.sec,header.stamp.nanosec,{xyz('angular_velocity.{}')}",
            [1700000000, 1700000000, 1700000001], column(600_000_001, 800_000_001, 1), W,
        ).replace(".0,", ","),
        0.2,
    ),
    "Gyroflow": Case(
        "GYROFLOW IMU LOG\nversion,1.1\ntimestamp,1644159993\ntscale,0.001\ngscale,0.25\n"
        "ascale,0.5\n" + table(f"t,{xyz('g{}')},{xyz('a{}')}", [7, 8, 9], W, A / 9.80665),
        0.001, 0.25, accel=0.5,
    ),
    "Xsens, SampleTimeFine": Case(
        "// Update Rate: 10.0Hz\n"
        + table("SampleTimeFine\tGyr_X\tGyr_Y\tGyr_Z", [5000, 6000, 7000], W, separator="\t"),
        0.1, said=RAD | {"time_unit": "100us"},
    ),
}  # fmt: skip


def read_case(folder, case, said):
    path = folder / case.name
    path.write_text(case.text, encoding="utf-8")
    return path, fa.read_gyro_log(path, **said)


@each("name", CASES)
def test_formats(tmp_path, name):
    case = CASES[name]
    path, log = read_case(tmp_path, case, case.said)
    # W as written times a factor: two roundings
    # the first mean has an interval that begins before the first stamp
    first = log.values != "samples"
    assert log.values == ("means" if name == "PX4 sensor_combined" else "samples")
    assert np.allclose(log.rates, W[first:] * case.scale, rtol=4.5e-16, atol=0.0)
    # stamps of 1.6e9 s and their differences are whole multiples of 0.25 s here, others small
    assert np.allclose(log.dt, case.dt, rtol=1e-14, atol=0.0)
    assert log.summary.startswith(f"{path}: 3 samples at ")
    assert len(log.summary.splitlines()) == 1
    if case.accel is None:
        assert log.accel is None
    else:
        assert np.allclose(log.accel, A[first:] * case.accel, rtol=6.7e-16, atol=0.0)
        assert re.search("; accelerometer in (m/s²|g): ", log.summary)


@each("name", [name for name, case in CASES.items() if case.said])
def test_what_a_format_does_not_say_is_asked_for(tmp_path, name):
    """Each of the arguments that the test before gives."""
    case = CASES[name]
    words = {"unit": "has no unit; accepted: unit", "time_unit": "given as time_unit"}
    words |= {"columns": "columns"}
    for argument in words.keys() & case.said.keys():
        given = {key: value for key, value in case.said.items() if key != argument}
        with pytest.raises(fa.GyroLogError, match=words[argument]):
            read_case(tmp_path, case, given)


GYRO = ("gx (rad/s)", "gy (rad/s)", "gz (rad/s)")


def text_of(columns):
    """A log of columns by name."""
    rows = zip(*columns.values(), strict=True)
    return io.StringIO("\n".join(",".join(map(str, row)) for row in [tuple(columns), *rows]))


def of_gyro(head, more=None):
    """A log of columns with these names and three rates; and others."""
    times = {"t (s)": SECONDS}
    return text_of(times | dict(zip(head, W.T.tolist(), strict=True)) | (more or {}))


def test_an_argument_that_agrees_with_the_names_changes_nothing():
    plain = fa.read_gyro_log(of_gyro(GYRO))
    options = {"unit": "rad/s", "time_unit": "s", "rate": 100.0, "values": "samples"}
    for name, value in options.items():
        log = fa.read_gyro_log(of_gyro(GYRO), **{name: value})
        assert np.array_equal(log.rates, plain.rates)
        assert np.allclose(log.t, plain.t, rtol=1e-15)


def test_a_rate_in_place_of_the_stamps_of_packets():
    stamped = {"t (s)": np.floor(np.arange(19400) / 4) * 0.02}
    stamped |= dict.fromkeys(GYRO, np.ones(19400))
    assert len(fa.read_gyro_log(stamped, rate=200.0).t) == 19400


NAMES = (
    "imu0_gyro_{}", "GyroCal_{}", "mpu6050_gyro_{}", "left_thigh_gyr_{}", "gyroFilt_{}",
    "bodyRate{}", "motionRotationRate{}", "gyroRotation{}", "omega_{}", "/imu/gyro/{}",
    "Angular Velocity {}", "turn_rate_{}",
)  # fmt: skip


@each(
    ("names", "options"),
    [
        *((name + " (rad/s)", {}) for name in NAMES),
        # revolutions or radians, and words in brackets, take a unit
        *((name, RAD) for name in ("gyro_{} (rps)", "gyro_{} (filtered)")),
        # columns that are said may have any name
        ("world_{} (rad/s)", {"columns": [f"world_{axis} (rad/s)" for axis in "XYZ"]}),
    ],
)
def test_names_of_body_rates(names, options):
    head = [names.format(axis) for axis in "XYZ"]
    assert np.array_equal(fa.read_gyro_log(of_gyro(head), **options).rates, W)


def with_sensor(names):
    values = zip("XYZ", A.T.tolist(), strict=True)
    return fa.read_gyro_log(of_gyro(GYRO, {names.format(a): x for a, x in values}))


@each(
    ("names", "scale"),
    [
        ("acc_{} (m/s^2)", 1.0), ("acc_{}_mps2", 1.0), ("acc_{}_m/s2", 1.0), ("acc_{}_m_s2", 1.0),
        ("acc_{}_ms2", 1.0), ("Acc{} (m/s/s)", 1.0), ("a_RS_S_{} [m s^-2]", 1.0),
        ("acc_{} [cm/s^2]", 1e-2), ("acc_{} [mm/s²]", 1e-3), ("Accelerometer {} (g)", 9.80665),
        ("acc_{}_mg", 9.80665e-3),
        # iOS has the opposite sign: SensorLog
        ("accelerometerAcceleration{}(G)", -9.80665),
    ],
)  # fmt: skip
def test_an_accelerometer_is_specific_force_in_si(names, scale):
    """By the unit that its columns are named with, whatever their size."""
    log = with_sensor(names)
    assert np.allclose(log.accel, scale * A, rtol=4e-16, atol=0.0)
    assert "; accelerometer in " in log.summary


OTHERS = (
    "geomagnetic_Rotation_Vector_{} (uT)", "FreeAcc_{} [m/s^2]", "motionUserAcceleration{}(G)",
    "Linear Acceleration {} (m/s^2)", "linear_acceleration_{} [m/s^2]", "dynamic_acc_{} [m/s^2]",
    "motion_acc_{} [m/s^2]", "acc_world_{} [m/s^2]",
)  # fmt: skip
UNNAMED = ("Mag_{}", "Magnetometer {} (a.u.)", "Acc_{}", "acc_{} [m/s]")


@each(
    ("names", "why"),
    [(name, "of another quantity") for name in OTHERS]
    + [(name, "without a unit") for name in UNNAMED],
)
def test_what_is_no_specific_force_and_no_magnetic_field_is_left_out(names, why):
    log = with_sensor(names)
    assert log.accel is None
    assert log.mag is None
    word = "magnetometer" if "mag" in names.lower() else "accelerometer"
    assert f"; no {word}: {names.format('X')} ... is {why}" in log.summary


def test_columns_of_other_sensors_are_named():
    more = dict(zip("abcdefghi", np.hstack([A, W, A]).T.tolist(), strict=True))
    of_g = {f"{a} (mg)": column for a, column in zip("uvw", A.T.tolist(), strict=True)}
    read = partial(fa.read_gyro_log, mag_columns=["d", "e", "f"])
    log = read(of_gyro(GYRO, more), accel_columns=["a", "b", 7], accel_unit="g")
    assert np.array_equal(log.accel, A * 9.80665)
    assert np.array_equal(log.mag, W)
    assert "; accelerometer in g: a ...; magnetometer: d ..." in log.summary
    log = read(of_gyro(GYRO, more | of_g), accel_columns=[*of_g])
    assert np.array_equal(log.accel, A * 9.80665e-3)


@each("unit", ["uT", "µT", "nT", "T", "gauss", "mG", "g"])
def test_a_magnetometer_is_in_the_unit_of_the_log(unit):
    for names in (f"mag_{{}}_{unit}", f"Magnetometer {{}} ({unit})"):
        assert np.array_equal(with_sensor(names).mag, A)


@each("name", ["T", "T (degC)", "T [°C]", "t [C]"])
def test_a_temperature_is_no_time(name):
    columns = {name: [20, 21, 22], **dict(zip(GYRO, W.T.tolist(), strict=True))}
    log = fa.read_gyro_log(text_of({"time (s)": SECONDS} | columns))
    assert np.allclose(log.dt, 0.01)


@each("damage", [b"\0", b"\0" * 64, b"\xb0"])
@each("column", [b"0.5", b"IMU"])
def test_bytes_that_are_no_text_make_a_row_bad(tmp_path, damage, column):
    """In columns that are not read too: the bytes may have been rows."""
    good = b"".join(b"%d,1,2,0.5,IMU\n" % k for k in range(500))
    head = b"t [s],gx [rad/s],gy [rad/s],gz [rad/s],label\n"
    path = tmp_path / "log.csv"
    path.write_bytes(head + re.sub(b"(\n300,.*)" + column, rb"\1" + damage + column, good))
    with pytest.raises(fa.GyroLogError, match="line 302: found bytes that are no text in UTF-8"):
        fa.read_gyro_log(path)
    log = fa.read_gyro_log(path, on_bad_rows="drop")
    assert len(log.t) == 499
    assert "1 row dropped: line 302 at 299 s" in log.summary


@each("end", ["\n", "\r\n", "\r"])
@each("tail", ["", ","])
def test_a_plain_log_is_parsed_by_pandas_alone(tmp_path, monkeypatch, end, tail):
    """And not line by line, which takes ten times as long; but lone carriage returns are."""
    lines = []
    monkeypatch.setattr(text, "_damage", lambda line: lines.append(line) or "")
    rows = "".join(f"{k},1,2.5,0.5,IMU{tail}{end}" for k in range(2000))
    path = tmp_path / "log.csv"
    path.write_text(
        f"# 1{end}t [s],gx [rad/s],gy [rad/s],gz [rad/s],label{tail}{end}{rows}", newline=""
    )
    log = fa.read_gyro_log(path)
    assert len(log.t) == 2000
    assert len(lines) < 10 or end == "\r"


@each(
    "head",
    [
        "t;gx;gy;gz\ns;rad/s;rad/s;rad/s",
        "t,gx,gy,gz,\n[s],[rad/s],[rad/s],[rad/s],",
        '"t, [s]","gyro, x [rad/s]","gyro, y [rad/s]","gyro, z [rad/s]"',
        '"t [s]","gyro x, rad/s","gyro y, rad/s","gyro z, rad/s"',
        '# "t [s]","gyro, x [rad/s]","gyro, y [rad/s]","gyro, z [rad/s]"',
        "Device: a\nSerial,7\n\nRecorded 2024-01-01 10:00\nt [s],gx [rad/s],gy [rad/s],gz [rad/s]",
    ],
)
def test_units_in_a_row_of_their_own_separators_in_quotes_and_a_preamble(head):
    separator = ";" if ";" in head else ","
    log = fa.read_gyro_log(io.StringIO(table(head, SECONDS, W, separator=separator)))
    assert np.array_equal(log.rates, W)
    assert np.allclose(log.dt, 0.01)


def test_the_text_log_of_ardupilot():
    """Rows of several kinds and lengths, which the log describes itself."""
    kinds = "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
    kinds += (
        "FMT, 129, 31, IMU, QBfff, TimeUS,I,GyrX,GyrY,GyrZ\nFMT, 130, 31, ATT, Qfff, TimeUS,R,P,Y\n"
    )
    rows = "PARM, 1, A, 2\n" * 1500 + "".join(
        f"IMU, {1000 * k}, 1, 7, 8, 9\nATT, {1000 * k}, 1, 2, 3\n"
        f"IMU, {1000 * k}, 0, {', '.join(map(str, w))}\n" for k, w in enumerate(W.tolist())
    )  # fmt: skip
    for chosen in (((1, "IMU"), (3, "0")), (("1", "IMU"), ("I", "0"))):
        log = fa.read_gyro_log(io.StringIO(kinds + rows), rows=chosen, unit="rad/s")
        assert np.array_equal(log.rates, W)
        assert np.allclose(log.dt, 0.001)
    numbers = {"columns": [4, 5, 6], "time_column": 2, "time_unit": "us", "unit": "rad/s"}
    log = fa.read_gyro_log(io.StringIO(rows), rows=((1, "IMU"), (3, "0")), **numbers)
    assert np.array_equal(log.rates, W)


N = 12
MIXED = "name,TimeUS,I,GyrX,GyrY,GyrZ,Roll\n" + "".join(
    f"IMU,{2500 * k},{k % 2},{k},2,3,\nCTUN,{2500 * k + 9},,,,,\nATT,{2500 * k + 3},,0,0,0,7\n"
    for k in range(N)
)


def test_rows_of_several_kinds_are_chosen():
    """DataFlash's IMU among others, of two sensors."""

    def read(source=None, **options):
        return fa.read_gyro_log(io.StringIO(MIXED) if source is None else source, **RAD, **options)

    kinds = r"name tells rows .*: 'ATT', 'CTUN', 'IMU'; acc"
    for options, message in (
        ({}, kinds),
        ({"on_bad_rows": "drop"}, kinds),
        ({"rows": ("name", "IMU")}, r"I tells rows .*: '0', '1'; accepted: rows=\('I', '0'"),
        ({"rows": ("name", "GPS")}, "rows: found no row with 'GPS'"),
        ({"rows": ("kind", "IMU")}, "rows: found 'kind'; accepted: 'name'"),
    ):
        with pytest.raises(fa.GyroLogError, match=message):
            read(**options)
    with pytest.raises(TypeError, match="rows: found 5; accepted: a column and its text"):
        read(rows=5)
    chosen = {"rows": [("name", "IMU"), ("I", 1)]}
    log = read(**chosen)
    assert log.rates[:, 0].tolist() == [*range(1, N, 2)]
    assert np.allclose(log.dt, 0.005)
    assert np.array_equal(read(pd.read_csv(io.StringIO(MIXED)), **chosen).rates, log.rates)


def test_a_label_of_long_spans_tells_no_rows_apart():
    columns = {"t (s)": 0.01 * np.arange(80), "activity": ["rest"] * 40 + ["walk"] * 40}
    columns |= dict.fromkeys(GYRO, np.ones(80))
    assert len(fa.read_gyro_log(columns).t) == 80
    columns["mode"] = ["a", "b"] * 40
    with pytest.raises(fa.GyroLogError, match="mode tells rows of several kinds"):
        fa.read_gyro_log(columns)
    assert len(fa.read_gyro_log(columns, rows=()).t) == 80


def of_packets(counts, stamps=None):
    stamps = [""] * len(counts) if stamps is None else stamps
    rows = zip(counts, stamps, strict=True)
    text = "".join(f"{count}\t{stamp}\t{count}\t2\t3\n" for count, stamp in rows)
    head = "// Update Rate: 100.0Hz\nPacketCounter\tSampleTimeFine\tGyr_X\tGyr_Y\tGyr_Z\n"
    return io.StringIO(head + text)


def test_a_packet_counter_that_jumps_is_a_gap():
    """With the header's rate, where SampleTimeFine is empty; 0 follows 65535."""
    whole = fa.read_gyro_log(of_packets([65534, 65535, 0, 1, 2]), unit="rad/s")
    assert whole.dt.tolist() == [0.01] * 4
    assert "at 100 Hz (100 Hz); " in whole.summary
    counts = [65534, 65535, 0, 3, 4, 5]
    gap = "; 1 gap: line 6 at 0.02 s"
    for given in ({}, {"rate": 100.0}):
        with pytest.raises(fa.GyroLogError, match=r"PacketCounter in line 6: a gap of 0\.03 s; "):
            fa.read_gyro_log(of_packets(counts), unit="rad/s", **given)
        log = fa.read_gyro_log(of_packets(counts), unit="rad/s", on_bad_rows="drop", **given)
        assert np.allclose(log.t, [0.0, 0.01, 0.02, 0.05, 0.06, 0.07])
        assert log.summary.endswith(gap)
    stamps = [10_000 * k for k in (0, 1, 2, 5, 6, 7)]
    options = {"unit": "rad/s", "time_unit": "us", "on_bad_rows": "drop"}
    assert fa.read_gyro_log(of_packets(counts, stamps), **options).summary.endswith(gap)
    # another counter is one of packets only without time stamps
    frames = {"counter": [0, 1, 4], **dict.fromkeys(GYRO, np.ones(3))}
    assert "gap" not in fa.read_gyro_log({"t (s)": [0.0, 0.01, 0.02], **frames}).summary
    refused = "row 2: a gap of 0.015 s; accepted: a packet counter without jumps"
    with pytest.raises(fa.GyroLogError, match=refused):
        fa.read_gyro_log(frames, rate=100.0, max_gap=1.0)


def of_two_sensors(name, values, shift=0.003, n=200):
    """Rows of two sensors in turn, the second one later than the first."""
    t = 0.01 * np.repeat(np.arange(n), 2) + np.tile([0.0, shift], n)
    return {"t (s)": t, name: list(values) * n, **dict.fromkeys(GYRO, np.tile([1.0, -1.0], n))}


@each(
    ("name", "values"),
    [
        ("node_id", (7, 9)), ("addr", ("0x68", "0x69")), ("serial", (1001, 1002)), ("ch", (0, 1)),
        ("mac", ("D4:22:CD:00:01:0A", "00:22:CD:00:01:0B")), ("board", (1, 2)), ("side", "LR"),
        ("port", (3, 4)), ("body", (1, 2)), ("unit", (1, 2)), ("index", (0, 1)),
        ("deviceId", (5, 6)), ("whatever", ("a", "b")), ("0", ("00B421AF", "00B42263")),
    ],
)  # fmt: skip
@each("shift", [0.003, 0.005, 0.0])
def test_two_sensors_in_one_table_are_refused(name, values, shift):
    """By text, or the name of a device, also where their stamps are even or equal."""
    with pytest.raises(fa.GyroLogError, match=rf"{name} tells rows .* accepted: rows=\('{name}'"):
        fa.read_gyro_log(of_two_sensors(name, values, shift))
    with pytest.raises(fa.GyroLogError, match=f"{name} tells rows"):
        fa.read_gyro_log(text_of(of_two_sensors(name, values, shift)))
    log = fa.read_gyro_log(of_two_sensors(name, values, shift), rows=(name, values[0]))
    assert (log.rates == 1.0).all()


def test_two_sensors_are_known_by_their_clocks():
    for shift in (0.003, 0.0, 1000.0, -0.3):
        with pytest.raises(fa.GyroLogError, match="flag tells rows of several kinds"):
            fa.read_gyro_log(of_two_sensors("flag", (0, 1), shift))
    # an even clock may be that of one sensor: told
    with pytest.warns(GyroLogWarning, match=r"flag changes in 399 rows .*rows=\('flag', '0'\)"):
        fa.read_gyro_log(of_two_sensors("flag", (0, 1), 0.005))
    assert len(fa.read_gyro_log(of_two_sensors("flag", (0, 1), 0.005), rows=()).t) == 400
    # numbers that take few values by chance are no sensors'
    columns = of_two_sensors("temperature", (20.5, 20.75), 0.005)
    assert len(fa.read_gyro_log(columns).t) == 400


def test_a_column_that_occurs_twice_is_said():
    frame = pd.DataFrame({"t (s)": SECONDS} | dict(zip(GYRO, W.T, strict=True)))
    for twice, name in (
        (pd.concat([frame, frame], axis=1), "t"),
        (pd.concat([frame, frame.iloc[:, 1:]], axis=1), "gx"),
    ):
        for source in (twice, io.StringIO(twice.to_csv(index=False))):
            with pytest.raises(fa.GyroLogError, match=rf"found the column '{name} .* twice; acc"):
                fa.read_gyro_log(source)
        log = fa.read_gyro_log(twice, columns=[2, 3, 4], time_column=1)
        assert np.array_equal(log.rates, W)


def test_units_in_attributes_are_those_of_names():
    data = xarray.Dataset(
        {"angular_velocity": (("time", "axis"), W, {"units": "deg/s"})},
        coords={"time": ("time", [0, 10, 20], {"units": "ms"})},
    )
    log = fa.read_gyro_log(data)
    assert np.allclose(log.rates, DEG * W, rtol=1e-15)
    assert np.allclose(log.dt, 0.01)
    for name, value in (("unit", "rad/s"), ("time_unit", "us")):
        with pytest.raises(fa.GyroLogError, match=f"{name}: found '{value}'"):
            fa.read_gyro_log(data, **{name: value})
    assert len(fa.read_gyro_log(data, time_column="time").t) == 3


def test_seconds_and_nanoseconds_in_two_columns():
    stamps = [(1700000000 + k // 100, k % 100 * 10_000_000) for k in range(150)]
    rows = "\n".join(f"{s},{ns},0.1,0.2,0.3" for s, ns in stamps)
    options = {"columns": [3, 4, 5], "unit": "rad/s"}
    log = fa.read_gyro_log(io.StringIO(rows), time_column=(1, 2), **options)
    assert np.allclose(log.dt, 0.01, rtol=1e-12)
    over = rows.replace(",0,", ",1000000000,")
    with pytest.raises(fa.GyroLogError, match="line 1: column 2 is '1000000000'; accepted: a"):
        fa.read_gyro_log(io.StringIO(over), time_column=(1, 2), **options)


def test_ticks_of_100_ns():
    ticks = 132_500_000_000_000_000 + 11_600 * np.arange(50)
    columns = {"HostTicks": ticks, **dict.fromkeys(GYRO, np.ones(50))}
    log = fa.read_gyro_log(columns, time_column="HostTicks", time_unit="100ns")
    assert log.rate == pytest.approx(1e7 / 11_600, rel=1e-9)
