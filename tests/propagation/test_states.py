"""States that a torque or a rate carries, stepped with the attitude as one system."""

import math

import numpy as np
import pytest
from exact import body_motion
from numba import njit
from scipy.integrate import solve_ivp

import fastatt as fa

J = np.array([[2.0, 0.1, -0.2], [0.1, 1.5, 0.15], [-0.2, 0.15, 1.2]])
Q0 = np.array([0.8, 0.0, 0.6, 0.0])
W0 = np.array([0.4, -0.3, 0.5])


def integral(t, q, w, s, p):
    """PID control of the attitude: s is the integral of the error."""
    error = tuple(2.0 * q[0] * x for x in q[1:])
    torque = tuple(
        -p[0] * e - p[1] * rate - p[2] * x for e, rate, x in zip(error, w, s, strict=True)
    )
    return torque, error


def wheel(t, q, w, s, p):
    """A wheel along z with viscous friction and a commanded torque: s is its momentum."""
    command = p[0] * math.sin(2.0 * t) - p[1] * s[0]
    h = s[0]
    return (-w[1] * h, w[0] * h, -command), command


def flexible(t, q, w, s, p):
    """An appendage on a damped spring: s is its deflection and the rate of that."""
    pull = p[0] * s[0] + p[1] * s[1]
    return (p[2] * pull, 0.0, 0.1 * math.cos(t)), (s[1], -pull - p[2] * w[0])


@njit
def sensed(t, q, w, s, p):
    """Rate damping by a gyro with a lag and a limit: s is what it reads."""
    lag = (p[0] * (w[0] - s[0]), p[0] * (w[1] - s[1]), p[0] * (w[2] - s[2]), math.sin(t) - s[3])
    if s[0] > 0.0:
        command = -0.2 * math.tanh(5.0 * p[1] * s[0])
    else:
        command = 0.2 * math.tanh(-5.0 * p[1] * s[0])
    return (command, -p[1] * s[1], -p[1] * s[2] + 0.1 * s[3]), lag


SYSTEMS = {
    "integral": (integral, (0.8, 0.9, 0.2), (0.1, 0.0, -0.1)),
    "wheel": (wheel, (0.3, 0.2), (0.7,)),
    "flexible": (flexible, (4.0, 0.2, 0.3), (0.05, -0.1)),
    "sensed": (sensed, (3.0, 0.5), (0.0, 0.1, 0.2, 0.3)),
}


def scene_of(name, params=None, **options):
    function, usual, start = SYSTEMS[name]
    return fa.Scene(
        inertia=J,
        torque=function,
        states=len(start),
        params=usual if params is None else params,
        **options,
    )


def kinematics(q, w):
    return 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])


def truth(function, params, start, t_end, t0=0.0):
    """(q, w, s) at the end, by DOP853."""
    plain = getattr(function, "py_func", function)

    def both(t, q, w, y):
        return plain(t, tuple(q), tuple(w), tuple(y[7:]), tuple(params))

    y = body_motion(
        J, lambda *x: np.array(both(*x)[0]), np.concatenate(start), t0, t0 + t_end,
        more=lambda *x: both(*x)[1],
    )  # fmt: skip
    return y[:4], y[4:7], y[7:]


def apart(run, wanted):
    q, w, s = wanted
    found = fa.angle_between(run.q[-1], q), np.abs(run.w[-1] - w).max()
    return max(*found, np.abs(run.s[-1] - s).max())


@pytest.mark.parametrize("name", SYSTEMS)
def test_systems_agree_with_scipy(name):
    function, usual, start = SYSTEMS[name]
    scene = scene_of(name)
    assert scene.states == len(start)
    assert all(f.followed for f in scene.functions)
    run = fa.propagate(scene, Q0, W0, s0=start, dt=0.02, n_steps=200, t0=1.0, method="rk8")
    assert run.s.shape == (1, len(start))
    assert apart(run, truth(function, usual, (Q0, W0, start), 4.0, 1.0)) < 1e-9


def turning(t, s, p):
    """A rate that follows a command with a lag of second order."""
    return (s[0], 0.3 * math.cos(t), p[0] * s[1]), (s[1], p[1] * (math.sin(t) - s[0]) - s[1])


@pytest.mark.parametrize("frame", ["body", "inertial"])
def test_rates_carry_states(frame):
    p, s0, sign = (0.7, 2.0), (0.4, -0.2), (1, -1, -1, -1) if frame == "inertial" else (1, 1, 1, 1)

    def slope(t, y):
        w, change = turning(t, y[4:], p)
        return np.concatenate([sign * kinematics(y[:4] * sign, sign[1] * np.array(w)), change])

    y = solve_ivp(slope, (0.0, 3.0), [*Q0, *s0], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    scene = fa.Scene(rate=turning, states=2, params=p, frame=frame)
    assert scene.kind == "rate"
    for method, steps, bound in (("rk4", 1600, 3e-9), ("rk8", 60, 1e-11)):
        run = fa.propagate(scene, Q0, s0=s0, dt=3.0 / steps, n_steps=steps, method=method)
        assert fa.angle_between(run.q[-1], y[:4]) < bound
        np.testing.assert_allclose(run.s[-1], y[4:], atol=bound)
        w = np.array(turning(3.0, run.s[-1], p)[0])
        if frame == "inertial":
            w = fa.quat_rotate_inverse(run.q[-1], w)
        np.testing.assert_allclose(run.w[-1], w, atol=1e-14)


def valve(t, q, w, s, p):
    """A valve that opens with a lag, and the propellant that has flowed through it."""
    return (0.0, p[1] * s[0], 0.0), (p[0] * (1.0 - s[0]), s[0])


def test_a_force_at_a_rate_reads_its_states():
    def push(t, q, w, v, s, p):
        return (
            w[1] * v[2] - w[2] * v[1],
            w[2] * v[0] - w[0] * v[2],
            w[0] * v[1] - w[1] * v[0] + s[0],
        )

    scene = fa.Scene(rate=turning, states=2, params=(0.7, 2.0), mass=1.0, force=push)
    v0 = (0.3, -0.2, 0.1)
    run = fa.propagate(
        scene, Q0, v0=v0, s0=(0.4, -0.2), dt=0.005, n_steps=600, method="rk4", save_every=1
    )
    # along body axes the velocity gains the integral of the state alone
    integral = run.s[:, 0] @ ([1.0, *[4.0, 2.0] * 299, 4.0, 1.0]) * 0.005 / 3.0
    np.testing.assert_allclose(run.v[-1], np.add(v0, (0.0, 0.0, integral)), atol=1e-9)


def test_events_read_the_states():
    """The time at which a wheel reaches its largest speed is known."""

    def spun(t, q, w, s, p):
        return (0.0, 0.0, -p[0]), p[0]

    moment, wheel, torque = 2.0, 0.1, 0.05
    scene = fa.Scene(inertia=(moment,) * 3, torque=spun, states=1, params=(torque,))
    limit = fa.event(lambda t, q, w, s, p: s[0] / wheel - w[2] - 3.0, 1)
    ends = fa.event(lambda t, q, w, s, p: s[0] - p[0], terminal=True)
    given = {"w0": np.zeros(3), "s0": [0.0], "dt": 0.5, "n_steps": 20, "method": "rk8"}
    run = fa.propagate(scene, Q0, **given, events=[limit, ends])
    assert np.isnan(run.event_times[0])
    np.testing.assert_allclose(run.event_times[1], 1.0, rtol=1e-14)
    np.testing.assert_allclose(run.s[-1], torque, rtol=1e-14)
    run = fa.propagate(scene, Q0, **given, events=[limit])
    wanted = 3.0 / torque / (1.0 / wheel + 1.0 / moment)
    np.testing.assert_allclose(run.event_times, wanted, rtol=1e-14)


def test_terms_of_a_sum_have_their_own_states():
    terms = [
        fa.torques.Custom(SYSTEMS[name][0], SYSTEMS[name][1], states=len(SYSTEMS[name][2]))
        for name in ("integral", "wheel")
    ]
    constant = fa.torques.Constant((0.01, 0.02, 0.03))
    scene = fa.Scene(inertia=J, torque=fa.torques.Sum((terms[0], constant, terms[1])))
    assert scene.states == 4

    def both(t, q, w, s, p):
        first, one = integral(t, q, w, s[:3], p[:3])
        second, two = wheel(t, q, w, s[3:], p[3:])
        torque = [a + b + c for a, b, c in zip(first, second, (0.01, 0.02, 0.03), strict=True)]
        return torque, (*one, two)

    start = (0.1, 0.0, -0.1, 0.7)
    run = fa.propagate(scene, Q0, W0, s0=start, dt=0.02, n_steps=150, method="rk8")
    params = SYSTEMS["integral"][1] + SYSTEMS["wheel"][1]
    assert apart(run, truth(both, params, (Q0, W0, start), 3.0)) < 1e-10


def test_a_function_that_is_called_gives_the_same():
    @njit
    def counted(t, q, w, s, p):
        x, n = abs(s[0]) + 1.0, 0
        while x > 1e-3:
            x *= 0.5
            n += 1
        return (0.0 * n, p[0] * s[0], 0.0), (w[0] - s[0],)

    @njit
    def pushed(t, q, w, v, s, p):
        return -0.2 * v[1], s[0], 0.0 * math.gamma(1.5 + t * t)

    runs, options = [], {"s0": [0.3], "v0": W0, "dt": 0.05, "n_steps": 40, "method": "rk4"}
    for torque, force in (
        (counted, pushed),
        (
            lambda t, q, w, s, p: ((0.0, p[0] * s[0], 0.0), w[0] - s[0]),
            lambda t, q, w, v, s, p: (-0.2 * v[1], s[0], 0.0),
        ),
    ):
        scene = fa.Scene(inertia=J, torque=torque, states=1, params=(0.4,), mass=2.0, force=force)
        assert [f.followed for f in scene.functions] == [torque is not counted] * 2
        runs.append(fa.propagate(scene, Q0, W0, **options))
    for name in "swv":
        np.testing.assert_allclose(*(getattr(x, name) for x in runs), rtol=0.0, atol=1e-14)


# ways of a run

N = 70
RNG = np.random.default_rng(3)
MANY = {
    "q0": RNG.normal(size=(N, 4)),
    "w0": RNG.normal(size=(N, 3)),
    "s0": RNG.normal(scale=0.2, size=(N, 3)),
}
STEPS = {"dt": 0.05, "n_steps": 60, "method": "rk8"}


def test_single_precision_is_near_double():
    scene = scene_of("integral")
    double, single = (fa.propagate(scene, **MANY, **STEPS, dtype=x) for x in ("f8", "f4"))
    assert single.s.dtype == np.float32
    assert 0.0 < np.abs(single.s - double.s).max() < 3e-5


def test_files_and_tables_take_states(tmp_path):
    run = fa.propagate(
        scene_of("integral"), Q0, W0, s0=(0.1, 0.2, 0.3), **STEPS, save_every=30,
        on_save=fa.to_file(tmp_path / "run.npy"),
    )  # fmt: skip
    np.testing.assert_array_equal(np.load(tmp_path / "run.npy")[-1, 0, 7:10], run.s[-1])
    run.to_csv(tmp_path / "run.csv")
    head, *lines = (tmp_path / "run.csv").read_text().splitlines()
    assert head == "t,q0,q1,q2,q3,wx,wy,wz,s0,s1,s2,status"
    found = np.array([line.split(",") for line in lines], dtype=float)
    np.testing.assert_array_equal(found[:, 8:11], run.s)
    np.testing.assert_array_equal(run.to_dataframe()["s1"], run.s[:, 1])


def test_states_that_are_lost_flag_their_body_alone():
    def explodes(t, q, w, s, p):
        return (0.0, 0.0, 0.0), (s[0] * s[0],)

    scene = fa.Scene(inertia=J, torque=explodes, states=1)
    run = fa.propagate(scene, Q0, W0, s0=[[-1.0], [1.0]], dt=0.05, n_steps=200, method="rk4")
    assert run.status.tolist() == [0, fa.Status.NON_FINITE]
    np.testing.assert_allclose(run.s[-1, 0], -1.0 / 11.0, rtol=1e-5)


def test_single_steps_are_those_of_a_run():
    scene = scene_of("flexible")
    step = fa.single_step(scene, method="rk8")
    x = step.state(Q0, W0, (0.1, 0.2))
    for k in range(10):
        x = step(0.05 * k, 0.05, x)
    run = fa.propagate(scene, Q0, W0, s0=(0.1, 0.2), dt=0.05, n_steps=10, method="rk8")
    _, y = step.read(x, step.params)
    np.testing.assert_array_equal(y[3:], run.s[-1])
    with pytest.raises(TypeError, match=r"accepted: q, w, s$"):
        step.state(Q0, W0)


def test_advice_and_checks_take_initial_states():
    scene, few = scene_of("integral"), {name: x[:6] for name, x in MANY.items()}
    some = {"methods": ["rk8"], "dtypes": ["float64"]}
    advice = fa.recommend(scene, **few, t_end=3.0, tol=1e-7, **some)
    run = fa.propagate(scene, **few, **advice.arguments, save_every=1)
    fine = fa.propagate(scene, **few, dt=0.005, n_steps=600, method="rk8")
    assert fa.angle_between(run.q[-1], fine.q[-1]).max() < 1e-7
    check = fa.check_convergence(scene, **few, dt=0.1, n_steps=30, method="rk4")
    assert check.passed
    assert check.order == pytest.approx(4.0, abs=0.3)
    assert fa.work_precision(scene, **few, t_end=3.0, **some, repeats=1, max_seconds=0.1).rows
    steps = fa.per_body_steps(scene, **few, t_end=3.0, tol=1e-6, method="rk8")
    assert steps.expected_error <= 1e-6
    drift = fa.drift(run, scene)
    assert drift.norm.shape == run.q.shape[:2]
    assert drift.energy is None
    rate = fa.Scene(rate=turning, states=2, params=(0.7, 2.0))
    assert fa.recommend(rate, Q0, s0=(0.4, -0.2), t_end=3.0, tol=1e-7, **some).method == "rk8"


def test_advice_sees_a_force_that_jumps_with_a_state():
    def switched(t, q, w, v, s, p):
        return (1.0 if s[0] > 0.5 else 0.0), 0.0, 0.0

    scene = fa.Scene(inertia=J, torque=valve, states=2, params=(2.0, 0.3), mass=2.0, force=switched)
    with pytest.raises(ValueError, match=r"^scene: the force jumps with the state near t = 0\.29"):
        fa.recommend(scene, Q0, W0, v0=[0, 0, 0], s0=[0.1, 0.0], t_end=3.0, tol=1e-7)
