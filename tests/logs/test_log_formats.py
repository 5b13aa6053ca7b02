"""Logs as loggers write them: a few lines in each format, read right; ambiguous ones refused."""

from __future__ import annotations

import re
import warnings
from typing import NamedTuple

import numpy as np
import pytest

import fastatt as fa

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
    """A log's text, what it means, and words of the warning if there is one."""

    text: str
    dt: float
    scale: float = 1.0  # rad/s in its unit
    accel: float | None = None  # m/s² in its unit
    warned: str = ""
    name: str = "log.csv"


NS = [1403636579758555392 + 5_000_000 * k for k in range(3)]
US = [38_512_305 + 4000 * k for k in range(3)]
SECONDS = [0.0, 0.01, 0.02]
ZYX = [2, 1, 0]
ROS = ",".join(f"field.angular_velocity.{a}" for a in "xyz")
COVARIANCE = ",".join(f"field.angular_velocity_covariance{k}" for k in range(9))
ROSTOPIC = "\n".join(
    [
        f"%time,field.header.seq,field.header.stamp,field.header.frame_id,{ROS},{COVARIANCE},"
        + ",".join(f"field.linear_acceleration.{a}" for a in "xyz"),
        *(
            ",".join(map(repr, [t + 3_000_000, k, t])) + ",imu_link,"
            + ",".join(map(repr, [*w, *[0.0] * 9, *a]))
            for k, (t, w, a) in enumerate(zip(NS, W.tolist(), A.tolist(), strict=True))
        ),
        "",
    ]
)  # fmt: skip
IMU = "/imu/angular_velocity/x,/imu/angular_velocity/y,/imu/angular_velocity/z"
SHIMMER = "\n".join(
    [
        "sep=\t",
        "Shimmer_43A6_Timestamp_Unix_CAL\t"
        + "\t".join(f"Shimmer_43A6_Gyro_{a}_CAL" for a in "XYZ") + "\t",
        "ms\tdeg/s\tdeg/s\tdeg/s\t",
        *(
            "\t".join(map(repr, [1.4e12 + 19.5 * k, *w])) + "\t"
            for k, w in enumerate(W.tolist())
        ),
        "",
    ]
)  # fmt: skip

CASES = {
    "EuRoC": Case(
        table(
            "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
            "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]",
            NS, W, A,
        ),
        0.005,
        accel=1.0,
    ),
    "PX4 sensor_combined": Case(
        table(
            "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt,"
            "accelerometer_timestamp_relative,accelerometer_m_s2[0],accelerometer_m_s2[1],"
            "accelerometer_m_s2[2],accelerometer_integral_dt",
            US, W, np.full((3, 2), [4000.0, 0.0]), A, np.full((3, 1), 4000.0),
        ),
        0.004,
        accel=1.0,
        warned="timestamp has no unit: taken as us (250 Hz)",
    ),
    "PX4 vehicle_angular_velocity": Case(
        table(
            "timestamp,timestamp_sample,xyz[0],xyz[1],xyz[2],xyz_derivative[0],xyz_derivative[1],"
            "xyz_derivative[2]",
            US, np.array(US)[:, None] - 100, W, 9 * W,
        ),
        0.004,
        warned="has no unit",
        name="flight_vehicle_angular_velocity_0.csv",
    ),
    "rostopic echo -p": Case(ROSTOPIC, 0.005, accel=1.0, warned="stamp has no unit: taken as ns"),
    "PlotJuggler": Case(
        table(f"__time,{IMU},/imu/linear_acceleration/x,/imu/linear_acceleration/y,"
              "/imu/linear_acceleration/z", SECONDS, W, A),
        0.01,
        accel=1.0,
    ),
    "bagpy": Case(
        table(
            "Time,header.seq,header.stamp.secs,header.stamp.nsecs,angular_velocity.x,"
            "angular_velocity.y,angular_velocity.z",
            [1.6e9, 1.6e9 + 0.25, 1.6e9 + 0.5], np.ones((3, 3)), W,
        ),
        0.25,
    ),
    "phyphox": Case(
        '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)",'
        '"Absolute (rad/s)"' + table("", SECONDS, W, np.ones((3, 1))),
        0.01,
    ),
    "phyphox with decimal commas": Case(
        "Time (s);Gyroscope x (rad/s);Gyroscope y (rad/s);Gyroscope z (rad/s)"
        + table("", SECONDS, W, separator=";").replace(".", ","),
        0.01,
    ),
    "Sensor Logger": Case(
        table("time,seconds_elapsed,z,y,x", NS, np.array([[0.0], [0.01], [0.02]]), W[:, ZYX]),
        0.01,
        warned="taken as rad/s",
        name="Gyroscope.csv",
    ),
    "Physics Toolbox": Case(
        table("time,wx,wy,wz,", SECONDS, W, more=("",)), 0.01, warned="wx has no unit"
    ),
    "Betaflight": Case(
        table(
            "loopIteration, time (us), gyroADC[0], gyroADC[1], gyroADC[2], accSmooth[0], "
            "accSmooth[1], accSmooth[2], debug[0]",
            [0, 4, 8], np.array([[55158008], [55158508], [55159008]]), W, 2048 * A, W[:, :1],
        ),
        0.0005,
        DEG,
        accel=2048.0,
    ),
    "ax ay az gx gy gz": Case(
        table("t_ms ax ay az gx gy gz", [5, 15, 25], A / 10, 100 * W, separator=" "),
        0.01,
        100 * DEG,
        accel=9.80665 / 10,
        warned="gx has no unit: taken as deg/s (at most 90",
    ),
    "p q r": Case(table("time (s),p,q,r,phi", SECONDS, W, W[:, :1]), 0.01, warned="taken as rad/s"),
    "rotation_rate": Case(
        table("timestamp;rotation_rate_x;rotation_rate_y;rotation_rate_z", NS, W, separator=";"),
        0.005,
        warned="taken as ns",
    ),
    "SensorLog": Case(
        table(
            "loggingTime(txt),gyroTimestamp_sinceReboot(s),motionRotationRateX(rad/s),"
            "motionRotationRateY(rad/s),motionRotationRateZ(rad/s)",
            [f"2021-03-04 10:00:00.{k}00" for k in range(3)], np.ones((3, 1)), W,
        ),
        0.1,
    ),
    "x-io": Case(
        table(
            "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),"
            "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)",
            SECONDS, W, A / 9.80665,
        ),
        0.01,
        DEG,
        accel=1.0,
    ),
    "Xsens": Case(
        "// Start Time: Unknown\n// Sample rate: 50.0Hz\n// Scenario: 4.9\n"
        + table("Counter\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z\t", [7, 8, 9], A, W,
                separator="\t", more=("",)),
        0.02,
        accel=1.0,
        warned="Gyr_X has no unit",
    ),
    "UZH-FPV": Case(
        table("# timestamp ang_vel_x ang_vel_y ang_vel_z lin_acc_x lin_acc_y lin_acc_z",
              [1540113186.25, 1540113186.5, 1540113186.75], W, A, separator=" "),
        0.25,
        accel=1.0,
        warned="taken as rad/s",
    ),
    "Kalibr": Case(
        table("timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z", NS, W, A),
        0.005,
        accel=1.0,
        warned="taken as ns",
    ),
    "ArduPilot": Case(
        table("timestamp,TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
              [1.6e9, 1.6e9 + 1, 1.6e9 + 2],
              np.array([[7_000_000, 0], [7_002_500, 0], [7_005_000, 0]]), W, A),
        0.0025,
        accel=1.0,
        warned="GyrX has no unit",
    ),
    "Shimmer": Case(SHIMMER, 0.0195, DEG),
    "ROS 2": Case(
        table(
            "header.stamp.sec,header.stamp.nanosec,angular_velocity.x,angular_velocity.y,"
            "angular_velocity.z",
            [1700000000, 1700000000, 1700000001],
            np.array([[600_000_001], [800_000_001], [1]]), W,
        ).replace(".0,", ","),
        0.2,
    ),
    "Xsens, update rate": Case(
        "// Update Rate: 100.0Hz\n"
        + table("PacketCounter\tGyr_X\tGyr_Y\tGyr_Z", [7, 8, 9], W, separator="\t"),
        0.01,
        warned="Gyr_X has no unit",
    ),
    "Xsens, SampleTimeFine": Case(
        "// Update Rate: 10.0Hz\n"
        + table("SampleTimeFine\tGyr_X\tGyr_Y\tGyr_Z", [5000, 6000, 7000], W, separator="\t"),
        0.1,
        warned="SampleTimeFine has no unit: taken as 100us (10 Hz)",
    ),
    "Xsens DOT": Case(
        table("PacketCounter,SampleTimeFine,Gyr_X,Gyr_Y,Gyr_Z", [7, 8, 9],
              np.array([[3_000_000_000], [3_000_016_667], [3_000_033_334]]), W),
        0.016667,
        warned="SampleTimeFine has no unit: taken as us (60 Hz)",
    ),
    "times of day": Case(
        table("time;gyro_x [rad/s];gyro_y [rad/s];gyro_z [rad/s]",
              ["23:59:59.950", "00:00:00.000", "00:00:00.05"], W, separator=";"),
        0.05,
    ),
    "quoted decimal commas": Case(
        "time (s),wx (rad/s),wy (rad/s),wz (rad/s)\n"
        + "".join(
            ",".join(f'"{x}"'.replace(".", ",") for x in (t, *w)) + "\n"
            for t, w in zip(SECONDS, W.tolist(), strict=True)
        ),
        0.01,
    ),
    "Hz": Case(table("t [s],wx [Hz],wy [Hz],wz [Hz]", SECONDS, W), 0.01, 2.0 * np.pi),
    "ISO 8601": Case(
        table("time,gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s]",
              [f"2024-05-06T07:08:09.{5 * k:06d}+02:00" for k in range(3)], W),
        5e-6,
    ),
}  # fmt: skip


def read(path, case, **options):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        log = fa.read_gyro_log(path, **options)
    text = "; ".join(str(w.message) for w in said)
    assert case.warned in text
    assert bool(text) == bool(case.warned)
    return log


@pytest.mark.parametrize("name", CASES)
def test_formats(tmp_path, name, reader):
    case = CASES[name]
    path = tmp_path / case.name
    path.write_text(case.text, encoding="utf-8")
    log = read(path, case)
    # W as written times a factor: two roundings
    assert np.allclose(log.rates, W * case.scale, rtol=4.5e-16, atol=0.0)
    # stamps of 1.6e9 s and their differences are whole multiples of 0.25 s here, others small
    assert np.allclose(log.dt, case.dt, rtol=1e-14, atol=0.0)
    assert log.summary.startswith(f"{path}: 3 samples at ")
    assert len(log.summary.splitlines()) == 1
    if case.accel is None:
        assert log.accel is None
    else:
        assert np.allclose(log.accel, A * case.accel, rtol=6.7e-16, atol=0.0)
        unit = {1.0: "(m/s²|g)", 2048.0: "a unit not known"}.get(case.accel, "g")
        assert re.search(rf"; accelerometer in {unit}: ", log.summary)
