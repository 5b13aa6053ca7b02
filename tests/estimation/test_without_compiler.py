"""Parts of estimators without a compiler: the same formulas in numpy, for debugging."""

import copy
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from oracle import EPS

import fastatt as fa
from fastatt import estimation
from fastatt.estimation import preintegration as pre

START = (0.5, -0.5, 0.5, 0.5)
GENERATOR = np.random.default_rng(0)
GYRO, ACCEL = GENERATOR.normal(size=(2, 3, 7, 3))
TOP = fa.Scene(inertia=(2.0, 1.0, 1.4), torque=fa.torques.HeavyTop((0.1, -0.2, 0.9), 1.5))
CONING = fa.Scene(rate=fa.rates.Coning(0.3, 2.0))
NOISE = {"gyro_noise": 0.02, "accel_noise": 0.3}


def filtered(n):
    f = estimation.MEKF(np.tile(START, (n, 1)), 0.01 * np.eye(6), angle_noise=0.1, bias_noise=0.1)
    f.predict(GYRO[0, 0], 0.1)
    f.update_vector(GYRO[0, 1], ACCEL[0, 0], 0.1)
    f.update_attitude(START, 0.2)
    return f.q, f.bias, f.covariance


def results():
    log = estimation.preintegrate(GYRO, ACCEL, 0.1, **NOISE)
    alone = estimation.preintegrate(GYRO, None, 0.1, gyro_noise=0.02)
    one = estimation.Preintegrator(**NOISE)
    one.add(GYRO[0, 0], ACCEL[0, 0], 0.1)
    found = [log.rows, alone.rotation, alone.covariance[:, :3, :3]]
    found.append(one.result.rows)
    found += log.predict(START, (1.0, 2.0, 3.0), (0.0, 1.0, 0.0), gyro_bias=(0.1, 0.0, 0.0))
    found += [estimation.right_jacobian(GYRO[0]), *filtered(1), *filtered(9)]
    for method in ("rk4", "kahan_li6"):
        body = estimation.body_tangent(TOP, START, GYRO[0], 0.1, method=method, parameters=True)
        found += [body.q, body.w, body.matrix, body.inertia, body.torque]
        made = estimation.step_tangent(TOP, method=method)
        found += made.step(0.0, 0.1, START, (0.1, 0.2, 0.3), made.params)
    cone = estimation.step_tangent(CONING)
    found += cone.step(0.0, 0.1, (0.1, 0.2, 0.3), cone.params)
    found.append(estimation.sample_transitions(GYRO, 0.1, method="coning2").matrix)
    return [np.asarray(x).tolist() for x in found]


PROGRAM = "import json, test_without_compiler as t; print(json.dumps(t.results()))"


def test_without_a_compiler():
    folders = [str(Path(__file__).parents[k]) for k in (0, 1)]
    plain = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(folders)},
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    for a, b in zip(json.loads(plain), results(), strict=True):
        assert np.shape(a) == np.shape(b)
        assert np.abs(np.subtract(a, b)).max() <= 64 * EPS * max(1.0, np.abs(b).max())


# a filter's arrays


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
@pytest.mark.parametrize("n", [None, 20])
def test_a_copy_of_a_filter_has_arrays_of_its_own(copied, n):
    q = START if n is None else np.tile(START, (n, 1))
    f = estimation.MEKF(q, 0.01 * np.eye(6), angle_noise=0.1, bias_noise=0.1)
    f.predict(GYRO[0, 0], 0.1)
    g = copied(f)
    before = f.q.copy()
    g.predict(GYRO[0, 1], 0.1)
    assert (f.q == before).all()
    f.predict(GYRO[0, 1], 0.1)
    assert (f.q == g.q).all()
    assert not (f.q == before).all()


def test_what_an_update_gives_is_not_changed_by_the_next():
    f = estimation.MEKF(np.tile(START, (3, 1)), np.eye(6), angle_noise=0.1, bias_noise=0.1)
    first = f.update_attitude(START, 0.1)
    kept = first.copy()
    f.update_attitude((1.0, 0.0, 0.0, 0.0), 0.1)
    assert (first == kept).all()


def test_many_filters_are_the_filters_alone():
    """Vectors of filters and single ones, by every operation, to the bit."""
    many, one = filtered(9), filtered(1)
    for a, b in zip(many, one, strict=True):
        assert (a == b).all()


# one sample from Python and in a log


def test_a_log_is_its_samples_one_by_one():
    state = pre.begin(1.0)
    for w, a in zip(GYRO[0].tolist(), ACCEL[0].tolist(), strict=True):
        state = pre.add_sample(state, tuple(w), tuple(a), 0.1, 0.02**2, 0.3**2)
    found = estimation.preintegrate(GYRO[0], ACCEL[0], 0.1, **NOISE)
    assert np.abs(np.subtract(state.p, found.position)).max() <= 8 * EPS
    assert np.abs(np.reshape(state.pg, (3, 3)) - found.position_gyro).max() <= 8 * EPS
