"""What holds for any input: rotations, conversions, frames, units, a run in two parts.

Hypothesis draws the seed and the kind of whole ensembles, so that a few calls cover much.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from exact import EPS, generic
from hypothesis import given, settings
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


def exactly(a, b):
    return a.shape == b.shape and a.tobytes() == b.tobytes()


# a component of a product is a sum of four products, wrong by at most 2 eps |p||q|

PRODUCT = 4.0 * EPS  # as a 4-vector
TURN = 2.0 * PRODUCT  # as an angle


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
    u = np.clip(u, -1e49, 1e49)  # longer ones are refused
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


def run(seed, method, q0=None, w0=None, **options):
    """64 bodies or rates of a seed, from their own start or another."""
    a = bodies(seed)
    a = a._replace(q=a.q if q0 is None else q0, w=a.w if w0 is None else w0)
    if method != RATE:
        return a.run(method, **options)
    options = {"dt": H, "n_steps": STEPS, "n_threads": 1, "method": method, **options}
    return fa.propagate(generic(64, seed).scene, a.q, **options)


@few
@given(seeds, st.sampled_from((RATE, *BODY)))
def test_runs_do_not_know_the_inertial_axes(seed, method):
    r, a = units(seed + 2, 1), run(seed, method)
    b = run(seed, method, fa.quat_multiply(r, bodies(seed).q))
    assert fa.angle_between(fa.quat_multiply(r, a.q), b.q).max() <= (2 * STEPS + 4) * TURN
    assert exactly(a.w, b.w)


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
