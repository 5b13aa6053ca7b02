"""Torques against their definitions in mpmath, motions under them, users' torques."""

from __future__ import annotations

import functools
import inspect
import re
from dataclasses import replace

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
from fastatt.propagation.choice_of_method import methods_for
from fastatt.scene import torque_record
from fastatt.scene import torques as ft
from fastatt.scene.models import Sum
from fastatt.scene.torque_record import Dependence, Pose

INERTIA = np.array([0.6, 0.8, 1.0])
AXES = exp([0.3, -0.5, 0.7])  # where the principal axes of the tensors lie
SPIN = np.array([0.9, -0.4, 1.2])
TARGET = tuple(mul(START, exp(SPIN)).tolist())  # ahead: less than half a turn away throughout
RADIAL, ALONG = (0.0, 0.6, 0.8), (1.0, 0.0, 0.0)
SPAN = 2.0


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


CONSTANT, PULL = (0.1, -0.2, 0.3), (1.5, -2.0, 0.5)
ARM, MOMENT, FIELD, ROTOR = (0.1, 0.2, 0.3), (0.3, -0.2, 0.5), (1.0, 0.5, -0.7), (0.3, 0.2, -0.4)
# name: the model, and what it is (of the inertia along body axes)
MODELS = {
    "Constant": (ft.Constant(CONSTANT), lambda i: ro.constant_body(CONSTANT)),
    "ConstantInertial": (ft.ConstantInertial(CONSTANT), lambda i: ro.constant_inertial(CONSTANT)),
    "Damping": (ft.Damping(0.2), lambda i: ro.linear_damping(0.2)),
    "DampingOfAxes": (ft.Damping((0.1, 0.2, 0.3)), lambda i: ro.linear_damping((0.1, 0.2, 0.3))),
    "QuadraticDamping": (ft.QuadraticDamping(0.2), lambda i: ro.quadratic_damping(0.2)),
    "GravityGradient": (
        ft.GravityGradient(0.5, RADIAL, ALONG),
        lambda i: gravity_gradient(i, 0.5, RADIAL, ALONG),
    ),
    "GravityGradientAt": (ft.GravityGradientAt(PULL, 3.0), lambda i: attracted(i, PULL, 3.0)),
    "HeavyTop": (ft.HeavyTop(ARM, 2.0), lambda i: ro.heavy_top(2.0, ARM)),
    "MagneticDipole": (ft.MagneticDipole(MOMENT, FIELD), lambda i: ro.dipole(MOMENT, FIELD)),
    "QuaternionPD": (ft.QuaternionPD(0.4, 0.3, TARGET), lambda i: ro.pd_control(0.4, 0.3, TARGET)),
    "Rotor": (ft.Rotor(ROTOR), lambda i: ro.rotor(ROTOR)),
}
MATRIX_GAIN = np.array([[0.4, 0.1, 0.0], [0.1, 0.3, -0.05], [0.0, -0.05, 0.2]])


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
    packed = torque_record.pack(model, None)
    if axes is not None:
        q = mul(q, axes)
        w = fa.quat_to_dcm(axes).T @ w
    x = {"quat": q, "dcm": fa.quat_to_dcm(q).ravel(), "dcm_rows": fa.quat_to_dcm(q).ravel()[:6]}
    torque = compiled(packed.structure, representation, None if axes is None else tuple(axes))
    (found,) = torque(t, x[representation], w, INERTIA, packed.params, tables=packed.tables)
    return found


TURNED = turned_tensor()
BOTH_AXES = pytest.mark.parametrize("axes", [None, AXES], ids=["principal", "turned"])


@each("name", MODELS)
@pytest.mark.parametrize("representation", ["quat", "dcm", "dcm_rows", "turned"])
def test_torque_is_its_definition(name, representation):
    """Of quaternions also along principal axes that are not the body's."""
    turned = representation == "turned"
    model, definition = MODELS[name]
    exact = definition(TURNED if turned else INERTIA)
    along = fa.quat_to_dcm(AXES).T if turned else np.eye(3)
    given = ("quat", AXES) if turned else (representation, None)
    for t, q, w in states():
        found = found_torque(model, given[0], t, q, w, given[1])
        assert close(found, along @ np.array(exact(t, q, w), float)) < 20 * EPS


# motions


def ends(inertia, actings, q0=START, w0=SPIN, t=SPAN, digits=18):
    """(q, w) of bodies at the end."""
    found = [ro.integrate(inertia, q0.tolist(), w0.tolist(), t, f, digits=digits) for f in actings]
    return np.array([floats(s.q) for s in found]), np.array([floats(s.w) for s in found])


def ends_at(traj, q, w):
    """The run ends at these attitudes and rates."""
    assert not traj.status.any()
    assert angle(traj.q[-1], q).max() < 1e-12
    assert np.abs(traj.w[-1] - w).max() < 1e-12


def run(scene, q0=START, w0=SPIN, n=64, t=SPAN, method="rk8", **options):
    return fa.propagate(
        scene, np.atleast_2d(q0), np.atleast_2d(w0), dt=t / n, n_steps=n, method=method, **options
    )


@pytest.mark.parametrize(
    ("inertia", "options"),
    # order 4, hundredths of h⁴
    [(INERTIA, {}), (TURNED, {"n": 4000, "method": "rkmk4"})],
    ids=["moments", "tensor"],
)
def test_motion_under_all_torques(inertia, options):
    """Of a tensor principal axes are turned against the body's."""
    scene = fa.Scene(inertia=inertia, torque=Sum(tuple(model for model, _ in MODELS.values())))
    acting = ro.total(*(definition(inertia) for _, definition in MODELS.values()))
    ends_at(run(scene, **options), *ends(inertia, [acting]))


OWN_GAINS = [[[0.4]], [[0.1]]]
CONTROLLERS = [
    (0.4, 0.3, 0.1), (0.4, (0.4, 0.3, 0.2), None), ((0.4, 0.3, 0.2), 0.3, (0.05, 0.1, 9.0)),
    (MATRIX_GAIN, OWN_GAINS, None), (OWN_GAINS, [MATRIX_GAIN, np.eye(3)], [[0.1], [0.2]]),
]  # fmt: skip


@pytest.mark.parametrize(("stiffness", "damping", "limit"), CONTROLLERS)
def test_gains_of_a_controller(stiffness, damping, limit):
    """Beside the same in NumPy: numbers, an axis each, matrices; of all bodies and of each."""
    model = ft.QuaternionPD(stiffness, damping, TARGET, limit=limit)
    pd = torque_record.pack(model, 2)
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
    assert np.array_equal(
        np.atleast_2d(torque_record.pack(one, 1).params)[-1], np.atleast_2d(pd.params)[-1]
    )


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


@BOTH_AXES
def test_user_torque_is_the_built_in_one(axes):
    """q, w and the result are along the body's axes, wherever the principal ones are."""
    theirs = ft.Custom(weight_and_damping, (*ARM, 2.0, 0.2))
    ours = Sum((ft.HeavyTop(ARM, 2.0), ft.Damping(0.2)))
    for t, q, w in states():
        a, b = (found_torque(m, "quat", t, q, w, axes) for m in (theirs, ours))
        assert close(a, b) < 20 * EPS


def test_user_torque_that_does_not_use_the_rate():
    """That it says so opens the methods that split, in a sum with damping too."""
    terms = ft.Custom(potential_v, uses_rate=False), ft.Damping(0.1)
    scene = fa.Scene(inertia=INERTIA, torque=Sum(terms))
    acting = ro.total(ro.potential_v, ro.linear_damping(0.1))
    ends_at(run(scene, n=500, method="kahan_li8"), *ends(INERTIA, [acting]))
    for acting, dependence in (
        (terms[0], Dependence.POSITION),
        (ft.Custom(potential_v), Dependence.RATE),
        (potential_v, Dependence.RATE),
        (Sum((ft.Custom(potential_v), ft.Damping(0.1))), Dependence.RATE),
    ):
        assert fa.Scene(inertia=INERTIA, torque=acting).dependence() == dependence


# what splits


DEPENDENCE = dict.fromkeys(MODELS, Dependence.POSITION) | {
    "Damping": Dependence.DAMPED,
    "DampingOfAxes": Dependence.DAMPED,
    "QuadraticDamping": Dependence.RATE,
    "QuaternionPD": Dependence.RATE,
    "Rotor": Dependence.RATE,
}
UNDER_TORQUE = [m for m in fa.METHODS.values() if m.is_stepped and "torqued" in m.scenes]


@each("name", MODELS)
def test_methods_that_fit_a_torque(name):
    model, expected = MODELS[name][0], DEPENDENCE[name]
    pushed = Sum((ft.Constant((1.0, 0.0, 0.0)), model))
    # damping along the body's axes is not along the principal ones
    turned = Dependence.RATE if name == "DampingOfAxes" else expected
    for inertia, torque, dependence in (
        (INERTIA, model, expected),
        (INERTIA, pushed, expected),
        (TURNED, model, turned),
    ):
        scene = fa.Scene(inertia=inertia, torque=torque)
        assert (scene.kind, scene.dependence()) == ("torqued", dependence)
        fitting = methods_for(scene)
        assert fitting == [m.name for m in UNDER_TORQUE if m.takes >= dependence]
        if dependence == Dependence.RATE:
            accepted = f"accepted: {', '.join(fitting)} (strang2 needs a torque"
            with pytest.raises(ValueError, match=re.escape(f"method: found 'strang2'; {accepted}")):
                fa.propagate(scene, START, SPIN, dt=0.1, n_steps=1, method="strang2")


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


@BOTH_AXES
@each("name", MODELS)
def test_dependence_on_the_rate_is_what_the_record_says(name, axes):
    """No less ever; no more but of a controller, whose damping is no term of its own."""
    model = MODELS[name][0]
    found = observed_dependence(model, axes)
    said = torque_record.dependence(
        torque_record.pack(model, None).structure, turned=axes is not None
    )
    assert found == (Dependence.DAMPED if name == "QuaternionPD" else said)
    assert found <= said


@each("name", MODELS)
def test_a_formula_that_holds_along_any_axes_is_declared(name):
    """It is evaluated along the principal axes as if they were the body's; no other is."""
    model = MODELS[name][0]
    (term,) = torque_record.pack(model, None).structure.terms
    t, q, w = next(iter(states()))
    along_principal = mul(q, AXES), fa.quat_to_dcm(AXES).T @ w
    as_of_body = found_torque(model, "quat", t, *along_principal, None)
    holds = close(as_of_body, found_torque(model, "quat", t, q, w, AXES)) < 20 * EPS
    assert term.model.axis_free == holds


@each("name", MODELS)
def test_what_is_documented_as_a_unit_vector_is_one(name):
    model = MODELS[name][0]
    text = re.sub(r"\n {4,}", " ", inspect.getdoc(type(model)))
    for field in re.findall(r"^(\w+) : array_like[^\n]*? Unit ", text, re.MULTILINE):
        longer = replace(model, **{field: 2.0 * np.array(getattr(model, field))})
        with pytest.raises(ValueError, match=f"{field}: its length is 2"):
            fa.Scene(inertia=INERTIA, torque=longer)


def test_every_torque_of_the_package_is_among_the_models():
    # of scenes with mass, with states, with samples in time: tests in files of their names
    elsewhere = {"CentralGravityGradient", "ReactionWheels", "SampledControl", "Switch"}
    assert {*MODELS, *elsewhere} - {"DampingOfAxes"} == set(ft.__all__) - {"Custom", "Sum"}


@each("name", MODELS)
def test_damping_that_splittings_take_exactly_is_the_torques(name):
    """All of what depends on w, of a torque that they take."""
    model = MODELS[name][0]
    packed = torque_record.pack(model, None)
    rates = torque_record.damping_rates(packed.structure, INERTIA, packed.params)
    if DEPENDENCE[name] != Dependence.DAMPED:
        assert rates is None
        return
    t, q, w = next(iter(states()))
    values = [found_torque(model, "quat", t, q, w + d, None) for d in displaced(3, 0.1)]
    assert close(np.diag(rates * INERTIA), -derivative(np.array(values), 0.1)) < 100 * EPS


@each("name", MODELS)
def test_first_steps_know_the_linear_damping_of_each_model(name):
    """That of small rates, as an optional method of the model bounds it."""
    model = MODELS[name][0]
    t, q, _ = next(iter(states()))
    values = [found_torque(model, "quat", t, q, d, None) for d in displaced(3, 1e-6)]
    slope = derivative(np.array(values), 1e-6)
    fastest = -np.linalg.eigvalsh(0.5 * (slope + slope.T)).min() / INERTIA.min()
    assert torque_record.fastest_decay(model, INERTIA) >= fastest - 1e-5


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
        (weight_and_damping, (*ARM, 2.0, 0.2)), (weight_and_damping, (*ARM, 2.0, 1e-6)),
        (damped_at_times, (0.1,)), (damped_at_times, ROWS), (singular_at_rest, (0.1,)),
    ):  # fmt: skip
        promised = ft.Custom(function, params, uses_rate=False)
        for torque in (promised, Sum((ft.Damping(0.1), promised))):
            with pytest.raises(
                ValueError, match=r"uses_rate False with \w+, which gives other tor"
            ):
                fa.Scene(inertia=INERTIA, torque=torque)
        fa.Scene(inertia=INERTIA, torque=ft.Custom(function, params))
    for function, params in (
        (rate_that_cancels, (0.1,)), (singular, (0.0,)), (singular, [[0.0], [1.0]]),
        (damped_at_times, (0.0,)), (weight_and_damping, (*ARM, 2.0, 0.0)), (potential_v, None),
    ):  # fmt: skip
        promised = ft.Custom(function, params, uses_rate=False)
        assert fa.Scene(inertia=INERTIA, torque=promised).dependence() == Dependence.POSITION


# potentials


@each("name", MODELS)
def test_a_torque_that_does_no_work_around_small_loops_has_an_energy(name):
    """Of torques of the attitude alone; the energy is what `fa.drift` then looks at."""
    model = MODELS[name][0]

    def torque(t, q):
        return found_torque(model, "quat", t, q, 0.0 * SPIN, None)

    curls, changes = [], []
    for t, q, _ in states():
        values = [torque(t, mul(q, exp(d))) for d in displaced(3, 1e-2)]
        slopes = derivative(np.array(values), 1e-2)  # of component i along axis j
        turned = np.array([[np.cross(a, b) @ torque(t, q) for b in np.eye(3)] for a in np.eye(3)])
        curls.append(slopes - slopes.T + turned)
        changes.append(torque(t + 1.0, q) - torque(t, q))
    is_closed = np.abs(curls).max() < 1e-6 and not np.any(changes)
    no_damping = DEPENDENCE[name] == Dependence.POSITION
    # the energy at a position that stays is of no use in an orbit
    if no_damping and name != "GravityGradientAt":
        assert is_closed == (model.energy is not None)


def test_torques_that_keep_an_energy():
    keep = ["HeavyTop", "MagneticDipole", "Rotor", "HeavyTop Rotor"]
    for names in (*keep, "HeavyTop Damping", "GravityGradient", "QuaternionPD", "Constant"):
        packed = torque_record.pack(Sum(tuple(MODELS[n][0] for n in names.split())), None)
        assert torque_record.has_potential(packed.structure) is (names in keep), names
