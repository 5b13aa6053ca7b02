"""Methods, representations and torques of one's own, from outside the package."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from each import each
from exact import EPS, LENGTHY, START, angle, coning, exp, generic, mul, observed_order
from numba import njit

import fastatt as fa
from fastatt.attitudes import ATTITUDES
from fastatt.methods import rk4, rk8, rk9
from fastatt.methods.runge_kutta import Tableau

SPAN = 2.0
BODIES = generic(3)
START3 = np.tile(START, (3, 1))
END = BODIES.attitude(0.0, SPAN)
INERTIA = np.array([[0.6, 0.8, 1.0], [0.8, 1.0, 0.6], [1.0, 0.6, 0.8], [0.7, 0.9, 1.0]])
SPIN = np.array([0.9, -0.4, 1.2])
DTYPES = ["float64", "float32"]


# methods


KUTTA38 = fa.runge_kutta(
    "kutta38",
    order=4,
    c=(0, 1 / 3, 2 / 3, 1),
    a=((1 / 3,), (-1 / 3, 1), (1, -1, 1)),
    b=(1 / 8, 3 / 8, 3 / 8, 1 / 8),
)
RALSTON3 = fa.runge_kutta(
    "ralston3", order=3, c=(0, 1 / 2, 3 / 4), a=((1 / 2,), (0, 3 / 4)), b=(2 / 9, 1 / 3, 4 / 9)
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
    """Magnus's order 4 with kernels, a jitted function and branches."""
    root = math.sqrt(3.0) / 6.0
    a = w(t + (0.5 - root) * h)
    b = w(t + (0.5 + root) * h)
    bracket = commutator(h, a, b)
    if h < 0.0:  # the two ways are the same formula
        bracket = tuple(-x for x in commutator(h, b, a))
    mean = fa.kernels.vec3.scale(0.5 * h, fa.kernels.vec3.add(a, b))
    return (fa.kernels.vec3.add(mean, bracket),)


def halves(w, t, h):
    """Two exponentials, each with the rate of its half's middle."""
    return tuple(fa.kernels.vec3.scale(0.5 * h, w(t + share * h)) for share in (0.25, 0.75))


SIMPSON = fa.lie_group("simpson", order=2, exponents=simpson)
GAUSS = fa.lie_group("gauss", order=4, exponents=gauss, limit=2.0)
HALVES = fa.lie_group("halves", order=2, exponents=halves)
EXPLICIT = [KUTTA38, RALSTON3, HEUN2, EULER1]
LIE = [SIMPSON, GAUSS, HALVES]
by_name = {"ids": lambda x: getattr(x, "name", x)}
LADDER = np.array([12, 18, 24, 36, 48, 72, 96, 144, 192, 288, 384, 576, 768, 1500, 3000])


def run(scene, method, n=24, q0=START3, w0=None, representation="quat", **options):
    options = {"dt": SPAN / n, "n_steps": n, "method": method, **options}
    return fa.propagate(scene, q0, w0, representation=representation, **options)


def rate_error(method, n, representation="quat"):
    traj = run(BODIES.scene, method, n, representation=representation)
    return angle(traj.q[-1], END).max()


def body_scene(torque=None):
    return fa.Scene(inertia=INERTIA, torque=torque)


START4, SPIN4 = np.tile(START, (4, 1)), np.tile(SPIN, (4, 1))


def body_error(scene, reference, method, n, representation="quat"):
    traj = run(scene, method, n, START4, SPIN4, representation)
    return max(angle(traj.q[-1], reference.q[-1]).max(), np.abs(traj.w - reference.w).max())


@pytest.mark.parametrize("representation", ["quat", "dcm", "dcm_rows", "rotation_vector"])
@pytest.mark.parametrize("method", EXPLICIT, **by_name)
def test_explicit_has_its_order_at_given_rates(method, representation):
    found = observed_order(lambda n: rate_error(method, n, representation), SPAN, ladder=LADDER)
    assert found == pytest.approx(method.order, abs=0.25)


@pytest.mark.parametrize("representation", ["quat", "dcm", "dcm_rows"])
@pytest.mark.parametrize("method", LIE, **by_name)
def test_lie_has_its_order(method, representation):
    found = observed_order(lambda n: rate_error(method, n, representation), SPAN, ladder=LADDER)
    assert found == pytest.approx(method.order, abs=0.25)


@pytest.mark.parametrize("torque", [None, fa.torques.HeavyTop((0.1, 0.2, 0.3), 2.0)])
@pytest.mark.parametrize("method", EXPLICIT, **by_name)
def test_explicit_has_its_order_on_bodies(method, torque):
    scene = body_scene(torque)
    reference = run(scene, "rk8", 400, START4, SPIN4)
    error = lambda n: body_error(scene, reference, method, n)  # noqa: E731
    found = observed_order(error, SPAN, ladder=LADDER)
    assert found == pytest.approx(method.order, abs=0.25)


@pytest.mark.parametrize("method", [*EXPLICIT, *LIE], **by_name)
def test_single_precision_is_double_precision_to_its_rounding(method):
    """Each stage rounds the state by 2⁻²⁴, at worst always to the same side."""
    n = 200
    double, single = (run(BODIES.scene, method, n, dtype=dtype) for dtype in DTYPES)
    assert single.q.dtype == np.float32
    work = max(method.rate_calls, 3 * method.exponentials)
    assert 1e-9 < angle(single.q[-1], double.q[-1]).max() < n * work * 2.0**-24


def test_a_method_of_ones_own_is_the_built_in_one():
    """To the last bit: its formulas are the same."""
    rk4_again = fa.runge_kutta(
        "again", order=4, **{k: getattr(rk4.TABLEAU, k) for k in ("c", "a", "b")}
    )
    ours, theirs = (run(BODIES.scene, m).q for m in (rk4_again, "rk4"))
    assert ours.tobytes() == theirs.tobytes()

    def middle(w, t, h):
        return (fa.kernels.vec3.scale(h, w(t + 0.5 * h)),)

    own = fa.lie_group(
        "own", order=2, exponents=middle, limit=fa.METHODS["lie_midpoint"].limit("quat")
    )
    ours, theirs = (run(BODIES.scene, m) for m in (own, "lie_midpoint"))
    assert ours.q.tobytes() == theirs.q.tobytes()
    assert ours.status.tolist() == theirs.status.tolist()


@pytest.mark.parametrize("method", [KUTTA38, GAUSS], **by_name)
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


@pytest.mark.parametrize("method", EXPLICIT, **by_name)
def test_the_limit_of_a_tableau_is_one_that_its_step_deserves(method):
    """A step of the limit is wrong by a tenth of a radian a radian at most.

    At a constant rate, and on a cone whose rate turns twice as fast as the body.
    """
    for representation in ("quat", "dcm"):
        theta = method.limit(representation)
        w = np.array([[0.0, 0.0, theta]])
        frequency = theta / (2.0 * np.sin(0.25))
        begin, end = coning(np.array([0.0, 1.0]), 0.5, frequency)
        for rate, q0, true in (
            (fa.rates.Constant(w), START, mul(START, exp(w))),
            (fa.rates.Coning(np.array([0.5]), frequency), begin, end),
        ):
            traj = fa.propagate(
                fa.Scene(rate=rate), q0[None], dt=1.0, n_steps=1, method=method,
                representation=representation,
            )  # fmt: skip
            assert angle(traj.q[-1], true).max() <= 0.1 * theta
        assert theta >= 0.3 or method.order < 3


# methods that are none


GOOD = {"order": 3, "c": (0, 1 / 2, 3 / 4), "a": ((1 / 2,), (0, 3 / 4)), "b": (2 / 9, 1 / 3, 4 / 9)}
WRONG_TABLEAUX = [
    ({"a": ((1 / 2,), (0.1, 3 / 4))}, ValueError, "a[1]: its sum is 0.85; accepted: the node c[2]"),
    ({"b": (2 / 9, 1 / 3, 3 / 9)}, ValueError, "a, b: a condition of order 1 gives 0.888888888888"),
    ({"b": (3 / 9, 2 / 9, 4 / 9)}, ValueError, "a, b: a condition of order 2 gives 0.444444444444"),
    ({"order": 4}, ValueError, "a, b: a condition of order 4 gives"),
    ({"order": 0}, ValueError, "order: found 0; accepted: a whole number of at least 1"),
    ({"order": 3.0}, TypeError, "order: found 3.0; accepted: a whole number"),
    ({"order": True}, TypeError, "order: found True; accepted: a whole number"),
    ({"c": (0, 1 / 2)}, ValueError, "c, a, b: found 2 nodes, 2 rows and 3 weights; accepted: as"),
    ({"a": ((1 / 2,),)}, ValueError, "c, a, b: found 3 nodes, 1 rows and 3 weights; accepted: as"),
    ({"a": ((1 / 2,), (3 / 4,))}, ValueError, "a[1]: found 1 numbers; accepted: 2"),
    ({"c": (0.1, 1 / 2, 3 / 4)}, ValueError, "c[0]: found 0.1; accepted: 0, of an explicit method"),
    ({"b": (math.nan, 1 / 3, 4 / 9)}, ValueError, "c, a, b: found numbers that are not finite"),
    ({"c": 3}, ValueError, "c: has shape (); accepted: (s,)"),
    ({"b": "abc"}, TypeError, "b: found 'abc'; accepted: real numbers of shape (s,)"),
    ({"name": ""}, TypeError, "name: found ''; accepted: a name"),
    ({"name": 3}, TypeError, "name: found 3; accepted: a name"),
]


@each(("change", "error", "message"), WRONG_TABLEAUX)
def test_a_wrong_tableau_is_refused(change, error, message):
    assert fa.runge_kutta("good", **GOOD).order == 3
    with pytest.raises(error, match=re.escape(message)):
        fa.runge_kutta(**{"name": "wrong", **GOOD, **change})


@pytest.mark.parametrize(
    "tableau", [rk4.TABLEAU, rk8.TABLEAU, rk9.TABLEAU], ids=["rk4", "rk8", "rk9"]
)
def test_a_digit_of_a_built_in_tableau_that_is_wrong_is_seen_at_import(tableau):
    """Each by itself: a node and a weight in the eighth digit, a row that keeps its sum by 1e-3."""
    given = {"order": tableau.order, "c": tableau.c, "a": tableau.a, "b": tableau.b}
    Tableau(**given)

    def moved(numbers, k):
        return (*numbers[:k], numbers[k] + 1e-8, *numbers[k + 1 :])

    for k in range(len(tableau.b)):
        with pytest.raises(ValueError, match="a, b: a condition of order 1 gives"):
            Tableau(**given | {"b": moved(tableau.b, k)})
    for k in range(1, len(tableau.c)):
        with pytest.raises(ValueError, match=r"a\[\d+\]: its sum is"):
            Tableau(**given | {"c": moved(tableau.c, k)})
    for i, row in enumerate(tableau.a):
        if len(row) < 2:
            continue
        # the row's sum kept, the condition is another
        wrong = (row[0] + 1e-3, row[1] - 1e-3, *row[2:])
        with pytest.raises(ValueError, match="a, b: a condition of order"):
            Tableau(**given | {"a": (*tableau.a[:i], wrong, *tableau.a[i + 1 :])})


def test_every_explicit_method_of_the_library_is_checked():
    """Those that step by derivatives are made of tableaux, but for the extrapolated rule."""
    stepping = {m.name for m in fa.METHODS.values() if m.uses == ("derivative",)}
    made = {"rk4": rk4.TABLEAU, "rk8": rk8.TABLEAU, "rk9": rk9.TABLEAU}
    assert stepping == {*made, "gbs16"}
    for name, tableau in made.items():
        assert tableau.order == fa.METHODS[name].order


def no_rate(w, t, h):
    return ((h, h, h),)


def two_numbers(w, t, h):
    u = w(t)
    return ((h * u[0], h * u[1]),)


def one_vector(w, t, h):
    u = w(t)
    return h * u[0], h * u[1], h * u[2]


def half_a_step(w, t, h):
    u = w(t)
    return ((0.5 * h * u[0], 0.5 * h * u[1], 0.5 * h * u[2]),)


def without_a_step(w, t, h):
    return (w(t),)


def endless(w, t, h):
    u = w(t)
    while u[0] > 0.0:
        u = (u[0] - h, u[1], u[2])
    return (u,)


def of_two(w, t):
    return (w(t),)


def unknown(w, t, h):
    return (np.linalg.det(w(t)),)


FEW = "exponents: found a function that gives no tuple of exponents made from w(t); accepted: f(w, "
OTHER = "at the constant rate (0.3, -0.5, 0.7) they add up to h "
WRONG_EXPONENTS = [
    ({"exponents": no_rate}, ValueError, FEW),
    ({"exponents": two_numbers}, ValueError, FEW),
    ({"exponents": one_vector}, ValueError, FEW),
    ({"exponents": half_a_step}, ValueError, OTHER + "(0.15, -0.25, 0.35); accepted: h w"),
    ({"exponents": without_a_step}, ValueError, OTHER),
    ({"exponents": endless}, TypeError, "exponents: "),
    ({"exponents": of_two}, TypeError, "exponents: "),
    ({"exponents": unknown}, TypeError, "exponents: "),
    ({"exponents": 3}, TypeError, "exponents: found 3; accepted: a function"),
    ({"order": 0}, ValueError, "order: found 0; accepted: a whole number of at least 1"),
    ({"limit": 0.0}, ValueError, "limit: found 0.0; accepted: above 0, rad"),
    ({"limit": math.nan}, ValueError, "limit: found nan"),
    ({"limit": "far"}, TypeError, "limit: found 'far'"),
    ({"name": ""}, TypeError, "name: found ''; accepted: a name"),
    ({"name": "rk4"}, ValueError, "name: found 'rk4', a method of the library; accepted: another"),
]


@each(("change", "error", "message"), WRONG_EXPONENTS)
def test_exponents_that_are_none_are_refused(change, error, message):
    with pytest.raises(error, match=re.escape(message)) as refusal:
        fa.lie_group(**{"name": "wrong", "order": 2, "exponents": simpson, **change})
    assert len(str(refusal.value).splitlines()) == 1


def test_a_method_that_does_not_fit_is_refused():
    for scene, given, method in (
        (body_scene(), SPIN4, GAUSS),
        (BODIES.scene, None, fa.METHODS["dmv4"]),
    ):
        with pytest.raises(ValueError, match=rf"method: found {method.name}, for .*; accepted for"):
            fa.propagate(scene, START, given, dt=0.1, n_steps=1, method=method)
    with pytest.raises(ValueError, match=r'method: found gauss, .* in "euler313": rk4'):
        run(BODIES.scene, GAUSS, representation="euler313")


def test_an_order_that_is_not_there_is_warned_of():
    untrue = fa.lie_group("untrue", order=4, exponents=simpson)
    scene = fa.Scene(rate=fa.rates.Coning(0.5, 1.0))
    with pytest.warns(fa.ConvergenceWarning, match="untrue"):
        check = fa.check_convergence(scene, START, dt=0.1, n_steps=20, method=untrue, sample=1)
    assert not check.passed


# representations


def mrp_start(q):
    """σ = e tan(θ/4) of the shorter turn."""
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[0] < 0.0:
        n = -n
    return tuple(x / (n + q[0]) for x in q[1:])


def mrp_derivative(x, w):
    """¼ ((1 − σ²) w + 2 σ×w + 2 (σ·w) σ), Schaub and Junkins, eq. 3.161."""
    s, d = fa.kernels.vec3.dot(x, x), fa.kernels.vec3.dot(x, w)
    c = fa.kernels.vec3.cross(x, w)
    return tuple(0.25 * ((1.0 - s) * r + 2.0 * (c[i] + d * x[i])) for i, r in enumerate(w))


def mrp_quaternion(x):
    s = fa.kernels.vec3.dot(x, x)
    k = 1.0 / (1.0 + s)
    return (1.0 - s) * k, 2.0 * k * x[0], 2.0 * k * x[1], 2.0 * k * x[2]


MRP = fa.Attitude(
    "mrp",
    size=3,
    stored=3,
    start=mrp_start,
    derivative=mrp_derivative,
    quaternion=mrp_quaternion,
    speed_squared=lambda xdot, w: 16.0 * fa.kernels.vec3.dot(xdot, xdot),
    summary="modified Rodrigues parameters",
)


@njit
def twice(q):
    return 2.0 * q[0], 2.0 * q[1], 2.0 * q[2], 2.0 * q[3]


DOUBLED = fa.Attitude(
    "doubled",
    size=4,
    stored=4,
    start=lambda q: twice(fa.kernels.quat.normalise(q)),
    derivative=fa.kernels.quat.derivative,
    rotate=lambda x, u: fa.kernels.quat.mul(x, fa.kernels.quat.exp(u)),
    quaternion=fa.kernels.quat.normalise,
    summary="quaternions of length 2",
)
OWN = [MRP, DOUBLED]
OF_RATES = [(MRP, "rk4"), (MRP, RALSTON3), (DOUBLED, "rk4")] + [
    (DOUBLED, m) for m in ("lie_midpoint", "magnus4", "magnus6", "cf4", "rkmk4", "cg3", GAUSS)
]


@pytest.mark.parametrize(("attitude", "method"), OF_RATES, **by_name)
def test_representation_of_ones_own_has_the_methods_order(attitude, method):
    found = observed_order(lambda n: rate_error(method, n, attitude), SPAN, ladder=LADDER)
    declared = (fa.METHODS[method] if isinstance(method, str) else method).order_of("rate")
    assert found == pytest.approx(declared, abs=0.25)


@pytest.mark.parametrize("attitude", OWN, **by_name)
def test_every_method_that_fits_steps_bodies(attitude):
    """Heavy tops with principal axes that are not the body's, and free bodies by the others."""
    c = fa.quat_to_dcm(exp([0.3, -0.5, 0.7]))
    tensor = c @ (INERTIA[..., None] * c.T)
    tensor = 0.5 * (tensor + np.swapaxes(tensor, -1, -2))
    top = fa.torques.HeavyTop((0.1, 0.2, 0.3), 2.0)
    tops, free = fa.Scene(inertia=tensor, torque=top), fa.Scene(inertia=INERTIA)
    of_tops, of_free = (fa.methods_for(scene, attitude) for scene in (tops, free))
    assert {"rk4", "rk8", "cf4"} - ({"cf4"} if attitude is MRP else set()) <= set(of_tops)
    assert "dmv6" in set(of_free) - set(of_tops)
    for scene, methods in ((tops, of_tops), (free, sorted(set(of_free) - set(of_tops)))):
        reference = run(scene, "rk8", 400, START4, SPIN4)
        # of the lengthy ones one representation stands for the other
        for method in (m for m in methods if attitude is MRP or m not in LENGTHY):
            traj = run(scene, method, 400, START4, SPIN4, attitude)
            off = angle(traj.q[-1], reference.q[-1]).max()
            assert off < (1e-9 if fa.METHODS[method].order >= 4 else 1e-3), method
            assert np.abs(traj.w[-1] - reference.w[-1]).max() < 1e-3


@pytest.mark.parametrize("attitude", OWN, **by_name)
def test_what_follows_from_start_and_quaternion_is_right(attitude):
    """Inertial rates, fields seen from the body, and what a trajectory hands out."""
    scene = fa.Scene(rate=BODIES.model, frame="inertial")
    ours, theirs = (run(scene, "rk4", 400, representation=r) for r in (attitude, "quat"))
    assert angle(ours.q[-1], theirs.q[-1]).max() < 1e-9
    assert np.abs(ours.dcm - theirs.dcm).max() < 1e-9
    assert np.abs(ours.w - theirs.w).max() < 1e-9
    assert np.abs(np.linalg.norm(ours.q, axis=-1) - 1.0).max() < 4 * EPS
    assert (ours.state.shape[-1], ours.representation) == (attitude.size, attitude.name)
    drift = fa.drift(ours, scene)
    assert drift.norm.max() < 4 * EPS
    assert drift.orthogonality.max() < 12 * EPS
    before = run(BODIES.scene, "rk4", representation=attitude, save_every=6)
    assert angle(before.q[0], START).max() < 8 * EPS


@pytest.mark.parametrize("attitude", OWN, **by_name)
def test_representation_of_ones_own_in_single_precision(attitude):
    n = 200
    double, single = (
        run(BODIES.scene, "rk4", n, representation=attitude, dtype=dtype) for dtype in DTYPES
    )
    assert single.q.dtype == single.state.dtype == np.float32
    assert 1e-9 < angle(single.q[-1], double.q[-1]).max() < n * 4 * 2.0**-24


def test_poles_of_ones_own_are_flagged():
    """Modified Rodrigues parameters pass infinity at a whole turn."""
    scene = fa.Scene(rate=fa.rates.Polynomial([[0.0, 0.0, 1.0], [0.0, 0.0, 1e-9]]))
    for n_steps, fine in ((400, True), (660, False)):
        traj = fa.propagate(
            scene, [1, 0, 0, 0], dt=0.01, n_steps=n_steps, method="rk4", representation=MRP
        )
        assert bool(traj.status[0] == 0) is fine
    assert traj.status[0] & (fa.Status.SINGULAR | fa.Status.NON_FINITE)


@pytest.mark.parametrize("name", [name for name in ATTITUDES if name != "quat"])
def test_a_representation_fits_by_its_formulas_wherever_it_is_from(name):
    mine = replace(ATTITUDES[name], name="mine")
    for scene in (BODIES.scene, body_scene(), body_scene(fa.torques.Damping(0.1))):
        fitting = fa.methods_for(scene, mine)
        assert fitting == fa.methods_for(scene, name)
        for method in map(fa.METHODS.get, fitting):
            assert method.limit(mine) == method.limit(name)


def test_closed_form_in_any_representation():
    """Formulas of ``start`` and ``raw`` alone make what a trajectory holds."""
    usual = run(body_scene(), "exact", 3, START4, SPIN4)
    for name in ATTITUDES:
        found = run(body_scene(), "exact", 3, START4, SPIN4, name)
        assert angle(found.q[-1], usual.q[-1]).max() < 16 * EPS


def test_defaults_fit_ones_own():
    assert run(BODIES.scene, None, representation=MRP).method == "rk4"
    assert run(BODIES.scene, None, representation=DOUBLED).method == "magnus4"
    exact = run(body_scene(), None, 24, START4, SPIN4, MRP)
    assert exact.method == "exact"
    assert angle(exact.q[-1], run(body_scene(), None, 24, START4, SPIN4).q[-1]).max() < 16 * EPS
    names = fa.methods_for(BODIES.scene, MRP)
    assert names == ["rk4", "gauss12"]
    message = re.escape("method for representation \"mrp\": found 'magnus4'; accepted: rk4")
    with pytest.raises(ValueError, match=message):
        run(BODIES.scene, "magnus4", representation=MRP)
    with pytest.raises(ValueError, match='compensated: found with representation "mrp"'):
        run(BODIES.scene, "rk4", representation=MRP, compensated=True)


PARTS = {
    "size": 3,
    "stored": 3,
    "start": mrp_start,
    "derivative": mrp_derivative,
    "quaternion": mrp_quaternion,
}
WRONG_ATTITUDES = [
    ({"quaternion": None}, ValueError, "quaternion, derivative, rotate: missing; accepted: quat"),
    ({"derivative": None}, ValueError, "quaternion, derivative, rotate: missing; accepted: quat"),
    ({"size": 4, "stored": 4}, ValueError, "start: gives 3 numbers; accepted: 4"),
    ({"quaternion": lambda x: x}, ValueError, "quaternion: gives 3 numbers; accepted: 4"),
    ({"finish": lambda x: x}, ValueError, "finish: gives 3 numbers; accepted: 4"),
    ({"stored": 2, "finish": lambda x: ((x[0], x[1]), 0.0)}, ValueError, "stored: found 2 numbers"),
    ({"derivative": 3}, TypeError, "derivative: 3, which is no Python function; accepted"),
    ({"derivative": lambda x, w: np.linalg.det(x)}, TypeError, "derivative: "),
    ({"start": lambda q, p: q}, TypeError, "start: "),
    ({"start": lambda q: q[1:]}, ValueError, "start, quaternion: of q = (0.969531,"),
    ({"quaternion": lambda x: (1.0, 0.0, 0.0, 0.0)}, ValueError, "start, quaternion: of q"),
    ({"derivative": lambda x, w: mrp_derivative(w, x)}, ValueError, "accepted: q∘exp(h w), to h²"),
    ({"rotate": lambda x, u: x}, ValueError, "rotate: of q"),
    ({"compose": lambda x, q: x}, ValueError, "compose: of q"),
    ({"flip": lambda x: x}, ValueError, "flip: of q"),
    ({"to_body": lambda x, v: v}, ValueError, "to_body: of q"),
    ({"restore": lambda x: ((0.1, 0.2, 0.3), 0.0)}, ValueError, "restore: of q"),
]


@each(("change", "error", "message"), WRONG_ATTITUDES)
def test_a_wrong_representation_is_refused(change, error, message):
    with pytest.raises(error, match=re.escape(message)):
        fa.Attitude("wrong", **PARTS | change)


# torques


@njit
def weight_and_damping(t, q, w, p):
    """A weight p[3] at p[:3], linear damping p[4]; more of it where it turns fast."""
    z = fa.kernels.quat.rotate_inverse(q, (0.0, 0.0, -p[3]))
    x = fa.kernels.vec3.cross(p[:3], z)
    c = p[4] if w[0] * w[0] < 1e6 else 2.0 * p[4]
    return x[0] - c * w[0], x[1] - c * w[1], x[2] - c * w[2]


def weight(t, q, w, p):
    return fa.kernels.vec3.cross(p[:3], fa.kernels.quat.rotate_inverse(q, (0.0, 0.0, -p[3])))


def height(t, q, p):
    up = fa.kernels.quat.rotate_inverse(q, (0.0, 0.0, 1.0))
    return p[3] * (p[0] * up[0] + p[1] * up[1] + p[2] * up[2])


ARMS = np.array([[0.1, 0.2, 0.3], [-0.2, 0.1, 0.3], [0.3, 0.0, -0.1], [0.0, 0.0, 0.4]])
WEIGHTS, DRAGS = np.array([2.0, 1.0, 3.0, 0.5]), np.array([0.1, 0.2, 0.0, 0.3])
PARAMS = np.column_stack([ARMS, WEIGHTS, DRAGS])
DAMPED = fa.Scene(inertia=INERTIA, torque=weight_and_damping, params=PARAMS)
KEPT = fa.Scene(
    inertia=INERTIA, torque=fa.torques.Custom(weight, PARAMS, uses_rate=False, potential=height)
)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("scene", [DAMPED, KEPT], ids=["damped", "kept"])
def test_torque_of_ones_own_with_numbers_of_each_body(scene, dtype):
    """The built-in models' sum, to rounding."""
    assert all(f.straight for f in scene.functions)
    top = fa.torques.HeavyTop(ARMS, WEIGHTS)
    damping = fa.torques.Damping(DRAGS if scene is DAMPED else np.zeros(4))
    built_in = fa.Scene(inertia=INERTIA, torque=fa.torques.Sum((top, damping)))
    n = 100
    ours, theirs = (run(s, "rk8", n, START4, SPIN4, dtype=dtype) for s in (scene, built_in))
    allowed = n * 12 * np.finfo(dtype).eps
    assert angle(ours.q[-1], theirs.q[-1]).max() < allowed
    assert np.abs(ours.w - theirs.w).max() < allowed


@pytest.mark.parametrize(
    ("scene", "method"),
    [(DAMPED, "rk4"), (DAMPED, "cf4"), (DAMPED, RALSTON3), (KEPT, "strang2"), (KEPT, "suzuki4")],
)
def test_torque_of_ones_own_has_the_methods_order(scene, method):
    reference = run(scene, "rk8", 400, START4, SPIN4)
    ladder = [4, 5, 6, 7, 8, 9, 10, 11, *LADDER]
    error = lambda n: body_error(scene, reference, method, n)  # noqa: E731
    found = observed_order(error, SPAN, ladder=ladder)
    declared = (fa.METHODS[method] if isinstance(method, str) else method).order_of("torqued")
    assert found == pytest.approx(declared, abs=0.25)


def test_potential_of_ones_own_is_what_drift_takes_the_energy_from():
    traj = run(KEPT, "rk8", 200, START4, SPIN4, save_every=20)
    assert fa.drift(traj, KEPT).energy.max() < 1e-12
    built_in = fa.Scene(inertia=INERTIA, torque=fa.torques.HeavyTop(ARMS, WEIGHTS))
    ours, theirs = (fa.potential_energy(s, traj.q) for s in (KEPT, built_in))
    assert np.abs(ours - theirs).max() < 16 * EPS


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("attitude", OWN, **by_name)
def test_method_representation_and_torque_of_ones_own_together(attitude, dtype):
    reference = run(DAMPED, "rk8", 200, START4, SPIN4, dt=0.005)
    errors = []
    for n in (50, 100):
        options = {"dt": 1.0 / n, "dtype": dtype}
        traj = run(DAMPED, KUTTA38, n, START4, SPIN4, attitude, **options)
        assert not traj.status.any()
        errors.append(angle(traj.q[-1], reference.q[-1]).max())
    if dtype == "float64":
        assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.15)
    else:
        assert 1e-9 < errors[1] < 100 * 4 * 2.0**-24


def test_a_representation_without_a_derivative_is_for_exponentials_alone():
    turned = fa.Attitude(
        "turned",
        size=4,
        stored=4,
        rotate=lambda x, u: fa.kernels.quat.mul(x, fa.kernels.quat.exp(u)),
        start=fa.kernels.quat.normalise,
        quaternion=fa.kernels.quat.normalise,
    )
    given = {"dt": 0.1, "n_steps": 5, "representation": turned}
    scene = fa.Scene(rate=fa.rates.Constant((0.1, 0.2, 0.3)))
    run = fa.propagate(scene, [1.0, 0.0, 0.0, 0.0], method="magnus4", **given)
    assert run.status == 0
    with pytest.raises(ValueError, match="representation"):
        fa.propagate(scene, [1.0, 0.0, 0.0, 0.0], method="rk4", **given)
