"""Particle filter on the rotation group: 10⁶ particles through the tile engine."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.arrays import quat_multiply, quat_rotate_inverse, rotation_vector_to_quat
from fastatt.estimation.amounts import attitude_covariance, covariances, root, variance
from fastatt.estimation.filters import (
    Floats,
    Motion,
    attitude_error,
    mean_attitude,
    moved_rows,
    normalised_square,
    rows_of,
    unit_rows,
)


class ParticleFilter:
    """Attitudes with K numbers each, and weights: any distribution, any measurement.

    Sampling and importance resampling: particles move by the motion and its noise, are weighted by
    how likely they make a measurement, and are drawn anew (systematically) when fewer than
    ``threshold`` of them count: Arulampalam, Maskell, Gordon and Clapp, IEEE Trans. Signal Proc. 50
    (2002) 174; Kitagawa, J. Comput. Graph. Stat. 5 (1996) 1.

    Parameters
    ----------
    q : (M, 4), attitudes, body to inertial, of any length but zero.
    y : (M, K), the auxiliary state.
    rng : a ``numpy.random.Generator``, or a seed for one.
    threshold : share of the particles below whose effective number they are drawn anew.

    Attributes
    ----------
    q, y : the particles; ``weights`` (M,), of sum 1.
    """

    def __init__(
        self, q: ArrayLike, y: ArrayLike, *, rng: Any = None, threshold: float = 0.5
    ) -> None:
        start = checks.attitudes("q", q, "(M, 4)")
        auxiliary = checks.array("y", y, "(M, K)", [(len(start), -1)])
        self.q = unit_rows(start, len(start))
        self.y = rows_of(auxiliary, auxiliary.shape)
        self.weights = np.full(len(start), 1.0 / len(start))
        self._rng = np.random.default_rng(rng)
        self._threshold = checks.real("threshold", threshold)

    @classmethod
    def around(
        cls, q: ArrayLike, y: ArrayLike, covariance: ArrayLike, n: int, *, rng: Any = None
    ) -> ParticleFilter:
        """n particles about q (4,) and y (K,), their errors (δθ, δy) of a covariance (D, D)."""
        generator = np.random.default_rng(rng)
        particles = checks.whole("n", n, 1)
        centre = checks.attitudes("q", q, "(4,)")
        auxiliary = checks.array("y", y, "(K,)")
        size = 3 + len(auxiliary)
        made = cls(
            np.broadcast_to(centre, (particles, 4)),
            np.broadcast_to(auxiliary, (particles, size - 3)),
            rng=generator,
        )
        made.scatter(covariance)
        return made

    def scatter(self, covariance: ArrayLike) -> None:
        """Move each particle by a random error (δθ, δy) of a covariance (D, D)."""
        size = 3 + self.y.shape[1]
        P = covariances("covariance", covariance, f"({size}, {size})")
        d = self._rng.standard_normal((len(self.q), size)) @ root(P).T
        self.q = np.asarray(quat_multiply(self.q, rotation_vector_to_quat(d[:, :3])))
        self.y = self.y + d[:, 3:]

    def predict(self, motion: Motion, noise: ArrayLike | None = None) -> None:
        """Move all particles: ``motion`` as for :meth:`UKF.predict`, then a noise's covariance."""
        size = 3 + self.y.shape[1]
        P = None if noise is None else covariances("noise", noise, f"({size}, {size})")
        q, y = motion(self.q, self.y)
        self.q, self.y = moved_rows(q, y, self.y.shape)
        if P is not None:
            self.scatter(P)

    def update(self, log_likelihood: ArrayLike) -> None:
        """Weight the particles by the logarithm of a likelihood, (M,), up to a constant.

        Raises ``ValueError`` where no particle has a finite one.
        """
        given = checks.array("log_likelihood", log_likelihood, f"({len(self.weights)},)", flag=True)
        with np.errstate(divide="ignore"):
            logs = np.log(self.weights) + given
        top = logs.max()
        if not math.isfinite(top):
            raise ValueError(f"log_likelihood: its maximum is {top}; accepted: a finite one")
        weights = np.exp(logs - top)
        self.weights = weights / weights.sum()
        if self.effective_number < self._threshold * len(self.weights):
            self.resample()

    def update_vector(self, measured: ArrayLike, reference: ArrayLike, sigma: float) -> None:
        """Use a vector (3,), measured in body axes, its reference along inertial ones."""
        seen = checks.array("measured", measured, "(3,)")
        fixed = checks.array("reference", reference, "(3,)")
        weight = -0.5 / variance("sigma", sigma)
        away = quat_rotate_inverse(self.q, fixed) - seen
        self.update(np.einsum("ij,ij->i", away, away) * weight)

    def update_attitude(self, measured: ArrayLike, sigma: ArrayLike) -> None:
        """Use an attitude (4,); ``sigma`` as for :meth:`MEKF.update_attitude`."""
        error = attitude_error(self.q, checks.attitudes("measured", measured, "(4,)"))
        self.update(-0.5 * normalised_square(error, attitude_covariance(sigma)))

    @property
    def effective_number(self) -> float:
        """1/Σw²: how many particles count."""
        return float(1.0 / np.dot(self.weights, self.weights))

    def resample(self) -> None:
        """Draw the particles anew, each as often as its weight says, to within one."""
        n = len(self.weights)
        ends = np.cumsum(self.weights)
        ends[-1] = 1.0
        chosen = np.searchsorted(ends, (np.arange(n) + self._rng.random()) / n)
        self.q, self.y = self.q[chosen], self.y[chosen]
        self.weights = np.full(n, 1.0 / n)

    def mean(self) -> tuple[Floats, Floats]:
        """(q, y): :func:`mean_attitude` (4,) and the weighted mean (K,)."""
        return mean_attitude(self.q, self.weights), self.weights @ self.y

    def covariance(self) -> Floats:
        """Covariance (D, D) of the errors (δθ, δy) about the mean."""
        q, y = self.mean()
        d = np.hstack([attitude_error(q, self.q), self.y - y])
        return np.asarray((d * self.weights[:, None]).T @ d)

    def nees(self, q: ArrayLike, y: ArrayLike) -> float:
        """Normalised error squared of the mean against the truth."""
        mean, centre = self.mean()
        away = checks.array("y", y, f"({len(centre)},)") - centre
        d = np.concatenate([attitude_error(mean, checks.attitudes("q", q, "(4,)")), away])
        return float(normalised_square(d, self.covariance()))
