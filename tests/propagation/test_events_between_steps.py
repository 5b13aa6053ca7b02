"""Events of runs with ``save_at``, with per-body step sizes, and of runs that are resumed."""

import numpy as np
import pytest
from each import in_tiers
from test_events import BODY, MOMENTS, Q0, W0, N, first_rate, height

import fastatt as fa

SIZES = np.random.default_rng(4).uniform(0.011, 0.03, N)  # s
END = 10.0


def late(t, q, w, p):
    """A time in the last, shorter step of most bodies."""
    return t - 9.9987


def touch(t, q, w, p):
    """Two crossings within one step."""
    return (t - 9.9975) ** 2 - 1e-6


FREE = [fa.event(first_rate), fa.event(height, -1), fa.event(late), fa.event(touch)]
STOPS = [fa.event(first_rate, terminal=True), *FREE[1:]]
#: save times within steps and at their ends
TIMES = np.sort(np.concatenate([np.linspace(0.0, END, 37), np.arange(0.0, END, 0.5)]))


def run(events, scene=BODY, method="rk8", dt=0.02, **options):
    given = {"t_end": END} | options
    return fa.propagate(scene, Q0, W0, dt=dt, method=method, events=events, **given)


@pytest.fixture(scope="module")
def reference():
    """Times of events and of stops by whole steps of one size."""
    return {name: run(e, save_every=25) for name, e in (("free", FREE), ("stops", STOPS))}


def assert_stopped(found, k):
    """Body ``k`` holds its state at the terminal event from then on, and no other one before."""
    is_late = found.t >= found.event_times[k, 0]
    assert (found.q[is_late, k] == found.q[-1, k]).all()
    assert np.abs(found.w[is_late, k, 0] - 0.1).max(initial=0.0) < 1e-12


@pytest.mark.parametrize("name", in_tiers(["stops"], ["free", "stops"]))
def test_per_body_step_sizes(reference, name):
    found = run(STOPS if name == "stops" else FREE, dt=SIZES, save_at=TIMES)
    np.testing.assert_allclose(found.event_times, reference[name].event_times, rtol=0.0, atol=1e-11)
    assert np.isfinite(found.event_times).any(axis=0).all()
    for k in range(N) if name == "stops" else ():
        assert_stopped(found, k)


def test_per_body_steps_of_a_run_backwards(reference):
    start = reference["free"]
    back = fa.propagate(
        BODY, start.q[-1], start.w[-1], t0=END, dt=-SIZES, t_end=0.0, method="rk8",
        events=[fa.event(first_rate, terminal=True)], save_at=TIMES[::-1],
    )  # fmt: skip
    forward = fa.propagate(
        BODY, start.q[-1], start.w[-1], t0=END, dt=-0.02, n_steps=500, method="rk8",
        events=[fa.event(first_rate)],
    )  # fmt: skip
    np.testing.assert_allclose(back.event_times, forward.event_times, rtol=0.0, atol=1e-11)
    for k in range(N):
        is_late = back.t <= back.event_times[k, 0]
        assert (back.q[is_late, k] == back.q[-1, k]).all()


def test_saves_after_a_stop_in_the_last_shorter_step():
    found = run([fa.event(late, terminal=True)], dt=SIZES, save_at=[9.9985, 9.9988, 9.9995, END])
    np.testing.assert_allclose(found.event_times, [[9.9987]] * N, rtol=0.0, atol=1e-14)
    assert (found.q[1:] == found.q[-1]).all()
    assert (found.q[0] != found.q[1]).any(axis=1).all()


@pytest.mark.parametrize("dt", [0.1, [0.1, 0.07]])
def test_events_after_the_last_save(dt):
    """The run goes on to its end: after a save within a step, and after a breakpoint."""
    scene = fa.Scene(inertia=MOMENTS, torque=lambda t, q, w, p: (0.0, 0.0, 0.1), breakpoints=(9.5,))
    events = [fa.event(lambda t, q, w, p, k=k: t - k) for k in (2.0, 9.3, 9.6)]
    given = {"dt": dt, "t_end": 10.0, "method": "rk8", "save_at": [2.0, 9.25]}
    run = fa.propagate(scene, Q0[:2], W0[:2], events=events, **given)
    np.testing.assert_allclose(run.event_times, [[2.0, 9.3, 9.6]] * 2, rtol=0.0, atol=1e-14)
    plain = fa.propagate(scene, Q0[:2], W0[:2], **given)
    np.testing.assert_array_equal(run.q, plain.q)
    np.testing.assert_array_equal(run.t, [2.0, 9.25])


def test_steps_after_the_end_of_a_body_set_no_status():
    """Bodies with larger steps reach the end first, while their lanes go on beside the others."""
    spin_up = fa.Scene(inertia=(1.0, 1.0, 1.0), torque=lambda t, q, w, p: (0.0, 0.0, 2.0 * t))
    given = {"dt": [0.001, 0.1], "t_end": 2.0, "method": "rk8"}
    found = fa.propagate(
        spin_up, Q0[:2], [0.0, 0.0, 0.0], events=[fa.event(lambda t, q, w, p: w[2] - 1.0)], **given
    )
    assert not found.status.any()
    np.testing.assert_allclose(found.event_times, 1.0, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("stops", in_tiers([5e-4], [-1e-3, 5e-4, None]))
def test_beside_breakpoints(stops):
    """A torque that jumps in the middle of steps; a crossing right before and after the jump."""
    jump = 3.3333
    scene = fa.Scene(
        inertia=MOMENTS, breakpoints=(jump,),
        torque=lambda t, q, w, p: (0.3 if t > jump else 0.0, 0.0, 0.1),
    )  # fmt: skip
    events = [
        fa.event(lambda t, q, w, p: (t - jump - 1e-3) ** 2 - 2.5e-7, terminal=stops == 5e-4),
        fa.event(lambda t, q, w, p: t - jump + 1e-3, terminal=stops == -1e-3),
        fa.event(lambda t, q, w, p: t - jump),
        fa.event(first_rate),
    ]
    times = np.sort(np.concatenate([TIMES, [jump - 2e-3, jump - 5e-4, jump, jump + 7e-4]]))
    whole = run(events, scene, save_every=1)
    wanted = np.array([jump + 5e-4, jump - 1e-3, jump])
    wanted[wanted > jump + (END if stops is None else stops)] = np.nan
    np.testing.assert_allclose(whole.event_times[:, :3], [wanted] * N, rtol=0.0, atol=1e-12)
    for dt in (0.02, SIZES):
        found = run(events, scene, dt=dt, save_at=times)
        np.testing.assert_allclose(found.event_times, whole.event_times, rtol=0.0, atol=1e-11)
        if stops is not None:
            is_late = found.t >= jump + stops
            assert (found.q[is_late] == found.q[-1]).all()
            assert (found.q[~is_late][-1] != found.q[-1]).any(axis=1).all()


@pytest.mark.parametrize("events", [FREE, STOPS], ids=["free", "stops"])
def test_a_resumed_run_takes_other_events(events):
    """They are searched from there on, unless a body has stopped."""
    first = fa.propagate(BODY, Q0, W0, n_steps=130, dt=0.02, method="rk8", events=events)
    others = [fa.event(lambda t, q, w, p, k=k: t - k) for k in (1.0, 5.0)]
    if events is STOPS:
        with pytest.raises(ValueError, match=r"events: found others .*since bodies stop"):
            fa.resume(BODY, first, n_steps=370, events=others)
    else:
        other = fa.resume(BODY, first, n_steps=370, events=others).event_times
        np.testing.assert_allclose(other, [[np.nan, 5.0]] * N, rtol=0.0, atol=1e-14)
