"""Events of runs whose steps are taken in parts, beside a motion that is known in closed form."""

import math

import numpy as np
import pytest

import fastatt as fa

# with steps of 0.25 s two of them lie in one step, one on a step's end
BREAKS = (1.03, 1.11, 2.5, 3.707)
END, DT = 5.0, 0.25
# before, at and after each breakpoint, in shorter steps and in whole ones, and at their ends
TIMES = np.array([
    0.9, 1.0, 1.015, 1.03, 1.0300001, 1.05, 1.11, 1.2, 1.25, 1.3, 1.6, 2.4, 2.4999999, 2.5,
    2.5000001, 2.6, 2.75, 3.6, 3.7, 3.707, 3.7072, 3.74, 3.75, 3.9, 4.3, 4.9999,
])  # fmt: skip


def pushed(t, q, w, p):
    """A torque about the third axis, whose jumps change the sign of the acceleration's change."""
    return 0.0, 0.0, 0.2 + (1.0 if 1.03 < t < 1.11 or 2.5 < t < 3.707 else 0.0) + 0.0 * p[0]


def rate(t):
    """w about the third axis, of a moment of 1 kg·m²."""
    on = sum(np.clip(t - a, 0.0, b - a) for a, b in (BREAKS[:2], BREAKS[2:]))
    return 0.1 + 0.2 * t + on


def reaches(t, q, w, p):
    return w[2] - p[0]


def scene_of(levels, breakpoints=BREAKS):
    """Bodies with a number each."""
    return fa.Scene(
        inertia=(2.0, 2.0, 1.0), torque=pushed, params=levels[:, None], breakpoints=breakpoints
    )


def start(bodies, w=0.1):
    return np.tile([1.0, 0.0, 0.0, 0.0], (bodies, 1)), [0.0, 0.0, w]


SCENE, START = scene_of(rate(TIMES)), start(TIMES.size)


@pytest.mark.parametrize("method", ["rk4", "rkmk4"])
@pytest.mark.parametrize("dt", [DT, 0.07])
def test_times_before_at_and_after_breakpoints(method, dt):
    for direction, wanted in ((1, TIMES), (-1, np.full(TIMES.size, np.nan))):
        events = [fa.event(reaches, direction)]
        run = fa.propagate(SCENE, *START, dt=dt, t_end=END, method=method, events=events)
        np.testing.assert_allclose(run.event_times[:, 0], wanted, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("half", [1e-4, 0.005])
def test_two_crossings_in_a_part_of_a_step(half):
    middles = np.array([0.51, 1.015, 1.035, 1.05, 1.1, 1.13, 1.24, 1.26, 2.48, 2.51, 3.7, 3.72])

    def near(t, q, w, p):
        return (t - p[0]) ** 2 - half**2

    scene = scene_of(middles)
    given = {"dt": DT, "t_end": END, "method": "rk8"}
    events = [fa.event(near), fa.event(near, -1), fa.event(near, 1)]
    found = fa.propagate(scene, *start(middles.size), **given, events=events).event_times
    wanted = np.stack([middles - half, middles - half, middles + half], axis=1)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-9)


def held_by(t, q, w, p):
    return 0.0, 0.0, (0.3 if t < 1.03 else math.sqrt(2.0 - t))


@pytest.mark.parametrize("method", ["strang2", "rk4"])
def test_what_comes_after_a_terminal_event_sets_no_status(method):
    """A torque that ends after 2 s; splittings look at it where a step begins and ends."""
    torque = fa.torques.Custom(held_by, uses_rate=False)
    scene = fa.Scene(inertia=(2.0, 2.0, 1.0), torque=torque, breakpoints=(1.03, 1.53, 2.6))
    end = fa.event(lambda t, q, w, p: t - 1.6, terminal=True)
    given = {"dt": 0.1, "t_end": 4.0, "method": method}
    run = fa.propagate(scene, *start(1), **given, events=[end])
    assert run.status[0] == 0
    assert run.event_times[0, 0] == pytest.approx(1.6, abs=1e-14)
    assert fa.propagate(scene, *start(1), **given).status[0]


def test_a_rate_that_jumps_across_zero_crosses_at_the_breakpoint():
    scene = fa.Scene(rate=lambda t, p: (0.3 if t < 1.03 else 1.3, 0.0, 0.0), breakpoints=(1.03,))
    for method in ("magnus4", "rk4"):
        run = fa.propagate(
            scene, [1, 0, 0, 0], dt=DT, n_steps=8, method=method,
            events=[fa.event(lambda t, q, w, p: w[0] - 0.5)],
        )  # fmt: skip
        assert run.event_times[0] == pytest.approx(1.03, abs=1e-15)


def test_sampled_controllers():
    """Rates are straight lines between sample times, at which they bend."""
    control = fa.torques.SampledControl(lambda t, q, w, p: (0.0, 0.0, -0.8 * w[2] - 0.3), 0.5)
    scene = fa.Scene(inertia=(2.0, 2.0, 1.0), torque=control)
    w, wanted = 1.0, []
    for k in range(4):
        slope = -0.8 * w - 0.3
        wanted += [0.5 * k - (w - x) / slope for x in (0.5, 0.1) if w > x >= w + 0.5 * slope]
        w += 0.5 * slope
    levels = (0.5, 0.1)
    events = [fa.event(lambda t, q, w, p, x=x: w[2] - x) for x in levels]
    for dt in (0.1, 0.07, 0.5):
        run = fa.propagate(
            scene, [1, 0, 0, 0], [0.0, 0.0, 1.0], s0=[0, 0, 0], dt=dt, t_end=2.0, method="rk8",
            events=events,
        )  # fmt: skip
        np.testing.assert_allclose(run.event_times, wanted, rtol=0.0, atol=1e-12)
