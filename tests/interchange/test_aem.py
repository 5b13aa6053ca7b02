"""Attitude ephemeris messages, beside the standard's examples and definitions."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from each import each
from exact import EPS, angle, conj, precession, rotate

import fastatt as fa
from fastatt import interchange as ic
from fastatt.interchange import epochs
from fastatt.interchange.aem import to_aem

EPOCH = "2016-12-31T23:59:58.25"
T = np.array([0.0, 0.1, 0.30000000000000004, 1.0 / 3.0, 2.5, 1e5 + 0.7])
Q = precession(T, 0.3, 0.2, 0.5, 0.1)
W = np.stack([0.3 * np.cos(0.5 * T + 0.1), 0.3 * np.sin(0.5 * T + 0.1), 0.2 + 0 * T], axis=1)
NEW = {
    "OBJECT_NAME": "SAT",
    "OBJECT_ID": "2026-001A",
    "REF_FRAME_A": "EME2000",
    "REF_FRAME_B": "SC_BODY_1",
    "TIME_SYSTEM": "UTC",
}
OLD = {**NEW, "ATTITUDE_DIR": "A2B", "QUATERNION_TYPE": "LAST"}
SWAPPED = {"REF_FRAME_A": "SC_BODY_1", "REF_FRAME_B": "EME2000"}
RATE = {"ATTITUDE_TYPE": "QUATERNION/RATE", "RATE_FRAME": "REF_FRAME_B"}
ANGVEL = {"ATTITUDE_TYPE": "QUATERNION/ANGVEL", "ANGVEL_FRAME": "SC_BODY_1"}
PLAIN = {"ATTITUDE_TYPE": "QUATERNION"}


def message(version, metadata, q=Q, w=W):
    segment = ic.AemSegment(EPOCH, T, q, w, metadata)
    header = {"CREATION_DATE": "2026-01-01T00:00:00", "ORIGINATOR": "TEST"}
    return ic.Aem(version, header, (segment, segment))


def read(text, tmp_path):
    path = tmp_path / "message.aem"
    path.write_text(text, encoding="ascii")
    return ic.read_aem(path)


KINDS = [
    ("2.0", NEW | PLAIN), ("2.0", NEW | ANGVEL), ("2.0", NEW | SWAPPED | ANGVEL),
    ("2.0", NEW | ANGVEL | {"ANGVEL_FRAME": "EME2000"}),
    ("1.0", OLD | PLAIN), ("1.0", OLD | PLAIN | {"QUATERNION_TYPE": "FIRST"}),
    ("1.0", OLD | PLAIN | {"ATTITUDE_DIR": "B2A", "QUATERNION_TYPE": "FIRST"}),
    ("1.0", OLD | SWAPPED | PLAIN | {"ATTITUDE_DIR": "B2A"}),
    ("1.0", OLD | RATE), ("1.0", OLD | RATE | {"RATE_FRAME": "REF_FRAME_A"}),
]  # fmt: skip


@each(("version", "metadata"), KINDS)
def test_there_and_back(version, metadata, tmp_path):
    """Times and attitudes to the bit; rates to the rounding of deg/s.

    The length of quaternions of a few digits, 1 to those digits, turns no rate.
    """
    sent = message(version, metadata)
    got = read(sent.text(), tmp_path)
    assert (got.version, got.header, len(got.segments)) == (version, sent.header, 2)
    for segment in got.segments:
        tags = epochs.tags(segment.epoch, segment.t, leaps=True)
        assert np.array_equal(epochs.seconds_since(EPOCH, tags, leaps=True), T)
        assert np.array_equal(segment.q, Q)
        assert segment.metadata.items() >= metadata.items()
        assert (segment.w is None) == (metadata["ATTITUDE_TYPE"] == "QUATERNION")
        assert segment.w is None or np.abs(segment.w - W).max() <= 4 * EPS
    short = message(version, metadata, q=1.004 * Q)
    segment = read(short.text(), tmp_path).segments[0]
    assert np.array_equal(segment.q, 1.004 * Q)
    assert segment.w is None or np.abs(segment.w - W).max() <= 8 * EPS
    if metadata["ATTITUDE_TYPE"] in ("QUATERNION/ANGVEL", "QUATERNION/RATE"):
        unit, same = (
            np.array(x.text().split("DATA_START\n")[1].split()[5:8], float) for x in (sent, short)
        )
        assert np.abs(unit - same).max() <= 1e-12


# what the numbers mean, from the standards' words


def lines(version, metadata, w=W):
    """The numbers of the first data line but one."""
    text = message(version, metadata, w=w).text()
    return np.array([float(x) for x in text.split("DATA_START\n")[1].splitlines()[1].split()[1:]])


def test_b2_says_the_rotation_from_a_to_b():
    """Annex F2.2: +90° about Z takes A's axes to B's; X of B is (0, 1, 0) along A."""
    quarter = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    text = message("2.0", NEW | PLAIN, q=np.tile(ic.from_scalar_last(quarter), (T.size, 1))).text()
    assert f"{EPOCH} 0.0 0.0 {float(quarter[2])} {float(quarter[3])}" in text
    assert np.abs(rotate(ic.from_scalar_last(quarter), [1.0, 0.0, 0.0]) - [0, 1, 0]).max() <= EPS


def test_orders_and_directions():
    q = Q[1]
    last, back = np.roll(q, -1), np.roll(conj(q), -1)
    assert np.array_equal(lines("2.0", NEW | PLAIN), last)
    assert np.array_equal(lines("1.0", OLD | PLAIN), last)
    assert np.array_equal(lines("1.0", OLD | PLAIN | {"QUATERNION_TYPE": "FIRST"}), q)
    assert np.array_equal(lines("1.0", OLD | PLAIN | {"ATTITUDE_DIR": "B2A"}), back)
    assert np.array_equal(lines("2.0", NEW | SWAPPED | PLAIN), back)
    # B relative to A in deg/s, along either
    inertial = rotate(q, W[1])
    for metadata, wanted in (
        (ANGVEL, W[1]),
        (ANGVEL | {"ANGVEL_FRAME": "REF_FRAME_A"}, inertial),
        (SWAPPED | ANGVEL, -W[1]),
        (SWAPPED | ANGVEL | {"ANGVEL_FRAME": "EME2000"}, -inertial),
    ):
        assert np.abs(np.radians(lines("2.0", NEW | metadata)[4:]) - wanted).max() <= 4 * EPS
    assert np.abs(np.radians(lines("1.0", OLD | RATE)[4:]) - W[1]).max() <= EPS


EXAMPLE = """\
CCSDS_AEM_VERS = 2.0
CREATION_DATE = 2002-11-04T17:22:31
ORIGINATOR    = NASA/JPL
MESSAGE_ID    = A701523

META_START
COMMENT This file was produced by M.R. Somebody, MSOO NAV/JPL.
OBJECT_NAME       = MARS_GLOBAL_SURVEYOR
OBJECT_ID         = 1996-062A
CENTER_NAME       = MARS BARYCENTER
REF_FRAME_A         = EME2000
REF_FRAME_B         = SC_BODY_1
TIME_SYSTEM       = UTC
START_TIME        = 1996-11-28T21:29:07.2555
USEABLE_START_TIME = 1996-11-28T22:08:02.5555
USEABLE_STOP_TIME  = 1996-11-30T01:18:02.5555
STOP_TIME         = 1996-11-30T01:28:02.5555
ATTITUDE_TYPE     = QUATERNION
INTERPOLATION_METHOD = HERMITE
INTERPOLATION_DEGREE = 7
META_STOP

DATA_START
1996-11-28T21:29:07.2555 0.56748 0.03146 0.45689 0.68427
1996-11-28T22:08:03.5555 0.42319 -0.45697 0.23784 0.74533
COMMENT between
1996-333T22:08:04.5555Z -0.84532 0.26974 -0.06532 0.45652
DATA_STOP
"""


def test_the_standards_example(tmp_path):
    """Figure G-4 of 504.0-B-2, with a comment and a day of the year among its lines."""
    aem = read(EXAMPLE, tmp_path)
    (segment,) = aem.segments
    assert aem.header["MESSAGE_ID"] == "A701523"
    assert segment.metadata["CENTER_NAME"] == "MARS BARYCENTER"
    assert np.array_equal(segment.t, [0.0, 2336.3, 2337.3])
    assert np.array_equal(segment.q[1], [0.74533, 0.42319, -0.45697, 0.23784])
    assert "USEABLE_STOP_TIME = 1996-11-30T01:18:02.5555" in aem.text()


def test_a_start_and_a_stop_rounded_to_ms_are_the_first_and_the_last_time(tmp_path):
    """Half a millisecond beside them, and no more, as the next test has."""
    text = EXAMPLE.replace("T21:29:07.2555\nUSE", "T21:29:07.256\nUSE")
    text = text.replace(
        "STOP_TIME         = 1996-11-30T01:28:02.5555", "STOP_TIME = 1996-333T22:08:04.555"
    )
    assert np.array_equal(read(text, tmp_path).segments[0].t, [0.0, 2336.3, 2337.3])


@pytest.mark.parametrize("keyword", ["QUATERNION_TYPE = FIRST", "ATTITUDE_DIR = B2A"])
def test_the_order_and_the_direction_that_a_message_says_count(keyword, tmp_path):
    """In version 2.0 too, which has fixed them."""
    (plain,) = read(EXAMPLE, tmp_path).segments
    aem = read(EXAMPLE.replace("META_STOP", f"{keyword}\nMETA_STOP"), tmp_path)
    (said,) = aem.segments
    first = np.roll(plain.q, -1, axis=1)
    assert np.array_equal(said.q, first if "FIRST" in keyword else [conj(q) for q in plain.q])
    assert keyword in aem.text()
    assert np.array_equal(read(aem.text(), tmp_path).segments[0].q, said.q)


def test_files_that_are_no_message(tmp_path):
    path = tmp_path / "message.aem"
    path.write_text(EXAMPLE, encoding="utf-8-sig")
    assert len(ic.read_aem(path).segments[0].t) == 3
    for content, message in (
        (EXAMPLE.encode("utf-16"), "message.aem: found no text in ASCII or UTF-8; accepted: a mes"),
        (b"", "message.aem: found no text in ASCII or UTF-8"),
        (b"\n \n", "message.aem: found no text in ASCII or UTF-8"),
        (b"CCSDS_AEM_VERS = 2.0\n", "line 1: the message ends before a block does"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            ic.read_aem(path)


FOUR = "a time and 4 numbers"
WRONG = [
    ("= 2.0", "= 3.0", "line 1: found CCSDS_AEM_VERS = 3.0; accepted"),
    ("= 2.0", "= 1.0", "QUATERNION_TYPE: found None; accepted: FIRST, LAST"),
    ("OBJECT_ID         = 1996-062A\n", "", "metadata without OBJECT_ID"),
    ("= QUATERNION\n", "= EULER_ANGLE\n", "ATTITUDE_TYPE: found .EULER_ANGLE.; accepted: QUATE"),
    ("= QUATERNION\n", "= QUATERNION/ANGVEL\n", "ANGVEL_FRAME: found None; accepted: REF_FRAME"),
    (" 0.74533\n", "\n", f"line 25: found .* {FOUR}, QUATERNION"),
    ("0.74533", "nan", f"line 25: .* {FOUR}"),
    ("0.74533", "0.84533", f"line 25: .* {FOUR}, QUATERNION, the quaternion of len"),
    ("T22:08:03", "T20:08:03", "time 1996-11-28T20:08:03.5555 does not rise"),
    ("T22:08:03", "T25:08:03", "line .*: time: found 1996-11-28T25:08:03.5555; accepted"),
    ("DATA_STOP\n", "", "line 27: the message ends before a block does"),
    ("STOP_TIME         = 1996-11-30", "STOP_TIME = 1996-11-28", "accepted: within START_TIME"),
    ("T21:29:07.2555\nUSE", "T21:29:07.2561\nUSE", "found times from 1996-11-28T21:29:07.2555 to"),
    ("META_STOP\n\nDATA_START", "META_STOP\n", "accepted: DATA_START"),
    ("CENTER_NAME  ", "OBJECT_ID", "line 10: OBJECT_ID is there twice"),
    ("ORIGINATOR    = NASA/JPL", "ORIGINATOR", "line 3: found ORIGINATOR; accepted: KEYWORD"),
]


@each(("old", "new", "message"), WRONG)
def test_what_is_not_right_is_refused_with_its_line(old, new, message, tmp_path):
    assert old in EXAMPLE
    with pytest.raises(ValueError, match=message):
        read(EXAMPLE.replace(old, new), tmp_path)


def test_rates_that_can_be_read_in_two_ways_are_refused(tmp_path):
    text = message("1.0", OLD | RATE).text()
    for change in ("ATTITUDE_DIR = B2A", "ATTITUDE_DIR = A2B\nEULER_ROT_SEQ = 312"):
        with pytest.raises(ValueError, match="can be read in two ways; accepted: A2B without it"):
            read(text.replace("ATTITUDE_DIR = A2B", change), tmp_path)


# time


def test_leap_seconds_of_utc_count():
    tags = ["2016-12-31T23:59:59", "2016-12-31T23:59:60.5", "2017-01-01T00:00:00.25"]
    utc, tai = (
        epochs.seconds_since(tags[0], tags[::k], leaps=leaps)
        for k, leaps in ((1, True), (2, False))
    )
    assert np.array_equal(utc, [0.0, 1.5, 2.25])
    assert np.array_equal(tai, [0.0, 1.25])
    assert epochs.tags(tags[0], utc, leaps=True) == tags
    for wrong in ("2016-12-30T23:59:60", "2015-13-01T00:00:00", "2015-366T00:00:00"):
        with pytest.raises(ValueError, match=f"time: found {wrong}"):
            epochs.seconds_since(tags[0], [wrong], leaps=True)
    # 37 − 10 s since 1972
    assert epochs.seconds_since("1972-01-01T00:00:00", ["2017-001T00:00:00"], leaps=True) == [
        16437 * 86400.0 + 27.0
    ]


# from which TAI - UTC is 11 s and one more each; IERS, Bulletin C
LEAPS = """1972-07 1973-01 1974-01 1975-01 1976-01 1977-01 1978-01 1979-01 1980-01 1981-07 1982-07
1983-07 1985-07 1988-01 1990-01 1991-01 1992-07 1993-07 1994-07 1996-01 1997-07 1999-01 2006-01
2009-01 2012-07 2015-07 2017-01"""


@each(("leaps", "month"), list(enumerate(LEAPS.split(), 1)))
def test_leap_seconds_are_those_published(leaps, month):
    """Since 1972, which began at TAI - UTC = 10 s."""
    day = np.datetime64(f"{month}-01")
    days = (day - np.datetime64("1972-01-01")).astype(int)
    tags = [f"{day - np.timedelta64(1, 'D')}T00:00:00", f"{day}T00:00:00"]
    found = epochs.seconds_since("1972-01-01T00:00:00", tags, leaps=True)
    assert list(found) == [(days - 1) * 86400 + leaps - 1, days * 86400 + leaps]


def test_times_come_back_to_the_bit():
    rng = np.random.default_rng(5)
    t = np.concatenate([rng.normal(0.0, 10.0 ** rng.uniform(-9, 9, 200)), [1e-20, -0.1, 5e9]])
    tags = epochs.tags("2020-02-29T12:00:00.1", t, leaps=True)
    assert np.array_equal(epochs.seconds_since("2020-02-29T12:00:00.1", tags, leaps=True), t)
    for far in (1e18, 1e200):
        with pytest.raises(ValueError, match="passes the years 1 to 9999"):
            epochs.tags("2020-02-29T12:00:00.1", np.array([far]), leaps=False)


# of a run


WHEN = {"epoch": "2026-01-01T00:00:00"}


def aem_from(t0=0.0, **options):
    return to_aem(run_from(t0), **{**WHEN, "frame": "ICRF", **options})


def test_a_run_as_a_message(tmp_path):
    body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    w0 = [[0.1, 0.3, -0.2], [0.0, 1e-9, 0.2]]
    steps = {"dt": 0.5, "n_steps": 4, "save_every": 1, "method": "exact"}
    run = fa.propagate(body, [[1.0, 0.0, 0.0, 0.0]] * 2, w0, **steps)
    path = tmp_path / "run.aem"
    run.to_aem(path, **WHEN, frame="ICRF", body=1, metadata={"TIME_SYSTEM": "TAI"})
    (segment,) = ic.read_aem(path).segments
    assert np.array_equal(segment.q, run.q[:, 1])
    assert np.array_equal(segment.t, run.t)
    assert np.abs(segment.w - run.w[:, 1]).max() <= EPS
    assert segment.metadata["ANGVEL_FRAME"] == segment.metadata["REF_FRAME_B"] == "SC_BODY_1"
    # numbers as the standard writes them: a point in every mantissa
    assert re.search(r"\d\.\d+e-\d+", path.read_text())
    assert not re.search(r" -?\d+(e| |$)", path.read_text().split("DATA_START")[1])
    old = to_aem(run, **WHEN, frame="ICRF", body=0, version="1.0")
    assert angle(read(old.text(), tmp_path).segments[0].q, run.q[:, 0]).max() == 0.0


def test_a_frame_of_an_orbit_that_does_not_rotate_is_written():
    (segment,) = aem_from(frame="LVLH_INERTIAL").segments
    assert segment.metadata["REF_FRAME_A"] == "LVLH_INERTIAL"


def run_from(t0):
    scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 0.1)))
    return fa.propagate(scene, [1.0, 0.0, 0.0, 0.0], dt=0.5, n_steps=2, save_every=1, t0=t0)


def test_unix_time_skips_leap_seconds():
    """1483228799 is the last second before 2017, which a leap second precedes."""
    start, unix = 1483228799.0, {"epoch": "unix"}
    text = aem_from(start, **unix).text()
    tags = [line.split()[0] for line in text.split("DATA_START\n")[1].splitlines()[:3]]
    assert tags == ["2016-12-31T23:59:59", "2016-12-31T23:59:59.5", "2017-01-01T00:00:00"]
    # a calendar's own count of the same times
    counted = [float(np.datetime64(x, "ms").astype(int)) / 1e3 for x in tags]
    assert counted == run_from(start).t.tolist()


@each(
    "epoch",
    [
        "2026-01-01T12:00:00", "2026-01-01 12:00", "2026-01-01T14:00:00+02:00",
        datetime.fromisoformat("2026-01-01T12:00"),
        datetime(2026, 1, 1, 14, tzinfo=timezone(timedelta(hours=2))),
    ],
)  # fmt: skip
def test_epochs_are_datetimes_and_iso_strings(epoch):
    assert aem_from(epoch=epoch).segments[0].epoch == "2026-01-01T12:00:00"


def test_a_run_of_1970_may_begin_then():
    assert aem_from(1e7, epoch="1970-01-01").segments[0].t[0] == 1e7


def test_order_and_direction_are_written_explicitly():
    """As a comment in version 2.0, which has no keywords for them."""
    new, old = (aem_from(version=v).text() for v in ("2.0", "1.0"))
    assert "COMMENT quaternions: scalar last, A2B of REF_FRAME_A and REF_FRAME_B\n" in new
    assert "QUATERNION_TYPE" not in new
    assert "ATTITUDE_DIR = A2B\n" in old
    assert "QUATERNION_TYPE = LAST\n" in old
