"""Attitudes and rates between saves, beside closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from exact import EPS, START, angle, precession

import fastatt as fa

# transverse rate, axial rate, frequency, phase
BODIES = [(0.7, 0.4, 0.9, 0.3), (0.2, -1.0, 1.3, -1.0), (0.0, 0.5, 0.0, 0.0)]


def motion(t, bodies=BODIES):
    """Attitudes (S, N, 4) and rates (S, N, 3) of precessing bodies."""
    t = np.asarray(t, float)
    q, w = [], []
    for a, s, k, phase in bodies:
        q.append(precession(t, a, s, k, phase, START))
        x = k * t + phase
        w.append(np.stack([a * np.cos(x), a * np.sin(x), s + 0 * t], axis=-1))
    return np.stack(q, axis=-2), np.stack(w, axis=-2)


def errors(saves, times, **options):
    q, w = fa.interpolate(saves, *motion(saves), times, **options)
    exact = motion(times)
    return angle(q, exact[0]).max(), np.abs(w - exact[1]).max()


@pytest.mark.parametrize("saves", [2, 3, 4])
def test_orders(saves):
    """Of attitudes twice the number of saves, of rates one less: Hermite's error term."""
    coarse, fine = (
        errors(np.linspace(0.0, h * (saves - 1), saves), np.linspace(0.0, h * (saves - 1), 41))
        for h in (0.2, 0.1)
    )
    found = np.log2(np.array(coarse) / fine)
    assert np.abs(found - [2 * saves, 2 * saves - 1]).max() < 0.25, found


def test_long_histories_at_uneven_saves():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.05, 0.1, 150))
    times = rng.uniform(t[0], t[-1], 300)
    # frequencies are below 2 rad/s: ψ⁽⁸⁾/8! Π (t − t_j)², the product at most 0.1⁸
    bound = 2.0**8 / 40320 * 0.1**8
    assert errors(t, times)[0] <= bound
    forth, back = (fa.interpolate(t[::k], *(x[::k] for x in motion(t)), times) for k in (1, -1))
    assert angle(forth[0], back[0]).max() <= 16 * EPS
    assert np.abs(forth[1] - back[1]).max() <= 64 * EPS / 0.05


def test_saves_themselves_and_signs():
    t = np.linspace(-1.0, 1.0, 9)
    q, w = motion(t)
    found = fa.interpolate(t, q, w, t)
    assert np.abs(found[0] - q).max() <= 4 * EPS
    assert np.abs(found[1] - w).max() <= 4 * EPS
    between = np.array([0.1, -0.9])
    turned = q * np.where(np.arange(9) % 2, -3.0, 2.0)[:, None, None]
    assert angle(
        fa.interpolate(t, turned, w, between)[0], fa.interpolate(t, q, w, between)[0]
    ).max() <= (8 * EPS)


def test_shapes_and_precision():
    t = np.linspace(0.0, 2.0, 5)
    q, w = motion(t)
    many = fa.interpolate(t, q, w, [0.3, 1.7])
    assert [x.shape for x in many] == [(2, 3, 4), (2, 3, 3)]
    one = fa.interpolate(t, q[:, 1], w[:, 1], 1.7)
    assert [x.shape for x in one] == [(4,), (3,)]
    assert np.array_equal(one[0], many[0][1, 1])
    single = fa.interpolate(t, q.astype(np.float32), w.astype(np.float32), 1.7)
    assert single[0].dtype == single[1].dtype == np.float32
    assert angle(single[0], many[0][1]).max() <= 16 * 2.0**-23


def test_turns_past_half_a_turn_are_refused_or_left_out():
    t = np.linspace(0.0, 8.0, 5)
    bodies = [*BODIES[2:], (0.0, 1.6, 0.0, 0.0)]  # 3.2 rad from save to save
    q, w = motion(t, bodies)
    with pytest.raises(ValueError, match=r"between saves 0 and 1 body 1 rotates by 3.2 rad"):
        fa.interpolate(t, q, w, 1.0)
    found = fa.interpolate(t, q, w, [1.0, 5.0], invalid="flag")
    alone = fa.interpolate(t, q[:, :1], w[:, :1], [1.0, 5.0])
    for x, y in zip(found, alone, strict=True):
        assert np.isnan(x[:, 1]).all()
        assert np.array_equal(x[:, :1], y)


def test_one_bad_body_leaves_the_others():
    t = np.linspace(0.0, 2.0, 5)
    q, w = motion(t)
    spoilt = w.copy()
    spoilt[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"w\[2, 1, 0\] is nan"):
        fa.interpolate(t, q, spoilt, 1.0)
    found, fine = (fa.interpolate(t, q, x, 1.1, invalid="flag") for x in (spoilt, w))
    assert np.isnan(found[0][1]).all()
    assert np.array_equal(found[0][[0, 2]], fine[0][[0, 2]])


def test_motion_that_saves_do_not_show_warns():
    """A rate that swings within the interval, 1 rad/s at every save."""
    t = np.arange(6.0)
    w = np.stack([np.where(np.arange(6) % 2, 3.0, -3.0), 0 * t, 0 * t], axis=1)
    with pytest.warns(fa.StepWarning, match="too far apart for their motion"):
        fa.interpolate(t, np.tile([1.0, 0.0, 0.0, 0.0], (6, 1)), w, 2.5)


def test_motion_that_saves_do_not_show_is_noticed_among_many_times():
    """More than are gathered at a time: the first of them alone is in doubt."""
    t = np.arange(12.0)
    w = np.zeros((12, 2, 3))
    w[:4, 1, 0] = [3.0, -3.0, 3.0, -3.0]
    still = np.tile([1.0, 0.0, 0.0, 0.0], (12, 2, 1))
    times = np.concatenate([[1.5], np.full(70_000, 9.5)])
    told = r"saves of 1 of 2 bodies are too far apart .* up to 0\.\d+ rad .*\(body 1\)"
    for order in (times, times[::-1]):
        with pytest.warns(fa.StepWarning, match=told):
            fa.interpolate(t, still, w, order)


def test_what_is_refused_says_how_near_saves_have_to_be():
    """3.2 rad between saves 2 s apart: π rad take 1.96 s."""
    t = np.linspace(0.0, 8.0, 5)
    q, w = motion(t, [*BODIES[2:], (0.0, 1.6, 0.0, 0.0)])
    with pytest.raises(ValueError, match=r"\(1 of 2 bodies\); .* saves 1\.96 s apart"):
        fa.interpolate(t, q, w, 1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t": [0.0, 1.0, 1.0]}, "t: found .* rising or falling"),
        ({"times": 2.1}, r"times\[0\] is 2.1; accepted: 0.0 to 2.0"),
        ({"w": np.zeros((3, 2, 3))}, r"w: has shape \(3, 2, 3\); accepted: \(3, 3\)"),
        ({"q": np.zeros((3, 4))}, r"q\[0\] is the zero quaternion"),
        ({"invalid": "drop"}, "invalid: found 'drop'; accepted: raise, flag"),
    ],
)
def test_refusals(change, message):
    t = [0.0, 1.0, 2.0]
    q, w = motion(t, BODIES[2:])
    given = {"t": t, "q": q[:, 0], "w": w[:, 0], "times": 0.5} | change
    with pytest.raises(ValueError, match=message):
        fa.interpolate(**given)


# other numbers of a run


def waves(t):
    """Numbers (S, 2, 3)."""
    t = np.asarray(t, float)
    return np.stack([np.sin((1.0 + k) * t + k) for k in range(6)], axis=-1).reshape(*t.shape, 2, 3)


@pytest.mark.parametrize("saves", [4, 8, 12])
def test_orders_of_states(saves):
    """The number of saves, up to eight, in the middle and at the ends."""
    found = []
    for h in (0.05, 0.025):
        t = np.linspace(0.0, -h * (saves - 1), saves)
        times = np.linspace(t[0], t[-1], 97)
        found.append(np.abs(fa.interpolate_states(t, waves(t), times) - waves(times)).max())
    assert np.log2(found[0] / found[1]) == pytest.approx(min(saves, 8), abs=0.4)


def test_states_at_saves_and_of_one_body():
    t = np.cumsum(np.random.default_rng(3).uniform(0.05, 0.2, 30))
    assert (fa.interpolate_states(t, waves(t), t) == waves(t)).all()
    single = fa.interpolate_states(t, waves(t)[:, 1].astype(np.float32), float(t[4]))
    assert single.shape == (3,)
    assert single.dtype == np.float32


def test_bad_states_stay_in_their_column():
    t = np.linspace(0.0, 3.0, 31)
    spoilt = waves(t)
    spoilt[20, 1, 0] = np.nan
    times = np.array([0.75, 2.03])
    got, whole = (fa.interpolate_states(t, x, times) for x in (spoilt, waves(t)))
    assert np.isnan(got[1, 1, 0])
    assert np.isnan(got).sum() == 1
    assert (got[~np.isnan(got)] == whole[~np.isnan(got)]).all()


def test_states_that_change_too_fast_warn():
    t = np.linspace(0.0, 30.0, 31)
    with pytest.warns(fa.StepWarning, match="1 of 2 columns"):
        fa.interpolate_states(t, np.stack([np.sin(2.9 * t), 3.0 + 0.0 * t], axis=1), t[:-1] + 0.5)


@pytest.mark.parametrize(
    ("t", "s", "times", "message"),
    [
        ([0.0, 0.0], np.zeros((2, 1)), 0.0, "rising or falling"),
        ([0.0, 1.0], np.zeros((3, 1)), 0.0, "s: has shape"),
        ([0.0, 1.0], np.zeros((2, 1)), [0.5, 1.5], r"times\[1\] is 1.5; accepted: 0.0 to 1.0"),
    ],
)
def test_refused_states(t, s, times, message):
    with pytest.raises(ValueError, match=message):
        fa.interpolate_states(t, s, times)
