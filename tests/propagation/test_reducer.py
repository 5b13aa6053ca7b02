"""A function that sees every step, beside the same function over the saves of every step."""

from __future__ import annotations

import math

import numpy as np
import pytest

import fastatt as fa

BODY = fa.Scene(inertia=(3.0, 2.0, 1.0))
RNG = np.random.default_rng(9)
N = 70  # a tile and some
Q0 = RNG.normal(size=(N, 4))
W0 = RNG.normal(size=(N, 3))
STEP = {"dt": 0.05, "n_steps": 60, "method": "rk4"}


def watch(t, q, w, s):
    """Largest |w|², first time at which the third axis is within 60° of up, time above it."""
    z = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    high = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]) > 0.5
    first = t if high and s[1] < 0.0 else s[1]
    return (z if z > s[0] else s[0]), first, (s[2] + 0.05 if high else s[2])


def count(t, q, w, s):
    return s[0] + 1.0


def looped(t, q, w, s):
    """The same largest |w|², counted up by a loop that no straight line is."""
    z, k = 0.0, 0
    while k <= 2 * s[1] and k < 3:
        k += 1
    for j in range(k if s[1] > 1.0 else 3):
        z += w[j] ** 2
    return max(z, s[0]), s[1] + 1.0


WATCH = fa.reducer(watch, start=(0.0, -1.0, 0.0))


def by_saves(run, function, start):
    """The function over the saves of a run, in Python."""
    found = []
    for body in range(run.status.size):
        s = start
        for k in range(1, len(run.t)):
            s = function(run.t[k], tuple(run.q[k, body]), tuple(run.w[k, body]), s)
        found.append(s)
    return np.array(found)


def agree(found, wanted, off=0.0, eps=2.0**-52):
    """To the rounding of 60 sums; saves are normalised, states have left unit length by ``off``."""
    assert np.abs(found - wanted).max() <= (64 * eps + 4.0 * off) * np.abs(wanted).max()


@pytest.mark.parametrize("representation", ["quat", "dcm"])
def test_bodies(representation):
    options = STEP | {"representation": representation}
    run = fa.propagate(BODY, Q0, W0, reduce=WATCH, **options)
    full = fa.propagate(BODY, Q0, W0, save_every=1, **options)
    assert WATCH.function.straight
    assert np.array_equal(run.q[-1], full.q[-1])  # watching changes no bit
    wanted = by_saves(full, watch, (0.0, -1.0, 0.0))
    agree(run.reduced, wanted)
    assert (wanted[:, 1] > 0).sum() > 20
    assert (wanted[:, 1] < 0).sum() > 5


def test_the_attitude_that_it_sees_is_unit():
    """Of a method whose steps leave the group."""

    def far(t, q, w, s):
        return max(s[0], abs(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2 - 1.0))

    options = {"dt": 0.1, "n_steps": 20, "method": "rk4", "reduce": fa.reducer(far, start=0.0)}
    run = fa.propagate(BODY, Q0, W0, **options)
    assert np.abs(run.norm_error).max() > 1e-6
    assert run.reduced.max() < 1e-9


def test_a_rate_and_a_scene_with_mass():
    cone = fa.Scene(rate=fa.rates.Coning(RNG.uniform(0.1, 1.0, N), frequency=2.0), frame="inertial")
    moving = fa.Scene(inertia=(3.0, 2.0, 1.0), mass=2.0, force=(0.1, 0.0, 0.3))
    translates = {"w0": W0, "v0": W0, "r0": W0}
    for scene, given in ((cone, {"method": "magnus4"}), (moving, translates)):
        options = STEP | given
        run = fa.propagate(scene, Q0, reduce=WATCH, **options)
        full = fa.propagate(scene, Q0, save_every=1, **options)
        # a rate along inertial axes is turned by the attitude that is stepped
        off = np.abs(full.norm_error).max() if scene is cone else 0.0
        assert off < 1e-13
        agree(run.reduced, by_saves(full, watch, (0.0, -1.0, 0.0)), off)
        assert np.array_equal(run.q[-1], full.q[-1])
        if scene is moving:
            assert np.array_equal(run.r, full.r[-1:])


def test_threads_sinks_and_saves_change_nothing():
    run = fa.propagate(BODY, Q0, W0, reduce=WATCH, **STEP)
    parts = []
    for options in (
        {"n_threads": 2},
        {"save_every": 1},
        {"save_every": 1, "on_save": parts.append},
    ):
        again = fa.propagate(BODY, Q0, W0, reduce=WATCH, **STEP, **options)
        assert np.array_equal(again.reduced, run.reduced)
    assert parts[-1].reduced.shape == (N, 3)


def test_a_run_that_goes_on_or_is_run_in_parts(monkeypatch, tmp_path):
    whole = fa.propagate(BODY, Q0, W0, reduce=WATCH, **STEP)
    half = STEP | {"n_steps": 30}
    first = fa.propagate(BODY, Q0, W0, reduce=WATCH, **half)
    first.save_end(tmp_path / "end.npz")
    for end in (first, tmp_path / "end.npz"):
        again = fa.propagate(BODY, resume=end, reduce=WATCH, **half)
        assert np.array_equal(again.reduced, whole.reduced)
    with pytest.raises(ValueError, match="reduce: found 0; accepted: 3, as in the earlier run"):
        fa.propagate(BODY, resume=first, **half)
    monkeypatch.setattr("fastatt.propagation.execute.PART", 32)
    assert np.array_equal(fa.propagate(BODY, Q0, W0, reduce=WATCH, **STEP).reduced, whole.reduced)


def test_own_starts_one_body_and_fast_ones():
    start = np.stack([np.arange(N), np.full(N, -1.0), np.zeros(N)], axis=1)
    own = fa.propagate(BODY, Q0, W0, reduce=fa.reducer(watch, start=start), **STEP)
    shared = fa.propagate(BODY, Q0, W0, reduce=WATCH, **STEP)
    assert np.array_equal(own.reduced[:, 1:], shared.reduced[:, 1:])
    assert np.array_equal(own.reduced[:, 0], np.maximum(shared.reduced[:, 0], np.arange(N)))
    one = fa.propagate(BODY, Q0[3], W0[3], reduce=WATCH, **STEP)
    assert np.array_equal(one.reduced, shared.reduced[3])
    # steps that are taken again by the form for any turn are seen once
    spin = fa.Scene(rate=lambda t, p: (p[0], 0.0, 0.0), params=[[1.0], [70.0], [2.0]])
    run = fa.propagate(
        spin,
        Q0[:3],
        dt=0.05,
        n_steps=60,
        reduce=fa.reducer(count, start=0.0),
        method="lie_midpoint",
    )
    assert np.array_equal(run.reduced, np.full((3, 1), 60.0))


def test_a_function_that_is_not_traced():
    reducer = fa.reducer(looped, start=(0.0, 0.0))
    assert not reducer.function.straight
    run = fa.propagate(BODY, Q0, W0, reduce=reducer, **STEP)
    wanted = fa.propagate(BODY, Q0, W0, reduce=WATCH, **STEP).reduced[:, 0]
    agree(run.reduced[:, 0], wanted)
    assert np.array_equal(run.reduced[:, 1], np.full(N, 60.0))


def test_its_operations_are_counted_among_those_of_the_step():
    def counted(**options):
        return int(fa.inspect_step(BODY, "rk4", **options).split(": ")[1].split()[0])

    assert counted(reduce=fa.reducer(count, start=0.0)) == counted() + 1
    with pytest.raises(TypeError, match=r"reduce: .*accepted: a fastatt\.reducer"):
        fa.inspect_step(BODY, "rk4", reduce=count)


def test_float32():
    run = fa.propagate(BODY, Q0, W0, reduce=WATCH, dtype=np.float32, **STEP)
    full = fa.propagate(BODY, Q0, W0, dtype=np.float32, save_every=1, **STEP)
    assert run.reduced.dtype == np.float64
    wanted = by_saves(full, watch, (0.0, -1.0, 0.0))
    agree(run.reduced[:, 0], wanted[:, 0], eps=2.0**-23)


def clock(t, q, w, s):
    """The time; steps so far beside a large number; the sum of a thousandth of each component."""
    return t, s[1] + 1.0, s[2] + 1e-3 * q[0]


@pytest.mark.parametrize("options", [{}, {"n_threads": 2, "save_every": 7}], ids=str)
def test_states_are_of_double_precision_in_a_float32_run(options, tmp_path):
    """A time in seconds since 1970, and a count that float32 would round to 16."""
    start = np.tile([0.0, 1.7e9, 0.0], (N, 1))
    start[3, 1] = 1.0 / 3.0
    reduce = fa.reducer(clock, start=start)
    given = {"dtype": np.float32, "t0": 1.7e9, **STEP, **options}
    run = fa.propagate(BODY, Q0, W0, reduce=reduce, **given)
    assert run.q.dtype == np.float32
    assert run.reduced.dtype == np.float64
    assert np.abs(run.reduced[:, 0] - (1.7e9 + 3.0)).max() < 1e-6
    counted = start[:, 1]
    for _ in range(60):
        counted = counted + 1.0
    assert np.array_equal(run.reduced[:, 1], counted)
    options = {**given, "save_every": 1}
    q = fa.propagate(BODY, Q0, W0, **options).q[1:, :, 0].astype(np.float64)
    assert np.abs(run.reduced[:, 2] - 1e-3 * q.sum(axis=0)).max() < 60 * 1e-3 * 2.0**-23

    half = {**given, "n_steps": 30}
    begun = fa.propagate(BODY, Q0, W0, reduce=reduce, **half)
    begun.save_end(tmp_path / "end")
    with pytest.raises(ValueError, match="reduce: found 0; accepted: 3, as in the earlier run"):
        fa.propagate(BODY, resume=begun, dt=0.05, n_steps=30)
    rest = fa.propagate(BODY, resume=tmp_path / "end", reduce=reduce, dt=0.05, n_steps=30)
    assert np.array_equal(rest.reduced, run.reduced)


def test_states_of_a_called_function_in_a_float32_run():
    """One that is compiled for itself gets doubles and gives them, bodies in steps of their own."""
    reduce = fa.reducer(looped, start=(0.0, 1.7e9))
    assert not reduce.function.straight
    counts = RNG.integers(5, 40, size=N)
    options = {"dt": 2.0 / counts, "n_steps": counts, "method": "rk4", "dtype": np.float32}
    run = fa.propagate(BODY, Q0, W0, reduce=reduce, **options)
    assert np.array_equal(run.reduced[:, 1], 1.7e9 + counts)


def test_what_is_no_number_flags_the_body_alone():
    def grows(t, q, w, s):
        return s[0] * 1e200, s[1]

    start = np.ones((3, 2))
    start[1, 0] = 0.0
    run = fa.propagate(BODY, Q0[:3], W0[:3], reduce=fa.reducer(grows, start=start), **STEP)
    assert run.status.tolist() == [1, 0, 1]
    assert run.reduced[1].tolist() == [0.0, 1.0]


def test_refusals():
    with pytest.raises(ValueError, match=r"start\[1\] is inf; accepted: finite numbers"):
        fa.reducer(watch, start=(0.0, math.inf, 0.0))
    with pytest.raises(ValueError, match=r"start: has shape \(0,\) and is empty; accepted: \(k,\)"):
        fa.reducer(watch, start=())
    with pytest.raises(
        TypeError, match=r"reducer: found 3; accepted: a function reducer\(t, q, w, s"
    ):
        fa.reducer(3, start=0.0)
    with pytest.raises(TypeError, match=r"count.* accepted is a tuple of 2 floats, the next s"):
        fa.reducer(count, start=(0.0, 0.0))
    with pytest.raises(TypeError, match=r"reduce: found .*; accepted: a fastatt.reducer"):
        fa.propagate(BODY, Q0, W0, reduce=watch, **STEP)
    with pytest.raises(ValueError, match=r"method with reduce: found 'exact'; accepted: .*rk4"):
        fa.propagate(BODY, Q0, W0, reduce=WATCH, dt=0.1, n_steps=1, method="exact")
    with pytest.raises(
        ValueError, match=r"q0: found rows reduced 2, q0 70|w0: found rows w0 70, reduced 2, q0 70"
    ):
        fa.propagate(BODY, Q0, W0, reduce=fa.reducer(count, start=[[0.0], [1.0]]), **STEP)
    with pytest.raises(ValueError, match="reduced: the run had no reduce; accepted: one with"):
        _ = fa.propagate(BODY, Q0, W0, **STEP).reduced


def test_with_steps_of_each_bodys_own():
    """Every step of a body is seen, and what is stepped beside it by others is not."""
    counts = RNG.integers(5, 40, size=N)
    counted = fa.reducer(count, start=0.0)
    for reduce in (WATCH, counted):
        options = {"method": "rk4", "reduce": reduce}
        together = fa.propagate(BODY, Q0, W0, dt=2.0 / counts, n_steps=counts, **options)
        for b in (0, 40, N - 1):
            step = {"dt": 2.0 / counts[b], "n_steps": int(counts[b])}
            alone = fa.propagate(BODY, Q0[b], W0[b], **step, **options)
            assert together.reduced[b].tobytes() == alone.reduced.tobytes()
    assert (together.reduced.ravel() == counts).all()
