"""Methods of one's own, from outside the package."""

import math

import numpy as np
import pytest
from each import each
from exact import RALSTON3, START, angle, body_motion, generic, matrix, observed_order
from numba import njit

import fastatt as fa
from fastatt.methods.explicit import RK4_TABLEAU, RK8_TABLEAU, RK9_TABLEAU, Tableau
from fastatt.methods.runge_kutta import check

SPAN = 2.0
BODIES = generic(3)
START3 = np.tile(START, (3, 1))
END = BODIES.attitude(0.0, SPAN)
INERTIA = np.array([[0.6, 0.8, 1.0], [0.8, 1.0, 0.6], [1.0, 0.6, 0.8], [0.7, 0.9, 1.0]])
SPIN = np.array([0.9, -0.4, 1.2])


# methods


KUTTA38 = fa.runge_kutta(
    "kutta38",
    order=4,
    c=(0, 1 / 3, 2 / 3, 1),
    a=((1 / 3,), (-1 / 3, 1), (1, -1, 1)),
    b=(1 / 8, 3 / 8, 3 / 8, 1 / 8),
)
HEUN2 = fa.runge_kutta("heun2", order=2, c=[0, 1], a=[[1]], b=[0.5, 0.5])
EULER1 = fa.runge_kutta("euler1", order=1, c=(0,), a=(), b=(1,))


def simpson(w, t, h):
    """One exponential, plain arithmetic: of order 2, for it has no commutator."""
    a, b, c = w(t), w(t + 0.5 * h), w(t + h)
    return [[h / 6.0 * (x + 4.0 * y + z) for x, y, z in zip(a, b, c, strict=True)]]


@njit
def commutator(h, a, b):
    return fa.kernels.vec3.scale(h * h * (math.sqrt(3.0) / 12.0), fa.kernels.vec3.cross(a, b))


def gauss(w, t, h):
    """Magnus's order 4 with kernels, a jitted function and a conditional expression."""
    root = math.sqrt(3.0) / 6.0
    a = w(t + (0.5 - root) * h)
    b = w(t + (0.5 + root) * h)
    # the two ways are the same formula
    bracket = commutator(h, a, b) if h >= 0.0 else tuple(-x for x in commutator(h, b, a))
    mean = fa.kernels.vec3.scale(0.5 * h, fa.kernels.vec3.add(a, b))
    return (fa.kernels.vec3.add(mean, bracket),)


def halves(w, t, h):
    """Two exponentials, each with the rate of its half's middle."""
    return tuple(fa.kernels.vec3.scale(0.5 * h, w(t + share * h)) for share in (0.25, 0.75))


SIMPSON = fa.lie_group("simpson", order=2, exponents=simpson)
GAUSS = fa.lie_group("gauss", order=4, exponents=gauss, limit=2.0)
HALVES = fa.lie_group("halves", order=2, exponents=halves)


def munthe_kaas(slope, t, h, m):
    """Munthe-Kaas's method of order 4 on attitude and momentum."""
    vec3, so3 = fa.kernels.vec3, fa.kernels.so3

    def stage(share, w, change):
        u = vec3.scale(share * h, w)
        w, change = slope(t + share * h, (u,), vec3.axpy(share * h, change, m))
        return so3.dexpinv(u, w), change

    first = slope(t, (), m)
    second = stage(0.5, *first)
    third = stage(0.5, *second)
    stages = zip(first, second, third, stage(1.0, *third), strict=True)
    u, d = (
        tuple(h / 6.0 * (a + 2.0 * (b + c) + d) for a, b, c, d in zip(*each, strict=True))
        for each in stages
    )
    return (u,), d


def midpoint_twice(slope, t, h, m):
    """Two exponentials, each with the momentum and the rate of its half's middle: of order 2."""
    scale, axpy = fa.kernels.vec3.scale, fa.kernels.vec3.axpy
    w, change = slope(t, (), m)
    u, middle = scale(0.25 * h, w), axpy(0.25 * h, change, m)
    w, change = slope(t + 0.25 * h, (u,), middle)
    u, half = scale(0.5 * h, w), axpy(0.5 * h, change, m)
    w, change = slope(t + 0.5 * h, (u,), half)
    v, middle = scale(0.25 * h, w), axpy(0.25 * h, change, half)
    w, change = slope(t + 0.75 * h, (u, v), middle)
    end = axpy(0.5 * h, change, half)
    return (u, scale(0.5 * h, w)), tuple(a - b for a, b in zip(end, m, strict=True))


BODY4 = fa.lie_group("body4", order=4, body=munthe_kaas)
BODY2 = fa.lie_group("body2", order=2, body=midpoint_twice, exponents=halves)
EXPLICIT = [KUTTA38, RALSTON3, HEUN2, EULER1]
LIE = [SIMPSON, GAUSS, HALVES]
LADDER = np.array([12, 18, 24, 36, 48, 72, 96, 144, 192, 288, 384, 576, 768, 1500, 3000])


def run(scene, method, n=24, q0=START3, w0=None, representation="quat", **options):
    options = {"dt": SPAN / n, "n_steps": n, "method": method, **options}
    return fa.propagate(scene, q0, w0, representation=representation, **options)


def rate_error(method, n, representation="quat"):
    traj = run(BODIES.scene, method, n, representation=representation)
    return angle(traj.q[-1], END).max()


START4, SPIN4 = np.tile(START, (4, 1)), np.tile(SPIN, (4, 1))


@each(
    ("method", "representation"),
    [(m, "quat") for m in (*EXPLICIT, *LIE)]
    + [(RALSTON3, "euler313"), (RALSTON3, "dcm"), (GAUSS, "dcm_rows")],
)
def test_order_at_given_rates(method, representation):
    found = observed_order(lambda n: rate_error(method, n, representation), SPAN, ladder=LADDER)
    assert found == pytest.approx(method.order, abs=0.25)


@each("method", [BODY4, BODY2])
def test_order_of_bodies(method):
    """A heavy body with a full tensor of inertia, against DOP853."""
    arm, tensor = np.array([0.3, 0.1, 0.2]), [[1.0, 0.1, 0.0], [0.1, 0.8, -0.05], [0.0, -0.05, 0.7]]
    scene = fa.Scene(inertia=tensor, torque=fa.torques.HeavyTop(arm, 2.0))

    def torque(t, q, w, y):
        return np.cross(arm, matrix(q).T @ (0.0, 0.0, -2.0))

    end = body_motion(tensor, torque, np.concatenate([START, SPIN]), 0.0, SPAN)

    def error(n):
        state = run(scene, method, n, q0=START, w0=SPIN)
        return angle(state.q[-1], end[:4]) + np.linalg.norm(state.w[-1] - end[4:])

    found = observed_order(error, SPAN, floor=1e-11, ladder=LADDER)
    assert found == pytest.approx(method.order, abs=0.25)


def test_a_body_method_of_ones_own_is_that_of_the_library():
    scene = fa.Scene(inertia=INERTIA, torque=fa.torques.Damping(0.1))
    own, built_in = (run(scene, x, 60, q0=START4, w0=SPIN4) for x in (BODY4, "rkmk4"))
    assert angle(own.q[-1], built_in.q[-1]).max() < 1e-14
    assert np.abs(own.w[-1] - built_in.w[-1]).max() < 1e-14


@each("method", [KUTTA38, GAUSS])
def test_methods_of_ones_own_go_wherever_a_name_goes(method):
    scene = fa.Scene(rate=fa.rates.Coning(0.5, 1.0))
    traj = fa.propagate(scene, START, dt=0.1, n_steps=20, method=method)
    assert (traj.method, traj.record) == (method.name, method)
    assert method.name in traj.summary()
    assert method.name in fa.inspect_step(scene, method)
    check = fa.check_convergence(scene, START, dt=0.1, n_steps=20, method=method, sample=2)
    assert (check.method, check.declared) == (method.name, 4)
    assert check.passed
    back = fa.propagate(scene, traj.q[-1], dt=-0.1, n_steps=20, t0=2.0, method=method)
    assert angle(back.q[-1], START).max() < 1e-5


def test_limits_of_ones_own_are_seen():
    scene = fa.Scene(rate=fa.rates.Polynomial([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    for method, limit in ((GAUSS, 2.0), (SIMPSON, 1.0), (KUTTA38, KUTTA38.limit("quat"))):
        for share, flag in ((0.98, 0), (1.02, fa.Status.STEP_TOO_LARGE)):
            traj = fa.propagate(scene, START, dt=share * limit, n_steps=1, method=method)
            assert traj.status[0] & fa.Status.STEP_TOO_LARGE == flag, method.name


@each("tableau", [RK4_TABLEAU, RK8_TABLEAU, RK9_TABLEAU])
def test_a_digit_of_a_built_in_tableau_that_is_wrong_is_seen(tableau):
    """Each by itself: a node and a weight in the eighth digit, a row that keeps its sum by 1e-3."""
    given = tableau._asdict()
    check(tableau)

    def moved(numbers, k):
        return (*numbers[:k], numbers[k] + 1e-8, *numbers[k + 1 :])

    for k in range(len(tableau.b)):
        with pytest.raises(ValueError, match="a, b: a condition of order 1 gives"):
            check(Tableau(**given | {"b": moved(tableau.b, k)}))
    for k in range(1, len(tableau.c)):
        with pytest.raises(ValueError, match=r"a\[\d+\]: its sum is"):
            check(Tableau(**given | {"c": moved(tableau.c, k)}))
    for i, row in enumerate(tableau.a):
        if len(row) < 2:
            continue
        # the row's sum kept, the condition is another
        wrong = (row[0] + 1e-3, row[1] - 1e-3, *row[2:])
        with pytest.raises(ValueError, match="a, b: a condition of order"):
            check(Tableau(**given | {"a": (*tableau.a[:i], wrong, *tableau.a[i + 1 :])}))


def test_an_order_that_is_not_there_is_warned_of():
    untrue = fa.lie_group("untrue", order=4, exponents=simpson)
    scene = fa.Scene(rate=fa.rates.Coning(0.5, 1.0))
    with pytest.warns(fa.ConvergenceWarning, match="untrue"):
        check = fa.check_convergence(scene, START, dt=0.1, n_steps=20, method=untrue, sample=1)
    assert not check.passed


# under torques


ARMS = np.array([[0.1, 0.2, 0.3], [-0.2, 0.1, 0.3], [0.3, 0.0, -0.1], [0.0, 0.0, 0.4]])
WEIGHTS, DRAGS = np.array([2.0, 1.0, 3.0, 0.5]), np.array([0.1, 0.2, 0.0, 0.3])
TERMS = fa.torques.HeavyTop(ARMS, WEIGHTS), fa.torques.Damping(DRAGS[:, None])
TORQUED = fa.Scene(inertia=INERTIA, torque=fa.torques.Sum(TERMS))


@each("method", EXPLICIT)
def test_order_under_a_torque(method):
    reference = run(TORQUED, "rk8", 400, START4, SPIN4)

    def error(n):
        traj = run(TORQUED, method, n, START4, SPIN4)
        return max(angle(traj.q[-1], reference.q[-1]).max(), np.abs(traj.w - reference.w).max())

    found = observed_order(error, SPAN, ladder=[4, 5, 6, 7, 8, 9, 10, 11, *LADDER])
    assert found == pytest.approx(method.order_of("torqued"), abs=0.25)


def beyond(w, t, h):
    """The rate at the start of the step and at that of the step before."""
    return (tuple(h * (1.5 * a - 0.5 * b) for a, b in zip(w(t), w(t - h), strict=True)),)


def switched(t, p):
    return (0.8 if t > 1.03 else 0.0), 0.3, 0.2


@pytest.mark.parametrize(
    "method",
    [
        fa.runge_kutta("late", order=2, c=(0.0, 1.25), a=((1.25,),), b=(0.6, 0.4)),
        fa.runge_kutta("early", order=2, c=(0.0, -0.5), a=((-0.5,),), b=(2.0, -1.0)),
        fa.lie_group("multistep", order=1, exponents=beyond),
    ],
    ids=lambda method: method.name,
)
def test_a_method_that_evaluates_beyond_its_step_refuses_breakpoints(method):
    options = {"dt": 0.1, "n_steps": 20, "method": method}
    assert not fa.propagate(fa.Scene(rate=switched), [1, 0, 0, 0], **options).status.any()
    slew = fa.rates.Slew((0.0, 0.3, 1.5), duration=1.7)
    for scene in (fa.Scene(rate=switched, breakpoints=(1.03,)), fa.Scene(rate=slew)):
        with pytest.raises(ValueError, match="nodes from 0 to 1"):
            fa.propagate(scene, [1, 0, 0, 0], **options)


def test_methods_of_the_library_evaluate_within_their_steps():
    assert all(method.within for method in fa.METHODS.values())
    assert RALSTON3.within
