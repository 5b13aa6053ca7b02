"""Log files: read, and integrated to files of attitudes, beside pandas."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fastatt as fa
from fastatt.gyro.attitudes import attitude_rows, write_attitudes

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
ROWS = 20_000 if SMOKE else 5_000_000


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    rates = np.random.default_rng(0).standard_normal((ROWS, 3)).round(5)
    frame = pd.DataFrame(rates, columns=[f"gyro_{a} [rad/s]" for a in "xyz"])
    frame.insert(0, "time [s]", (np.arange(ROWS) * 1e-3).round(3))
    frame.to_csv(path, index=False)
    return path


def integrated(path: Path, suffix: str) -> int:
    rows = attitude_rows(fa.read_gyro_log(path), (1.0, 0.0, 0.0, 0.0), "previous")
    write_attitudes(path.with_suffix(suffix), rows)
    return len(rows)


@pytest.mark.parametrize(
    "way",
    [
        lambda path: len(pd.read_csv(path)),
        lambda path: len(fa.read_gyro_log(path).t),
        lambda path: integrated(path, ".npy"),
        lambda path: integrated(path, ".attitudes.csv"),
    ],
    ids=["pandas.read_csv", "read_gyro_log", "to attitudes, npy", "and csv"],
)
def test_log(benchmark, log, way):
    def setup():
        for old in log.parent.glob("log.[!c]*"):
            old.unlink()
        return (log,), {}

    assert benchmark.pedantic(way, setup=setup, rounds=3, warmup_rounds=1) == ROWS
    if benchmark.stats is not None:
        seconds = benchmark.stats.stats.min
        benchmark.extra_info["MB/s"] = round(log.stat().st_size / seconds / 1e6)
