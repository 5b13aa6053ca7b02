"""Events beside times that are known, those of other methods, and the run without events."""

import itertools
import math

import numpy as np
import pytest
from each import in_tiers

import fastatt as fa

MOMENTS = np.array([3.0, 2.0, 1.0])
BODY = fa.Scene(inertia=MOMENTS)
CONE = fa.Scene(inertia=(1.0, 1.0, 2.0))
RNG = np.random.default_rng(4)
N = 70  # a tile and some
Q0 = RNG.normal(size=(N, 4))
Q0 /= np.linalg.norm(Q0, axis=1)[:, None]
W0 = RNG.normal(size=(N, 3))
RUN = {"dt": 0.02, "n_steps": 500}


def first_rate(t, q, w, p):
    return w[0] - 0.1


def height(t, q, w, p):
    return 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])


EVENTS = [fa.event(first_rate), fa.event(height, -1), fa.event(height, 1)]


@pytest.fixture(scope="module")
def free():
    return fa.propagate(BODY, Q0, W0, **RUN, method="rk8", events=EVENTS, save_every=50)


def still(t, q, w, p):
    return 0.0, 0.0, 0.0 * p[0]


def times(*events):
    """The times of the events of one body."""
    given = {"dt": 0.5, "n_steps": 20, "method": "rk8", "events": events}
    run = fa.propagate(CONE, [1, 0, 0, 0], [0.5, 0.0, 1.0], **given)
    assert not run.status.any()
    return run.event_times


BOUNDS = [("strang2", 2e-2), ("rk4", 2e-5), ("kahan_li8", 1e-9), ("dmv10", 1e-9)]


@pytest.mark.parametrize(("method", "bound"), in_tiers(BOUNDS[:2], BOUNDS))
def test_methods_locate_to_their_order(method, bound, free):
    found = fa.propagate(BODY, Q0, W0, **RUN, method=method, events=EVENTS).event_times
    assert np.array_equal(np.isnan(found), np.isnan(free.event_times))
    coarse = np.nanmax(abs(found - free.event_times))
    assert coarse < bound
    if method == "rk4":
        steps = {"dt": 0.01, "n_steps": 1000}
        fine = fa.propagate(BODY, Q0, W0, **steps, method=method, events=EVENTS).event_times
        assert np.nanmax(abs(fine - free.event_times)) < coarse / 10.0


OF_TIME = [
    (lambda t, q, w, p: t - 1.2345678, 0, 1.2345678),
    (lambda t, q, w, p: t - 1.2345678, -1, np.nan),
    (lambda t, q, w, p: (t - 3.3) ** 3, 1, 3.3),
    (lambda t, q, w, p: t - 2.5, 1, 2.5),  # at the end of a step
    (lambda t, q, w, p: t - 10.0, 0, 10.0),  # of the last one
    (lambda t, q, w, p: t, 0, np.nan),  # where the run begins
    (lambda t, q, w, p: t, -1, np.nan),
    (lambda t, q, w, p: 0.0 * t, 0, np.nan),
    # where a function reaches zero, or leaves it, and stays there
    (lambda t, q, w, p: max(0.0, t - 6.06), 1, 6.06),
    (lambda t, q, w, p: max(0.0, t - 6.06), -1, np.nan),
    (lambda t, q, w, p: max(0.0, 6.06 - t), -1, 6.06),
    (lambda t, q, w, p: max(0.0, 6.06 - t), 1, np.nan),
    (lambda t, q, w, p: max(0.0, 6.06 - t), 0, 6.06),
    (lambda t, q, w, p: max(-0.3, min(0.0, t - 4.44)), 1, 4.44),
    (lambda t, q, w, p: math.floor(t) - 2.0, 0, 2.0),
    (lambda t, q, w, p: math.floor(t) - 2.0, -1, np.nan),
    (lambda t, q, w, p: t - 10.1, 0, np.nan),
    (lambda t, q, w, p: math.sqrt(1.1 - t), 0, np.nan),
    (lambda t, q, w, p: abs(t - 1.7) + 1e-3, 0, np.nan),
]


def test_times_of_functions_of_time():
    events = [fa.event(g, direction) for g, direction, _ in OF_TIME]
    message = r"events\[\d+\]: found values that are not finite, and no crossing, for 1 of 1"
    with pytest.warns(RuntimeWarning, match=message) as told:
        run = fa.propagate(
            CONE, [1, 0, 0, 0], [0.5, 0.0, 1.0], dt=0.5, n_steps=20, method="rk8", events=events
        )
    assert len(told) == 1
    assert not run.status.any()
    wanted = np.array([x[2] for x in OF_TIME])
    triple = wanted == 3.3  # a root of order three
    np.testing.assert_allclose(run.event_times[triple], 3.3, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(run.event_times[~triple], wanted[~triple], rtol=0.0, atol=4e-15)


def test_a_crossing_at_a_save_has_the_time_of_the_save():
    given = {"dt": 0.1, "n_steps": 60, "method": "rk4", "save_every": 1}
    saves = fa.propagate(CONE, [1, 0, 0, 0], [0.5, 0.0, 1.0], **given).t
    scene = fa.Scene(inertia=(1.0, 1.0, 2.0), torque=still, params=saves[:, None])
    q0, reached = np.tile([1.0, 0.0, 0.0, 0.0], (61, 1)), fa.event(lambda t, q, w, p: t - p[0])
    run = fa.propagate(scene, q0, [0.5, 0.0, 1.0], **given, events=[reached])
    assert np.array_equal(run.event_times[1:, 0], saves[1:])
    assert np.isnan(run.event_times[0, 0])  # at the start


def test_the_direction_of_a_crossing_at_a_point_of_the_search():
    """A zero in the middle of the step [3, 3.5], where the search of two crossings begins."""
    events, wanted = [], []
    for sign in (1, -1):

        def twice(t, q, w, p, sign=sign):
            return sign * (t - 3.25) * (t - 3.35)

        events += [fa.event(twice, sign), fa.event(twice, -sign), fa.event(twice)]
        events += [fa.event(lambda t, q, w, p: (t - 3.25) ** 2, sign)]
        wanted += [3.35, 3.25, 3.25, 3.25]
    found = times(*events)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-7)
    crossed = np.arange(8) % 4 < 3
    np.testing.assert_allclose(found[crossed], np.array(wanted)[crossed], rtol=0.0, atol=1e-13)


def test_a_crossing_right_after_a_step_that_turns_back():
    """The function comes near zero in the step [3, 3.5], and crosses in the next."""
    found = times(fa.event(lambda t, q, w, p: ((t - 3.35) ** 2 + 1e-3) * (3.8 - t)))
    assert abs(found - 3.8) < 1e-13


def test_two_crossings_within_one_step():
    shapes = (
        lambda t, q, w, p: (t - p[0]) ** 2 - p[1] ** 2,
        lambda t, q, w, p: math.cos(0.3 * p[1]) - math.cos(0.3 * (t - p[0])),
        lambda t, q, w, p: ((t - p[0]) ** 2 - p[1] ** 2) * (10.0 + t - p[0]),
    )
    # middles and halves of intervals, a body each; some next to an end of a step
    middles = [0.25, 2.0, 2.004, 2.1, 2.31, 2.45, 2.496, 9.75]
    params = np.array([*itertools.product(middles, [1e-3, 0.03, 0.24])])
    scene = fa.Scene(inertia=(1.0, 1.0, 2.0), torque=still, params=params)
    events = [fa.event(g, direction) for g in shapes for direction in (0, -1, 1)]
    given = {"dt": 0.5, "n_steps": 20, "method": "rk8", "events": events}
    q0 = np.tile([1.0, 0.0, 0.0, 0.0], (len(params), 1))
    found = fa.propagate(scene, q0, [0.5, 0.0, 1.0], **given).event_times
    first, second = params[:, 0] - params[:, 1], params.sum(axis=1)
    wanted = np.stack([first, first, second] * 3, axis=1)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("method", in_tiers(["dmv10"], ["rk4", "strang2", "dmv10"]))
def test_a_terminal_event_keeps_the_state(method):
    events = [fa.event(height, -1), fa.event(first_rate, terminal=True)]
    given = {**RUN, "method": method, "save_every": 5}
    plain = fa.propagate(BODY, Q0, W0, **given, events=[events[0], fa.event(first_rate)])
    run = fa.propagate(BODY, Q0, W0, **given, events=events)
    end = run.event_times[:, 1]
    assert not run.status.any()
    assert 0 < np.isnan(end).sum() < N
    for body in range(N):
        late = run.t >= end[body]
        assert np.array_equal(run.q[~late, body], plain.q[~late, body])
        assert np.abs(run.w[late, body, 0] - 0.1).max(initial=0.0) < 1e-12
        assert (run.q[late, body] == run.q[-1, body]).all()
        assert not run.event_times[body, 0] > end[body]
    early = np.isnan(end) | (run.event_times[:, 0] <= end)
    free = plain.event_times[:, 0]
    assert np.array_equal(run.event_times[early, 0], free[early], equal_nan=True)
    assert np.isnan(run.event_times[~early, 0]).all()


@pytest.mark.parametrize("sign", in_tiers([-1], [1, -1]))
def test_the_first_of_some_terminal_events_ends_a_body(sign):
    ends = sign * np.array([1.013, 1.011, 1.012])
    events = [fa.event(lambda t, q, w, p, k=k: t - k, terminal=True) for k in ends.tolist()]
    given = {"dt": sign * 0.02, "n_steps": 500, "method": "rk4"}
    run = fa.propagate(BODY, Q0, W0, **given, events=events)
    assert np.isnan(run.event_times[:, [0, 2]]).all()
    np.testing.assert_allclose(run.event_times[:, 1], ends[1], rtol=1e-15)
    alone = fa.propagate(BODY, Q0, W0, **given, events=events[1:2])
    assert np.array_equal(run.q, alone.q)


@pytest.mark.parametrize("method", ["strang2", "rk4"])
def test_a_terminal_event_ends_as_a_run_of_that_length_does(method):
    """Of a torque that changes with time, of which strang2 takes a part after its last step."""
    table = fa.TimeSeries(0.1 * np.arange(20), RNG.normal(size=(20, 3)), kind="linear")
    scene = fa.Scene(inertia=MOMENTS, torque=fa.torques.Constant(table))
    end = fa.event(lambda t, q, w, p: t - 0.905, terminal=True)
    given = {"q0": Q0[0], "w0": W0[0], "dt": 0.1, "method": method}
    run = fa.propagate(scene, **given, n_steps=15, events=[end])
    alone = fa.propagate(scene, **given, t_end=0.905)
    np.testing.assert_allclose(run.w[-1], alone.w[-1], rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(run.q[-1], alone.q[-1], rtol=0.0, atol=1e-14)


def test_a_terminal_event_at_a_save_keeps_the_state_of_the_save():
    given = {"q0": Q0[0], "w0": W0[0], "dt": 0.125, "n_steps": 16, "method": "rk4"}
    plain = fa.propagate(BODY, **given, save_every=4)
    end = fa.event(lambda t, q, w, p: t - 1.0, terminal=True)
    run = fa.propagate(BODY, **given, save_every=4, events=[end])
    assert run.event_times[0] == plain.t[2] == 1.0
    for q, wanted in zip(run.q, plain.q[[0, 1, 2, 2, 2]], strict=True):
        np.testing.assert_allclose(q, wanted, rtol=0.0, atol=4e-16)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_terminal_event_keeps_a_prescribed_rate(sign):
    scene = fa.Scene(rate=lambda t, p: (t, p[0], 0.0), params=[[0.905], [1.31], [9.0]])
    reached = fa.event(lambda t, q, w, p: abs(t) - p[0], terminal=True)
    events = [fa.event(lambda t, q, w, p: abs(t) - 0.2), reached]
    given = {"dt": sign * 0.1, "n_steps": 30, "method": "rk4", "save_every": 1, "events": events}
    run, pieces = fa.propagate(scene, Q0[:3], **given), []
    ends = np.array([0.905, 1.31, 9.0])
    np.testing.assert_allclose(run.w[..., 0], sign * np.minimum(sign * run.t[:, None], ends))
    fa.propagate(scene, Q0[:3], **given, on_save=lambda piece: pieces.append(piece.w))
    assert np.array_equal(np.concatenate(pieces), run.w)


def test_single_precision_and_compensated_runs(free):
    single = fa.propagate(BODY, Q0, W0, **RUN, method="rk8", events=EVENTS, dtype="float32")
    same = np.isnan(single.event_times) == np.isnan(free.event_times)
    assert same.mean() > 0.98  # a touch is found or not
    assert np.nanmedian(abs(single.event_times - free.event_times)) < 1e-5
    carried = fa.propagate(BODY, Q0, W0, **RUN, method="rk8", events=EVENTS, compensated=True)
    np.testing.assert_allclose(carried.event_times, free.event_times, rtol=0.0, atol=1e-11)


def test_a_function_that_is_not_traced():
    def counted(t, q, w, p):
        total, k = 0.0, 0
        while total < abs(t) and k < 100:
            total += 0.5
            k += 1
        return t - 1.3 - 1e-9 * (k - k % 100)

    assert abs(times(fa.event(counted)) - 1.3) < 1e-8


def test_a_function_that_is_no_number_flags_nothing():
    g = fa.event(lambda t, q, w, p: math.log(w[0]) if t > 0.0 else math.nan)
    with pytest.warns(RuntimeWarning, match=r"events\[0\]: found values that are not finite"):
        run = fa.propagate(BODY, Q0, W0, **RUN, method="rk4", events=[g])
    assert not run.status.any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("later", [0.0, 1e-15, 1e-12])
def test_a_run_that_begins_at_an_event_goes_on_to_the_next(sign, later):
    """Each root once, in loops that begin a run at the last one, or right after it."""
    g, roots, t = fa.event(lambda t, q, w, p: math.cos(t) + 0.9), [], 0.0
    while t < 18.0:
        run = fa.propagate(
            BODY, Q0[0], W0[0], t0=sign * t, dt=sign * 0.3, t_end=sign * 18.0, method="rk4",
            events=[g],
        )  # fmt: skip
        if np.isnan(run.event_times[0]):
            break
        roots.append(sign * run.event_times[0])
        t = roots[-1] * (1.0 + later)
    first = math.acos(-0.9)
    wanted = [2.0 * math.pi * k + s * first for k in range(4) for s in (1, -1)]
    np.testing.assert_allclose(roots, sorted(x for x in wanted if 0.0 < x < 18.0), rtol=1e-14)


def test_a_run_that_begins_at_an_event_of_the_motion():
    """The state has rounding errors: in float32 the zero is not to the last digit of a double."""
    for dtype in ("float64", "float32"):
        g, ends = fa.event(lambda t, q, w, p: w[0], terminal=True), []
        q, w, t = Q0[0], W0[0], 0.0
        while t < 30.0:
            run = fa.propagate(
                BODY, q, w, t0=t, dt=0.1, t_end=30.0, method="rk8", dtype=dtype, events=[g]
            )
            if np.isnan(run.event_times[0]):
                break
            q, w, t = run.q[-1], run.w[-1], float(run.event_times[0])
            ends.append(t)
        assert len(ends) > 3
        assert np.diff(ends).min() > 0.5
