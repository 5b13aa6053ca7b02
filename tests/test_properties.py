"""What holds for any input: group laws, conversions, frames, units, splits of a run, of a batch.

Hypothesis draws the seed and the kind of whole ensembles, so that a few calls cover much.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from exact import EPS, START, generic
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import fastatt as fa

few = settings(max_examples=20, database=None)
many = settings(max_examples=100, database=None)
seeds = st.integers(0, 2**32 - 1)
TINY = 5e-324

# whole arrays of any finite numbers


def _wild(seed, kind, length):
    """Rows: tame, each row of its own size, each number of its own size, or many zeros."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(64, length))
    if kind == "rows":
        x *= 10.0 ** rng.uniform(-323, 307, (64, 1))
    elif kind == "numbers":
        x *= 10.0 ** rng.uniform(-323, 307, x.shape)
    elif kind == "sparse":
        x *= rng.integers(0, 2, x.shape) * rng.choice([TINY, 1e-310, 1.0, 1e300], (64, 1))
    return x


def wild(length):
    floats = st.floats(allow_nan=False, allow_infinity=False)
    drawn = hnp.arrays(np.float64, (16, length), elements=floats)
    kinds = st.sampled_from(["tame", "rows", "numbers", "sparse"])
    return st.builds(_wild, seeds, kinds, st.just(length)) | drawn


def _not_zero(q):
    q[~q.any(axis=1), 3] = TINY
    return q


vectors = wild(3)
quaternions = wild(4).map(_not_zero)


def units(seed, n=64):
    q = np.random.default_rng(seed).normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def inverse(q):
    return q * (1.0, -1.0, -1.0, -1.0)


def exactly(a, b):
    return a.shape == b.shape and a.tobytes() == b.tobytes()


# the group: a component of a product is a sum of four products, wrong by at most 2 eps |p||q|

PRODUCT = 4.0 * EPS  # as a 4-vector
TURN = 2.0 * PRODUCT  # as an angle


@few
@given(seeds)
def test_products_are_a_group(seed):
    p, q, r = units(seed), units(seed + 1), units(seed + 2)
    mul = fa.quat_multiply
    left, right = mul(mul(p, q), r), mul(p, mul(q, r))
    assert np.linalg.norm(left - right, axis=1).max() <= 4.0 * PRODUCT
    one = np.array([1.0, 0.0, 0.0, 0.0])
    assert np.array_equal(mul(one, q), q)
    assert np.array_equal(mul(q, one), q)
    # |q| itself is wrong by at most 2 eps
    assert np.linalg.norm(mul(q, inverse(q)) - one, axis=1).max() <= PRODUCT + 4.0 * EPS
    gap = np.linalg.norm(inverse(mul(p, q)) - mul(inverse(q), inverse(p)), axis=1)
    assert gap.max() <= 2.0 * PRODUCT


@few
@given(seeds, vectors)
def test_rotation_is_an_action_of_the_group(seed, v):
    v = np.ldexp(v, -4)  # sums of three stay finite
    n = len(v)
    p, q = units(seed, n), units(seed + 1, n)
    size = np.abs(v).max(axis=1, keepdims=True)
    once, twice = fa.quat_rotate(fa.quat_multiply(p, q), v), fa.quat_rotate(p, fa.quat_rotate(q, v))
    # three rotations, each two cross products: some 8 roundings of √3 |v|; subnormals round by TINY
    allowed = 64.0 * EPS * size + 64.0 * TINY
    assert (np.abs(once - twice) <= allowed).all()
    assert (np.abs(fa.quat_rotate_inverse(p, fa.quat_rotate(p, v)) - v) <= allowed).all()


# exponential, logarithm, conversions


@many
@given(vectors)
def test_exponential_of_any_vector_is_unit_and_its_logarithm_comes_back(u):
    q = fa.rotation_vector_to_quat(u)
    assert np.isfinite(q).all()
    assert np.abs(np.linalg.norm(q, axis=1) - 1.0).max() <= 4.0 * EPS
    short = np.linalg.norm(np.clip(u, -4.0, 4.0), axis=1) < math.pi
    back = fa.quat_to_rotation_vector(q)[short]
    # relative errors of the kernels: logarithm 1e-15, exponential twice 4e-16
    size = np.abs(u[short]).max(axis=1, keepdims=True)
    assert (np.abs(back - u[short]) <= 2e-15 * math.sqrt(3.0) * size + 4.0 * TINY).all()


@many
@given(quaternions)
def test_logarithm_of_any_quaternion_is_its_turn(q):
    u = fa.quat_to_rotation_vector(q)
    assert np.linalg.norm(u, axis=1).max() <= math.pi * (1.0 + 8.0 * EPS)
    # 1e-15 of up to π, the exponential's 4e-16 as a 4-vector, the measure's own 1e-15
    assert fa.angle_between(fa.rotation_vector_to_quat(u), q).max() <= 6e-15


@few
@given(seeds)
def test_conversions_come_back(seed):
    q = units(seed)
    C = fa.quat_to_dcm(q)
    # an entry is 1 or 0 less or plus two products, doubled: 4 eps
    assert np.abs(C @ np.swapaxes(C, 1, 2) - np.eye(3)).max() <= 3.0 * 2.0 * 4.0 * EPS
    assert np.linalg.det(C) == pytest.approx(1.0, abs=32.0 * EPS)
    assert fa.angle_between(fa.dcm_to_quat(C), q).max() <= 64.0 * EPS
    assert fa.angle_between(C, q).max() <= 64.0 * EPS
    # sums of two angles of at most π, each with an error of an ulp, 4.4e-16
    angles = fa.quat_to_euler313(q)
    assert fa.angle_between(fa.euler313_to_quat(angles), q).max() <= 8e-15
    assert ((angles[:, 1] >= 0.0) & (angles[:, 1] <= math.pi)).all()


@many
@given(vectors)
def test_any_euler_angles_are_an_attitude(angles):
    q = fa.euler313_to_quat(angles)
    assert np.isfinite(q).all()
    assert np.abs(np.linalg.norm(q, axis=1) - 1.0).max() <= 8.0 * EPS


@many
@given(quaternions, seeds, st.integers(-40, 40))
def test_angle_is_a_metric(a, seed, k):
    n = len(a)
    b, c = units(seed, n), units(seed + 1, n)
    ab, bc, ac = fa.angle_between(a, b), fa.angle_between(b, c), fa.angle_between(a, c)
    assert ((ab >= 0.0) & (ab <= math.pi * (1.0 + 2.0 * EPS))).all()
    assert exactly(ab, fa.angle_between(b, a))
    assert exactly(ab, fa.angle_between(-a, b))
    assert exactly(ab, fa.angle_between(a, np.ldexp(b, k)))
    assert not fa.angle_between(a, a).any()
    assert not fa.angle_between(a, -a).any()
    assert (ac <= ab + bc + 3e-15).all()
    turned = fa.angle_between(fa.quat_multiply(c, b), fa.quat_multiply(c, c))
    assert (np.abs(turned - bc) <= 2.0 * TURN + 2e-15).all()


# runs

STEPS, H = 24, 0.05
RATE = "magnus4"
# two explicit methods of other kinds, in body axes and by turns about principal ones
BODY = ("rk4", "strang2")
PAIRS = st.sampled_from(BODY)
# of |w| ≤ 2 rad/s for 1.2 s a difference grows at most e^2.4 times; a step rounds q by two products
# and m by some 16 operations
ROUND_OFF = 2.0 * STEPS * 16.0 * EPS * math.exp(2.4)


class Bodies(NamedTuple):
    q: np.ndarray
    w: np.ndarray
    inertia: np.ndarray

    @property
    def scene(self):
        return fa.Scene(inertia=self.inertia)

    def run(self, method, **options):
        options = {"dt": H, "n_steps": STEPS, "n_threads": 1, **options}
        return fa.propagate(self.scene, self.q, self.w, method=method, **options)


def bodies(seed, n=64, kind="any"):
    """Moments b + c, c + a, a + b of masses along three axes, which any body has."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(0.3, 2.0, (3, n))
    if kind == "rods":
        a = b = 1e-3 * a
    elif kind == "discs":
        a, c = 1e-4 * b, 1.001 * b
    elif kind == "tops":
        a = b
    elif kind == "balls":
        a, b, c = 1.0 + 1e-9 * np.array([a, b, c])
    w = rng.uniform(-1.15, 1.15, (n, 3))  # at most 2 rad/s
    return Bodies(units(seed + 1, n), w, np.stack([b + c, c + a, a + b], axis=1))


KINDS = st.sampled_from(["any", "rods", "discs", "tops", "balls"])
ORIENTED = [  # signed permutations of axes, det = 1, and whose inertia they permute
    np.eye(3)[list(p)] * np.array(s)[:, None]
    for p, s in (
        ((0, 1, 2), (1, 1, 1)),
        ((1, 2, 0), (1, 1, 1)),
        ((2, 0, 1), (1, 1, 1)),
        ((1, 0, 2), (1, 1, -1)),
        ((0, 2, 1), (-1, 1, 1)),
        ((2, 1, 0), (1, -1, 1)),
    )
]


@few
@given(seeds)
def test_rates_do_not_know_the_inertial_axes(seed):
    scene, q0, r = generic(64, seed).scene, units(seed), units(seed + 1, 1)
    options = {"dt": H, "n_steps": STEPS, "method": RATE, "n_threads": 1}
    q = fa.propagate(scene, q0, **options).q
    turned = fa.propagate(scene, fa.quat_multiply(r, q0), **options).q
    assert fa.angle_between(fa.quat_multiply(r, q), turned).max() <= (2 * STEPS + 4) * TURN


@few
@given(seeds, PAIRS)
def test_free_bodies_do_not_know_the_inertial_axes(seed, method):
    given_bodies, r = bodies(seed), units(seed + 2, 1)
    a = given_bodies.run(method)
    b = given_bodies._replace(q=fa.quat_multiply(r, given_bodies.q)).run(method)
    assert fa.angle_between(fa.quat_multiply(r, a.q), b.q).max() <= (2 * STEPS + 4) * TURN
    assert exactly(a.w, b.w)


@few
@given(seeds, st.sampled_from((*BODY, "exact")), st.integers(0, 5))
def test_order_of_the_axes_does_not_matter(seed, method, k):
    """Principal axes and moments permuted, the motion is the same, seen along the new axes."""
    a, M = bodies(seed), ORIENTED[k]
    # strang2 turns about the axes in their cyclic order
    assume(method != "strang2" or np.linalg.det(np.abs(M)) > 0.0)
    turn = fa.dcm_to_quat(M.T)  # new body axes to old ones
    b = Bodies(fa.quat_multiply(a.q, turn), a.w @ M.T, a.inertia @ np.abs(M).T)
    first, second = a.run(method), b.run(method)
    assert fa.angle_between(fa.quat_multiply(first.q, turn), second.q).max() <= ROUND_OFF
    assert np.abs(first.w @ M.T - second.w).max() <= ROUND_OFF
    assert not first.status.any()


@few
@given(seeds, KINDS, st.sampled_from((*BODY, "exact")), st.integers(-40, 40), st.integers(-60, 60))
def test_units_change_no_bit(seed, kind, method, time, mass):
    """Powers of 2 as units of time and of mass: numbers scale and round as before."""
    a = bodies(seed, kind=kind)
    b = a._replace(w=np.ldexp(a.w, time), inertia=np.ldexp(a.inertia, mass))
    first, second = a.run(method), b.run(method, dt=math.ldexp(H, -time))
    assert exactly(first.q, second.q)
    assert exactly(np.ldexp(first.w, time), second.w)
    assert exactly(first.status, second.status)


@few
@given(seeds, st.floats(0.01, 100.0))
def test_any_unit_of_time(seed, s):
    a = bodies(seed)
    first = a.run("rk4")
    second = a._replace(w=s * a.w).run("rk4", dt=H / s)
    assert fa.angle_between(first.q, second.q).max() <= ROUND_OFF
    assert np.abs(s * first.w - second.w).max() <= s * ROUND_OFF


@few
@given(seeds, st.integers(1, 200), st.sampled_from((RATE, *BODY)), st.sampled_from([1, 2, 3, 7]))
def test_bodies_and_threads_are_independent(seed, n, method, threads):
    """An ensemble is its single runs, and so it is on any number of threads, bit for bit."""
    motion, all_bodies = generic(n, seed), bodies(seed, n)

    def run(rows, threads):
        if method != RATE:
            return Bodies(*[x[rows] for x in all_bodies]).run(method, n_threads=threads)
        scene, q0 = motion.take(rows).scene, all_bodies.q[rows]
        return fa.propagate(
            scene, q0, dt=H, n_steps=STEPS, method=method, n_threads=threads, save_every=10
        )

    together = run(slice(None), 1)
    assert exactly(together.q, run(slice(None), threads).q)
    for i in {0, n // 2, n - 1}:
        alone = run(slice(i, i + 1), 1)
        assert exactly(together.q[:, i : i + 1], alone.q)
        assert exactly(together.w[:, i : i + 1], alone.w)


@few
@given(seeds, st.integers(0, 150), st.integers(1, 160), st.sampled_from((RATE, *BODY)))
def test_saves_change_no_bit_of_the_end(seed, n, every, method):
    if method == RATE:
        scene, q0, w0 = generic(5, seed).scene, units(seed, 5), None
    else:
        q0, w0, inertia = bodies(seed, 5)
        scene = fa.Scene(inertia=inertia)
    options = {"dt": 0.01, "n_steps": n, "method": method, "n_threads": 1}
    end = fa.propagate(scene, q0, w0, **options)
    saved = fa.propagate(scene, q0, w0, save_every=every, **options)
    assert exactly(end.q[-1], saved.q[-1])
    assert exactly(end.w[-1], saved.w[-1])


@few
@given(seeds, st.integers(0, STEPS), st.sampled_from((RATE, *BODY, "exact")))
def test_a_run_in_two_parts(seed, first, method):
    if method == RATE:
        scene, q0 = generic(64, seed).scene, units(seed)
        options = {"method": method, "dt": H, "n_threads": 1}
        whole = fa.propagate(scene, q0, n_steps=STEPS, **options)
        part = fa.propagate(scene, q0, n_steps=first, **options)
        rest = fa.propagate(scene, part.q[-1], n_steps=STEPS - first, t0=first * H, **options)
    else:
        a = bodies(seed)
        whole, part = a.run(method), a.run(method, n_steps=first)
        rest = a._replace(q=part.q[-1], w=part.w[-1]).run(method, n_steps=STEPS - first)
        assert np.abs(whole.w - rest.w).max() <= ROUND_OFF
    assert fa.angle_between(whole.q, rest.q).max() <= ROUND_OFF


@few
@given(seeds, KINDS)
def test_what_free_bodies_keep(seed, kind):
    a = bodies(seed, kind=kind)
    split, closed = (a.run(method, save_every=1) for method in ("strang2", "exact"))
    # a turn of m, at most three a step, rounds |m| by 4 eps
    assert fa.drift(split, a.scene).momentum.max() <= STEPS * (12.0 * EPS + TURN) + 8.0 * TURN
    found = fa.drift(closed, a.scene)
    # 1e-15 (1 + |w| t) rad of attitude, as much of w
    allowed = 2.0 * 1e-15 * (1.0 + 2.0 * STEPS * H)
    ratio = (a.inertia.max(axis=1) / a.inertia.min(axis=1)).max()
    assert found.momentum.max() <= 2.0 * allowed
    assert found.energy.max() <= 2.0 * allowed * max(1.0, ratio)


# samples


@few
@given(seeds, st.integers(1, 100), st.integers(1, 20), st.integers(-40, 40))
def test_logs_know_no_axes_units_or_neighbours(seed, n, n_logs, k):
    rng = np.random.default_rng(seed)
    rates, q0, r = rng.normal(size=(n_logs, n, 3)), units(seed, n_logs), units(seed + 1, 1)[0]
    integrate = partial(fa.integrate_rates, method="hold")
    q = integrate(rates, H, q0)
    turned = integrate(rates, H, fa.quat_multiply(r, q0))
    assert fa.angle_between(fa.quat_multiply(r, q), turned).max() <= (2 * n + 4) * TURN
    assert exactly(q, integrate(np.ldexp(rates, k), math.ldexp(H, -k), q0))
    alone = integrate(rates[n_logs - 1 :], H, q0[n_logs - 1 :])
    assert fa.angle_between(q[-1:], alone).max() <= 2 * n * TURN


@few
@given(seeds, st.integers(1, 100), st.integers(0, 100))
def test_turns_in_two_parts_and_back(seed, n, first):
    turns = np.random.default_rng(seed).normal(size=(n, 3))
    options = {"method": "hold", "increments": True}
    q = fa.integrate_rates(turns, 1.0, START, **options)
    first = min(first, n - 1)
    rest = fa.integrate_rates(turns[first:], 1.0, q[first], **options)
    allowed = (2 * n + 4) * TURN
    assert fa.angle_between(q[first:], rest).max() <= allowed
    back = fa.integrate_rates(-turns[::-1], 1.0, q[-1], **options)
    assert fa.angle_between(q[::-1], back).max() <= allowed
