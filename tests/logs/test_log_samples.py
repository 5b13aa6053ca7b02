"""Rows that are no samples, biases, references, tables in memory, and logs in chunks."""

from __future__ import annotations

import gzip
import io
import sys
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal

import numpy as np
import pytest

import fastatt as fa
from fastatt.cli import main
from fastatt.logs import GyroLogError
from fastatt.logs import text as texts
from fastatt.logs.reference import RecordedAttitudes, against_reference, read_attitudes

# bad rows are more than a hundredth of what is written here
pytestmark = pytest.mark.filterwarnings("ignore:.* rows are left out:fastatt.GyroLogWarning")

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


@pytest.fixture(params=[1, 25, 1000])
def size(request, monkeypatch):
    """Blocks that end anywhere."""
    monkeypatch.setattr(texts, "BYTES", request.param)
    monkeypatch.setattr(texts, "_HEAD", 3)


def text(content, name="log.csv"):
    file = io.BytesIO((HEAD + content).encode())
    file.name = name
    return file


def test_bad_rows_dropped(size):
    log = fa.read_gyro_log(text(BAD), on_bad_rows="drop")
    assert log.t.tolist() == DROPPED
    assert log.rates[:, 0].tolist() == [1.0, 1.1, 1.3, 1.4, 1.5, 1.7, 1.8]
    assert log.dt.tolist() == np.diff(DROPPED).tolist()
    assert log.summary.endswith(
        "; 5 rows dropped: line 4 at 0.1 s, line 6 at 0.3 s, line 7 at 0.3 s, ...; 1 gap: "
        "line 9 at 0.4 s"
    )
    assert log.pieces == (slice(0, 7),)


def test_bad_rows_cut_a_log(size):
    log = fa.read_gyro_log(text(BAD), on_bad_rows="split")
    assert log.t.tolist() == DROPPED
    assert [log.t[p].tolist() for p in log.pieces] == [
        [0.0, 0.1], [0.3, 0.4], [5.0], [5.2, 5.3],
    ]  # fmt: skip


def test_bad_rows_held(size):
    log = fa.read_gyro_log(text(BAD), on_bad_rows="hold")
    # the row without a number keeps its time; before the gap's end, and a usual interval, one more
    assert log.t.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, pytest.approx(4.9), 5.0, 5.2, 5.3]
    assert log.rates[:, 0].tolist() == [1.0, 1.1, 1.1, 1.3, 1.4, 1.4, 1.5, 1.7, 1.8]
    assert log.summary.endswith(
        "; 4 rows dropped: line 6 at 0.3 s, line 7 at 0.3 s, line 10 at 5 s, ...; 1 row held: "
        "line 4 at 0.1 s; 1 gap: line 9 at 0.4 s"
    )


def test_held_rates_have_their_bias_taken_off_once(size):
    rest = "".join(f"{k},0.01,0,0\n" for k in range(8))
    log = fa.read_gyro_log(
        text(rest + "8,nan,0,0\n9,0.11,0,0\n50,0.01,0,0\n"), on_bad_rows="hold", bias_seconds=5
    )
    assert np.abs(log.rates[:, 0] - [*[0.0] * 9, 0.1, 0.1, 0.0]).max() < 1e-17
    assert "bias 0.01, 0, 0 rad/s taken off" in log.summary


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0.2,nan,2,3", "line 4: wx .rad/s. is 'nan'; accepted: a finite number, or on_bad_rows"),
        ("0.1,1,2,3", r"t \[s\] in line 4 is repeated \(0.1 s after the first\)"),
        ("0.05,1,2,3", "line 4 is decreasing"),
        ("9.0,1,2,3", "line 4: a gap of 8.9 s; accepted: at most 1 s"),
    ],
)
def test_bad_rows_are_refused(size, row, message):
    with pytest.raises(GyroLogError, match=message):
        fa.read_gyro_log(text(f"0,1,2,3\n0.1,1,2,3\n{row}\n9.1,1,2,3\n9.2,1,2,3\n"))


def test_at_a_rate_a_row_left_out_leaves_a_hole():
    content = "0,1,2,3\n0,nan,2,3\n0,1,2,3\n"
    dropped = fa.read_gyro_log(text(content), rate=4.0, on_bad_rows="drop")
    assert (dropped.t.tolist(), dropped.dt.tolist()) == ([0.0, 0.5], [0.5])
    assert fa.read_gyro_log(text(content[:20]), rate=4.0, on_bad_rows="drop").rate == 4.0
    held = fa.read_gyro_log(text(content), rate=4.0, on_bad_rows="hold", max_gap=Decimal(1))
    assert (held.t.tolist(), held.dt.tolist()) == ([0.0, 0.25, 0.5], [0.25, 0.25])


def test_a_bias_is_that_of_a_start_at_rest(size):
    rates = np.array([[0.02, -0.01, 0.0], [0.02, -0.03, 0.0], [0.02, -0.02, 0.0], [1.0, 1.0, 1.0]])
    rows = "".join(f"{k},{','.join(map(repr, w))}\n" for k, w in enumerate(rates.tolist()))
    log = fa.read_gyro_log(text(rows), bias_seconds=2.5)
    assert np.allclose(log.rates, rates - [0.02, -0.02, 0.0], rtol=0, atol=3e-17)
    with pytest.raises(GyroLogError, match=r"not at rest in the first 3\.5 s"):
        fa.read_gyro_log(text(rows + "4,0,0,0\n"), bias_seconds=3.5)


@pytest.mark.parametrize(
    ("hertz", "wave", "is_at_rest"),
    [
        # rad/s, and s of half a period: 0.1 rad there and back, 0.01 rad, and noise of samples
        (100.0, (0.1, 1.0), False),
        (100.0, (0.1, 0.1), True),
        (100.0, (0.19, 0.01), True),
        (10.0, (0.19, 0.1), True),
    ],
)
def test_a_start_that_turns_about_its_mean_is_not_at_rest(size, hertz, wave, is_at_rest):
    """By the angle from the start, however small the mean rate is."""
    speed, half = wave
    t = np.arange(round(4.0 * hertz) + 2) / hertz
    w = 0.02 + speed * np.where((t / half + 0.01) % 2.0 < 1.0, 1.0, -1.0)
    rows = "".join(f"{a!r},{b!r},0.0,0.0\n" for a, b in zip(t.tolist(), w.tolist(), strict=True))
    if is_at_rest:
        log = fa.read_gyro_log(text(rows), bias_seconds=4.0)
        assert np.abs(log.rates[:, 0]).max() < 1.1 * speed
    else:
        with pytest.raises(GyroLogError, match=r"rotation about it 0\.\d+ rad"):
            fa.read_gyro_log(text(rows), bias_seconds=4.0)


@pytest.mark.parametrize(
    ("unit", "scale"), [("m/s^2", 1.0), ("g", 9.80665), ("mg", 9.80665e-3), ("mG", 9.80665e-3)]
)
def test_an_accelerometer_is_in_si(unit, scale):
    """By the unit that its columns are named with, whatever their size."""
    names = [f"gyro_{a} (rad/s)" for a in "xyz"], [f"acc_{a} ({unit})" for a in "xyz"]
    table = {"t": [0.0, 0.01, 0.02], **dict.fromkeys(names[0], [0.1] * 3)}
    table |= dict(zip(names[1], ([1.0, 2.0, 3.0], [0.0] * 3, [4.0] * 3), strict=True))
    log = fa.read_gyro_log(table)
    wanted = np.array([[1.0, 0.0, 4.0], [2.0, 0.0, 4.0], [3.0, 0.0, 4.0]])
    assert np.allclose(log.accel, scale * wanted, rtol=4e-16, atol=0)


CONTENT = "".join(f"{0.01 * k!r},{0.1 * k!r},{-0.2 * k!r},0.5\n" for k in range(40))
PLAIN = fa.read_gyro_log(text(CONTENT))


def same(log):
    return np.array_equal(log.rates, PLAIN.rates) and np.array_equal(log.t, PLAIN.t)


def test_gzip_and_open_files(tmp_path, monkeypatch, size):
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
    pandas = pytest.importorskip("pandas")
    data = np.column_stack([PLAIN.t, PLAIN.rates])
    frame = pandas.DataFrame(data, columns=HEAD.strip().split(","))
    assert same(fa.read_gyro_log(frame))
    when = pandas.to_datetime((frame.pop("t [s]") * 1e9).round().astype("int64"))
    log = fa.read_gyro_log(
        frame.set_index(pandas.DatetimeIndex(when, name="when")), time_column="when"
    )
    # whole ns
    assert np.abs(log.t - PLAIN.t).max() <= 0.5e-9
    spans = fa.read_gyro_log(frame.set_index(pandas.TimedeltaIndex(when - when[0])))
    assert np.array_equal(spans.t, log.t)
    for name in ("time_s", "t [ms]"):
        index = pandas.TimedeltaIndex(when - when[0], name=name)
        assert np.array_equal(fa.read_gyro_log(frame.set_index(index)).t, log.t)
    frame.iloc[2, 1] = np.nan
    with pytest.raises(GyroLogError, match=r"row 2: wy \[rad/s\] is no finite number"):
        fa.read_gyro_log(frame, rate=1.0)
    assert len(fa.read_gyro_log(frame, rate=1.0, on_bad_rows="drop").t) == 39


def test_data_sets():
    xarray = pytest.importorskip("xarray")
    data = xarray.Dataset(
        {
            "angular_velocity": (("time", "axis"), PLAIN.rates),
            "orientation": (("time", "part"), np.tile([1.0, 0.0, 0.0, 0.0], (40, 1))),
        },
        coords={"time": PLAIN.t},
    )
    log = fa.read_gyro_log(data)
    assert same(log)
    assert np.array_equal(log.attitudes, np.tile([1.0, 0.0, 0.0, 0.0], (40, 1)))
    assert same(fa.read_gyro_log({"t": PLAIN.t, "gyro": PLAIN.rates}, unit="rad/s"))
    with pytest.raises(GyroLogError, match=r"columns of lengths \[2, 3\]"):
        fa.read_gyro_log({"t": [1, 2], "gx": [1, 2, 3]})


@pytest.mark.parametrize("method", ["hold", "previous", "coning3", "picard"])
@pytest.mark.parametrize("rate", [None, "100"])
def test_chunks_are_the_whole_bit_for_bit(tmp_path, size, method, rate, capsys):
    path, out = tmp_path / "log.csv", tmp_path / "q.npy"
    path.write_text(HEAD + CONTENT, encoding="utf-8")
    given = [] if rate is None else ["-r", rate]
    assert main(["integrate", str(path), "-q", "-m", method, "-o", str(out), *given]) == 0
    log = fa.read_gyro_log(path, rate=rate and float(rate))
    q = fa.integrate_rates(log.rates, log.dt, method=method)
    assert np.array_equal(np.load(out), np.column_stack([log.t, q]))
    assert "40 samples at 100 Hz" in capsys.readouterr().out


def test_pieces_begin_anew(tmp_path, size):
    path, out = tmp_path / "log.csv", tmp_path / "q.npy"
    path.write_text(HEAD + BAD, encoding="utf-8")
    assert main(["integrate", str(path), "-q", "-o", str(out), "--on-bad-rows", "split"]) == 0
    log = fa.read_gyro_log(path, on_bad_rows="split")
    expected = [
        np.column_stack([log.t[p], q, np.full(len(q), k)])
        for k, p in enumerate(log.pieces)
        for q in [fa.integrate_rates(log.rates[p], np.diff(log.t[p]))]
    ]
    assert np.array_equal(np.load(out), np.concatenate(expected))


def test_what_fails_leaves_no_file(tmp_path, capsys):
    path, out = tmp_path / "log.csv", tmp_path / "q.csv"
    path.write_text(HEAD + CONTENT + "9,1,2\n", encoding="utf-8")
    assert main(["integrate", str(path), "-q", "-o", str(out)]) == 2
    assert "line 42: found 3 columns" in capsys.readouterr().err
    assert [x.name for x in tmp_path.iterdir()] == ["log.csv"]


WORLD = np.array([0.5, 0.5, -0.5, 0.5])
BODY = np.array([0.9, 0.1, -0.3, 0.3])
SHIFT = 0.0437


def conjugate(q):
    return q * [1.0, -1.0, -1.0, -1.0]


def motion(t):
    """Attitudes whose turning changes its axis and speed."""
    first = fa.rotation_vector_to_quat(np.outer(np.sin(1.3 * t), [0.4, 0.9, 0.2]))
    return fa.quat_multiply(
        first, fa.rotation_vector_to_quat(np.outer(t * t / 20, [0.0, 0.6, 0.8]))
    )


def test_a_reference_is_aligned_in_time_and_frames():
    t, when = np.arange(0.0, 10.0, 0.005), np.arange(-1.0, 9.0, 0.02)
    q = fa.quat_multiply(WORLD, fa.quat_multiply(motion(when), BODY))
    for start, ahead in ((0.0, SHIFT), (1000.0, SHIFT), (0.0, 500.0 + SHIFT)):
        reference = RecordedAttitudes(when - when[0], q, start + when[0] + ahead)
        found = against_reference(t, motion(t), reference, start)
        assert found.aligned == (True, True)
        assert found.shift == pytest.approx(ahead, abs=1e-5)
        # attitudes between two samples 5 ms apart: the angle of w' h²/8, w' below 2 rad/s²
        assert found.angle.max() < 2.0 * 0.005**2 / 8 + 1e-5 * 3.0
        assert len(found.t) == np.count_nonzero((when >= 0.0) & (when <= t[-1]))


def test_clocks_that_say_the_same_time_are_not_shifted_by_a_period():
    """Of a motion that repeats itself all shifts by periods fit: the least of them is meant."""
    t, when = np.arange(0.0, 30.0, 0.01), np.arange(8.0, 20.0, 0.02)

    def swings(t):
        angle = 0.5 * np.sin(2.0 * np.pi * t / 3.0) + 0.2 * np.sin(4.0 * np.pi * t / 3.0)
        return fa.rotation_vector_to_quat(np.outer(angle, [0.0, 0.6, 0.8]))

    noise = np.random.default_rng(3).normal(scale=1e-3, size=(len(when), 3))
    q = fa.quat_multiply(swings(when), fa.rotation_vector_to_quat(noise))
    for ahead in (-0.6, 0.0, 0.4):
        recorded = RecordedAttitudes(when - when[0], q, when[0] + ahead)
        found = against_reference(t, swings(t), recorded)
        assert found.aligned[0]
        assert found.shift == pytest.approx(ahead, abs=0.01)


def test_clocks_with_one_time_in_common_are_aligned_by_the_motion():
    """As those without any: a shift of at most 1 s would leave one attitude to compare."""
    t, when = np.arange(0.0, 30.0, 0.01), np.arange(8.0, 20.0, 0.02)
    since = when - when[0]
    for start in (t[-1], -since[-1]):
        found = against_reference(t, motion(t), RecordedAttitudes(since, motion(when), start))
        assert found.aligned[0]
        assert found.shift == pytest.approx(start - when[0], abs=0.01)
        assert found.angle.max() < 1e-3


def test_what_the_motion_does_not_align_stays():
    """A constant rotation aligns neither the clocks nor the axes across it."""
    t = np.arange(0.0, 5.0, 0.01)
    q = fa.rotation_vector_to_quat(np.outer(t, [0.0, 0.0, 1.0]))
    found = against_reference(t, q, RecordedAttitudes(t, q), 0.0)
    assert (found.aligned, found.shift) == ((False, False), 0.0)
    assert found.angle.max() < 1e-7
    with pytest.raises(GyroLogError, match="no time in common"):
        against_reference(t, q, RecordedAttitudes(t, q, 100.0))
    with pytest.raises(GyroLogError, match="reference: 1 attitudes within the log's time"):
        against_reference(t, q, RecordedAttitudes(t, q, t[-1] - 0.005))


@pytest.mark.parametrize(
    "head",
    [
        "# timestamp tx ty tz qx qy qz qw",
        "#timestamp, p_R_x [m], p_R_y [m], p_R_z [m], q_RS_x [], q_RS_y [], q_RS_z [], q_RS_w []",
    ],
)
def test_references_are_read(tmp_path, head, capsys):
    t = np.arange(0.0, 4.0, 0.02)
    q = motion(t)
    separator = "," if "," in head else " "
    rows = np.column_stack([1.4e9 + t, np.zeros((len(t), 3)), q[:, [1, 2, 3, 0]]])
    path, log, out = (tmp_path / n for n in ("truth.csv", "log.csv", "q.csv"))
    lines = [separator.join(map(repr, r)) for r in rows.tolist()]
    path.write_text("\n".join([head, *lines]), encoding="utf-8")
    found = read_attitudes(path)
    assert np.abs(found.q - q).max() < 1e-15
    assert found.start == 1.4e9
    w = fa.angular_velocity(q, 0.02)
    np.savetxt(
        log, np.column_stack([1.4e9 + t, w]), delimiter=",", header=HEAD.strip(), comments=""
    )
    arguments = ["integrate", str(log), "-q", "-o", str(out), "-m", "coning3"]
    assert main([*arguments, "--reference", str(path)]) == 0
    said = capsys.readouterr().out
    assert "reference attitudes (clocks " in said
    # attitudes written here are a reference too
    written = np.loadtxt(out, delimiter=",", skiprows=1)
    assert np.abs(read_attitudes(out).q - written[:, 1:]).max() < 1e-15
    again = [*arguments, "-r", "50", "--reference", str(out)]
    assert main([*again, "-o", str(tmp_path / "again.csv")]) == 0
    assert "at the end" in capsys.readouterr().out
    assert main(again) == 2
    assert "q.csv, which is --reference; accepted: another file" in capsys.readouterr().err


def test_masks_and_what_is_no_real_number_in_tables():
    """Of masked numbers those beneath the mask were read; truths and complex numbers as floats."""
    hidden = np.arange(5) == 2
    names = [f"gyro_{a} (rad/s)" for a in "xyz"]
    for t in (
        0.01 * np.arange(5),
        10_000_000 * np.arange(5),
        np.arange(5) * np.timedelta64(1, "s"),
    ):
        masked = {"t": np.ma.masked_array(t, hidden), **dict.fromkeys(names, np.ones(5))}
        options = {"time_unit": "ns" if t.dtype.kind == "i" else None, "on_bad_rows": "drop"}
        found = fa.read_gyro_log(masked, **options).t
        assert np.array_equal(found, fa.read_gyro_log({**masked, "t": t}, **options).t[~hidden])
    time = {"t": 0.01 * np.arange(5)}
    for bad in (np.ma.masked_array(np.ones(5), hidden), np.ones(5) > 0.0, np.ones(5) * 1j):
        with pytest.raises(GyroLogError, match=r"row [02]: gyro_x \(rad/s\) is no finite number"):
            fa.read_gyro_log({**time, **dict.fromkeys(names, bad)})


def test_columns_of_objects_are_read_cell_by_cell():
    """One cell without a number made all of a column NaN, a magnetometer's in silence."""
    count = np.arange(5.0).tolist()
    gyro = {f"gyro_{a} (rad/s)": count for a in "xyz"}
    mag = {f"mag_{a}": np.array([1.0, None, "x", 2.5, "3"], dtype=object) for a in "xyz"}
    moments = [datetime(2024, 1, 1, 0, 0, 0, 10_000 * k) for k in range(5)]  # noqa: DTZ001
    for stamps in (
        [f"{0.01 * k:g}" for k in range(5)],
        [str(m) + (".000000" if not m.microsecond else "") for m in moments],
        [f"{m:%H:%M:%S.%f}" for m in moments],
        [m - moments[0] for m in moments],
    ):
        log = fa.read_gyro_log({"t": np.array(stamps, dtype=object), **gyro, **mag})
        assert np.allclose(log.t, 0.01 * np.arange(5), rtol=0.0, atol=1e-15)
        assert np.array_equal(log.mag[:, 0], [1.0, np.nan, np.nan, 2.5, 3.0], equal_nan=True)
    with pytest.raises(GyroLogError, match="row 2: t is no finite number"):
        fa.read_gyro_log({"t": np.array([0.0, 0.01, None, 0.03, 0.04]), **gyro})


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


def test_rows_before_the_first_that_can_be_held(size):
    """Their stamps are none of samples: a row of the same time, or an earlier one, is the first."""
    rows = "0.1,nan,2,3\n0.2,nan,2,3\n0.1,1,2,3\n0.2,nan,2,3\n0.3,4,5,6\n"
    log = fa.read_gyro_log(io.StringIO(HEAD + rows), on_bad_rows="hold")
    assert np.allclose(log.t, [0.0, 0.1, 0.2], rtol=0.0, atol=1e-15)
    assert np.array_equal(log.rates, [[1, 2, 3], [1, 2, 3], [4, 5, 6]])


def test_a_row_without_the_empty_cell_at_its_end():
    text = HEAD + "0.0,1,2,\n0.1,1,2\n0.2,1,2,3\n0.3,1,2,3\n"
    with pytest.raises(GyroLogError, match=r"line 2: wz \[rad/s\] is ''"):
        fa.read_gyro_log(io.StringIO(text))
    assert len(fa.read_gyro_log(io.StringIO(text), on_bad_rows="drop").t) == 2


@pytest.mark.parametrize("unit", ["uT", "nT", "T", "gauss", "mG"])
def test_units_at_the_end_of_a_magnetometers_names(unit):
    head = f"t_s,gx_dps,gy_dps,gz_dps,mag_x_{unit},mag_y_{unit},mag_z_{unit}\n"
    rows = "\n".join(f"{0.005 * k:.3f},.1,.2,.3,20,1,-43" for k in range(50))
    log = fa.read_gyro_log(io.StringIO(head + rows))
    np.testing.assert_array_equal(log.mag, [[20.0, 1.0, -43.0]] * 50)
