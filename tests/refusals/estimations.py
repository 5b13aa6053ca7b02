"""Of filters, preintegration, tangents and simulated gyros."""

from __future__ import annotations

from functools import partial

import numpy as np
from exact import START

import fastatt as fa
from fastatt import estimation as es

H, NAN, INF = 0.1, np.nan, np.inf
REFERENCE = np.array([0.6, 0.8, 0.0])
NOISE = {"angle_noise": 3e-4, "bias_noise": 1e-5}
P0 = np.diag([0.05**2] * 3 + [1e-3**2] * 3)
MANY, DOWN = np.tile(START, (4, 1)), np.tile([0.0, 0.0, 1.0], (4, 1))
LOST, ZERO = DOWN.copy(), DOWN.copy()
LOST[2, 1], ZERO[1] = NAN, 0.0


def mekf(q=START, P=P0, **options):
    return es.MEKF(q, P, **NOISE | options)


def ukf(q=START, P=P0, y=(0.0, 0.0, 0.0), **options):
    return es.UKF(q, y, P, **options)


def of(make, call, **options):
    return lambda: call(make(**options))


def both(message, call, *error, **options):
    """Of a MEKF and of a UKF."""
    return [(message, of(make, call, **options), *error) for make in (mekf, ukf)]


def vector(measured=REFERENCE, reference=REFERENCE, sigma=0.1, **options):
    return lambda f: f.update_vector(measured, reference, sigma, **options)


def attitude(measured=START, sigma=0.1, **options):
    return lambda f: f.update_attitude(measured, sigma, **options)


def predicted(gyro=(0.0, 0.0, 0.0), dt=H):
    return lambda f: f.predict(gyro, dt)


def moved(noise=P0, motion=None):
    return lambda f: f.predict(motion or es.gyro_motion((0.1, 0.2, 0.3), H), noise)


def observed(observe, noise, measured, **options):
    return lambda f: f.update(observe, measured, noise, **options)


def mean(*given):
    return partial(es.mean_attitude, *given)


# matrices that are no covariances, of all six numbers and of the bias's, which is 1e-8 rad/s

BAD = [
    (np.eye(6)[::-1] * [0, 0, 0, 0, 0, 1e-3], "is not symmetric"),
    (np.diag([0, 0, 0, 0, -1.0, 0]), "has a negative variance"),
    (np.eye(6)[::-1], "has a negative variance"),
]
BLOCKS = [([[1, 2], [2, 1]], "has a negative variance"), ([[1, 0.5], [0.4, 1]], "is not symmetric")]


def small(block):
    P = np.diag([1.0] * 3 + [1e-16] * 3)
    P[4:, 4:] = 1e-16 * np.array(block)
    return P


# tangents

BODY, CONING = fa.Scene(inertia=(2.0, 1.0, 1.4)), fa.Scene(rate=fa.rates.Coning(0.1, 1.0))
Q, W = np.array([0.1, -0.5, 0.7, 0.5]), np.array([0.2, -0.3, 0.6])


def body_tangent(scene=BODY, q=Q, w=W, **options):
    return partial(es.body_tangent, scene, q, w, H, **options)


def simulated(**noise):
    return partial(es.simulate_gyro, np.zeros((4, 3)), H, **noise)


def of_gyro_alone():
    found = es.preintegrate(np.ones((6, 3)), None, H, gyro_noise=0.1)
    found.predict(START, np.zeros(3), np.zeros(3))


REFUSED = [
    *[(f"covariance: {what}; accepted: a covariance", call) for change, what in BAD
     for call in (partial(mekf, P=P0 + change), partial(ukf, P=P0 + change),
     partial(es.covariance_to_body, P0 + change, START))],
    *[(f"covariance[1]: {what}", partial(mekf, P=np.stack([P0, P0 + change])))
      for change, what in BAD],
    *[(f"noise: {what}; accepted: a covariance", of(ukf, moved(P0 + change)))
      for change, what in BAD],
    ("sigma: has a negative variance; accepted: a covariance",
     of(mekf, attitude(sigma=(P0 + BAD[2][0])[[[0], [4], [5]], [0, 4, 5]]))),
    *[(f"covariance: {what}; accepted: a covariance", call) for block, what in BLOCKS
     for call in (partial(mekf, P=small(block)),
     partial(es.covariance_to_body, small(block), START))],
    ("q: found rows q 4, bias 2;", partial(mekf, MANY, bias=np.zeros((2, 3)))),
    ("kappa: found -6.0; accepted: abov", partial(ukf, kappa=-6.0)),
    ("invalid: found 'flag'; accepted: raise, skip", partial(mekf, invalid="flag")),
    ("invalid: found 'flag'; accepted: raise, skip", partial(ukf, invalid="flag")),
    *[(f"{name}: found …; accepted: …", call) for name in NOISE
     for x in (-1e-300, 1.01e150, INF, NAN)
     for call in (simulated(**{name: x}), partial(mekf, **{name: x}))],
    # measurements
    *[row for x in (0.3, [0.3], np.zeros((5, 3)))
     for row in both("measured: has shape …; accepted: (3,)", vector(x))],
    *both("measured: has shape (5, 4); accepted: (4,)", attitude(np.tile(START, (5, 1)))),
    *[row for x, said in ((0.0, "0.0; accepted: a number above 0"),
     (-0.1, "-0.1; accepted: a number above 0"), (0.99e-150, "9.9e-151; accepted: 1e-150"),
     (1.01e150, "1.01e+150; accepted: 1e-150")) for call in (attitude(sigma=x), vector(sigma=x))
     for row in both(f"sigma: found {said}", call)],
    *[row for x, said in (([0.1, -0.1, 0.1], "found -0.1; accepted: a number above 0"),
     ([0.1, 0.0, 0.1], "found 0.0; accepted: a number above 0"),
     (np.diag([1.0, 1.0, 0.0]), "has no variance in some direction"),
     (np.ones((3, 3)), "has no variance in some direction"))
     for row in both(f"sigma: {said}", attitude(sigma=x))],
    *[row for x in (0.0, -1.0, NAN)
     for row in both("gate: found …; accepted: a number above 0, or N", attitude(gate=x))],
    *both("measured[2, 1] is nan; accepted: finite numbers", vector(LOST), q=MANY),
    *both("reference[2, 1] is nan", vector(reference=LOST), q=MANY),
    *both("measured[0] is inf", vector([INF, 0.0, 0.0])),
    *both("measured[1] is the zero vector; accepted: any other", vector(ZERO), q=MANY),
    *both("measured is the zero vector", vector(np.zeros(3))),
    *both("reference[1] is the zero vector", vector(reference=ZERO), q=MANY),
    *both("measured[1, 2] is nan", attitude(np.where(np.arange(16).reshape(4, 4) == 6, NAN, MANY)),
     q=MANY),
    ("gyro: has shape (2, 3); accepted: (3,) or (", of(mekf, predicted(np.zeros((2, 3))), q=MANY)),
    ("gyro[3, 0] is inf; accepted: finite numbers",
     of(mekf, predicted(np.where(np.arange(12).reshape(4, 3) == 9, INF, 0.0)), q=MANY)),
    ("gyro[1] is nan", of(mekf, predicted([0.0, NAN, 0.0]))),
    *[("dt: found …; accepted: an interval above 0", of(mekf, predicted(dt=x)))
     for x in (0.0, -0.1, NAN, INF)],
    ("y: has shape (9, 1); accepted: a bias of three",
     of(ukf, moved(P0[:4, :4]), P=P0[:4, :4], y=[0.5])),
    *[("period: found …; accepted: a number above 0",
     of(ukf, observed(lambda q, y: y[:, :1], [[0.01]], [0.0], period=x)))
     for x in (0.0, -1.0, (1.0, 2.0), NAN)],
    # truths and means
    *both("q is the zero quaternion", lambda f: f.nees(np.zeros(4), np.zeros(3))),
    ("bias[1] is nan", of(mekf, lambda f: f.nees(START, [0.0, NAN, 0.0]))),
    ("bias: has shape (2,); accepted: (3,)", of(mekf, lambda f: f.nees(START, np.zeros(2)))),
    ("y[1] is nan", of(ukf, lambda f: f.nees(START, [0.0, NAN, 0.0]))),
    ("y: has shape (2,); accepted: (3,)", of(ukf, lambda f: f.nees(START, np.zeros(2)))),
    ("q: found a zero quaternion", partial(es.attitude_error, np.zeros(4), START)),
    ("q_true: found a zero quaternion", partial(es.attitude_error, START, [START, np.zeros(4)])),
    ("weights: has shape (3,); accep", mean(np.ones((2, 4)), np.ones(3))),
    ("weights: …; accepted: at least 0, and s", mean(np.ones((2, 4)), [1.0, -1.0])),
    ("weights: found 0 to 1; accepted: at least 0, and some",
     mean(np.ones((2, 2, 4)), [[1.0, 0.0], [0.0, 0.0]])),
    ("q: has no one mean", mean(np.eye(4)[:2])),
    ("q: found a zero quaternion", mean(np.zeros((2, 4)))),
    ("accel: found None where the samples were added", of_gyro_alone),
    # tangents
    ("scene: found 3; accepted: a fastatt.Scene", partial(es.step_tangent, 3), TypeError),
    ("method: found 'hold'; accepted:", partial(es.step_tangent, CONING, method="hold")),
    ("method: found 'picard'; accepted: hold",
     partial(es.sample_transitions, np.ones((4, 3)), H, method="picard")),
    ("rates: found one rate", partial(es.sample_transitions, np.zeros((1, 3)), H)),
    ("method: found 'exact'", body_tangent(method="exact")),
    ("q0: found rows q0 2, w0 3, scene 1", body_tangent(q=np.tile(Q, (2, 1)), w=np.zeros((3, 3)))),
    ("scene: found no inertia", body_tangent(CONING)),
    ("scene: found no inertia", partial(es.run_tangent, CONING, Q, W, dt=0.2, n_steps=8)),
    ("after: has shape (3,); accepted: (..., 6)",
     partial(es.RunTangent(np.eye(6)[None]).adjoint, [1.0, 0.0, 0.0])),
]  # fmt: skip
