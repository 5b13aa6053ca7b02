"""The trade study: its numbers are those of the library, its files are there."""

from __future__ import annotations

import csv

import numpy as np
import pytest

import fastatt as fa
from fastatt import gyrolog, trade


@pytest.fixture(scope="module")
def rows():
    return trade.coning_trade(32, (120, 240), repeats=1, bar=False)


def test_every_method_and_representation_is_there(rows):
    found = {(r.method, r.representation) for r in rows if r.input == "rate function"}
    scene = fa.Scene(rate=fa.rates.Coning(1.0, 1.0))
    assert found == {(m, r) for m in fa.methods_for(scene) for r in fa.METHODS[m].representations}
    assert {r.method for r in rows if r.input == "samples"} == set(trade.methods_for_samples())


def test_orders_are_near_the_declared_ones(rows):
    """Coarsely: each step's median is another body's error. Exact orders: test_methods.py."""
    for row in rows:
        if row.order is None or row.dtype == "float32" or row.error_median < 1e-10:
            continue
        assert row.order > fa.METHODS[row.method].order - 1.0, row


def test_exact_attitudes_obey_the_rates():
    """The closed form, differentiated, gives the rates that the scene is made of."""
    angle, frequency, t = np.array([0.3, 1.2]), np.array([0.7, 1.9]), np.linspace(0.0, 1.0, 401)
    q = trade.coning_attitudes(angle, frequency, t)
    w = fa.angular_velocity(q, t[1], order=8)
    assert np.abs(w - trade.coning_rates(angle, frequency, t).swapaxes(0, 1)).max() < 1e-11


def test_frontier_falls(rows):
    best = trade.frontier(rows)
    times = [r.seconds_per_body for r in best]
    errors = [r.error_median for r in best]
    assert times == sorted(times)
    assert errors == sorted(errors, reverse=True)
    beaten = [r for r in rows if r not in best]
    for r in beaten:
        assert any(
            b.seconds_per_body <= r.seconds_per_body and b.error_median <= r.error_median
            for b in best
        )


def test_recordings_are_found_and_agree_with_their_maker():
    paths = trade.find_recordings()
    assert len(paths) == len(trade.RECORDINGS)
    log = gyrolog.read_log(paths[0])
    assert (len(log.rates), log.rate) == (953, 50.0)
    rows = {r.method: r for r in trade.log_rows(log, repeats=1)}
    # the maker's filter corrects the gyro's bias by gravity and north: some degrees in 19 s
    assert 0.5 < rows["coning3"].maker_difference_max < 10.0
    assert rows["coning3"].difference_max == 0.0
    assert 0.0 < rows["previous"].difference_max < rows["picard"].difference_max


def test_run_leaves_its_files(tmp_path, capsys, rows, monkeypatch):
    monkeypatch.setattr(trade, "coning_trade", lambda *a, **k: rows)
    trade.run_trade(tmp_path / "out", n_bodies=32, quick=True)
    names = {"recordings.csv", "recordings.png", "trade.csv", "trade.png"}
    assert {p.name for p in (tmp_path / "out").iterdir()} == names
    with (tmp_path / "out" / "trade.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == len(rows)
    assert float(table[0]["error_median"]) == rows[0].error_median
    for name in names:
        assert (tmp_path / "out" / name).stat().st_size > 1000
    text = capsys.readouterr().out
    assert "Frontier, rate as samples" in text


def test_missing_recordings(monkeypatch):
    monkeypatch.setattr(trade.metadata, "files", lambda name: [])
    with pytest.raises(ImportError, match=r"fastatt\[trade\]"):
        trade.find_recordings()
