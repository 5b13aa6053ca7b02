"""A filter's arrays are its own; many filters, and the samples of a log, are the ones alone."""

import copy
import pickle

import numpy as np
import pytest

from fastatt import estimation

START = (0.5, -0.5, 0.5, 0.5)
GENERATOR = np.random.default_rng(0)
GYRO, ACCEL = GENERATOR.normal(size=(2, 3, 7, 3))


def filtered(n):
    f = estimation.MEKF(np.tile(START, (n, 1)), 0.01 * np.eye(6), angle_noise=0.1, bias_noise=0.1)
    f.predict(GYRO[0, 0], 0.1)
    f.update_vector(GYRO[0, 1], ACCEL[0, 0], 0.1)
    f.update_attitude(START, 0.2)
    return f.q, f.bias, f.covariance


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
