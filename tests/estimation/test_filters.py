"""Filters on a simulated spacecraft with star tracker and magnetometer."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from exact import EPS, START, Motion, angle, attitude, conj, exp, matrix, mul
from numba import njit

import fastatt as fa
from fastatt import estimation as es
from fastatt.estimation import mean_attitude
from fastatt.interchange import from_scipy

# the spacecraft: coning at 0.6 rad and 0.3 rad/s on top of a slow turn
N, H, SAMPLES = 200, 0.1, 300
TRACKER_EVERY, FIELD_EVERY = 10, 5
ANGLE_NOISE, BIAS_NOISE = 3e-4, 1e-5
TRACKER, FIELD = 2e-3, 0.02
START_ERROR, START_BIAS = 0.05, 1e-3
REFERENCE = np.array([0.6, 0.8, 0.0])
MOTION = Motion(
    np.array([0.6]), np.array([0.3]), np.array([[[0.02, -0.03, 0.05], [0, 0, 0], [0, 0, 0]]])
)
TIMES = H * np.arange(SAMPLES + 1)
NOISE = {"angle_noise": ANGLE_NOISE, "bias_noise": BIAS_NOISE}
P0 = np.diag([START_ERROR**2] * 3 + [START_BIAS**2] * 3)


class Spacecraft:
    """N runs on one motion, each with noise of its own."""

    def __init__(self, n, seed):
        rng = np.random.default_rng(seed)
        steps = [START]
        for t in TIMES[:-1]:
            steps.append(attitude(MOTION.rate, t, t + H, steps[-1], panels=1)[0])
        self.q = np.array(steps)
        true = MOTION.increments(TIMES)[:, 0] / H
        bias = rng.normal(0.0, START_BIAS, (n, 3))
        runs = np.broadcast_to(true, (n, *true.shape))
        self.gyro = es.simulate_gyro(runs, H, bias=bias, rng=rng, **NOISE)
        self.start = mul(START, exp(-rng.normal(0.0, START_ERROR, (n, 3))))
        tracked = rng.normal(0.0, TRACKER, (SAMPLES + 1, n, 3))
        self.tracker = mul(self.q[:, None], exp(tracked))
        field = np.einsum("kji,j->ki", matrix(self.q), REFERENCE)
        self.field = field[:, None] + rng.normal(0.0, FIELD, (SAMPLES + 1, n, 3))


@pytest.fixture(scope="module")
def spacecraft():
    return Spacecraft(N, seed=5)


def through(craft, predict, filtered):
    """Mean NEES of the runs after each second, and NIS of the tracker's fixes."""
    nees, nis = [], []
    for k in range(1, SAMPLES + 1):
        predict(np.ascontiguousarray(craft.gyro.samples[:, k - 1]))
        if k % FIELD_EVERY == 0:
            filtered.update_vector(craft.field[k], REFERENCE, FIELD)
        if k % TRACKER_EVERY == 0:
            nis.append(filtered.update_attitude(craft.tracker[k], TRACKER))
            nees.append(np.mean(filtered.nees(craft.q[k], craft.gyro.bias[:, k])))
    return np.array(nees), np.array(nis)


def consistent(nees, nis, bias, covariance, craft):
    """Inside the 95 % bands of χ² over the runs."""
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], 6 * N) / N
    assert low < nees[-1] < high
    inside = (nees > low) & (nees < high)
    assert inside.mean() > 0.8  # 30 correlated means, of which 95 % are expected inside
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], 3 * nis.size) / nis.size
    assert low < nis.mean() < high
    # recovered: from 1e-3 to what the covariance says, and that is far below
    error = bias - craft.gyro.bias[:, -1]
    told = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, 3:])
    assert told.max() < 0.2 * START_BIAS
    low, high = np.sqrt(scipy.stats.chi2.ppf([1e-4, 1 - 1e-4], N) / N)
    assert ((error / told).std(axis=0) > low).all()
    assert ((error / told).std(axis=0) < high).all()


def test_the_mekf_is_consistent(spacecraft):
    f = es.MEKF(spacecraft.start, P0, **NOISE)
    nees, nis = through(spacecraft, lambda gyro: f.predict(gyro, H), f)
    consistent(nees, nis, f.bias, f.covariance, spacecraft)


def test_a_mekf_that_is_told_too_little_noise_is_not(spacecraft):
    f = es.MEKF(spacecraft.start, P0, angle_noise=0.5 * ANGLE_NOISE, bias_noise=BIAS_NOISE)
    nees, _ = through(spacecraft, lambda gyro: f.predict(gyro, H), f)
    assert nees[-1] > 1.1 * scipy.stats.chi2.ppf(0.975, 6 * N) / N


def ukf_predict(f):
    def predict(gyro):
        f.predict(es.gyro_motion(gyro, H), es.process_noise(gyro - f.y, H, **NOISE))

    return predict


def test_the_ukf_is_consistent(spacecraft):
    f = es.UKF(spacecraft.start, np.zeros(3), P0)
    nees, nis = through(spacecraft, ukf_predict(f), f)
    consistent(nees, nis, f.y, f.covariance, spacecraft)


# the parts of the MEKF against dense algebra


def dense(P):
    a, b, d = P
    full = np.zeros((6, 6))
    full[np.triu_indices(3)] = a
    full[3:, 3:][np.triu_indices(3)] = d
    full[:3, 3:] = np.reshape(b, (3, 3))
    return np.triu(full) + np.triu(full, 1).T


def blocks(P):
    upper = np.triu_indices(3)
    parts = P[:3, :3][upper], P[:3, 3:].ravel(), P[3:, 3:][upper]
    return tuple(tuple(p.tolist()) for p in parts)


def some_covariance():
    root = np.random.default_rng(4).normal(size=(6, 9)) * np.array([[0.1] * 3 + [0.01] * 3]).T
    return root @ root.T


def cross(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


BIAS = (0.01, 0.02, -0.03)


def iterated(q, P, linearised, R):
    """(q, δb, P, NIS) by dense algebra: the prior as it is seen from what was found, four times."""
    a = np.array(q)
    for _ in range(4):
        z, H = linearised(a)
        back = mul(conj(a), q)
        turn = scipy.linalg.block_diag(matrix(back), np.eye(3))
        p = turn @ P @ turn.T
        mean = np.concatenate([es.attitude_error(a, q), np.zeros(3)])
        S = H @ p @ H.T + R
        left = z - H @ mean
        nis = left @ np.linalg.solve(S, left)
        K = p @ H.T @ np.linalg.inv(S)
        d = mean + K @ left
        rest = np.eye(6) - K @ H
        a = mul(a, exp(d[:3]))
    return a, d[3:], rest @ p @ rest.T + K @ R @ K.T, nis


@pytest.mark.parametrize("kind", ["vector", "attitude"])
def test_updates_against_dense_algebra(kind):
    P = some_covariance()
    rng = np.random.default_rng(7)
    if kind == "vector":
        r, sigma = np.array([0.3, -0.4, 1.2]), 0.05
        measured, R = matrix(START).T @ r + rng.normal(0.0, 0.1, 3), sigma**2 * np.eye(3)

        def linearised(q):
            expected = matrix(q).T @ r
            size = np.linalg.norm(r)
            axis = np.cross(expected, measured)
            angle = np.arctan2(np.linalg.norm(axis), expected @ measured)
            arc = angle * np.cross(axis, expected) / np.linalg.norm(axis)
            longer = (np.linalg.norm(measured) - size) * expected / size
            return arc + longer, np.hstack([cross(expected), np.zeros((3, 3))])

        found = es.mekf_update_vector(
            tuple(START), BIAS, blocks(P), tuple(measured), tuple(r), sigma**2
        )
        other = es.UKF(START, BIAS, P)
        given = measured, r, sigma
    else:
        root = rng.normal(0.0, 0.1, (3, 3))
        measured, R = mul(START, exp(np.array([0.1, -0.2, 0.15]))), root @ root.T

        def linearised(q):
            return es.attitude_error(q, measured), np.eye(3, 6)

        upper = tuple(R[np.triu_indices(3)].tolist())
        found = es.mekf_update_attitude(tuple(START), BIAS, blocks(P), tuple(measured), upper)
        other = es.UKF(START, BIAS, P)
        given = measured, R
    q, d, after, nis = iterated(START, P, linearised, R)
    condition = np.linalg.cond(P[:3, :3] + R)
    same = getattr(other, f"update_{kind}")(*given)
    for a, b, p, normalised in (
        (found[0], found[1], dense(found[2]), found[3]),
        (other.q, other.y, other.covariance, same),
    ):
        assert angle(q, a) <= 32 * EPS * condition
        assert np.abs(b - (BIAS + d)).max() <= 32 * EPS * condition
        assert np.abs(p - after).max() <= 64 * EPS * condition * np.abs(P).max()
        assert normalised == pytest.approx(nis, rel=64 * EPS * condition)


def test_an_update_by_a_residual_is_kalmans():
    P, rng = some_covariance(), np.random.default_rng(7)
    H, z, root = rng.normal(size=(3, 3)), rng.normal(0.0, 0.01, 3), rng.normal(0.0, 0.1, (3, 3))
    R, wide = root @ root.T, np.hstack([H, np.zeros((3, 3))])
    S = wide @ P @ wide.T + R
    K = P @ wide.T @ np.linalg.inv(S)
    rest = np.eye(6) - K @ wide
    upper = tuple(R[np.triu_indices(3)].tolist())
    q, b, p, nis = es.mekf_update(tuple(START), BIAS, blocks(P), tuple(z), tuple(H.ravel()), upper)
    condition = np.linalg.cond(S)
    assert angle(q, mul(START, exp((K @ z)[:3]))) <= 32 * EPS * condition
    assert np.abs(np.subtract(b, BIAS) - (K @ z)[3:]).max() <= 32 * EPS * condition
    assert np.abs(dense(p) - rest @ P @ rest.T - K @ R @ K.T).max() <= 64 * EPS * condition
    assert nis == pytest.approx(z @ np.linalg.solve(S, z), rel=64 * EPS * condition)


def test_a_direction_far_more_precise_than_the_estimate():
    """One of another length than the reference, whose rounding would be an angle's: closed form."""
    e, seen, p, r = np.array([1.0, 2.0, 3.0]), np.array([1.001, 2.0, 3.0]), 0.01, 1e-24
    size = e @ e
    axis = np.cross(seen, e)
    turn = np.arctan2(np.linalg.norm(axis), seen @ e)
    found = es.mekf_update_vector(
        (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), blocks(np.diag([p] * 3 + [1e-4] * 3)),
        tuple(seen), tuple(e), r,
    )  # fmt: skip
    share = p * size / (p * size + r)
    expected = exp(axis / np.linalg.norm(axis) * turn * share)
    assert np.abs(np.array(found[0]) - expected).max() <= 8 * EPS
    values, axes = np.linalg.eigh(dense(found[2])[:3, :3])
    assert values[2] == pytest.approx(p, rel=32 * EPS)
    # the axis about which nothing is known, now along the corrected axes
    assert abs(axes[:, 2] @ seen) == pytest.approx(np.linalg.norm(seen), rel=32 * EPS)
    assert (np.abs(values[:2]) <= 32 * EPS * p).all()
    longer = np.linalg.norm(seen) - np.sqrt(size)
    nis = size * turn**2 / (p * size + r) + longer**2 / r
    assert found[3] == pytest.approx(nis, rel=1e-12)


def test_covariances_stay_positive_under_nearly_perfect_fixes():
    f = es.MEKF(START, 1e2 * np.eye(6), angle_noise=1e-9, bias_noise=1e-9)
    for _ in range(200):
        f.predict((0.1, 0.2, 0.3), 1e-3)
        f.update_attitude(f.q, 1e-8)
        size = np.sqrt(np.diagonal(f.covariance))
        assert np.linalg.eigvalsh(f.covariance / np.outer(size, size)).min() > 0.0
    assert np.array_equal(f.covariance, f.covariance.T)


def test_from_jitted_code_and_from_the_class():
    predict, update = es.mekf_predict, es.mekf_update_vector

    @njit
    def run(q, b, P, gyro, field, reference, h, v, u, r):
        for i in range(gyro.shape[0]):
            q, P = predict(q, b, P, (gyro[i, 0], gyro[i, 1], gyro[i, 2]), h, v, u)
            seen = (field[i, 0], field[i, 1], field[i, 2])
            q, b, P, _ = update(q, b, P, seen, reference, r)
        return q, b, P

    rng = np.random.default_rng(8)
    gyro, field = rng.normal(0.0, 0.1, (20, 3)), REFERENCE + rng.normal(0.0, 0.01, (20, 3))
    found = run(tuple(START), BIAS, blocks(P0), gyro, field, tuple(REFERENCE), H, 1e-6, 1e-10, 1e-4)
    f = es.MEKF(START, P0, bias=BIAS, angle_noise=1e-3, bias_noise=1e-5)
    for w, b in zip(gyro, field, strict=True):
        f.predict(w, H)
        f.update_vector(b, REFERENCE, 1e-2)
    assert angle(found[0], f.q) <= 1e-12
    assert np.abs(found[1] - f.bias).max() <= 1e-12
    assert np.abs(dense(found[2]) - f.covariance).max() <= 1e-12 * P0.max()
    for text in run.inspect_llvm().values():
        assert not any("@NRT_MemInfo_alloc" in ln for ln in text.splitlines() if " call " in ln)


@pytest.mark.parametrize("start", [START, np.tile(START, (3, 1))])
def test_a_covariance_changed_in_place_is_that_of_the_filter(start):
    before, wider = P0.copy(), P0.copy()
    wider[:3, :3] += 0.04 * np.eye(3)
    changed, given = (es.MEKF(start, P, **NOISE) for P in (P0, wider))
    changed.covariance[..., :3, :3] += 0.04 * np.eye(3)
    for f in (changed, given):
        f.update_vector(REFERENCE, REFERENCE, FIELD)
    assert np.array_equal(changed.covariance, given.covariance)
    assert np.array_equal(P0, before)


# sigma points


@pytest.mark.parametrize("numbers", [1, 3, 6])
def test_sigma_points_have_the_moments_of_the_error(numbers):
    P = np.diag(np.linspace(0.1, 0.2, 3 + numbers))
    P[:6, :6] = some_covariance()[: len(P), : len(P)]
    f = es.UKF(START, np.linspace(0.1, 0.3, numbers), P, kappa=8.0 - len(P))
    q, y = f.sigma_points()
    d = np.concatenate([es.attitude_error(f.q, q[0]), y[0] - f.y], axis=1)
    weights = np.array([8.0 - len(P), *[0.5] * (2 * len(P))]) / 8.0
    assert np.abs(weights @ d).max() <= 1e-15
    assert np.abs((d.T * weights) @ d - P).max() <= 1e-14
    assert np.array_equal(q[0, 0], f.q)


@pytest.mark.parametrize("kappa", [0.0, 1.0, 2.0])
def test_a_motion_that_is_not_linear_gives_the_weighted_moments(kappa):
    """Of what is carried besides, squared: mean and covariance of the points by their weights."""
    P = 1e-2 * some_covariance()[:5, :5]
    f = es.UKF(START, (0.7, -0.4), P, kappa=kappa)
    _, y = f.sigma_points()
    weights = np.array([2.0 * kappa, *[1.0] * 10]) / (2.0 * (5.0 + kappa))
    square = y[0] ** 2
    mean = weights @ square
    expected = ((square - mean).T * weights) @ (square - mean)
    f.predict(lambda q, y: (q, y * y), np.zeros((5, 5)))
    assert np.abs(f.y - mean).max() <= 1e-14
    assert np.abs(f.covariance[3:, 3:] - expected).max() <= 1e-14 * np.abs(expected).max() + 1e-15


def test_a_body_without_gyro():
    """Attitude fixes alone find the angular velocity of a turning body; N = 2 filters at once."""
    scene = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
    w0 = np.array([0.1, 0.3, -0.2])
    truth = fa.propagate(scene, START, w0, dt=0.1, n_steps=60, save_every=10, method="dmv10")
    P = np.diag([1e-4] * 3 + [0.1] * 3)
    f = es.UKF(np.tile(START, (2, 1)), np.zeros(3), P)
    motion = es.scene_motion(scene, 0.1, 10, method="dmv10")
    for q in truth.q[1:]:
        f.predict(motion, 1e-12 * np.eye(6))
        f.update_attitude(q, 1e-5)
    assert angle(f.q, truth.q[-1]).max() < 1e-4
    assert np.abs(f.y - truth.w[-1]).max() < 1e-4


def test_a_bodys_motion_leaves_the_numbers_that_are_not_its_rate():
    scene = fa.Scene(inertia=(2.0, 1.0, 0.9))
    rng = np.random.default_rng(3)
    q, y = rng.normal(size=(4, 4)), rng.normal(size=(4, 6))
    options = {"dt": 0.1, "n_steps": 5, "method": "rk4"}
    moved_q, moved_y = es.scene_motion(scene, **options)(q, y)
    run = fa.propagate(scene, q, y[:, :3], **options)
    np.testing.assert_array_equal(moved_q, run.q[-1])
    np.testing.assert_array_equal(moved_y, np.hstack([run.w[-1], y[:, 3:]]))


# means


def test_the_mean_attitude_is_scipys():
    rng = np.random.default_rng(3)
    q = mul(START, exp(rng.normal(0.0, 0.7, (50, 3)))) * rng.choice([-1.0, 1.0], (50, 1))
    weights = rng.uniform(0.0, 1.0, 50)
    found = es.mean_attitude(q, weights)
    theirs = from_scipy(
        scipy.spatial.transform.Rotation.from_quat(q[:, [1, 2, 3, 0]]).mean(weights)
    )
    assert angle(found, theirs) <= 32 * EPS
    assert found[0] >= 0.0
    assert es.mean_attitude(np.tile(q, (3, 1, 1))).shape == (3, 4)
    # a length is no weight, and weights of 1e300 are as good as of 1
    assert angle(mean_attitude(q * 1e200 * weights[:, None], 1e300 * weights), found) < 32 * EPS


# gyro


def test_a_gyros_noise_has_farrenkopfs_covariance():
    """Increments and biases of 40 000 runs of one interval beside the exact covariance."""
    n, h, v, u = 40_000, 0.7, 0.3, 0.5
    g = es.simulate_gyro(
        np.zeros((n, 1, 3)), h, angle_noise=v, bias_noise=u, increments=True, rng=9
    )
    pair = np.stack([g.samples[:, 0], g.bias[:, 1]], axis=-1).reshape(-1, 2)
    exact = np.array([[v**2 * h + u**2 * h**3 / 3, u**2 * h**2 / 2], [u**2 * h**2 / 2, u**2 * h]])
    found = pair.T @ pair / len(pair)
    # Wishart: the standard deviation of an entry
    sigma = np.sqrt((exact**2 + np.outer(np.diag(exact), np.diag(exact))) / len(pair))
    assert (np.abs(found - exact) < 4.0 * sigma).all()


def test_a_gyro_without_noise_says_the_truth():
    true = np.random.default_rng(1).normal(size=(2, 5, 3))
    g = es.simulate_gyro(true, 0.1, bias=(0.1, 0.0, 0.0))
    assert np.abs(g.samples - (true + np.array([0.1, 0.0, 0.0]))).max() <= 4 * EPS
    assert (g.bias == [0.1, 0.0, 0.0]).all()
    assert g.bias.shape == (2, 6, 3)
    a, b = (es.simulate_gyro(true, 0.1, angle_noise=1.0, rng=4).samples for _ in range(2))
    assert np.array_equal(a, b)
    increments = es.simulate_gyro(0.1 * true, 0.1, bias=(0.1, 0.0, 0.0), increments=True)
    assert np.abs(increments.samples - 0.1 * g.samples).max() <= 4 * EPS
