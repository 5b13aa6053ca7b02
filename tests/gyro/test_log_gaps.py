"""Rows that are no samples: told apart, and no more of a log lost than them."""

from __future__ import annotations

import io

import numpy as np
import pytest

import fastatt as fa
from fastatt.cli import main
from fastatt.gyro import GyroLogWarning

N, H = 1000, 0.01
T = H * np.arange(N)
RATES = np.stack([np.sin(T), np.cos(3 * T), 0.1 * T], axis=1)
NAMES = [f"gyro_{a} [rad/s]" for a in "xyz"]


def table(t, rates=RATES, **more):
    return {"t [s]": t, **dict(zip(NAMES, rates.T, strict=True)), **more}


def at_rows(*places):
    """T with other stamps at some rows."""
    t = T.copy()
    for row, stamp in places:
        t[row] = stamp
    return t


@pytest.mark.parametrize("how", ["refuse", "drop"])
@pytest.mark.parametrize(("sensor", "unit"), [("mag", "uT"), ("acc", "m/s^2")])
def test_cells_of_other_sensors_are_left_empty(how, sensor, unit):
    """A magnetometer at a twentieth of the gyro's rate: all gyro samples stay as they are."""
    head = ",".join(["t [s]", *NAMES, *(f"{sensor}_{a} ({unit})" for a in "xyz")])
    lines = [
        f"{t!r},{','.join(map(repr, w))},{'0.1,0.2,0.3' if k % 20 == 0 else ',,'}"
        for k, (t, w) in enumerate(zip(T.tolist(), RATES.tolist(), strict=True))
    ]
    log = fa.read_gyro_log(io.StringIO("\n".join([head, *lines])), on_bad_rows=how)
    assert np.array_equal(log.rates, RATES)
    found = log.mag if sensor == "mag" else log.accel
    assert np.array_equal(np.isfinite(found).all(axis=1), np.arange(N) % 20 == 0)
    assert np.isnan(found[1]).all()


@pytest.mark.parametrize(
    "places",
    [
        [(10, 1e9)], [(10, 0.0)], [(10, np.nan)], [(10, T[14] + 0.1 * H)],  # ahead of rows to come
        [(10, 1e9), (11, 1e9 + H), (12, 1e9 + 2 * H)], [(400, -5.0), (700, 5e5)],
        [(300, T[299])],  # a repeated stamp
        [(0, 1e9)], [(998, 1e9)], [(999, 0.0)],
    ],
)  # fmt: skip
def test_an_outlier_costs_its_own_row(places):
    log = fa.read_gyro_log(table(at_rows(*places)), on_bad_rows="drop")
    kept = np.delete(np.arange(N), [row for row, _ in places])
    assert np.array_equal(log.rates, RATES[kept])
    assert np.allclose(log.t, T[kept] - T[kept[0]], rtol=0.0, atol=1e-6)


def test_the_sample_rate_leaves_out_gaps():
    """Of a log with a tenth of its time missing, and of one whose stamps are whole milliseconds."""
    t = np.where(np.arange(N) < 500, T, T + 0.09)
    t[700:] += 1.0
    log = fa.read_gyro_log(table(t), on_bad_rows="drop")
    assert log.rate == pytest.approx(100.0, rel=1e-9)
    assert "1000 samples at 100 Hz" in log.summary
    coarse = np.floor(np.arange(N) / 0.7) * 1e-3
    assert fa.read_gyro_log(table(coarse)).rate == pytest.approx(700.0, rel=2e-3)


def test_repeated_rows_are_no_samples():
    """A logger that is faster than its gyro."""
    with pytest.warns(GyroLogWarning, match="1000 of 2000 rows are left out"):
        log = fa.read_gyro_log(
            table(np.repeat(T, 2), np.repeat(RATES, 2, axis=0)), on_bad_rows="drop"
        )
    assert np.array_equal(log.rates, RATES)


@pytest.mark.parametrize(("bad", "warned"), [(10, False), (11, True)])
def test_more_than_a_hundredth_is_warned_of(bad, warned, tmp_path, capsys):
    rates = RATES.copy()
    rates[50 : 50 + bad] = np.nan
    path, out = str(tmp_path / "log.csv"), str(tmp_path / "q.npy")
    head = ",".join(["t [s]", *NAMES])
    np.savetxt(path, np.column_stack([T, rates]), delimiter=",", header=head, comments="")
    assert main(["integrate", path, "--on-bad-rows", "drop", "-o", out]) == 0
    found = capsys.readouterr()
    rows = "11 of 1000 rows are left out (11 rows dropped: line 52 at 0.49 s, line 53 at 0.49 s, "
    gap = "line 54 at 0.49 s, ...; 1 gap: line 63 at 0.49 s)"
    assert found.err == (f"fastatt: warning: {path}: {rows}{gap}\n" if warned else "")
    assert f"; {bad} rows dropped" in found.out


def test_samples_that_a_logger_lost_are_counted():
    lost = np.random.default_rng(1).choice(np.arange(10, N - 10, 9), 12, replace=False)
    kept = np.delete(np.arange(N), np.concatenate([lost + k for k in range(4)]))
    with pytest.warns(GyroLogWarning, match=r"48 samples missing, the longest interval 0\.05 s"):
        log = fa.read_gyro_log(table(T[kept], RATES[kept]))
    assert "48 samples missing, the longest interval 0.05 s, before row" in log.summary
    # a few are said in the summary alone
    kept = np.delete(np.arange(N), [500, 501])
    assert "; 2 samples missing, the" in fa.read_gyro_log(table(T[kept], RATES[kept])).summary
    # late stamps, and stamps of a coarse clock, miss nothing
    late = T + np.random.default_rng(2).exponential(0.2 * H, N)
    coarse = np.floor(np.arange(N) / 0.7) * 1e-3
    for t in (np.maximum.accumulate(late) + 1e-9 * np.arange(N), coarse):
        assert "missing" not in fa.read_gyro_log(table(t)).summary


@pytest.mark.parametrize(("size", "apart"), [(4, 1e-5), (10, 1e-4), (3, 1e-3), (2, 1e-3)])
def test_a_rate_in_place_of_stamps_of_arrival_in_bursts(size, apart):
    count = np.arange(N)
    t = np.floor(count / size) * size * H + (count % size) * apart
    assert len(fa.read_gyro_log(table(t), rate=1 / H).t) == N
