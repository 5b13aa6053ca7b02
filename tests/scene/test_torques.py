"""Torques against their definitions in mpmath, closed forms of torqued bodies, users' torques.

One sum of every built-in model with each body's own numbers serves most tests: zeros switch a term
off, and the sum is compiled once.
"""

from __future__ import annotations

import functools
import math
import pickle
import re

import mpmath as mp
import numpy as np
import pytest
import rigid_oracle as ro
from differences import derivative, displaced
from each import each
from exact import EPS, START, angle, conj, exp, mul
from numba import njit
from oracle import floats

import fastatt as fa
from fastatt.attitudes import ATTITUDES, QUATERNION
from fastatt.codegen.rows import rows
from fastatt.scene import torques as ft
from fastatt.scene.models import Sum
from fastatt.scene.torque_record import Dependence, Pose, Torque

INERTIA = np.array([0.6, 0.8, 1.0])
AXES = exp([0.3, -0.5, 0.7])  # where the principal axes of the tensors lie
SPIN = np.array([0.9, -0.4, 1.2])
TARGET = tuple(mul(START, exp(SPIN)).tolist())  # ahead: less than half a turn away throughout
RADIAL, ALONG = (0.0, 0.6, 0.8), (1.0, 0.0, 0.0)
FAR = (1e30, 0.0, 0.0)  # from a planet: its gravity gradient is none
RAMP = np.array([[0.1, -0.2, 0.3], [-0.4, 0.5, 0.2]])
SPAN = 2.0


def ramp(t, q, w):
    """The torques of RAMP at t = 0 and SPAN, linear between."""
    s = t / SPAN
    return tuple(float(a) + s * float(b - a) for a, b in zip(*RAMP, strict=True))


def gravity_gradient(inertia, n, radial, along):
    """The oracle's orbit lies in the plane of e1 and e2: seen from axes turned to this one."""
    o = ro.gravity_gradient(inertia, n)
    r, a = np.array(radial), np.array(along)
    frame = fa.dcm_to_quat(np.stack([r, a, np.cross(r, a)], axis=1))
    return lambda t, q, w: o(t, ro.quat_mul(ro.conj(tuple(frame.tolist())), q), w)


def attracted(inertia, position, mu):
    """3 μ/r⁵ r×(I r), r along body axes."""
    tensor = ro.tensor(inertia)

    def acting(t, q, w):
        r = ro.to_body(q, position)
        k = 3 * mu / ro.dot(position, position) ** 2.5
        return tuple(k * x for x in ro.cross(r, ro.times(tensor, r)))

    return acting


def kepler(inertia, n, e, anomaly):
    """The same where bisection of Kepler's equation finds the body, of a = 1 and μ = n²."""

    def acting(t, q, w):
        number = float if isinstance(t, float) else ro.to_gmpy2
        mean = mp.mpf(n) * ro.to_mpmath(t) + anomaly
        low, high = mean - e, mean + e
        for _ in range(mp.mp.prec):
            middle = (low + high) / 2
            low, high = (low, middle) if middle - e * mp.sin(middle) > mean else (middle, high)
        u, v = mp.cos(low) - e, mp.sqrt(1 - mp.mpf(e) ** 2) * mp.sin(low)
        r = tuple(number(u * a + v * b) for a, b in zip(RADIAL, ALONG, strict=True))
        return attracted(inertia, r, n * n)(t, q, w)

    return acting


# name: the model, and what it is (of the inertia along body axes)
MODELS = {
    "Constant": (ft.Constant((0.1, -0.2, 0.3)), lambda i: ro.constant_body((0.1, -0.2, 0.3))),
    "ConstantInertial": (
        ft.ConstantInertial((0.1, -0.2, 0.3)),
        lambda i: ro.constant_inertial((0.1, -0.2, 0.3)),
    ),
    "Damping": (ft.Damping(0.2), lambda i: ro.linear_damping(0.2)),
    "AxisDamping": (
        ft.AxisDamping((0.1, 0.2, 0.3)),
        lambda i: ro.linear_damping((0.1, 0.2, 0.3)),
    ),
    "QuadraticDamping": (ft.QuadraticDamping(0.2), lambda i: ro.quadratic_damping(0.2)),
    "GravityGradient": (
        ft.GravityGradient(0.5, RADIAL, ALONG),
        lambda i: gravity_gradient(i, 0.5, RADIAL, ALONG),
    ),
    "KeplerGravityGradient": (
        ft.KeplerGravityGradient(0.5, 0.4, RADIAL, ALONG, 0.3),
        lambda i: kepler(i, 0.5, 0.4, 0.3),
    ),
    "GravityGradientAt": (
        ft.GravityGradientAt((1.5, -2.0, 0.5), 3.0),
        lambda i: attracted(i, (1.5, -2.0, 0.5), 3.0),
    ),
    "HeavyTop": (
        ft.HeavyTop((0.1, 0.2, 0.3), 2.0),
        lambda i: ro.heavy_top(2.0, (0.1, 0.2, 0.3)),
    ),
    "MagneticDipole": (
        ft.MagneticDipole((0.3, -0.2, 0.5), (1.0, 0.5, -0.7)),
        lambda i: ro.dipole((0.3, -0.2, 0.5), (1.0, 0.5, -0.7)),
    ),
    "QuaternionPD": (
        ft.QuaternionPD(0.4, 0.3, TARGET),
        lambda i: ro.pd_control(0.4, 0.3, TARGET),
    ),
    "Rotor": (ft.Rotor((0.3, 0.2, -0.4)), lambda i: ro.rotor((0.3, 0.2, -0.4))),
    "Sampled": (ft.Sampled(RAMP, SPAN), lambda i: ramp),
}
MATRIX_GAIN = np.array([[0.4, 0.1, 0.0], [0.1, 0.3, -0.05], [0.0, -0.05, 0.2]])
# a history is one for all bodies; an orbit takes long to compile (its motion: test_time_series)
SUMMED = [name for name in MODELS if name not in ("Sampled", "KeplerGravityGradient")]


def turned_tensor():
    c = fa.quat_to_dcm(AXES)
    a = c @ np.diag(INERTIA) @ c.T
    return 0.5 * (a + a.T)


def close(a, b):
    return np.abs(np.subtract(a, b)).max()


# each model at an instant


@functools.cache
def compiled(law, representation, axes):
    """Of (t, state, rate, moments, parameters) the torque under a law."""
    attitude = ATTITUDES[representation]

    def torque(t, x, w, moments, p):
        return law.formula(t, Pose(attitude, x, w, moments, axes=axes), p)

    inputs = {"t": None, "x": attitude.size, "w": 3, "moments": 3, "p": law.count}
    return rows(torque, inputs, (3,))


def states(n=5, seed=4):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return zip(rng.uniform(0.0, SPAN, n), q, rng.normal(size=(n, 3)), strict=True)


def found_torque(model, representation, t, q, w, axes):
    """Along principal axes, from the state of the principal axes."""
    packed = ft.pack(model, None)
    if axes is not None:
        q = mul(q, axes)
        w = fa.quat_to_dcm(axes).T @ w
    x = {"quat": q, "dcm": fa.quat_to_dcm(q).ravel(), "dcm_rows": fa.quat_to_dcm(q).ravel()[:6]}
    torque = compiled(packed.structure, representation, None if axes is None else tuple(axes))
    (found,) = torque(t, x[representation], w, INERTIA, packed.params, tables=packed.tables)
    return found


@pytest.mark.parametrize("representation", ["quat", "dcm", "dcm_rows"])
@pytest.mark.parametrize("name", MODELS)
def test_torque_is_its_definition(name, representation):
    model, definition = MODELS[name]
    for t, q, w in states():
        exact = definition(INERTIA)(t, q, w)
        assert close(found_torque(model, representation, t, q, w, None), exact) < 20 * EPS


@pytest.mark.parametrize("name", MODELS)
def test_torque_along_principal_axes_that_are_not_the_bodys(name):
    model, definition = MODELS[name]
    definition = definition(turned_tensor())
    c = fa.quat_to_dcm(AXES)
    for t, q, w in states():
        exact = c.T @ np.array(definition(t, q, w), float)
        assert close(found_torque(model, "quat", t, q, w, AXES), exact) < 20 * EPS


def test_sum_of_one_and_of_sums():
    constant, damping, rotor = (MODELS[n][0] for n in ("Constant", "Damping", "Rotor"))
    t, q, w = next(iter(states()))

    def found(model):
        return np.array(found_torque(model, "quat", t, q, w, AXES))

    parts = found(constant) + found(damping) + found(rotor)
    assert np.array_equal(found(Sum((rotor,))), found(rotor))
    assert close(found(Sum((constant, damping, rotor))), parts) < 4 * EPS
    assert close(found(Sum((constant, Sum((damping, rotor))))), parts) < 4 * EPS


def test_sampled_is_linear_between_samples_and_held_outside_where_that_is_asked_for():
    rng = np.random.default_rng(0)
    table = rng.normal(size=(5, 3))
    model, strict = ft.Sampled(table, 0.25, 1.0, "hold"), ft.Sampled(table, 0.25, 1.0)
    instants = 1.0 + 0.25 * np.arange(5)
    for t in [-1e9, 0.0, 0.999, *instants, 1.1, 1.6, 1.999, 2.0, 2.001, 1e9]:
        found = found_torque(model, "quat", t, START, SPIN, None)
        exact = [np.interp(t, instants, c) for c in table.T]
        assert close(found, exact) < 4 * EPS
        other = found_torque(strict, "quat", t, START, SPIN, None)
        assert np.isnan(other).all() if not 1.0 <= t <= 2.0 else (other == found).all()
    two = ft.Sampled(np.float32(table[:2]), 1.0)
    assert close(found_torque(two, "quat", 0.5, START, SPIN, None), table[:2].mean(0)) < 1e-7


# motions


def every(n, **terms):
    """All built-in models for n bodies, each with its own numbers; those not named are zero."""
    zeros = {
        "Constant": (np.zeros(3),),
        "ConstantInertial": (np.zeros(3),),
        "Damping": (0.0,),
        "AxisDamping": (np.zeros(3),),
        "QuadraticDamping": (0.0,),
        "GravityGradient": (0.0, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        "GravityGradientAt": (FAR, 1.0),
        "HeavyTop": (np.zeros(3), 0.0),
        "MagneticDipole": (np.zeros(3), np.zeros(3)),
        "QuaternionPD": (np.zeros((1, 1)), np.zeros((1, 1)), (1.0, 0.0, 0.0, 0.0)),
        "Rotor": (np.zeros(3),),
    }
    made = []
    for name, default in zeros.items():
        given = [*terms.get(name, ()), *default[len(terms.get(name, ())) :]]
        each = [np.broadcast_to(a, (n, *np.shape(d))) for a, d in zip(given, default, strict=True)]
        made.append(getattr(ft, name)(*each))
    return Sum(tuple(made))


def one_each():
    """Body i has model i alone, the last one all of them."""
    n = len(SUMMED) + 1
    terms = {}
    for i, name in enumerate(SUMMED):
        terms[name] = []
        for value in MODELS[name][0].values:
            if value is None:  # no limit
                continue
            if name == "QuaternionPD" and np.ndim(value) == 0:
                value = [[value]]
            row = np.zeros((n, *np.shape(value)))
            row[[i, -1]] = value
            terms[name].append(row)
    for unit in (terms["GravityGradient"][1], terms["GravityGradient"][2]):
        unit[~unit.any(axis=1)] = 1.0
    position, mu = terms["GravityGradientAt"]
    position[mu == 0.0], mu[mu == 0.0] = FAR, 1.0
    terms["QuaternionPD"][2][:, :] = TARGET
    return every(n, **terms)


def definitions(inertia):
    alone = [MODELS[name][1](inertia) for name in SUMMED]
    return [*alone, ro.total(*alone)]


def ends(inertia, actings, q0=START, w0=SPIN, t=SPAN, digits=18):
    """(q, w) of bodies at the end."""
    found = [ro.integrate(inertia, q0.tolist(), w0.tolist(), t, f, digits=digits) for f in actings]
    return np.array([floats(s.q) for s in found]), np.array([floats(s.w) for s in found])


def gaps(traj, q, w):
    return angle(traj.q[-1], q), np.abs(traj.w[-1] - w).max(axis=-1)


def run(scene, q0=START, w0=SPIN, n=64, t=SPAN, method="rk8", **options):
    return fa.propagate(scene, q0, w0, dt=t / n, n_steps=n, method=method, **options)


def many(n, q0=START, w0=SPIN):
    return np.tile(q0, (n, 1)), np.tile(w0, (n, 1))


def test_motion_under_each_torque_and_under_all():
    actings = definitions(INERTIA)
    n = len(actings)
    scene = fa.Scene(inertia=np.tile(INERTIA, (n, 1)), torque=one_each())
    traj = run(scene, *many(n))
    assert not traj.status.any()
    for found in gaps(traj, *ends(INERTIA, actings)):
        assert found.max() < 1e-12


def test_motion_with_a_tensor():
    """Principal axes turned against the body's, one tensor a body."""
    tensor = turned_tensor()
    actings = definitions(tensor)
    n = len(actings)
    scene = fa.Scene(inertia=np.tile(tensor, (n, 1, 1)), torque=one_each())
    # order 4, hundredths of h⁴
    traj = run(scene, *many(n), n=4000, method="rkmk4")
    assert not traj.status.any()
    for found in gaps(traj, *ends(tensor, actings)):
        assert found.max() < 1e-12


def test_a_run_beyond_a_history_says_so():
    """As of a ``TimeSeries``."""
    for outside, flags in (("nan", fa.Status.NON_FINITE), ("hold", 0)):
        scene = fa.Scene(inertia=INERTIA, torque=ft.Sampled(RAMP, SPAN, 0.0, outside))
        past = fa.propagate(scene, START, SPIN, dt=0.1, n_steps=21, method="rk4", invalid="flag")
        assert past.status == flags


def test_motion_under_a_history():
    scene = fa.Scene(inertia=INERTIA, torque=ft.Sampled(RAMP, SPAN))
    traj = run(scene, START[None], SPIN[None], n=4000, method="rkmk4")
    for found in gaps(traj, *ends(INERTIA, [ramp])):
        assert found.max() < 1e-12


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (ft.GravityGradient(0.5, (7e6, 0, 0)), r"radial: its length is 7000000.0; accepted: 1"),
        (ft.GravityGradient(0.5, along=(0.8, 0.6, 0)), r"radial·along is 0.8; accepted: 0"),
        (ft.KeplerGravityGradient([0.5, 0.5], 0.1, [(1, 0, 0), (0, 0, 0)]), r"periapsis.*\[1\] is"),
        (ft.QuaternionPD(1.0, 1.0, (1, 1, 0, 0)), "target: its length is 1.41"),
    ],
)
def test_directions_that_are_no_unit_vectors_are_refused(model, message):
    with pytest.raises(ValueError, match=message):
        fa.Scene(inertia=INERTIA, torque=model)


def test_torques_of_each_body_are_single_runs():
    scene = fa.Scene(inertia=np.tile(INERTIA, (len(SUMMED) + 1, 1)), torque=one_each())
    full = run(scene, *many(len(SUMMED) + 1))
    for i in range(len(SUMMED) + 1):
        terms = {
            type(m).__name__: [np.asarray(a)[i] for a in m.values if a is not None]
            for m in scene.torque.terms
        }
        one = run(
            fa.Scene(inertia=INERTIA[None], torque=every(1, **terms)), START[None], SPIN[None]
        )
        assert one.q.tobytes() == full.q[:, [i]].tobytes()
        assert one.w.tobytes() == full.w[:, [i]].tobytes()


# closed forms


def test_symmetric_heavy_top_precesses_regularly():
    """Slow and fast roots of I1 cos θ φ̇² − I3 w3 φ̇ + m g l = 0, three inclinations."""
    i1, i3, w3, weight, arm, t = 0.8, 0.5, 6.0, 3.0, 0.2, 3.0
    tops = []
    for theta in (0.4, 1.2, 2.3):
        for precession in ro.heavy_top_precession(i1, i3, mp.mpf(theta), w3, weight * arm):
            states = [ro.regular_precession(mp.mpf(theta), w3, precession, s) for s in (0, t)]
            tops.append([[floats(a) for a in s] for s in states])
    n = len(tops)
    scene = fa.Scene(
        inertia=np.tile([i1, i1, i3], (n, 1)), torque=every(n, HeavyTop=([0.0, 0.0, arm], weight))
    )
    (q0, w0), (q, w) = (
        [np.array(x) for x in zip(*s, strict=True)] for s in zip(*tops, strict=True)
    )
    traj = run(scene, q0, w0, n=600, t=t)
    # the initial state is rounded, and regular precession is stable
    for found in gaps(traj, q, w):
        assert found.max() < 1e-12


def test_symmetric_heavy_top_nutates():
    """Released without precession, the axis falls and rises; about its axis w3 stays."""
    i1, i3, w3, weight, arm, t = 0.8, 0.5, 6.0, 3.0, 0.2, 3.0
    q0 = np.array(floats(ro.euler_attitude(0, mp.mpf("0.9"), 0)))
    w0 = np.array([0.0, 0.0, w3])
    scene = fa.Scene(inertia=[[i1, i1, i3]], torque=every(1, HeavyTop=([0.0, 0.0, arm], weight)))
    traj = run(scene, q0[None], w0[None], n=600, t=t, save_every=1)
    exact = ends((i1, i1, i3), [ro.heavy_top(weight, (0.0, 0.0, arm))], q0, w0, t)
    for found in gaps(traj, *exact):
        assert found.max() < 1e-12
    assert np.abs(traj.w[..., 2] - w3).max() < 1e-13
    height = traj.dcm[:, 0, 2, 2]  # the cosine of the inclination
    energy = 0.5 * (traj.w[:, 0] ** 2 * [i1, i1, i3]).sum(-1) + weight * arm * height
    assert np.ptp(energy) < 1e-13 * energy[0] * 10
    vertical = np.einsum("si,si->s", traj.dcm[:, 0, 2], traj.w[:, 0] * [i1, i1, i3])
    assert np.ptp(vertical) < 1e-12
    assert np.ptp(height) > 0.05


def test_pitch_libration_in_orbit():
    """Amplitudes from small to 1.2 rad: the period is that of the elliptic integral."""
    inertia, n = np.array([1.0, 0.9, 0.4]), 0.8
    amplitudes = [mp.mpf(a) for a in ("1e-6", "0.1", "1.2")]
    period = 2 * mp.pi / ro.pitch_frequency(inertia.tolist(), n)
    t = float(1.3 * period)
    start, end = (
        [[floats(x) for x in ro.pitch_libration(inertia.tolist(), n, a, s)[:2]] for a in amplitudes]
        for s in (0, mp.mpf(t))
    )
    (q0, w0), (q, w) = ([np.array(x) for x in zip(*s, strict=True)] for s in (start, end))
    bodies = len(amplitudes) + 1  # three rows of moments would be a tensor
    q0, w0, q, w = (np.concatenate([x, x[:1]]) for x in (q0, w0, q, w))
    scene = fa.Scene(
        inertia=np.tile(inertia, (bodies, 1)), torque=every(bodies, GravityGradient=(n,))
    )
    traj = run(scene, q0, w0, n=800, t=t)
    for found in gaps(traj, q, w):
        assert found.max() < 1e-12
    # small librations: α = a cos(n √(3 (I1 − I3)/I2) t)
    alpha = w[0, 1] - n
    exact = -1e-6 * math.sin(2.6 * math.pi) * 2 * math.pi / float(period)
    assert alpha == pytest.approx(exact, rel=1e-9)


def test_damped_spins():
    """w = w0 e^(−ct/I) and w0/(1 + c w0 t/I), each axis."""
    t, w0, c = 5.0, 3.0, 0.2
    spins = np.concatenate([w0 * np.eye(3)] * 3)
    linear, quadratic, axial = (np.repeat(a, 3) for a in np.eye(3))
    torques = every(
        9,
        Damping=(c * linear,),
        QuadraticDamping=(c * quadratic,),
        AxisDamping=(np.outer(axial, [c, 2 * c, 0.5 * c]),),
    )
    start = np.tile([1.0, 0.0, 0.0, 0.0], (9, 1))
    traj = run(fa.Scene(inertia=np.tile(INERTIA, (9, 1)), torque=torques), start, spins, n=200, t=t)
    for b in range(9):
        i = INERTIA[b % 3]
        form = ro.quadratic_spin_down if 3 <= b < 6 else ro.linear_spin_down
        rate, turned = form(i, c * (1.0 if b < 6 else (1.0, 2.0, 0.5)[b % 3]), w0, t)
        unit = np.eye(3)[b % 3]
        assert close(traj.w[-1, b], float(rate) * unit) < 1e-12
        assert angle(traj.q[-1, b], exp(float(turned) * unit)) < 1e-12


def test_slew_to_a_target():
    """About one axis I θ̈ = −k sin(θ/2) − c θ̇; more than half a turn goes the other way."""
    i, k, c, t = 0.8, 2.0, 0.7, 4.0
    angles = np.array([1e-3, 0.5, 3.0, 2 * math.pi - 3.0, 4.0])
    n = len(angles)
    target = START
    q0 = mul(target, exp(np.outer(angles, [0.0, 1.0, 0.0])))
    torques = every(n, QuaternionPD=(k, c, target))
    scene = fa.Scene(inertia=np.tile(INERTIA, (n, 1)), torque=torques)
    traj = run(scene, q0, np.zeros((n, 3)), n=200, t=t)
    for b, a in enumerate(angles):
        shorter = a if a < math.pi else a - 2 * math.pi
        theta, rate = ro.pd_slew(i, k, c, mp.mpf(float(shorter)), t, digits=20)
        assert angle(traj.q[-1, b], mul(target, exp([0.0, float(theta), 0.0]))) < 1e-12
        assert close(traj.w[-1, b], [0.0, float(rate), 0.0]) < 1e-12
    theta, rate = ro.pd_slew_linear(i, k, c, mp.mpf("1e-3"), t)
    assert traj.w[-1, 0, 1] == pytest.approx(float(rate), abs=1e-10)


OWN_GAINS = [[[0.4]], [[0.1]]]
CONTROLLERS = [
    (0.4, 0.3, 0.1),
    (0.4, (0.4, 0.3, 0.2), None),
    ((0.4, 0.3, 0.2), 0.3, (0.05, 0.1, 9.0)),
    (MATRIX_GAIN, OWN_GAINS, None),
    (OWN_GAINS, [MATRIX_GAIN, np.eye(3)], [[0.1], [0.2]]),
]


@pytest.mark.parametrize(("stiffness", "damping", "limit"), CONTROLLERS)
def test_gains_of_a_controller(stiffness, damping, limit):
    """Beside the same in NumPy: numbers, an axis each, matrices; of all bodies and of each."""
    model = ft.QuaternionPD(stiffness, damping, TARGET, limit=limit)
    pd = ft.pack(model, 2)
    rng = np.random.default_rng(1)
    q, w = rng.normal(size=(2, 4)), rng.normal(size=(2, 3))
    q /= np.linalg.norm(q, axis=1, keepdims=True)

    def formula(t, q, w, p):
        return pd.structure.formula(t, Pose(QUATERNION, q, w, INERTIA), p)

    acting = rows(formula, {"t": None, "q": 4, "w": 3, "p": pd.structure.count}, (3,))
    (found,) = acting(0.0, q, w, pd.params)

    def times(gain, v):
        gain = np.asarray(gain)
        matrix = gain * np.eye(3) if gain.shape[-1:] in ((), (1,)) or gain.ndim == 1 else gain
        return np.einsum("...ij,...j->...i", matrix, v)

    e = mul(conj(TARGET), q)
    wanted = -times(stiffness, np.sign(e[:, :1]) * e[:, 1:]) - times(damping, w)
    if limit is not None:
        assert (np.abs(wanted) > limit).any()
        wanted = np.clip(wanted, -np.asarray(limit), limit)
    assert close(found, wanted) < 8 * EPS
    # a row of a scene has the gains of its body
    one = fa.Scene(inertia=INERTIA, torque=model)[[1]].torque
    assert np.array_equal(np.atleast_2d(ft.pack(one, 1).params)[-1], np.atleast_2d(pd.params)[-1])


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ((-1.0, 0.0), r"QuaternionPD.stiffness is -1.0; accepted: 0 or more"),
        ((1.0, (1.0, -2.0, 1.0)), r"QuaternionPD.damping\[1\] is -2.0; accepted: 0 or more"),
        ((np.diag([1.0, 1.0, -1.0]), 0.0), "stiffness: its lowest eigenvalue is -1.0; accepted"),
        ((1.0, np.arange(9.0).reshape(3, 3)), "damping: its asymmetry is 4.0; accepted: 0"),
        (([1.0, 2.0], 1.0), r"has shape \(2,\); accepted: a number, \(3,\) per axis, a \(3, 3\)"),
        ((1.0, 1.0, TARGET, 0.0), r"QuaternionPD.limit\[0\] is 0.0; accepted: above 0"),
        ((1.0, 1.0, TARGET, (1.0, 2.0)), r"QuaternionPD.limit has shape \(2,\); accepted: a num"),
    ],
)
def test_gains_that_no_controller_has_are_refused(gains, message):
    with pytest.raises(ValueError, match=message):
        fa.Scene(inertia=INERTIA, torque=ft.QuaternionPD(*gains))


def test_rotor_is_a_torque_that_does_no_work():
    """Energy and the length of I w + h stay."""
    h = np.array([0.3, 0.2, -0.4])
    scene = fa.Scene(inertia=INERTIA[None], torque=every(1, Rotor=(h,)))
    traj = run(scene, START[None], SPIN[None], n=400, t=10.0, save_every=10)
    w = traj.w[:, 0]
    assert np.ptp((w * w) @ INERTIA) < 1e-12
    total = INERTIA * w + h
    assert np.ptp(np.linalg.norm(total, axis=1)) < 1e-12
    fixed = np.einsum("sij,sj->si", traj.dcm[:, 0], total)
    assert np.ptp(fixed, axis=0).max() < 1e-12


# users' torques


@njit
def weight_and_damping(t, q, w, p):
    """A weight p[3] at p[:3], linear damping p[4]."""
    x, y, z = (
        2.0 * (q[1] * q[3] - q[0] * q[2]),
        2.0 * (q[2] * q[3] + q[0] * q[1]),
        q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3],
    )
    return (
        -p[3] * (p[1] * z - p[2] * y) - p[4] * w[0],
        -p[3] * (p[2] * x - p[0] * z) - p[4] * w[1],
        -p[3] * (p[0] * y - p[1] * x) - p[4] * w[2],
    )


def potential_v(t, q, w, p):
    """Of U = q0² − q1² − q2² + q3²; needs no njit of its own."""
    return 2.0 * (q[0] * q[1] + q[2] * q[3]), 2.0 * (q[0] * q[2] - q[1] * q[3]), 0.0 * w[2]


ARM = np.array([0.1, 0.2, 0.3])


@pytest.mark.parametrize("axes", [None, AXES], ids=["principal", "turned"])
def test_user_torque_is_the_built_in_one(axes):
    """q, w and the result are along the body's axes, wherever the principal ones are."""
    theirs = ft.Custom(weight_and_damping, (*ARM, 2.0, 0.2))
    ours = Sum((ft.HeavyTop(ARM, 2.0), ft.Damping(0.2)))
    for t, q, w in states():
        a, b = (found_torque(m, "quat", t, q, w, axes) for m in (theirs, ours))
        assert close(a, b) < 20 * EPS


def test_motion_under_a_user_torque_with_each_bodys_parameters():
    n = 5
    arms = np.random.default_rng(2).normal(size=(n, 3)) * 0.3
    params = np.concatenate([arms, np.full((n, 1), 2.0), np.full((n, 1), 0.2)], axis=1)
    scene = fa.Scene(inertia=INERTIA, torque=weight_and_damping, params=params)
    traj = run(scene, *many(n), n=4000, method="rkmk4")
    actings = [ro.total(ro.heavy_top(2.0, tuple(a)), ro.linear_damping(0.2)) for a in arms]
    for found in gaps(traj, *ends(INERTIA, actings)):
        assert found.max() < 1e-12
    one = run(
        fa.Scene(inertia=INERTIA, torque=weight_and_damping, params=params[[3]]),
        *many(1),
        n=4000,
        method="rkmk4",
    )
    assert one.q.tobytes() == traj.q[:, [3]].tobytes()


def test_user_torque_that_does_not_use_the_rate():
    """That it says so opens the methods that split, in a sum with damping too."""
    terms = ft.Custom(potential_v, uses_rate=False), ft.Damping(0.1)
    scene = fa.Scene(inertia=INERTIA, torque=Sum(terms))
    acting = ro.total(ro.potential_v, ro.linear_damping(0.1))
    traj = run(scene, START[None], SPIN[None], n=500, method="kahan_li8")
    for found in gaps(traj, *ends(INERTIA, [acting])):
        assert found.max() < 1e-12
    for acting, dependence in (
        (terms[0], Dependence.POSITION),
        (ft.Custom(potential_v), Dependence.RATE),
        (potential_v, Dependence.RATE),
        (Sum((ft.Custom(potential_v), ft.Damping(0.1))), Dependence.RATE),
    ):
        assert fa.Scene(inertia=INERTIA, torque=acting).dependence() == dependence


def closure(gain):
    def acting(t, q, w, p):
        return gain * t, 0.0, -gain

    return acting


def test_functions_that_close_over_a_number():
    """Two functions of one code are two torques; njit is optional, and so are parameters."""
    for gain, make in ((0.5, njit), (2.0, lambda function: function)):
        found = found_torque(ft.Custom(make(closure(gain))), "quat", 1.5, START, SPIN, None)
        assert found.tolist() == [1.5 * gain, 0.0, -gain]


# what splits


DEPENDENCE = {
    "Constant": Dependence.POSITION,
    "ConstantInertial": Dependence.POSITION,
    "Damping": Dependence.DAMPED,
    "AxisDamping": Dependence.DAMPED,
    "QuadraticDamping": Dependence.RATE,
    "GravityGradient": Dependence.POSITION,
    "KeplerGravityGradient": Dependence.POSITION,
    "GravityGradientAt": Dependence.POSITION,
    "HeavyTop": Dependence.POSITION,
    "MagneticDipole": Dependence.POSITION,
    "QuaternionPD": Dependence.RATE,
    "Rotor": Dependence.RATE,
    "Sampled": Dependence.POSITION,
}
UNDER_TORQUE = [m for m in fa.METHODS.values() if m.is_stepped and "torqued" in m.scenes]


@each("name", MODELS)
def test_methods_that_fit_a_torque(name):
    model = MODELS[name][0]
    # damping along the body's axes is not along the principal ones
    turned = Dependence.RATE if name == "AxisDamping" else DEPENDENCE[name]
    for scene, dependence in (
        (fa.Scene(inertia=INERTIA, torque=model), DEPENDENCE[name]),
        (
            fa.Scene(inertia=INERTIA, torque=Sum((ft.Constant((1.0, 0.0, 0.0)), model))),
            DEPENDENCE[name],
        ),
        (fa.Scene(inertia=turned_tensor(), torque=model), turned),
    ):
        assert scene.kind == "torqued"
        assert scene.dependence() == dependence
        fitting = fa.methods_for(scene)
        assert fitting == [m.name for m in UNDER_TORQUE if m.takes >= dependence]
        if dependence == Dependence.RATE:
            with pytest.raises(ValueError, match="method: found 'strang2'; accepted: ") as refusal:
                fa.propagate(scene, START, SPIN, dt=0.1, n_steps=1, method="strang2")
            assert f"accepted: {', '.join(fitting)} (strang2 needs a torque" in str(refusal.value)


def observed_dependence(model, axes):
    """The least that explains the derivatives of a torque in w, along principal axes."""
    derivatives = []
    for t, q, w in states():
        values = [found_torque(model, "quat", t, q, w + d, axes) for d in displaced(3, 0.1)]
        derivatives.append(derivative(np.array(values), 0.1))
    if axes is not None:  # w was displaced along the body's axes
        derivatives = [d @ fa.quat_to_dcm(axes) for d in derivatives]
    found = np.array(derivatives)
    if not found.any():
        return Dependence.POSITION
    diagonal = np.abs(found - found * np.eye(3)).max() < 100 * EPS
    constant = np.abs(found - found[0]).max() < 100 * EPS
    return Dependence.DAMPED if diagonal and constant else Dependence.RATE


@pytest.mark.parametrize("axes", [None, AXES], ids=["principal", "turned"])
@pytest.mark.parametrize("name", MODELS)
def test_dependence_on_the_rate_is_what_the_record_says(name, axes):
    """No less ever; no more but of a controller, whose damping is no term of its own."""
    model = MODELS[name][0]
    found = observed_dependence(model, axes)
    said = ft.dependence(ft.pack(model, None).structure, turned=axes is not None)
    assert found == (Dependence.DAMPED if name == "QuaternionPD" else said)
    assert found <= said


def test_every_torque_of_the_package_is_among_the_models():
    # of scenes with mass, with states, with samples in time: tests in files of their names
    elsewhere = {"CentralGravityGradient", "ReactionWheels", "SampledControl"}
    every = {*MODELS, *elsewhere}
    assert every == set(ft.__all__) - {"Custom", "Sum"}


def test_a_torque_that_says_nothing_is_taken_for_one_of_any_rate_along_body_axes():
    """No splitting evaluates it at a standstill, and no frame is assumed for it."""
    assert Torque.depends is Dependence.RATE
    assert not Torque.axis_free


@each("name", MODELS)
def test_damping_that_splittings_take_exactly_is_the_torques(name):
    """All of what depends on w, of a torque that they take."""
    model = MODELS[name][0]
    packed = ft.pack(model, None)
    rates = ft.damping_rates(packed.structure, INERTIA, packed.params)
    if DEPENDENCE[name] != Dependence.DAMPED:
        assert rates is None
        return
    t, q, w = next(iter(states()))
    values = [found_torque(model, "quat", t, q, w + d, None) for d in displaced(3, 0.1)]
    assert close(np.diag(rates * INERTIA), -derivative(np.array(values), 0.1)) < 100 * EPS
    assert ft.fastest_decay(model, INERTIA) >= max(rates)


@njit
def damped_at_times(t, q, w, p):
    """What is called, not traced."""
    n = 0
    while n < t:
        n += 1
    return -p[0] * w[0], 0.0 * n, q[1]


def rate_that_cancels(t, q, w, p):
    return q[1] + (w[0] - w[0]), 0.0 * w[1], p[0]


def singular_at_rest(t, q, w, p):
    return (w[0] - w[0]) / w[0], 0.0, 0.0


def singular(t, q, w, p):
    return p[0] / p[0], 0.0, q[1]


ROWS = np.array([[0.0], [0.0], [0.0], [0.1]])


def test_a_users_function_that_uses_the_rate_is_seen_where_it_says_it_does_not():
    """Splittings would ask for it at w = 0."""
    assert observed_dependence(ft.Custom(weight_and_damping, (*ARM, 2.0, 0.2)), None) == (
        Dependence.DAMPED
    )
    for function, params in (
        (weight_and_damping, (*ARM, 2.0, 0.2)),
        (weight_and_damping, (*ARM, 2.0, 1e-6)),
        (damped_at_times, (0.1,)),
        (damped_at_times, ROWS),
        (singular_at_rest, (0.1,)),
    ):
        promised = ft.Custom(function, params, uses_rate=False)
        for torque in (promised, Sum((ft.Damping(0.1), promised))):
            with pytest.raises(
                ValueError, match=r"uses_rate False with \w+, which gives other tor"
            ):
                fa.Scene(inertia=INERTIA, torque=torque)
        fa.Scene(inertia=INERTIA, torque=ft.Custom(function, params))
    for function, params in (
        (rate_that_cancels, (0.1,)),
        (singular, (0.0,)),
        (singular, [[0.0], [1.0]]),
        (damped_at_times, (0.0,)),
        (weight_and_damping, (*ARM, 2.0, 0.0)),
        (potential_v, None),
    ):
        promised = ft.Custom(function, params, uses_rate=False)
        assert fa.Scene(inertia=INERTIA, torque=promised).dependence() == Dependence.POSITION


# potentials


@pytest.mark.parametrize(
    ("names", "kept"),
    [
        (["HeavyTop"], True),
        (["MagneticDipole"], True),
        (["Rotor"], True),
        (["HeavyTop", "Rotor"], True),
        (["HeavyTop", "Damping"], False),
        (["GravityGradient"], False),
        (["QuaternionPD"], False),
        (["Constant"], False),
        (["Sampled"], False),
    ],
)
def test_torques_that_keep_an_energy(names, kept):
    packed = ft.pack(Sum(tuple(MODELS[n][0] for n in names)), None)
    assert ft.has_potential(packed.structure) is kept


# wrong input


T = ft
WRONG = [
    (
        T.Damping("much"),
        TypeError,
        "torque: Damping.coefficient: found 'much'; accepted: finite",
    ),
    (T.Damping(np.nan), ValueError, "torque: Damping.coefficient is nan"),
    (
        T.Constant([1.0, 2.0]),
        ValueError,
        "torque: Constant.torque has shape (2,); accepted are (3,)",
    ),
    (T.Constant([[1.0, np.inf, 0.0]]), ValueError, "torque: Constant.torque[0, 1] is inf"),
    (T.HeavyTop([0.0, 0.0, 1.0], [[1.0]]), ValueError, "torque: HeavyTop.weight has shape (1, 1)"),
    (
        T.MagneticDipole(np.ones((2, 3)), np.ones((4, 3))),
        ValueError,
        "torque: MagneticDipole: found parameters for 2 and 4 bodies",
    ),
    (T.QuaternionPD(1.0, 1.0, [1.0, 0.0, 0.0]), ValueError, "QuaternionPD.target has shape (3,)"),
    (T.Sampled([[0.0, 0.0, 0.0]], 0.1), ValueError, "Sampled.torques has 1 sample; accepted: at"),
    (
        T.Sampled(np.ones((4, 2)), 0.1),
        ValueError,
        "Sampled.torques: has shape (4, 2); accepted: (n",
    ),
    (
        T.Sampled(np.ones((4, 3)), 1.0, 0.0, "zero"),
        ValueError,
        "Sampled.outside: found 'zero'; accepted: ",
    ),
    (T.Sampled(np.ones((4, 3)), 0.0), ValueError, "Sampled.dt: found 0.0; accepted: above 0"),
    (T.Sampled(np.ones((4, 3)), -1.0), ValueError, "Sampled.dt: found -1.0; accepted: above 0"),
    (T.Sampled(np.ones((4, 3)), 1.0, np.nan), ValueError, "Sampled.start: found nan"),
    (T.Sum(()), ValueError, "torque: Sum.terms is empty"),
    (T.Sum((T.Damping(1.0), 3.0)), TypeError, "torque: Sum: found float; accepted is a model of"),
    (
        3.0,
        TypeError,
        "torque: found float; accepted is a model of fastatt.torques (AxisDamping",
    ),
    (fa.rates.Constant([1.0, 0.0, 0.0]), TypeError, "torque: found Constant; accepted is a model"),
    (T.Custom("function"), TypeError, "torque: found 'function'; accepted: a function torque("),
]


@each(("model", "error", "message"), WRONG)
def test_wrong_numbers(model, error, message):
    with pytest.raises(error, match=re.escape(message)):
        fa.Scene(inertia=INERTIA, torque=model)


def two_numbers(t, q, w, p):
    return 0.0, 1.0


def a_number(t, q, w, p):
    return 0.0


def beyond(t, q, w, p):
    return p[3], 0.0, 0.0


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (two_numbers, "returns UniTuple(float64 x 2); accepted is a tuple of three floats, N·m"),
        (a_number, "returns float64; accepted is a tuple of three floats"),
        (beyond, "does not compile for floats, with p a tuple of 2 floats"),
    ],
)
def test_wrong_functions(function, message):
    with pytest.raises(
        TypeError, match=re.escape(f"torque: {function.__name__}(t, q, w, p) ")
    ) as e:
        fa.Scene(inertia=INERTIA, torque=function, params=(1.0, 2.0))
    assert message in str(e.value)


def test_numbers_for_another_count_of_bodies():
    scene = fa.Scene(inertia=INERTIA, torque=T.Damping([0.1, 0.2]))
    with pytest.raises(ValueError, match=r"found parameters for 2 bodies; accepted: 5 bodies"):
        run(scene, *many(5))


def test_params_stand_beside_a_function_only():
    with pytest.raises(ValueError, match=r"params: found .* with the model Damping; accepted: "):
        fa.Scene(inertia=INERTIA, torque=T.Damping(0.1), params=(1.0,))
    with pytest.raises(ValueError, match=r"params: found .* with the model NoneType; accepted: "):
        fa.Scene(inertia=INERTIA, params=(1.0,))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_numbers_of_each_body_beside_an_inertia_that_all_share(dtype):
    """Rows of parameters lie one after the other, whatever they were put together from."""
    n = 70
    q0, w0 = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.tile([0.1, 0.3, -0.2], (n, 1))
    runs = [
        fa.propagate(
            fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=fa.torques.Damping(coefficient)),
            q0, w0, dt=0.05, n_steps=40, method="rk4", dtype=dtype,
        )
        for coefficient in (0.02, np.full(n, 0.02))
    ]  # fmt: skip
    assert np.array_equal(runs[0].q, runs[1].q)
    assert np.array_equal(runs[0].w, runs[1].w)


def test_a_scene_that_was_used_can_be_pickled():
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=fa.torques.Damping(0.02))
    fa.propagate(scene, [1, 0, 0, 0], [0.1, 0.3, -0.2], dt=0.05, n_steps=1)
    copied = pickle.loads(pickle.dumps(scene))
    assert copied == scene
    assert copied.kind == "torqued"
