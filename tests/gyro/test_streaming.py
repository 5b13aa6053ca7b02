"""Samples that come one by one or in pieces: the bits of the whole log."""

from __future__ import annotations

import copy
import pickle
import re
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from itertools import product

import numpy as np
import pytest
from each import each
from exact import same

import fastatt as fa

START = np.array([0.5, -0.5, 0.1, 0.7])
REPRESENTATIVES = [("previous", False), ("coning2", True), ("picard", False)]
SAMPLED = [
    (m.name, increments)
    for m in fa.METHODS.values()
    if m.window is not None
    for increments in (False, True)
    if m.window.takes(increments)
]
LOG = np.cumsum(np.random.default_rng(0).normal(size=(20, 400, 3)), axis=1) * 0.01
# samples at the ends of chunks and in the middle of windows
CUTS = {
    "singly": (1,) * 130,
    "in pieces": (1, 1, 1, 45, 2, 50, 7, 1, 200, 3),
    "few": (4,),
    "one": (1,),
}


def streamed(rates, dt, cuts, q0, **options):
    """All that comes out of a log cut into pieces, the integrator pickled between two of them."""
    uneven = np.ndim(dt) > 0
    flow = fa.GyroIntegrator(q0, None if uneven else dt, **options)
    found, at = [], 0
    for k, n in enumerate(cuts):
        end = at + n
        first = at if options.get("increments") else max(at - 1, 0)
        last = end if options.get("increments") else end - 1
        found.append(flow.push(rates[..., at:end, :], *([dt[first:last]] if uneven else [])))
        at = end
        if k == 2:
            flow = pickle.loads(pickle.dumps(flow))
    return np.concatenate([*found, flow.close()], axis=-2)


CASES = [
    *product(SAMPLED, CUTS, ("even",), ((1, "f8"),)),
    *product(
        (("trapezoid", False), *REPRESENTATIVES), ("singly", "in pieces"), ("uneven", "gaps"),
        ((1, "f8"), (3, "f4"), (20, "f8")),
    ),
]  # fmt: skip


@each(("way", "cuts", "intervals", "bodies"), CASES)
def test_pieces_are_the_whole_log(way, cuts, intervals, bodies):
    """Of many bodies too; windows begin anew where those of the whole log do."""
    (method, increments), (n_bodies, dtype) = way, bodies
    cuts = CUTS[cuts]
    n = sum(cuts)
    rng = np.random.default_rng(1)
    data = (LOG[:n_bodies, :n] * (0.02 if increments else 1.0)).astype(dtype)
    q0 = rng.normal(size=(n_bodies, 4))
    dt = rng.uniform(0.015, 0.025, n - (not increments))
    if intervals == "even":
        data, q0, dt = data[0], q0[0], 0.02
    if intervals == "gaps":
        dt[[3, 40, 41, 48, 100, 126]] = [0.1, 0.15, 1e-6, 1e-4, 0.12, 0.2]
    options = {"method": method, "increments": increments, "max_gap": 1.0}
    whole = fa.integrate_rates(data, dt, q0, **options)
    found = streamed(data, dt, cuts, q0, **options)
    assert found.dtype == dtype
    assert same(found, whole)


@each(("method", "increments"), SAMPLED)
def test_one_interval_for_all_samples_of_a_push(method, increments):
    data = LOG[0, :67] * (0.02 if increments else 1.0)
    options = {"method": method, "increments": increments}
    flow = fa.GyroIntegrator(START, **options)
    found = np.concatenate([flow.push(data[:50], 0.02), flow.push(data[50:], 0.02), flow.close()])
    spans = np.full(len(data) - (not increments), 0.02)
    assert found.tobytes() == fa.integrate_rates(data, spans, START, **options).tobytes()


def test_a_long_gap_is_warned_of_unless_it_is_accepted():
    rates = np.tile([0.1, 0.2, 0.3], (41, 1))
    spans = np.full(40, 0.01)
    spans[30] = 0.5
    for max_gap in (1.0, np.inf):
        fa.GyroIntegrator(START, max_gap=max_gap).push(rates, spans)
    for method in ("trapezoid", "previous"):
        flow = fa.GyroIntegrator(START, method=method)
        flow.push(rates[:25], spans[:24])
        before = pickle.dumps(flow)
        with pytest.warns(fa.StepWarning, match="interval 30 of 0.5 s is a gap, 50 times the med"):
            later = flow.push(rates[25:], spans[24:])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            again = pickle.loads(before)
            with pytest.raises(fa.StepWarning):
                again.push(rates[25:], spans[24:])
            assert pickle.dumps(again) == before
        assert len(later) == 16
    with pytest.raises(ValueError, match=r"0\.5: a gap"):
        fa.GyroIntegrator(START, max_gap=0.1).push(rates, spans)


@pytest.mark.parametrize(
    ("method", "increments", "sizes", "left"),
    [
        ("hold", False, [1, 1, 1, 1, 1], 0), ("hold", True, [2, 1, 1, 1, 1], 0),
        ("previous", False, [1, 0, 2, 1, 1], 0),  # the first interval takes three rates
        ("previous", True, [1, 2, 1, 1, 1], 0),
        ("coning2", False, [1, 0, 2, 0, 2], 0), ("coning2", True, [1, 2, 0, 2, 0], 1),
    ],
)  # fmt: skip
def test_attitudes_come_as_soon_as_they_are_final(method, increments, sizes, left):
    flow = fa.GyroIntegrator(START, 0.1, method=method, increments=increments)
    assert [len(flow.push((0.1, 0.2, 0.3))) for _ in sizes] == sizes
    assert flow.close().shape == (left, 4)


def test_previous_begins_again_with_three_rates_after_a_gap():
    flow = fa.GyroIntegrator(START, max_gap=1.0)
    flow.push(LOG[0, :20], 0.02)
    sizes = [len(flow.push(LOG[0, 20 + k], 0.02 if k else 0.5)) for k in range(20)]
    assert sizes == [1, 0, 2, *[1] * 17]


@pytest.mark.parametrize(("method", "increments"), REPRESENTATIVES)
@pytest.mark.parametrize("n_bodies", [1, 3])
def test_an_attitude_that_is_assigned_turns_all_later_ones(method, increments, n_bodies):
    """By the same rotation along inertial axes, within a chunk, a window and at the beginning."""
    data = LOG[:n_bodies, :150] * (0.02 if increments else 1.0)
    data = data if n_bodies > 1 else data[0]
    start = np.tile(START, (n_bodies, 1)) if n_bodies > 1 else START
    options = {"method": method, "increments": increments}
    plain, turned = (fa.GyroIntegrator(start, 0.02, **options) for _ in range(2))
    turn = np.array([0.8, 0.0, -0.6, 0.0])
    turned.q = 3.0 * fa.quat_multiply(turn, turned.q)
    for piece in (slice(0, 31), slice(31, 38), slice(38, 150)):
        a, b = (flow.push(data[..., piece, :]) for flow in (plain, turned))
        assert np.array_equal(plain.q, a[..., -1, :])
        assert fa.angle_between(fa.quat_multiply(turn, a), b).max() < 1e-14
        turn = fa.quat_multiply([0.6, 0.8, 0.0, 0.0], turn)
        turned.q = fa.quat_multiply([0.6, 0.8, 0.0, 0.0], turned.q)
    a, b = plain.close(), turned.close()
    assert not a.size or fa.angle_between(fa.quat_multiply(turn, a), b).max() < 1e-14


@pytest.mark.parametrize("method", ["previous", "coning2"])
def test_threads_push_one_after_another(method):
    """Equal samples of two threads are those of one log, whose order does not matter."""
    rates, n = [0.1, -0.2, 0.3], 400
    sizes = []

    def push(_):
        sizes.append(len(flow.push(rates)))

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(5):
            sizes.clear()
            flow = fa.GyroIntegrator(START, 0.01, method=method)
            with ThreadPoolExecutor(2) as threads:
                list(threads.map(push, range(n)))
            assert sum(sizes) + len(flow.close()) == n
            whole = fa.integrate_rates(np.tile(rates, (n, 1)), 0.01, START, method=method)
            assert np.array_equal(flow.q, whole[-1])
    finally:
        sys.setswitchinterval(interval)


def test_a_log_without_samples():
    assert fa.GyroIntegrator(START, 0.1).close().shape == (0, 4)
    assert fa.GyroIntegrator([START] * 2, 0.1).close().shape == (2, 0, 4)


def test_what_comes_out_is_the_users_own():
    flow = fa.GyroIntegrator(START, 0.1, method="picard")
    other = copy.copy(flow)
    rates = LOG[0, :12]
    flow.push(rates[:10])[:] = 7.0
    other.push(rates[:10])
    assert np.array_equal(flow.push(rates[10:]), other.push(rates[10:]))
    assert np.array_equal(flow.close(), other.close())


@pytest.mark.parametrize(
    ("rates", "dt", "message"),
    [
        ([0.0, np.nan, 0.0], 0.1, "rates[1] is nan"),
        ([0.0, 1e308, 1e308], 1e5, "rates: the angles overflow float64"),
        ([[0.0] * 4], 0.1, "rates: has shape (1, 4); accepted: (3,) or (n, 3)"),
        ([0.0] * 3, None, "dt: found None; accepted: a number or (1,)"),
        ([0.0] * 3, -0.1, "dt: found -0.1; accepted: an interval above 0"),
        ([0.0] * 3, [0.2], "dt[0] is 0.2: a gap; accepted: at most 0.15 s"),
    ],
)
def test_refused_samples_leave_all_as_it_was(rates, dt, message):
    max_gap = 0.15 if "gap" in message else np.inf
    flows = [fa.GyroIntegrator(START, method="hold", max_gap=max_gap) for _ in range(2)]
    for flow in flows:
        flow.push([0.1, 0.2, 0.3])
        if "overflow" in message:
            flow.push(rates, 0.1)
    with pytest.raises(ValueError, match=re.escape(message)):
        flows[0].push(rates, dt)
    first, second = (flow.push([0.3, 0.2, 0.1], 0.1) for flow in flows)
    assert np.array_equal(first, second)


def test_long_turns_are_told_by_their_place_in_the_log():
    flow = fa.GyroIntegrator(START, 0.1, method="coning2")
    flow.push(np.zeros((60, 3)))
    with pytest.warns(fa.StepWarning, match="interval 60 of log 0 rotates by 3 rad") as said:
        flow.push([[0.0] * 3, [30.0, 0.0, 0.0], [0.0] * 3])
    assert said[0].filename == __file__
