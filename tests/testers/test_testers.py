"""Random testers: cases that nobody wrote down, other ones each day (``make fuzz MINUTES=30``)."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from damaged_ends import of_ends
from damaged_logs import of_damage, of_names
from each import each
from random_functions import of_functions, of_impure, of_values
from random_runs import of_runs
from testing import SECONDS, first_seed, try_cases
from write_faults import of_faults

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


@each("case", [of_functions, of_values, of_impure])
def test_functions_of_users(case):
    def told(seed):
        how, why = case(seed)
        return how, why if how == "error" else ""

    outcomes = try_cases(case.__name__, told, 1 / 3)
    assert case is of_impure or outcomes["followed"] > 0.5 * outcomes.total()


def test_runs_by_bits(tmp_path):
    try_cases("runs", partial(of_runs, folder=tmp_path))


def test_logs_that_are_damaged(tmp_path):
    outcomes = try_cases("logs", partial(of_damage, folder=tmp_path), 0.5)
    assert outcomes.total() > 10


def test_tables_of_odd_names(tmp_path):
    outcomes = try_cases("names", partial(of_names, folder=tmp_path), 0.5)
    assert outcomes["names: right"] > 0


def test_ends_that_are_damaged_or_crafted(tmp_path):
    try_cases("ends", partial(of_ends, folder=tmp_path))


def test_writes_that_fail(tmp_path):
    try_cases("faults", partial(of_faults, folder=tmp_path), 0.2)


def test_kills(tmp_path):
    """And what a cache holds after the kills is loaded, or compiled again."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "testers")])
    files, cache = tmp_path / "files", tmp_path / "cache"
    files.mkdir()
    cache.mkdir(mode=0o700)
    environment = {**os.environ, "PYTHONPATH": path, "FASTATT_CACHE": str(cache)}
    kills, program = max(20, int(SECONDS / 3)), ROOT / "tests" / "testers" / "write_faults.py"
    for number in (kills, 0):
        command = [sys.executable, str(program), str(files), str(number), str(first_seed())]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"FASTATT_SEED={first_seed()}: {done.stderr[-2000:]}"
        assert number == 0 or int(done.stdout) > number
