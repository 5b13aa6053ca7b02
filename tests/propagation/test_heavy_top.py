"""Heavy symmetric tops in closed form against integration with many digits and conserved sums."""

import math
import warnings

import mpmath as mp
import numpy as np
import oracle
import pytest
import rigid_oracle as ro

import fastatt as fa
from fastatt import closed_form
from fastatt.invariants.energy import potential_energy

UP, DOWN = (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)
SOME = (0.6, 0.5, -0.4, 0.48)
BODY = (1.0, 1.0, 0.5)
THIRD = (0.0, 0.0, 1.0)
TIMES = (-0.5, 1.5)


def tilted(angle, turn=0.3):
    s = math.sin(0.5 * angle)
    return math.cos(0.5 * angle), s * math.cos(turn), s * math.sin(turn), 0.0


def steady(angle, spin, fast, off=0.0):
    """Start of a regular precession, and of one that nutates by ``off``.

    I1 cos θ φ̇² − I3 w3 φ̇ + m g l = 0 has a slow and a fast solution.
    """
    rate = np.roots([math.cos(angle), -0.5 * spin, 1.0]).real[0 if fast else 1]
    return tilted(angle, 0.0), (off, rate * math.sin(angle) + off, spin)


# attitude, angular velocity, moments, arm; the weight is 1 N, so that √(μ/A) is 1
CASES = {
    "generic": (SOME, (0.3, -0.2, 4.0), BODY, THIRD),
    "downward arm": (SOME, (0.3, -0.2, 4.0), BODY, (0.0, 0.0, -1.5)),
    "first axis": (SOME, (4.0, 0.3, -0.2), (0.5, 1.0, 1.0), (0.8, 0.0, 0.0)),
    "second axis": (SOME, (-0.2, 1.0, 0.3), (1.0, 1.7, 1.0), (0.0, -0.8, 0.0)),
    "sphere": (SOME, (0.3, -0.2, 1.0), (1.0, 1.0, 1.0), (0.3, -0.5, -0.4)),
    "no gravity": (SOME, (0.3, -0.2, 1.0), BODY, (0.0, 0.0, 0.0)),
    "hardly gravity": (SOME, (0.3, -0.2, 1.0), BODY, (0.0, 0.0, 1e-13)),
    "hardly motion": (tilted(0.7), (0.0, 1e-9, 0.0), BODY, (0.0, 0.0, 1e-13)),
    "no gravity, rest": (UP, (0.0, 0.0, 0.0), BODY, (0.0, 0.0, 0.0)),
    "hardly a tilt": (tilted(1e-160), (0.0, 0.0, 0.0), BODY, THIRD),
    "no gravity, tilted": (SOME, (0.0, 0.0, 0.0), BODY, (0.0, 0.0, 0.0)),
    "needle": (SOME, (0.2, 0.3, 1e3), (1.0, 1.0, 1e-3), THIRD),
    "rest, hanging": (DOWN, (0.0, 0.0, 0.0), BODY, THIRD),
    "rest, upright": (UP, (0.0, 0.0, 0.0), BODY, THIRD),
    "hanging spin": (DOWN, (0.0, 0.0, 3.0), BODY, THIRD),
    "small pendulum": (DOWN, (1e-3, 0.0, 0.0), BODY, THIRD),
    "tiny pendulum": (DOWN, (1e-9, 0.0, 0.0), BODY, THIRD),
    "pendulum": (tilted(1.0), (0.0, 0.0, 0.0), BODY, THIRD),
    "pendulum, over": (DOWN, (5.0, 0.0, 0.0), BODY, THIRD),
    "no spin": (tilted(0.7), (1.0, 0.4, 0.0), BODY, THIRD),
    "cusps": (tilted(0.5), (0.0, 0.0, 8.0), BODY, THIRD),
    "fast": (tilted(0.5), (0.1, 0.2, 40.0), BODY, THIRD),
    "sleeping": (UP, (0.0, 0.0, 6.0), BODY, THIRD),
    "nearly sleeping": (tilted(1e-8), (1e-9, 0.0, 6.0), BODY, THIRD),
    "pushed asleep": (UP, (0.3, 0.2, 5.0), BODY, THIRD),
    "through the top": (UP, (0.5, 0.4, 2.0), BODY, THIRD),
    "by the top": (tilted(1e-9), (0.5, 0.4, 2.0), BODY, THIRD),
    "by the bottom": (tilted(math.pi - 1e-9), (0.5, 0.4, 2.0), BODY, THIRD),
    "slow precession": (*steady(0.7, 6.0, 0), BODY, THIRD),
    "fast precession": (*steady(0.7, 6.0, 1), BODY, THIRD),
    "slow, 1e-12 off": (*steady(0.7, 6.0, 0, 1e-12), BODY, THIRD),
    "slow, 1e-6 off": (*steady(0.7, 6.0, 0, 1e-6), BODY, THIRD),
    "fast, 1e-8 off": (*steady(0.7, 6.0, 1, 1e-8), BODY, THIRD),
    # about to wake, or coming to rest upright: deviations grow by exp √(μ/A) t or less
    "~marginal": (tilted(1e-6), (1e-6, 0.0, 4.0 + 1e-6), BODY, THIRD),
    "~marginal, upright": (UP, (0.0, 0.0, 4.0), BODY, THIRD),
    "~marginal, below": (tilted(1e-3), (1e-3, 0.0, 4.0 - 1e-3), BODY, THIRD),
    "~waking": (tilted(1e-8), (0.0, 0.0, 1.0), BODY, THIRD),
    "~waking, spin 3": (tilted(1e-3), (0.0, 0.0, 3.0), BODY, THIRD),
    "~falling": (tilted(1e-6), (0.0, 0.0, 0.0), BODY, THIRD),
    "~pushed": (UP, (1e-9, 0.0, 1.0), BODY, THIRD),
    "~unstable, upright": (UP, (0.0, 0.0, 1.0), BODY, THIRD),
    "~separatrix": (DOWN, (2.0, 0.0, 0.0), BODY, THIRD),
    "~separatrix, inside": (DOWN, (2.0 - 1e-10, 0.0, 0.0), BODY, THIRD),
    "~separatrix, outside": (DOWN, (2.0 + 1e-10, 0.0, 0.0), BODY, THIRD),
    "~separatrix, from a tilt": (tilted(0.8), (2.0 * math.sin(0.4), 0.0, 1e-9), BODY, THIRD),
}
COLUMNS = [np.array(x) for x in zip(*CASES.values(), strict=True)]
GOOD = {"arm": THIRD, "weight": 1.0}


def speed(w, inertia, arm):
    """W: as fast as a top may ever be."""
    return math.sqrt(ro.dot(w, w) + 4.0 * math.hypot(*arm) / sorted(inertia)[1])


@pytest.fixture(scope="module")
def motions():
    """All cases at all times, in one call."""
    q0, w0, inertia, arm = COLUMNS
    return closed_form.heavy_top(q0, w0, inertia, (0.0, *TIMES), arm=arm, weight=1.0)


@pytest.mark.parametrize("name", CASES)
def test_against_integration(name, motions):
    q0, w0, inertia, arm = CASES[name]
    row = list(CASES).index(name)
    size = mp.sqrt(sum(mp.mpf(c) ** 2 for c in q0))
    start = [c / size for c in q0]
    true = ro.integrate(inertia, start, w0, TIMES, ro.heavy_top(1.0, arm), digits=18)
    top = speed(w0, inertia, arm)
    states = zip((0.0, *TIMES), (ro.State(start, w0), *true), strict=True)
    for k, (t, state) in enumerate(states):
        growth = math.cosh(t) if name.startswith("~") else 1.0
        bound = 1e-15 * (1.0 + top * abs(t)) * growth
        assert 2.0 * oracle.attitude_error(motions[0][k, row], state.q) <= bound
        assert oracle.distance(motions[1][k, row], state.w) <= bound * top


@pytest.mark.parametrize("spin", [0.0, 1.0, 3.9, 4.0, 5.0])
def test_upright_it_stays(spin):
    """An equilibrium, stable or not, at any time."""
    t = np.array([-1e5, -30.0, 3.0, 1e3])
    q, w = closed_form.heavy_top(UP, (0.0, 0.0, spin), BODY, t, **GOOD)
    true = np.stack([np.cos(0.5 * spin * t), 0.0 * t, 0.0 * t, np.sin(0.5 * spin * t)], axis=1)
    assert (np.abs(q - true).max(axis=1) <= 4e-16 * (1.0 + spin * np.abs(t))).all()
    assert np.abs(w - (0.0, 0.0, spin)).max() <= 1e-15


def test_what_is_conserved_over_long_times():
    """Energy, momentum about the axis and the vertical, to rounding whatever the time."""
    q0, w0, inertia, arm = COLUMNS
    t = np.array([-3e4, 1e3])
    q, w = closed_form.heavy_top(q0, w0, inertia, t, arm=arm, weight=1.0)
    scene = fa.Scene(inertia=inertia, torque=fa.torques.HeavyTop(arm, np.ones(len(arm))))
    reach = np.linalg.norm(arm, axis=1)
    size = (inertia * w0**2).sum(1) + reach
    n = np.linalg.norm(q0, axis=1, keepdims=True)

    def energy(q, w):
        return fa.kinetic_energy(w, inertia) + potential_energy(scene, q)

    def vertical(q, w):
        return fa.quat_rotate(q, inertia * w)[..., 2]

    assert (np.abs(energy(q, w) - energy(q0 / n, w0)) <= 1e-14 * size).all()
    assert (np.abs(vertical(q, w) - vertical(q0 / n, w0)) <= 1e-14 * np.sqrt(2.0 * size)).all()
    assert np.abs(np.linalg.norm(q, axis=-1) - 1.0).max() <= 1e-15


def test_tensors():
    """Body axes turned by p."""
    q0, w0, inertia, arm = (x[:5] for x in COLUMNS)
    p = np.array(oracle.quaternions(5, 6))
    C = fa.quat_to_dcm(p)
    tensors = np.einsum("nij,nj,nkj->nik", C, inertia, C)
    turned = fa.quat_multiply(q0, p * (1.0, -1.0, -1.0, -1.0)), fa.quat_rotate(p, w0)
    q, w = closed_form.heavy_top(*turned, tensors, TIMES, arm=fa.quat_rotate(p, arm), weight=1.0)
    true_q, true_w = closed_form.heavy_top(q0, w0, inertia, TIMES, arm=arm, weight=1.0)
    assert fa.angle_between(fa.quat_multiply(q, p), true_q).max() <= 3e-14
    assert np.abs(fa.quat_rotate_inverse(p, w) - true_w).max() <= 2e-13


def test_tensor_of_nearly_a_sphere():
    """Its axes are known to some 1e-9 only, and matter as little."""
    p = np.array(oracle.quaternions(1, 8)[0])
    C = fa.quat_to_dcm(p)
    inertia = C @ np.diag([1.0, 1.0, 1.0 + 1e-7]) @ C.T
    q, w = closed_form.heavy_top(
        p * (1, -1, -1, -1), C @ (0.3, 0.2, 1.0), inertia, 2.0, arm=C[:, 2], weight=1.0
    )
    true = closed_form.heavy_top(UP, (0.3, 0.2, 1.0), (1.0, 1.0, 1.0 + 1e-7), 2.0, **GOOD)
    assert fa.angle_between(fa.quat_multiply(q, p), true[0]) <= 2e-14
    assert np.abs(C.T @ w - true[1]).max() <= 2e-14


def test_single_precision(motions):
    q0, w0, inertia, arm = COLUMNS
    q, w = closed_form.heavy_top(
        q0, w0, inertia, (0.0, *TIMES), arm=arm, weight=1.0, dtype=np.float32
    )
    assert q.dtype == w.dtype == np.float32
    for row, name in enumerate(CASES):
        top = speed(w0[row], inertia[row], arm[row])
        for k, t in enumerate((0.0, *TIMES)):
            growth = math.cosh(t) ** 2 if name.startswith("~") else 1.0
            bound = 2.0**-23 / 2.0**-52 * 1e-15 * (1.0 + top * abs(t)) * growth
            assert fa.angle_between(q[k, row].astype(float), motions[0][k, row]) <= bound, name
            assert np.abs(w[k, row] - motions[1][k, row]).max() <= bound * top, name


def test_finite_for_any_finite_top():
    rng = np.random.default_rng(4)
    n = 3000
    w = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-60, 60, (n, 3))
    w *= rng.uniform(size=(n, 3)) > 0.1
    inertia = np.repeat(10.0 ** rng.uniform(-50, 50, (n, 1)), 3, axis=1)
    inertia[:, 2] *= rng.choice([1.0, 0.1, 1.9], n)
    arm = np.outer(10.0 ** rng.uniform(-90, 90, n) * rng.choice([-1, 0, 1], n), THIRD)
    q0 = np.where(rng.uniform(size=(n, 1)) < 0.2, UP, oracle.quaternions(n, 5))
    with pytest.warns(fa.StepWarning):
        q, w = closed_form.heavy_top(q0, w, inertia, [0.0, 1e-9, -1.0], arm=arm, weight=1.0)
    assert np.isfinite(w).all()
    assert np.abs(np.linalg.norm(q, axis=-1) - 1.0).max() <= 1e-15


# scenes

TOP = fa.Scene(inertia=BODY, torque=fa.torques.HeavyTop(THIRD, 1.0))


def test_propagate_takes_it_first():
    q0, w0, inertia, arm = (x[:6] for x in COLUMNS)
    scene = fa.Scene(inertia=inertia, torque=fa.torques.HeavyTop(arm, np.ones(6)))
    run = fa.propagate(scene, q0, w0, dt=0.5, n_steps=5, save_every=5, t0=3.0)
    assert run.method == "exact"
    true = closed_form.heavy_top(q0, w0, inertia, [0.0, 2.5], arm=arm, weight=1.0)
    assert np.array_equal(run.q, true[0])
    assert np.array_equal(run.w, true[1])
    assert not run.status.any()
    turned = fa.propagate(scene, q0, w0, dt=2.5, n_steps=1, representation="dcm")
    assert turned.method == "exact"
    gap = fa.quat_to_dcm(turned.q[-1]) - fa.quat_to_dcm(run.q[-1])
    assert np.abs(gap).max() <= 2e-15


def test_what_needs_steps_takes_steps():
    """Where no method is named."""
    start, options = (UP, (0.1, 0.0, 3.0)), {"dt": 0.1, "n_steps": 2}
    event = fa.event(lambda t, q, w, p: w[0])
    with pytest.warns(RuntimeWarning, match=r'method: found none with .*accepted: method="rk8"'):
        assert fa.propagate(TOP, *start, **options, events=event).method == "rk8"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fa.propagate(TOP, *start, **options, events=event, method="rk8")
    run, exact = (fa.propagate(TOP, *start, **options, compensated=x) for x in (True, False))
    assert run.method == exact.method == "exact"
    assert (run.q == exact.q).all()


def test_dipole_in_an_oblique_field():
    dipole, field = (0.0, 0.0, -1.3), (0.3, -0.8, -0.5)
    scene = fa.Scene(inertia=BODY, torque=fa.torques.MagneticDipole(dipole, field))
    run = fa.propagate(scene, SOME, (0.3, -0.2, 4.0), dt=2.5, n_steps=1)
    assert run.method == "exact"
    size = mp.sqrt(sum(mp.mpf(c) ** 2 for c in SOME))
    start = [c / size for c in SOME]
    torque = ro.dipole(dipole, field)
    (true,) = ro.integrate(BODY, start, (0.3, -0.2, 4.0), [2.5], torque, digits=18)
    assert 2.0 * oracle.attitude_error(run.q[-1], true.q) <= 1e-15 * (1.0 + 5.0 * 2.5)


def test_turns_beyond_rounding_are_told():
    """Gravity may turn what starts from rest."""
    with pytest.warns(fa.StepWarning, match="found rotations by 2e"):
        run = fa.propagate(TOP, tilted(1.0), (0.0, 0.0, 0.0), dt=1e16, n_steps=1)
    assert run.status_counts() == {"STEP_TOO_LARGE": 1}
