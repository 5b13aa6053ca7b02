"""Logs of samples, of means over intervals and of increments, beside coning in closed form."""

from __future__ import annotations

import io

import numpy as np
import pytest
from each import each

import fastatt as fa
from fastatt.cli import main

ANGLE, FREQUENCY, H, N = 0.02, 2 * np.pi * 15.0, 0.005, 400
T = H * np.arange(N + 1)


def coning(t):
    """Attitudes of a cone, and the integral of its body rates."""
    turn, slow = FREQUENCY * t, -2 * FREQUENCY * np.sin(ANGLE / 2) ** 2
    half = np.sin(ANGLE / 2)
    q = np.stack([np.cos(ANGLE / 2) + 0 * t, half * np.cos(turn), half * np.sin(turn), 0 * t], 1)
    wide = np.sin(ANGLE)
    return q, np.stack([wide * np.cos(turn), wide * np.sin(turn), slow * t], 1)


TRUTH, INTEGRAL = coning(T)
INCREMENTS = np.diff(INTEGRAL, axis=0)
# rates at the stamps, in closed form
SAMPLES = np.stack([-FREQUENCY * INTEGRAL[:, 1], FREQUENCY * INTEGRAL[:, 0], 0 * T], 1)
SAMPLES[:, 2] = -2 * FREQUENCY * np.sin(ANGLE / 2) ** 2


def px4(scale=1.0, names="gyro_rad[{}]"):
    """Numbers over the intervals that end at the stamps, as PX4 writes them."""
    head = ",".join(["timestamp", *(names.format(k) for k in range(3))])
    rows = zip(T[1:], INCREMENTS * scale, strict=True)
    lines = [f"{round(1e6 * t)},{','.join(map(repr, x.tolist()))}" for t, x in rows]
    return "\n".join([head, *lines]) + "\n"


def error(q, first=1):
    return fa.angle_between(q, TRUTH[first:]).max()


@each(("text", "values"), [(px4(1 / H), "means"), (px4(1.0, "delta_angle[{}]"), "increments")])
def test_a_format_defines_means_and_increments(text, values):
    log = fa.read_gyro_log(io.StringIO(text))
    assert log.values == values
    assert values in log.summary
    assert (len(log.t), log.rates.shape, len(log.dt)) == (N, (N - 1, 3), N - 1)
    right = fa.integrate_rates(INCREMENTS[1:], H, TRUTH[1], increments=True)
    for q in (
        fa.integrate_rates(log, q0=TRUTH[1]),
        fa.integrate_rates(log.rates, log.dt, TRUTH[1]),
        fa.GyroIntegrator(TRUTH[1]).push(log),
    ):
        assert q.shape == (N, 4)
        assert np.abs(q - right).max() < 1e-13
        assert error(q) < 3e-4
    # the same numbers read as samples have the error of half an interval
    as_samples = fa.integrate_rates(log.rates, H, TRUTH[2])
    assert fa.angle_between(as_samples, TRUTH[2:]).max() > 5e-3


@each("method", ["hold", "previous", "coning2", "picard"])
def test_means_are_increments_over_their_intervals(method):
    means = INCREMENTS / H
    spans = np.full(N, H)
    q = fa.integrate_rates(means, spans, TRUTH[0], method=method)
    right = fa.integrate_rates(means * H, spans, TRUTH[0], method=method, increments=True)
    assert q.tobytes() == right.tobytes()
    flow = fa.GyroIntegrator(TRUTH[0], method=method)
    parts = [slice(0, 7), slice(7, 60), slice(60, N)]
    pieces = [flow.push(means[part], spans[part]) for part in parts]
    assert np.concatenate([*pieces, flow.close()]).tobytes() == q.tobytes()
    many = fa.integrate_rates(np.stack([means] * 3), spans, TRUTH[0], method=method)
    assert np.array_equal(many, np.stack([q] * 3))


def test_the_order_of_methods_for_means():
    """Halved intervals of one motion: the error falls as with increments."""
    errors = []
    for step in (4, 2, 1):
        means = np.diff(INTEGRAL[::step], axis=0) / (step * H)
        q = fa.integrate_rates(means, np.full(len(means), step * H), TRUTH[0], method="picard")
        errors.append(fa.angle_between(q, TRUTH[::step]).max())
    assert errors[1] < errors[0] / 8
    assert errors[2] < errors[1] / 16


def test_samples_means_and_increments_are_said():
    names = [f"gyro_{a} [{{}}]" for a in "xyz"]
    for values, unit, data, scale in (
        ("samples", "deg/s", SAMPLES, 180 / np.pi),
        ("means", "deg/s", np.r_[SAMPLES[:1], INCREMENTS / H], 180 / np.pi),
        ("increments", "mrad", np.r_[SAMPLES[:1] * H, INCREMENTS], 1e3),
    ):
        columns = {n.format(unit): x for n, x in zip(names, scale * data.T, strict=True)}
        log = fa.read_gyro_log({"t [s]": T, **columns}, values=values)
        assert log.values == values
        assert error(fa.integrate_rates(log, q0=TRUTH[0]), 0) < 5e-4
    # at a rate every number has its interval
    columns = {n.format("rad"): x for n, x in zip(names, INCREMENTS.T, strict=True)}
    log = fa.read_gyro_log(columns, rate=1 / H, values="increments")
    assert (len(log.t), len(log.rates), len(log.dt)) == (N + 1, N, N)
    assert error(fa.integrate_rates(log, q0=TRUTH[0]), 0) < 5e-4


def test_a_log_has_its_intervals():
    log = fa.read_gyro_log(io.StringIO(px4(1 / H)))
    with pytest.raises(TypeError, match=r"dt: found .* beside a log"):
        fa.integrate_rates(log, log.dt)
    with pytest.raises(TypeError, match="increments: found True beside a log"):
        fa.integrate_rates(log, increments=True)
    with pytest.raises(ValueError, match="method: found 'trapezoid'"):
        fa.integrate_rates(log, method="trapezoid")
    flow = fa.GyroIntegrator(TRUTH[0], H)
    flow.push(SAMPLES[:5])
    with pytest.raises(ValueError, match="found a log of other values"):
        flow.push(log)
    with pytest.raises(fa.GyroLogError, match="values: found 'samples'; accepted: 'means'"):
        fa.read_gyro_log(io.StringIO(px4(1 / H)), values="samples")


def test_the_command_line_follows_the_values(tmp_path):
    path, out = tmp_path / "log.csv", tmp_path / "q.npy"
    q0 = ",".join(map(repr, TRUTH[1].tolist()))
    path.write_text(px4(1 / H), encoding="utf-8")
    assert main(["integrate", str(path), "-o", str(out), f"--q0={q0}"]) == 0
    assert error(np.load(out)[:, 1:]) < 3e-4
    text = px4().replace("gyro_rad[0],gyro_rad[1],gyro_rad[2]", "gx [rad],gy [rad],gz [rad]")
    path.write_text(text, encoding="utf-8")
    more = ["--values", "increments", "--time-unit", "us"]
    assert main(["integrate", str(path), "-o", str(out), f"--q0={q0}", *more]) == 0
    assert error(np.load(out)[:, 1:]) < 3e-4


def test_intervals_that_only_grow_are_told():
    with pytest.warns(fa.StepWarning, match="400 intervals only grow, .* as time stamps do"):
        fa.integrate_rates(1e-6 * SAMPLES, T[1:])
    with pytest.warns(fa.StepWarning, match="only grow"):
        fa.integrate_rates(1e-6 * INCREMENTS, 10.0 + T[1:], increments=True)


def test_a_push_of_no_rows_returns_none():
    flow = fa.GyroIntegrator(TRUTH[0], H)
    assert flow.push(np.empty((0, 3))).shape == (0, 4)
    flow.push(SAMPLES[:9])
    assert flow.push([]).shape == (0, 4)
    assert fa.GyroIntegrator(TRUTH[:2], H).push(np.empty((2, 0, 3))).shape == (2, 0, 4)
