"""Inertia: principal moments and axes, what no body has, the kinds of free bodies."""

from __future__ import annotations

import itertools
import re
from contextlib import nullcontext

import numpy as np
import pytest
from each import each
from exact import EPS, exp, matrix

import fastatt as fa
from fastatt.scene.inertia import (
    TRIANGLE,
    is_spherical,
    is_symmetric,
    is_tensor,
    principal,
    sort_axes,
)

MOMENTS = np.array([0.6, 0.8, 1.0])
AXES = exp([[0.3, -0.5, 0.7], [2.0, 1.0, -0.4], [0.0, 0.0, 0.0], [0.0, np.pi / 2, 0.0]])


def tensors(moments=MOMENTS, axes=AXES):
    """Tensors of bodies whose principal axes lie at ``axes``."""
    c = matrix(axes)
    return c @ (np.asarray(moments)[..., None] * np.swapaxes(c, -1, -2))


def rebuilt(found):
    if found.axes is None:
        return found.moments[..., None] * np.eye(3)
    return tensors(found.moments, found.axes)


# principal axes


def test_moments_and_diagonal_tensors_are_kept_as_they_are():
    for moments in (MOMENTS, MOMENTS[[2, 0, 1]], np.tile(MOMENTS, (5, 1))):
        for given in (moments, moments[..., None] * np.eye(3)):
            found = principal(given)
            assert found.axes is None
            assert np.array_equal(found.moments, moments)


@pytest.mark.parametrize("given", [tensors()[0], tensors(), tensors(axes=AXES[:1])])
def test_tensor_is_its_principal_moments_and_axes(given):
    given = 0.5 * (given + np.swapaxes(given, -1, -2))
    found = principal(given)
    assert found.moments.shape == given.shape[:-1]
    assert np.sort(found.moments, axis=-1) == pytest.approx(
        np.broadcast_to(MOMENTS, found.moments.shape), rel=8 * EPS
    )
    assert np.abs(np.linalg.norm(found.axes, axis=-1) - 1.0).max() < 4 * EPS
    assert np.abs(rebuilt(found) - given).max() < 16 * EPS


def test_rounded_tensors_are_symmetric_enough():
    given = tensors()[0]
    given[0, 1] *= 1.0 + 1e-12
    assert np.abs(rebuilt(principal(given)) - given).max() < 1e-12


def test_sort_axes_puts_the_intermediate_moment_second():
    """Of a body, and of bodies in several orders."""
    orders = MOMENTS[list(itertools.permutations(range(3)))]
    for given in (*orders, *map(tensors, orders), orders):
        before = principal(given)
        after = sort_axes(before)
        middle = after.moments[..., 1]
        assert middle == pytest.approx(np.full(middle.shape, 0.8), rel=8 * EPS)
        assert np.abs(rebuilt(after) - rebuilt(before)).max() < 16 * EPS


# what no body has


def tilted(moments):
    a = tensors(moments, AXES[0])
    return 0.5 * (a + a.T)


@each("size", [1e-90, 1.0, 7e4])
@each("allow_unphysical", [False, True])
def test_a_rod_is_refused_whatever_its_tensor_rounds_to(size, allow_unphysical):
    """A moment of 0 comes out of 200 tensors as one of either sign; one of 1e-9 is taken."""
    for axes in np.random.default_rng(0).normal(size=(200, 4)):
        c = fa.quat_to_dcm(axes)
        good, rod = (size * c @ np.diag([least, 1.0, 1.0]) @ c.T for least in (1e-9, 0.0))
        fa.Scene(inertia=0.5 * (good + good.T), allow_unphysical=allow_unphysical)
        with pytest.raises(ValueError, match=r"a principal moment is (0|not above 0)"):
            fa.Scene(inertia=0.5 * (rod + rod.T), allow_unphysical=allow_unphysical)


def test_triangle_may_be_broken_by_a_quarter():
    """As estimates from flight and the body (2, 1, 2/3) do."""
    assert TRIANGLE == 1.25
    for fine in ([2.0, 1.0, 2.0 / 3.0], [1.0, 1.0, 2.5], [1.0, 1.0, 2.0], [1.0, 1e3, 1e3]):
        assert fa.Scene(inertia=fine).kind in ("free", "symmetric")


def test_allow_unphysical():
    for inertia in ([1.0, 1.0, 5.0], [1.0, -2.0, 3.0], tilted([1.0, 1.0, 5.0])):
        assert fa.Scene(inertia=inertia, allow_unphysical=True).kind in ("free", "symmetric")
    skew = np.array([[1.0, 0.1, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = principal(skew, allow_unphysical=True)
    assert np.abs(rebuilt(found) - 0.5 * (skew + skew.T)).max() < 8 * EPS


def rows_of_bodies(rng, n):
    """Moments that bodies have, (n, 3)."""
    rows = rng.uniform(0.0, 1.0, (8 * n, 3))
    return rows[rows.max(axis=1) <= TRIANGLE * (rows.sum(axis=1) - rows.max(axis=1))][:n]


THREE = [
    ([[1.0, 0.9, 0.8], [0.9, 1.0, 0.7], [0.8, 0.7, 1.0]], "bodies"),  # symmetric
    ([[1.0, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 3.0, 4.0]], "bodies"),
    ([[0.6, 0.8, 1.0], [0.6, 0.8, 1.0], [0.6, 0.8, 0.9]], "bodies"),
    ([[1.0, 1.0, 9.0], [1.0, 2.0, 3.0], [2.0, 3.0, 4.0]], "bodies"),  # one that no body has
    ([[1.0, 0.1, 0.1], [0.1, 1.0, 0.1], [0.1, 0.1, 1.0]], "tensor"),
    ([[1.0, 0.1, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 1.0]], "tensor"),
    ([[1.0, 0.9, -0.1], [0.9, 1.0, -0.1], [-0.1, -0.1, 1.0]], "tensor"),
]


@each(("inertia", "reading"), THREE)
def test_three_bodies_moments_are_not_taken_for_a_tensor(inertia, reading):
    """Not even where what no body has is allowed."""
    inertia = np.array(inertia)
    start = [1, 0, 0, 0], [0.1, 0.2, 0.3]
    refused = nullcontext()
    if reading == "bodies":
        refused = pytest.raises(ValueError, match=re.escape("three bodies as (3, 3, 3), moments["))
    with refused:
        _ = fa.Scene(inertia=inertia, allow_unphysical=True).kind
    with refused:
        fa.closed_form.free_body(*start, inertia, 1.0, allow_unphysical=True)
    if (inertia > 0.0).all():
        diagonal = inertia[:, :, None] * np.eye(3)
        found = fa.Scene(inertia=diagonal, allow_unphysical=True).principal
        assert found.axes is None
        assert np.array_equal(found.moments, inertia)
    one = fa.Scene(inertia=inertia[None], allow_unphysical=True)
    assert one.principal.moments.shape == (1, 3)


def test_no_tensor_of_a_body_reads_as_three_bodies():
    """As the bounds of both readings say: of any axes, and moments up to the triangle."""
    rng = np.random.default_rng(0)
    moments = np.concatenate([rows_of_bodies(rng, 300), [[1.0, 1.0, 2.5], [1e-3, 1.0, 1.0]]])
    for m in moments:
        turned = tensors(m, exp(rng.normal(size=3)))
        assert is_tensor(0.5 * (turned + turned.T))


# kinds


KINDS = [
    ([1.0, 1.0, 1.0], "spherical"), ([1.0, 1.0, 0.8], "symmetric"), ([0.8, 1.0, 1.0], "symmetric"),
    ([1.0, 0.8, 1.0], "symmetric"), ([0.6, 0.8, 1.0], "free"),
    ([1.0, 1.0 + 9e-13, 0.8], "symmetric"), ([1.0, 1.0 + 2e-12, 0.8], "free"),
    ([1.0, 1.0 + 9e-13, 1.0], "spherical"), ([1.0, 1.0 + 2e-12, 1.0], "symmetric"),
    ([[1.0, 1.0, 1.0], [1.0, 1.0, 0.8]], "symmetric"),
    ([[1.0, 1.0, 1.0], [0.6, 0.8, 1.0]], "free"), ([[1.0, 1.0, 1.0]] * 4, "spherical"),
]  # fmt: skip


@each("unit", [1.0, 1e-12, 1e12])
@each(("inertia", "kind"), KINDS)
def test_kind(inertia, kind, unit):
    """To 1e-12 of the largest moment; of an ensemble, what all its bodies are."""
    inertia = unit * np.array(inertia)
    assert fa.Scene(inertia=inertia).kind == kind
    assert bool(is_spherical(inertia).all()) == (kind == "spherical")
    assert bool(is_symmetric(inertia).all()) == (kind in ("spherical", "symmetric"))
    torque = fa.torques.Constant([0.0, 0.0, 0.0])
    assert fa.Scene(inertia=inertia, torque=torque).kind == "torqued"


def test_kind_of_tensors():
    """Rounding of a turned tensor is far below the tolerance."""
    for moments, kind in (((1, 1, 1), "spherical"), ((1, 1, 0.8), "symmetric"), (MOMENTS, "free")):
        assert fa.Scene(inertia=tilted(moments)).kind == kind
