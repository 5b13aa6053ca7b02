"""Attitudes and the numbers beside them, together: their covariance, and what a motion leaves."""

from __future__ import annotations

import numpy as np
from exact import START

import fastatt as fa
from fastatt import estimation as es


def test_particles_have_the_covariance_that_they_were_drawn_of():
    """Each entry within five standard errors, (P_ii P_jj + P_ij²)/n; errors are small turns."""
    n = 20_000
    root = 0.01 * np.random.default_rng(1).normal(size=(5, 5))
    P = root @ root.T
    found = es.ParticleFilter.around(START, [1.0, -2.0], P, n, rng=2).covariance()
    spread = np.sqrt((np.outer(P.diagonal(), P.diagonal()) + P**2) / n)
    assert (np.abs(found - P) < 5.0 * spread).all()
    # enough of attitude and numbers vary together that a sign would show
    assert (np.abs(P[:3, 3:]) > 20.0 * spread[:3, 3:]).any()


def test_a_bodys_motion_leaves_the_numbers_that_are_not_its_rate():
    scene = fa.Scene(inertia=(2.0, 1.0, 0.9))
    rng = np.random.default_rng(3)
    q, y = rng.normal(size=(4, 4)), rng.normal(size=(4, 6))
    options = {"dt": 0.1, "n_steps": 5, "method": "rk4"}
    moved_q, moved_y = es.scene_motion(scene, **options)(q, y)
    run = fa.propagate(scene, q, y[:, :3], **options)
    np.testing.assert_array_equal(moved_q, run.q[-1])
    np.testing.assert_array_equal(moved_y, np.hstack([run.w[-1], y[:, 3:]]))
