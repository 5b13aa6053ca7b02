"""Of samples of a gyro: arrays, logs as texts and tables, integrators."""

from __future__ import annotations

import gzip
import io
from functools import partial
from pathlib import Path

import numpy as np
from exact import START

import fastatt as fa
from fastatt.gyro.gyro_steps import sample_step

NAN = np.nan
Q = [1.0, 0.0, 0.0, 0.0]
LOG, SPANS = np.full((20, 3), 0.1), np.full(19, 0.1)
SAMPLED = "hold, trapezoid, previous, coning2, picard"
OF_INCREMENTS = "hold, previous, coning2, picard"


def changed(where, value, like=LOG):
    data = like.copy()
    data[where] = value
    return data


def integrated(rates=LOG, dt=0.1, **options):
    return partial(fa.integrate_rates, rates, dt, **{"method": "hold", **options})


def spans(where, value, **options):
    return integrated(dt=changed(where, value, SPANS), **options)


def flow(*given, **options):
    return partial(fa.GyroIntegrator, *given, **options)


def closed(call):
    """Of an integrator that takes no more."""

    def made():
        flow = fa.GyroIntegrator(START, 0.1)
        flow.close()
        call(flow)

    return made


# between the ends of a window alone
WILD = np.array([[1e39, 0.0, 0.0], [0.0, 1e63, -4e257], [0.0] * 3, [9e141, 0.0, 0.0], [0.0] * 3])
OUT = [np.empty((30, 3)), np.empty((30, 4), np.float32), np.empty((4, 30)).T]

# logs

RAD = "wx [rad/s],wy [rad/s],wz [rad/s]"
GOOD = f"t [s],{RAD}\n0,1,2,3\n1,1,2,3\n2,1,2,3\n"
SENSORS = GOOD.replace("wx", "gx,gy,gz,wx").replace(",3", ",3,1,2,3")
TWO_TIMES = GOOD.replace("t [s]", "t [s],time [s]").replace("\n", "\n0,")[:-2]
HUGE = GOOD.replace("2,1,2,3", "1e308,1,2,3").replace("\n0", "\n-1e308")
MIXED_UNITS = "wx (deg/s),wy (rad/s),wz (deg/s)\n1,2,3\n4,5,6\n"
WITH_TICKS = f"t [s],{RAD}\n0,1,2,3\n0.1,1,2,3\n{{}}\n9.1,1,2,3\n9.2,1,2,3\n"
GYRO = "gx (rad/s),gy (rad/s),gz (rad/s)"
NAMES = [f"gyro_{a} (rad/s)" for a in "xyz"]
SAID = "t (s),{},{},{}\n0,1,2,3\n0.01,1,2,3\n"
PACKETS = "PacketCounter,{0}\n" + "".join(f"{k},1,2,3\n" for k in (65534, 65535, 0, 3, 4))
N, H = 1000, 0.01
T, COUNT = H * np.arange(N), np.arange(N)


def text(content, **options):
    return lambda: fa.read_gyro_log(io.StringIO(content), **options)


def named(names, **options):
    """A log of columns with these names."""
    return text(SAID.format(*(names.format(a) for a in "xyz")), **options)


def table(t, rates=None, **options):
    """A log in memory."""
    rates = np.arange(len(t)) if rates is None else rates
    return partial(fa.read_gyro_log, {"t (s)": t, **dict.fromkeys(NAMES, rates)}, **options)


def dated(stamp):
    return text(f"time,{GYRO}\n{stamp},1,2,3\n{stamp[:-1]}1,1,2,3\n")


def of_bytes(content):
    return lambda: fa.read_gyro_log(io.BytesIO(content))


def late(row, by):
    t = T.copy()
    t[row:] += by
    return t


KINDS = ("refuse", "drop")
NO_GYRO = "…found no three columns named like gyro x, y, z"
NOT_BODY_RATES = [
    "gyro_world_{}", "gyro_nav_{}", "gyro_earth_{}", "gyro_drift_{}", "gyro_residual_{}",
    "gyro_target_{}", "gyro_rms_{}", "gyro_ned_{}", "gyro_setpoint_{}", "gyro_mean_{}",
    "gyro_dot_{}", "inertial_gyro_{}", "omega_ref_{}", "angular_velocity_error_{}",
    "desired_body_rate_{}", "gyro_bias_{}", "gyro_scale_{}",
]  # fmt: skip
NO_RATES = {
    "gyro_angle_{} [deg]": "deg", "gyro_inc_{} [rad]": "rad", "gyro_{} [deg/s^2]": "deg/s^2",
    "gyro_{} (rad/s²)": "rad/s²", "gyro_{} [rad s^-2]": "rad s^-2", "gyro_{}_deg": "deg",
    "gyro_{} [g]": "g", "gyro_{} [LSB]": "LSB", "gyro_{} (rad/day)": "rad/day",
    "gyro_{} (kHz)": "khz",
}  # fmt: skip

OTHER_FILES = {
    b"PK\3\4": "found a ZIP archive; accepted: the table in it",
    b"ULog\1\x12\x35\1": "found PX4's ULog; accepted: its tables, which ulog2csv writes",
    b"\xa3\x95\x80\x80\x59": "found ArduPilot's DataFlash; accepted: its tables, which mavlogdump",
    "t [s],gx [°/s]\n1,2,3".encode("latin-1"): "line 1: found bytes that are no text in … Latin-1",
    b"t\n" + b"1" * 10_000_001: "line 2: found 10000001 letters; accepted: 10000000 at most",
}
BAD_ROWS = [
    ("…line 4: wx [rad/s] is 'nan'; accepted: a finite number, or on_bad_rows", "0.2,nan,2,3"),
    ("…t [s] in line 4 is an outlier, 0 s after the row before; acc", "0.1,1,2,3"),
    ("…line 4 is an outlier, -0.05 s after the row before", "0.05,1,2,3"),
    ("…line 4: a gap of 8.9 s; accepted: at most 1 s", "9.0,1,2,3"),
]
AGAINST_NAMES = [
    ("…unit: found 'deg/s'; accepted: rad/s, as the columns say", {"unit": "deg/s"}),
    ("…time_unit: found 'ms', but t (s) is in s", {"time_unit": "ms"}),
    ("…rate: found 50 Hz, but the stamps in t (s) give 100 Hz on average", {"rate": 50.0}),
    ("…found the unit rad/s in the names of columns; accepted: one", {"values": "increments"}),
    ("…unit: found 'rad'; accepted: rad/s, …, of samples", {"unit": "rad"}),
]
DATES = [
    ("03/04/2024 10:00:00", "day and month can be mistaken"),
    ("3.4.2024 10:00:00", "day and month can be mistaken"),
    ("2024-123T10:00:00", "by the day of the year"),
]
RESETS = [(11, 0.0), (500, -100.0), (990, 0.0)]

REFUSED = [
    ("rates: has shape (3,); accepted: (n, 3) or (N, n, 3)", integrated(np.ones(3))),
    ("rates: has shape (2, 2, 2, 3)", integrated(np.ones((2, 2, 2, 3)))),
    ("rates: found", integrated([["a", "b", "c"]]), TypeError),
    ("rates[7, 0] is nan; accepted: finite numbers", integrated(changed(7, NAN))),
    ("rates[1, 5, 2] is nan", integrated(changed((1, 5, 2), NAN, np.stack([LOG] * 2)))),
    ("rates (increments)[3, 1] i", integrated(changed((3, 1), NAN), increments=True)),
    ("rates: the angles overflow float64; accepted: smaller",
     integrated(np.full((5, 3), 1e308), 10.0)),
    ("rates: the angles overflow float64", integrated(WILD, 0.18, q0=START, method="coning2")),
    ("rates: the angles overflow float64",
     lambda: flow(START, 0.18, method="coning2")().push(WILD)),
    ("dt: found 0.0", integrated(dt=0.0)),
    ("dt: found -0.1", integrated(dt=-0.1)),
    ("dt: found None; accepted", integrated(dt=None), TypeError),
    ("dt: has shape (18,); accepted: a number or (19,)", integrated(dt=SPANS[:-1])),
    ("dt: has shape (19,); accepted: a number or (", integrated(dt=SPANS, increments=True)),
    ("dt[4] is nan", spans(4, NAN)),
    ("dt: found [0.1, [None]]; accepted: a number or", integrated(dt=[0.1, [None]]), TypeError),
    ("rates: found [[1, 2, 3], [1]]; accepted", integrated([[1, 2, 3], [1]], [0.1]), TypeError),
    ("dt[4] is 0.0: a repeated time stamp", spans(4, 0.0)),
    ("dt[18] is -0.1: a decreasing time stamp", spans(18, -0.1)),
    ("dt[9] is 1.5: a gap; accepted: at most 1 s", spans(9, 1.5)),
    ("dt[9] is 0.3: a gap; accepted: at most 0", spans(9, 0.3, max_gap=0.2)),
    ("dt[9] is 0.10000000…: a gap; accepted: at most", spans(9, 0.1 + 1e-9, max_gap=0.1)),
    ("max_gap: found 'no'", integrated(dt=SPANS, max_gap="no"), TypeError),
    ("max_gap: found -1.0", integrated(dt=SPANS, max_gap=-1)),
    ("dt: found 0.3; accepted: at most 0.2 s, max_gap", integrated(dt=0.3, max_gap=0.2)),
    ("q0 is the zero quaternion", integrated(q0=np.zeros(4))),
    ("q0: has shape (2, 4); accepted: (4,) or (1, 4), one a log", integrated(q0=[Q, Q])),
    ("method: found 'rk4'; accepted: " + SAMPLED, integrated(method="rk4")),
    ("method: found 'trapezoid'; accepted: " + OF_INCREMENTS,
     integrated(method="trapezoid", increments=True)),
    *[("out: found", integrated(np.ones((30, 3)), out=x)) for x in OUT],
    ("out: found", integrated(np.ones((30, 3)), out=[[0.0] * 4]), TypeError),
    *[(f"method: found '{x}'; accepted: hold", partial(sample_step, x)) for x in ("rk4", "picard")],
    # integrators
    ("dt: found 0.0", flow(START, 0.0)),
    ("method: found 'rk4'", flow(START, 0.1, method="rk4")),
    ("q0 is the zero quaternion", flow(np.zeros(4), 0.1)),
    ("dt: found 0.1; accepted: None", lambda: flow(START, 0.1)().push([0.0] * 3, 0.1)),
    ("rates: has shape (0, 4)", lambda: flow(START, 0.1)().push(np.empty((0, 4)))),
    *[("…found an integrator that is closed", closed(call))
     for call in (lambda flow: flow.push([0.0] * 3), lambda flow: flow.close(),
     lambda flow: setattr(flow, "q", START))],
    # texts
    ("source: found", lambda: fa.read_gyro_log(None), TypeError),
    ("source: found", lambda: fa.read_gyro_log("a\0b"), TypeError),
    ("rate:", text(GOOD, rate="9"), TypeError),
    *[("…found no row of numbers", text(x)) for x in ("", "a,b\nc,d\n")],
    ("…among 'a', 'b', 'c', 'this is no unit'",
     text("t,wx,wy,wz\na,b,c,this is no unit\n1,2,3,4\n")),
    ("…no three columns named like gyro", text("a,b\n1,2\n", rate=1.0)),
    ("…no time column and no sample rate", text(f"{RAD}\n1,2,3\n")),
    ("…line 4: wy [rad/s] is 'nan'", text(GOOD.replace("2,1,2,3", "2,1,nan,3"))),
    ("…line 4: wy [rad/s] is 'x'", text(GOOD.replace("2,1,2,3", "2,1,x,3"))),
    ("…line 14: wy [rad/s] is 'inf'",
     text(f"{RAD}\n" + "1,2,3\n\n" * 6 + "1,inf,3\n1,2,x\n", rate=1.0)),
    ("…line 3: found 3 columns; accepted: 4", text(GOOD.replace("1,1,2,3", "1,2,3"))),
    ("…line 3: found 5 columns; accepted: 4, as in the f",
     text(GOOD.replace("1,1,2,3", "1,9,1,2,3"))),
    ("…among 4 columns without a name each (line 1 has 3 names, the rows have 4); name them",
     text(GOOD.replace("t [s],wx", "wx"))),
    ("…without a name each (line 1 has 5 names, the rows have 4)", text(f"a,{GOOD}")),
    ("…without a name each (line 1 is the first row)", text("Version,1,2,3\n" + GOOD)),
    ("…found no row of numbers with 'IMU'; accepted", text(GOOD, rows=(1, "IMU"))),
    ("…t [s] in line 4, or a number beside it, overflo", text(HUGE, time_unit="s")),
    ("…columns: found 'a'", text(GOOD.replace("wx", "x" * 9999), columns=["a", "b", "c"])),
    ("…columns: found 'wx", text(GOOD.replace("wz", "wx"), columns=["wx [rad/s]", "3", "1"])),
    ("…columns: found 'xyz'; accepted: 3 different columns", text(GOOD, columns="xyz")),
    ("…columns: found '999", text(GOOD, columns=["1", "2", "9" * 9999])),
    ("…or a number beside it, overflows", text(f"{RAD}\n1,2,3\n1,2,3\n", rate=1e-320)),
    ("…3 different columns", text(GOOD, columns=["2", "3", "3"])),
    ("…a number from 1 to 4", text(GOOD, columns=["1", "2", "9"])),
    ("…time column: found 'T'", text(GOOD, time_column="T")),
    ("rate: found 0.0", text(GOOD, rate=0.0)),
    ("rate: found nan", text(GOOD, rate=NAN)),
    ("unit: found 'rps'; accepted: rad/s, deg/s", text(GOOD, unit="rps")),
    ("time_unit: found 'h'; accepted: s, ms, 100us, us, 100ns, ns", text(GOOD, time_unit="h")),
    ("…at least two", text(GOOD.partition("\n1,")[0])),
    ("…of 3 rows that are samples; accepted: at least two",
     text(f"t [s],{RAD}\n0,1,2,3\n0,nan,2,3\n0,1", rate=4.0, on_bad_rows="drop")),
    ("…line 3: a gap of 1 s; accepted: at most 0.5 s", text(GOOD, max_gap=0.5)),
    ("max_gap: found 0.0; accepted: a number above 0", text(GOOD, max_gap=0.0)),
    ("…bad_rows: found 'keep'; accepted: refuse, drop", text(GOOD, on_bad_rows="keep")),
    ("…t [min] is in 'min'; accepted: the unit of time", text(GOOD.replace("[s]", "[min]"))),
    ("…one gyro", text(SENSORS)),
    ("…than one time column", text(TWO_TIMES)),
    ("…one for all", text(MIXED_UNITS, rate=1.0)),
    *[("…line 8", text(f"{RAD}\n" + "1,2,3\n" * 6 + f"{row}\n", rate=1.0))
     for row in ('1,0."5,3', "1,2,3#6", "1,2,3.0//4", "1,2,3%5")],
    ("…line 2: wz [rad/s] is ''", text(f"t [s],{RAD}\n0.0,1,2,\n0.1,1,2\n0.2,1,2,3\n0.3,1,2,3\n")),
    *[(message, text(WITH_TICKS.format(row))) for message, row in BAD_ROWS],
    *[("…no time column and no sample rate", text(f"# Sample rate: {said}\n{RAD}\n1,2,3\n4,5,6\n"))
     for said in ("1,000 Hz", "0.1 kHz", "1..5", ".", "-50 Hz", "50 per min")],
    ("…no time column and no sample rate",
     text(f"# cutoff frequency: 20 Hz\n{GYRO}\n1,2,3\n4,5,6\n")),
    ("…found the sample rates 100 and 20 Hz; accepted: one",
     text(f"# gyro sample rate: 100 Hz\n# sample rate: 20 Hz\n{GYRO}\n1,2,3\n4,5,6\n")),
    ("…t [s] gives 0.0005 Hz; …0.5 Hz in ms", text(f"t [s],{RAD}\n0,1,2,3\n2000,1,2,3\n")),
    *[("…found UTF-16 text; accepted: text in UTF-8", of_bytes(GOOD.encode(encoding)))
     for encoding in ("utf-16", "utf-16-le", "utf-16-be")],
    *[(f"…{what}", source) for begin, what in OTHER_FILES.items()
      for source in (of_bytes(begin), of_bytes(gzip.compress(begin)))],
    ("source: found the directory …; accepted: a file",
     partial(fa.read_gyro_log, Path(__file__).parent)),
    # names and units
    *[(f"…found the unit {unit} in the names of", named(names))
      for names, unit in NO_RATES.items()],
    *[("…found the unit", named(names, unit="rad/s")) for names in NO_RATES],
    *[("…found the unit", named(names)) for names in ("gyro_{} (rps)", "gyro_{} (filtered)")],
    *[(NO_GYRO, named(names + " (rad/s)")) for names in NOT_BODY_RATES],
    *[("…has no unit; accepted: unit", named(x)) for x in ("Gyr_{}", "angular_velocity_{}")],
    ("…found the unit rad", named("gyro_rad_{}")),
    ("…has no unit; accepted: unit", text(SAID.format(*(f"gyroADC[{k}]" for k in range(3))))),
    *[(message, text(SAID.format(*GYRO.split(",")), **options))
      for message, options in AGAINST_NAMES],
    *[("…found no time column and no sample rate", text(f"{name},{GYRO}\n20,1,2,3\n21,1,2,3\n"))
     for name in ("T", "T (degC)", "T [°C]", "t [C]")],
    *[(f"…time stamps: found '{stamp}', a date …{what}; accepted: dates of ISO 8601", dated(stamp))
      for stamp, what in DATES],
    ("…accel_unit: found None for gx (rad/s); accepted: m/s², cm/s², mm/s², g, mg, -g",
     text(SAID.format(*GYRO.split(",")), accel_columns=[2, 3, 4])),
    ("…accel_unit: found 'mg' for a (g); accepted: g, or none",
     text(f"t (s),a (g),{GYRO}\n0,1,2,3,4\n1,1,2,3,4\n", accel_columns=[2, 3, 4], accel_unit="mg")),
    ("accel_unit: found 'G'; accepted: m/s²", text(GOOD, accel_unit="G")),
    ("…accel_unit: found 'g'; accepted: with accel_columns alone",
     text(SAID.format(*GYRO.split(",")), accel_unit="g")),
    # tables
    ("…columns of lengths [2, 3]", lambda: fa.read_gyro_log({"t": [1, 2], "gx": [1, 2, 3]})),
    ("…row 0: gyro_x (rad/s) is …; accepted: a fin", table(T[:5], np.ones(5) * 1j)),
    ("…row 0: gyro_x (rad/s) is …; accepted: a fin", table(T[:5], np.ones(5) > 0.0)),
    ("…row 2: t (s) is 'None'; accepted: a finite number",
     table(np.array([0.0, 0.01, None, 0.03, 0.04]))),
    ("…a gap of 0.10000000… s; accepted: at most 0.1",
     table(late(500, 9.000000001 * H), max_gap=0.1)),
    ("…rate: found 200 Hz, but the stamps", table(0.005 * np.r_[0:800, 1400:20000], rate=200.0)),
    *[(f"…t (s) in row {k} is decreasing, and the clock goes on from there; accepted: a",
       table(late(k, to - T[k]), on_bad_rows=how)) for how in KINDS for k, to in RESETS],
    *[("…rows share the stamp of the row before…or rate=",
     table(np.floor(COUNT / share) * H, on_bad_rows=how)) for how in KINDS for share in (3, 1.6)],
    *[("…stamps of arrival, … rate= in their place (…100",
       table(np.floor(COUNT / k) * k * H + (COUNT % k) * apart, on_bad_rows=how))
      for how in KINDS for k, apart in ((4, 1e-5), (10, 1e-4), (3, 1e-3), (2, 1e-3))],
    ("…PacketCounter in line 5: a gap of 0.03 s; ", text(PACKETS.format(RAD), rate=100.0)),
]  # fmt: skip
