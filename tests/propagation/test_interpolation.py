"""Attitudes, rates and what a run carries between saves, beside closed forms."""

import itertools
import pickle
from dataclasses import replace

import numpy as np
import pytest
from exact import EPS, START, angle, precession
from scipy.spatial.transform import Rotation, RotationSpline

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


def test_turns_past_half_a_turn_are_left_out():
    """3.2 rad between saves 2 s apart: π rad take 1.96 s."""
    t = np.linspace(0.0, 8.0, 5)
    q, w = motion(t, [*BODIES[2:], (0.0, 1.6, 0.0, 0.0)])
    told = r"t: 1 of 2 bodies rotate .*\(body 1 by 3\.2 rad after save 0\).* save every 1\.96 s"
    with pytest.warns(fa.StepWarning, match=told):
        found = fa.interpolate(t, q, w, [1.0, 5.0])
    alone = fa.interpolate(t, q[:, :1], w[:, :1], [1.0, 5.0])
    assert_left_out(found, alone, [0])


def assert_left_out(found, whole, others):
    """Body 1 has no numbers, the others have theirs."""
    for x, y in zip(found, whole, strict=True):
        assert np.isnan(x[:, 1]).all()
        assert np.array_equal(x[:, others], y[:, others])


def test_one_lost_body_leaves_the_others():
    w0 = np.array([[0.1, 0.2, 0.3], [1e200] * 3, [0.0, 0.2, 0.3]])
    given = {"dt": 0.1, "n_steps": 4, "save_every": 1, "method": "rk4"}
    scene = fa.Scene(inertia=(2.0, 1.0, 0.7))
    with pytest.warns(fa.StepWarning, match="dt: a step of body 1"):
        run = fa.propagate(scene, [START] * 3, w0, **given)
    with pytest.warns(fa.StepWarning, match="body 1"):
        found = fa.interpolate(run, 0.11)
    fine = fa.interpolate(fa.propagate(scene, [START] * 3, w0[[0, 0, 2]], **given), 0.11)
    assert_left_out((found.q, found.w), (fine.q, fine.w), [0, 2])


def test_motion_that_saves_do_not_show_warns():
    """A rate that swings within the interval, 1 rad/s at every save."""
    t = np.arange(6.0)
    w = np.stack([np.where(np.arange(6) % 2, 3.0, -3.0), 0 * t, 0 * t], axis=1)
    with pytest.warns(fa.StepWarning, match="too far apart for their motion"):
        fa.interpolate(t, np.tile([1.0, 0.0, 0.0, 0.0], (6, 1)), w, 2.5)


# a run


def waves(t):
    """Numbers (S, 2, 3)."""
    t = np.asarray(t, float)
    return np.stack([np.sin((1.0 + k) * t + k) for k in range(6)], axis=-1).reshape(*t.shape, 2, 3)


def rest(t, **carried):
    """A run of two bodies at rest with saves at t and other numbers."""
    scene = fa.Scene(inertia=(1.0, 2.0, 2.5))
    run = fa.propagate(scene, [START, START], np.zeros(3), dt=1.0, n_steps=1, method="rk4")
    still = {"w": np.zeros((len(t), 2, 3)), **carried}
    state, errors = np.repeat(run.state, len(t), axis=0), np.zeros((len(t), 2))
    return replace(run, t=np.asarray(t), state=state, norm_error=errors, carried=still, end=None)


def states(t, s, times):
    return fa.interpolate(rest(t, s=s), times).s


@pytest.mark.parametrize("saves", [4, 8, 12])
def test_orders_of_states(saves):
    """The number of saves, up to eight, in the middle and at the ends."""
    found = []
    for h in (0.05, 0.025):
        t = np.linspace(0.0, -h * (saves - 1), saves)
        times = np.linspace(t[0], t[-1], 97)
        found.append(np.abs(states(t, waves(t), times) - waves(times)).max())
    assert np.log2(found[0] / found[1]) == pytest.approx(min(saves, 8), abs=0.4)


def test_states_at_saves_and_in_single_precision():
    t = np.cumsum(np.random.default_rng(3).uniform(0.05, 0.2, 30))
    assert (states(t, waves(t), t) == waves(t)).all()
    single = states(t, waves(t).astype(np.float32), float(t[4]))
    assert single.shape == (1, 2, 3)
    assert single.dtype == np.float32


def test_bad_states_stay_in_their_column():
    t = np.linspace(0.0, 3.0, 31)
    spoilt = waves(t)
    spoilt[20, 1, 0] = np.nan
    times = np.array([0.75, 2.03])
    found, whole = (states(t, x, times) for x in (spoilt, waves(t)))
    assert np.isnan(found[1, 1, 0])
    assert np.isnan(found).sum() == 1
    assert (found[~np.isnan(found)] == whole[~np.isnan(found)]).all()


def test_states_that_change_too_fast_warn():
    t = np.linspace(0.0, 30.0, 31)
    fast = np.stack([np.sin(2.9 * t), 3.0 + 0.0 * t], axis=1)[:, :, None]
    with pytest.warns(fa.StepWarning, match="1 of 2 columns of s, up to"):
        states(t, fast, t[:-1] + 0.5)


@pytest.mark.parametrize("representation", ["quat", "dcm"])
@pytest.mark.parametrize("bodies", [1, 3])
def test_a_run_is_interpolated_as_its_arrays(representation, bodies):
    scene, times = fa.Scene(inertia=(1.0, 2.0, 2.5)), [1.93, 0.24, 1.0]
    given = {"dt": 0.1, "n_steps": 20, "save_every": 1, "representation": representation}
    q0 = [START] * bodies if bodies > 1 else START
    run = fa.propagate(scene, q0, [0.3, -0.2, 0.5], **given, method="rk8")
    between, (q, w) = fa.interpolate(run, times), fa.interpolate(run.t, run.q, run.w, times)
    assert np.array_equal(between.q, q)
    assert np.array_equal(between.w, w)
    assert between.t.tolist() == times
    assert between.norm_error.tolist() == run.norm_error[[19, 2, 10]].tolist()
    assert (between.representation, between.method) == ("quat", "rk8")
    assert np.abs(between.dcm - fa.quat_to_dcm(q)).max() < 4 * EPS
    assert fa.drift(between, scene).energy.max() < 1e-9
    assert fa.interpolate(run, times=0.24).q.shape == (1, *q.shape[1:])


def test_velocities_positions_and_states_of_a_run():
    def driven(t, q, w, s, p):
        return (0.1 * s[1], 0.0, 0.0), (s[1], -s[0])

    scene = fa.Scene(inertia=(1.0, 2.0, 2.5), torque=driven, states=2, mass=2.0, force=(0.1, 0, 0))
    start = {"q0": START, "w0": (0.3, -0.2, 0.5), "v0": (1, 0, 0), "r0": (0, 0, 0), "s0": (0, 1)}
    given = {**start, "dt": 0.1, "n_steps": 20, "method": "rk8"}
    times = [0.5, 1.37, 2.0]
    between = fa.interpolate(fa.propagate(scene, **given, save_every=1), times)
    known = fa.propagate(scene, **given, save_at=times)
    assert angle(between.q, known.q).max() < 1e-9
    for name in ("w", "v", "r", "s"):
        assert np.abs(getattr(between, name) - getattr(known, name)).max() < 1e-7, name


@pytest.mark.parametrize("frame", ["body", "inertial"])
def test_a_prescribed_rate_is_evaluated(frame):
    """Where it can be: a run that was pickled has its numbers alone."""
    scene = fa.Scene(rate=fa.rates.Coning([0.5, 0.8], 1.0), frame=frame)
    run = fa.propagate(scene, [START, START], dt=0.1, n_steps=20, save_every=2, method="magnus6")
    between, copied = (fa.interpolate(x, 0.53) for x in (run, pickle.loads(pickle.dumps(run))))
    known = fa.propagate(scene, [START, START], dt=0.1, t_end=0.53, method="magnus6")
    assert np.abs(between.w - known.w).max() < (4 * EPS if frame == "body" else 1e-9)
    assert np.abs(copied.w - known.w).max() < 1e-7
    assert angle(copied.q, known.q).max() < 1e-9


def test_bodies_that_an_event_stopped_are_left_out():
    """Their attitude stands still, their angular velocity does not."""
    end = fa.event(lambda t, q, w, p: w[0] * t - 0.1, terminal=True)
    scene = fa.Scene(inertia=(1.0, 1.0, 1.0))
    w0 = np.array([[0.01, 0.2, 0.3], [0.1, 0.2, 0.3], [0.0, 0.2, 0.3]])
    given = {"dt": 0.1, "n_steps": 20, "save_every": 1, "method": "rk4"}
    run = fa.propagate(scene, [START] * 3, w0, **given, events=end)
    with pytest.warns(fa.StepWarning, match=r"run: terminal events stopped 1 of 3 .*\(body 1\)"):
        found = fa.interpolate(run, 1.5)
    whole = fa.interpolate(fa.propagate(scene, [START] * 3, w0, **given), 1.5)
    assert_left_out((found.q, found.w), (whole.q, whole.w), [0, 2])


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("near", [3e-5, 4e-8, 1e-11])
def test_saves_that_nearly_coincide_cost_no_accuracy(near, backwards):
    """Beside the second, a middle and the last save: as without, also of attitudes with noise."""
    body, q0, w0 = (2.0, 1.0, 1.5), [0.5, 0.5, -0.5, 0.5], [0.4, -0.3, 0.6]
    times = np.linspace(0.0, 4.0, 997)
    rng = np.random.default_rng(6)
    errors = []
    for extra in ([], [0.4 - near, 2.0 + near, 2.0 + 3.0 * near, 4.0 - near]):
        t = np.sort(np.append(np.arange(11) * 0.4, extra))
        q, w = fa.closed_form.free_body(q0, w0, body, t)
        true, rate = fa.closed_form.free_body(q0, w0, body, times)
        noise = fa.rotation_vector_to_quat(rng.normal(0.0, 1e-5, (t.size, 3)))
        if backwards:
            t, q, w = t[::-1], q[::-1], w[::-1]
        found, rates = fa.interpolate(t, q, w, times)
        noisy, _ = fa.interpolate(t, fa.quat_multiply(q, noise), w, times)
        errors.append(
            [angle(found, true).max(), np.abs(rates - rate).max(), angle(noisy, true).max()]
        )
        assert angle(fa.interpolate(t, q, w, t)[0], q).max() < 8 * EPS
    assert (np.array(errors[1]) < np.array(errors[0]) * [1.1, 1.1, 2.0]).all()


@pytest.mark.parametrize(("dt", "n"), [(0.3, 3), (0.1, 7), (1.1, 3), (-0.3, 3)])
def test_times_within_rounding_of_the_ends_are_accepted(dt, n):
    scene = fa.Scene(inertia=(2.0, 1.0, 1.5))
    run = fa.propagate(scene, [1, 0, 0, 0], [0.3, -0.2, 0.1], dt=dt, n_steps=n, save_every=1)
    for end in (np.nextafter(run.t[-1], np.inf), np.nextafter(run.t[-1], -np.inf)):
        assert angle(fa.interpolate(run, end).q[0], run.q[-1]) < 8 * EPS
    with pytest.raises(ValueError, match="the saves' span"):
        fa.interpolate(run, run.t[-1] * (1.0 + 1e-14))


def pulse(t, q, w, p):
    return (2.0 if 5.0 < t < 5.4 else 0.0), 0.0, 0.0


def in_pieces(run, edges, times):
    """Attitudes from the saves between two edges alone."""
    q = np.empty((len(times), 4))
    for a, b in itertools.pairwise(edges):
        saves, inside = ((x > a - 1e-9) & (x < b + 1e-9) for x in (run.t, times))
        q[inside], _ = fa.interpolate(run.t[saves], run.q[saves], run.w[saves], times[inside])
    return q


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_polynomials_stop_at_breakpoints(way):
    """A run is interpolated as its pieces are; an interval with a breakpoint is told of."""
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=pulse, breakpoints=(5.0, 5.4))
    how = {"dt": way * 0.1, "t0": 5.0 - 5.0 * way, "method": "rk8"}
    start, w0, times = [1, 0, 0, 0], [0.1, 0.2, 0.3], np.linspace(0.0, 10.0, 402)[:: int(way)]
    right = fa.propagate(scene, start, w0, save_at=times, **how)
    run = fa.propagate(scene, start, w0, n_steps=100, save_every=1, **how)
    between = fa.interpolate(run, times)
    np.testing.assert_array_equal(between.q, in_pieces(run, [0.0, 5.0, 5.4, 10.0], times))
    assert fa.angle_between(between.q, right.q).max() < 1e-10
    apart = fa.propagate(scene, start, w0, n_steps=100, save_every=5, **how)
    with pytest.warns(fa.StepWarning, match="1 intervals between saves contain a breakpoint"):
        rough = fa.interpolate(apart, times)
    far = np.abs(times - 5.25) > 0.25  # only the interval with the breakpoint is less accurate
    assert (
        fa.angle_between(rough.q, right.q)[far].max()
        < 1e-5
        < fa.angle_between(rough.q, right.q).max()
    )


def test_what_controllers_hold_is_held():
    """Two clocks; saves at the samples of the faster one, and then elsewhere."""
    terms = {
        "slow": fa.torques.SampledControl(lambda t, q, w, p: w, 1.0, holds=3),
        "fast": fa.torques.SampledControl(fa.torques.QuaternionPD(2.0, 3.0), 0.5, delay=1),
    }
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=fa.torques.Sum(terms))
    start, times = fa.rotation_vector_to_quat([1.0, 0.5, -0.3]), np.linspace(0.0, 5.0, 173)
    how = {"s0": {}, "dt": 0.1, "t_end": 5.0, "method": "rk8"}
    right = fa.propagate(scene, start, [0, 0, 0], save_at=times, **how)
    for save_at in (np.arange(51) * 0.1, np.arange(11) * 0.5):
        run = fa.propagate(scene, start, [0, 0, 0], save_at=save_at, **how)
        between = fa.interpolate(run, times)
        np.testing.assert_allclose(between.s, right.s, rtol=0.0, atol=1e-15)
        wanted = in_pieces(run, np.arange(11) * 0.5, times)
        np.testing.assert_array_equal(between.q, wanted)
    run = fa.propagate(scene, start, [0, 0, 0], save_at=[0.0, 0.7, 1.6, 5.0], **how)
    with pytest.warns(fa.StepWarning) as told:
        between = fa.interpolate(run, times)
    assert "held there is unknown" in " ".join(str(x.message) for x in told)
    known = np.isfinite(between.s)
    np.testing.assert_allclose(between.s[known], right.s[known], rtol=0.0, atol=1e-15)
    assert 0.2 < known.mean() < 0.8


def free_attitudes(n, uneven):
    t = np.linspace(0.0, 20.0, n + 1)
    t[1:-1] += uneven * 6.0 / n * np.sin(7.0 * t[1:-1])
    start = [1, 0, 0, 0], [0.1, 0.5, -0.3], (2.0, 1.0, 2 / 3)
    q, w = fa.closed_form.free_body(*start, t)
    times = np.linspace(0.0, 20.0, 1001)
    signs = np.random.default_rng(3).choice([-1.0, 1.0], n + 1)
    return t, q * signs[:, None], w, times, fa.closed_form.free_body(*start, times)


@pytest.mark.parametrize("uneven", [0.0, 1.0])
def test_attitudes_without_rates(uneven):
    """Beside a closed form and SciPy's spline, whose ends are worse; signs are any."""
    errors, of_rates = [], []
    for n in (80, 160):
        t, q, w, times, exact = free_attitudes(n, uneven)
        found = fa.interpolate(t, q, None, times)
        spline = RotationSpline(t, Rotation.from_quat(q, scalar_first=True))
        inner = (times > 2.0) & (times < 18.0)
        other = spline(times).as_quat(scalar_first=True)
        ours, theirs = (fa.angle_between(x, exact[0]) for x in (found[0], other))
        assert ours.max() < theirs.max()
        assert ours[inner].max() < theirs[inner].max()
        assert np.abs(found[1] - exact[1]).max() < np.abs(spline(times, 1) - exact[1]).max()
        attitudes, rates = fa.interpolate(t, q)
        assert fa.angle_between(attitudes, q).max() < 1e-15
        of_rates.append(np.abs(rates - w).max())
        errors.append(ours.max())
    assert np.log2(errors[0] / errors[1]) > 3.9
    assert np.log2(of_rates[0] / of_rates[1]) > 3.4


def test_rates_of_attitudes_of_a_steady_rotation():
    """Exact for a constant rate, also by more than π over five saves; of bodies, backwards."""
    w, t = np.array([[0.3, -0.2, 0.9], [-0.9, 0.1, 0.4]]), np.linspace(9.0, 0.0, 7)
    q = fa.rotation_vector_to_quat(t[:, None, None] * w)
    _, rates = fa.interpolate(t, q)
    np.testing.assert_allclose(rates, np.broadcast_to(w, rates.shape), rtol=0.0, atol=1e-14)
    _, rates = fa.interpolate(t[:2], q[:2])
    np.testing.assert_allclose(rates, np.broadcast_to(w, rates.shape), rtol=0.0, atol=1e-14)
    with pytest.warns(fa.StepWarning, match="more than π/2 from save 0"):
        fa.interpolate(t[::2], q[::2])


def test_a_message_of_quaternions_alone(tmp_path):
    t, _, _, times, exact = free_attitudes(160, 0.0)
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    run = fa.propagate(scene, [1, 0, 0, 0], [0.1, 0.5, -0.3], save_at=t, dt=0.125)
    how = {"epoch": "2026-01-01T00:00:00", "frame": "EME2000", "attitude_type": "QUATERNION"}
    run.to_aem(tmp_path / "run.aem", **how)
    (segment,) = fa.interchange.read_aem(tmp_path / "run.aem").segments
    assert segment.w is None
    found, _ = fa.interpolate(segment.t, segment.q, segment.w, times)
    assert fa.angle_between(found, exact[0]).max() < 1e-7
