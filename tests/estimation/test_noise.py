"""Data sheets' units, Allan deviation and its fit, against published and analytic figures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracle import EPS

from fastatt import estimation as es

H = 0.05
COLUMNS = 24


# units


@pytest.mark.parametrize(
    ("value", "unit", "found"),
    [
        # 1°/√h is 1/60 °/√s
        (60.0, "deg/sqrt(h)", math.radians(1.0)),
        (60.0, "°/√h", math.radians(1.0)),
        (60.0, "° / √(h)", math.radians(1.0)),
        (3600.0, "deg/h", math.radians(1.0)),
        (216000.0, "deg/h/sqrt(h)", math.radians(1.0)),
        # a density in °/h/√Hz is 60 times the random walk in °/√h
        (60.0, "deg/h/sqrt(Hz)", math.radians(1.0) / 60.0),
        (5.0, "mdps/√Hz", math.radians(0.005)),
        (60.0, "m/s/sqrt(h)", 1.0),
        (1000.0, "µg/√Hz", 9.80665e-3),
        (40.0, "mg", 0.392266),
        (40.0, "mg/sqrt(Hz)", 0.392266),
        (40.0, "mg/√Hz", 0.392266),
        (40.0, "ug", 0.392266e-3),
        (2.0, "g", 19.6133),
        (1.0, "m/s²/√Hz", 1.0),
    ],
)
def test_units(value, unit, found):
    assert es.from_data_sheet(value, unit) == pytest.approx(found, rel=4 * EPS)
    assert es.to_data_sheet(found, unit) == pytest.approx(value, rel=4 * EPS)
    assert_allclose(es.from_data_sheet([value, 0.0], unit), [found, 0.0], rtol=4 * EPS)


# Allan deviation


def test_the_record_of_nist():
    """1000 numbers of Riley, NIST SP 1065, §12.4, tables 30 and 31: overlapping Allan deviation."""
    x, n = [], 1234567890
    for _ in range(1000):
        x.append(n / 2147483647)
        n = 16807 * n % 2147483647
    found = es.allan_deviation(x, 1.0, counts=[1, 10, 100])
    assert_allclose(found.deviation, [2.922319e-01, 9.159953e-02, 3.241343e-02], atol=5e-8)


def test_it_is_its_definition():
    """Of every pair of means side by side; increments, columns and powers of two besides."""
    rates = np.random.default_rng(1).normal(size=(37, 2))
    found = es.allan_deviation(rates, H)
    assert_allclose(found.tau, [H, 2 * H, 4 * H, 8 * H])
    for k, deviation in zip((1, 2, 4, 8), found.deviation, strict=True):
        means = np.array([rates[i : i + k].mean(axis=0) for i in range(37 - k + 1)])
        pairs = means[k:] - means[:-k]
        assert_allclose(deviation, np.sqrt((pairs**2).mean(axis=0) / 2.0), rtol=1e-13)
    angles = es.allan_deviation(rates[:, 0] * H, H, increments=True)
    assert_allclose(angles.deviation, found.deviation[:, 0], rtol=1e-13)
    # a ramp of R has R τ/√2
    ramp = es.allan_deviation(0.3 * H * np.arange(100), H)
    assert_allclose(ramp.deviation, 0.3 * ramp.tau / math.sqrt(2.0), rtol=1e-12)


def simulated(angle_noise, bias_instability, bias_noise, n=2**14, seed=0):
    """(n, COLUMNS): white noise and a walk as ``simulate_gyro`` has them, and flicker noise.

    Flicker: Kasdin, Proc. IEEE 83 (1995) 802, with α = 1: two-sided density B²/(2π f).
    """
    rng = np.random.default_rng(seed)
    gyro = es.simulate_gyro(
        np.zeros((n, 3)), H, angle_noise=angle_noise, bias_noise=bias_noise, runs=COLUMNS // 3,
        rng=rng,
    )  # fmt: skip
    k = np.arange(1, n)
    response = np.concatenate([[1.0], np.cumprod((k - 0.5) / k)])
    white = np.fft.rfft(rng.normal(size=(n, COLUMNS)), 2 * n, axis=0)
    flicker = np.fft.irfft(np.fft.rfft(response, 2 * n)[:, None] * white, axis=0)[:n]
    samples = np.moveaxis(gyro.samples, 1, 0).reshape(n, COLUMNS)
    return samples + bias_instability * flicker


def test_the_deviation_of_a_walk_is_the_formula():
    """N²/τ + K² τ/3 within 5 deviations of the mean over all columns."""
    found = es.allan_deviation(simulated(3e-4, 0.0, 1e-4), H)
    seen = (found.deviation**2).mean(axis=1)
    true = 9e-8 / found.tau + 1e-8 * found.tau / 3.0
    assert np.all(np.abs(seen / true - 1.0) <= 5.0 * np.sqrt(2.0 / found.freedom / COLUMNS))


@pytest.mark.parametrize(
    "true", [(3e-4, 0.0, 0.0), (3e-4, 0.0, 1e-4), (3e-4, 2e-4, 0.0)], ids=["N", "N K", "N B"]
)
def test_a_fit_tells_the_parts(true):
    fit = es.allan_deviation(simulated(*true), H).fit()
    parts = np.stack([fit.angle_noise, fit.bias_instability, fit.bias_noise])
    for value, found, said in zip(true, parts, fit.deviations, strict=True):
        # of none there is less than 3 deviations of one column; of the mean of all, 5 of theirs
        limit = 5.0 / math.sqrt(COLUMNS) if value else 3.0
        assert abs(found.mean() - value) <= limit * said.mean()
        if value:
            # what is said is what 24 columns scatter by: to 5 deviations of such a scatter
            ratio = found.std(ddof=1) / said.mean()
            assert abs(math.log(ratio)) <= 5.0 / math.sqrt(2.0 * COLUMNS)
    tau = np.array([1.0, 4.0])
    expected = np.sqrt(
        parts[0] ** 2 / tau[:, None]
        + 2.0 * math.log(2.0) / math.pi * parts[1] ** 2
        + parts[2] ** 2 * tau[:, None] / 3.0
    )
    assert_allclose(fit.deviation(tau), expected, rtol=1e-14)


def test_the_deviations_of_a_fit_are_those_of_many_records():
    """Of 600 of 4096 white samples; a part that is not there stays within what is said of it."""
    white = np.random.default_rng(5).normal(scale=1e-3, size=(4096, 600))
    fit = es.allan_deviation(white, H).fit()
    scatter, said = fit.angle_noise.std(ddof=1), fit.deviations[0].mean()
    assert abs(math.log(scatter / said)) < 0.18
    for part, deviations in (
        (fit.bias_instability, fit.deviations[1]),
        (fit.bias_noise, fit.deviations[2]),
    ):
        assert (deviations > 0.0).all()
        assert (part <= 3.0 * deviations).mean() > 0.95
        assert (part == 0.0).mean() > 0.2


@pytest.mark.parametrize("name", ["angle_noise", "bias_noise"])
@pytest.mark.parametrize("value", [-1e-300, 1.01e150, math.inf, math.nan])
def test_noise_whose_square_is_no_number_is_refused(name, value):
    accepted = rf"{name}: found .*; accepted: (at least 0, up to 1e\+150|.*finite)"
    P = np.eye(6)
    for call in (
        lambda noise: es.simulate_gyro(np.zeros((4, 3)), H, **noise),
        lambda noise: es.MEKF([1, 0, 0, 0], P, **{"angle_noise": 1e-4, "bias_noise": 0.0, **noise}),
    ):
        with pytest.raises(ValueError, match=accepted):
            call({name: value})
        for good in (0.0, 1e-6):
            call({name: good})


def test_one_column_and_silence():
    one = es.allan_deviation(simulated(3e-4, 0.0, 0.0)[:, 0], H).fit()
    assert one.angle_noise.shape == ()
    assert one.deviations.shape == (3,)
    silent = es.allan_deviation(np.ones(100), H)
    assert not silent.deviation.any()
    assert silent.fit().angle_noise == 0.0
    # no sum of parts; averages of even numbers of samples do not change at all
    odd = es.allan_deviation(np.tile([1.0, -1.0], 50), H)
    assert odd.deviation[0] > 1.0
    assert np.abs(odd.deviation[1:]).max() < 1e-14
    fit = odd.fit()
    assert np.isfinite([fit.angle_noise, *fit.deviations]).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: es.from_data_sheet(1.0, "deg/sqrt(min)"), "unit: found 'deg/sqrt.min.'; accepted"),
        (lambda: es.from_data_sheet(np.nan, "deg/h"), "value is nan"),
        (lambda: es.allan_deviation(np.zeros(8), H), "samples: found 8; accepted: at least 9"),
        (lambda: es.allan_deviation(np.zeros(9), 0.0), "dt: found 0.0"),
        (lambda: es.allan_deviation([*np.zeros(9), np.nan], H), r"samples\[9\]"),
        (
            lambda: es.allan_deviation(np.zeros(20), H, counts=[1, 11]),
            "counts: found 1 to 11; accepted: whole numbers from 1 to 10",
        ),
        (lambda: es.allan_deviation(np.zeros(9), H).fit(), "tau: found 2 times"),
        (lambda: es.allan_deviation(np.zeros(20), H, counts=[1.5]), "counts: found 1.5 to 1.5"),
    ],
)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=message):
        call()
