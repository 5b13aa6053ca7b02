"""Particle filter on the rotation group, for up to 10⁶ particles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import quat_multiply, quat_rotate_inverse, rotation_vector_to_quat
from fastatt.estimation.amounts import (
    attitude_covariance,
    covariances,
    random_generator,
    root,
    variance,
)
from fastatt.estimation.filters import (
    Floats,
    attitude_error,
    mean_attitude,
    normalised_square,
    rows_of,
    unit_rows,
)
from fastatt.estimation.motions import Motion, moved_rows


class ParticleFilter:
    """Particle filter of attitudes with K auxiliary numbers each, for any distribution.

    The filter moves the particles by a motion and its noise, weights them by the likelihood of a
    measurement, and resamples them systematically if their effective number is below ``threshold``
    times their number (sampling and importance resampling).

    Parameters
    ----------
    q : array_like of shape (M, 4)
        Attitudes, body to inertial, of any norm above zero.
    y : array_like of shape (M, K)
        Auxiliary states.
    rng : numpy.random.Generator or int, optional
        Random generator, or a seed for one.
    threshold : float, default 0.5
        Effective number of particles, as a share of all, below which they are resampled.

    Attributes
    ----------
    q : ndarray of shape (M, 4)
        Attitudes of the particles.
    y : ndarray of shape (M, K)
        Auxiliary states of the particles.
    weights : ndarray of shape (M,)
        Weights, whose sum is 1.

    References
    ----------
    Arulampalam, Maskell, Gordon and Clapp, *IEEE Transactions on Signal Processing* 50 (2002) 174;
    Kitagawa, *Journal of Computational and Graphical Statistics* 5 (1996) 1.

    Examples
    --------
    >>> import numpy as np
    >>> from fastatt import estimation as es
    >>> cloud = es.ParticleFilter.around([1, 0, 0, 0], [0, 0, 0], 0.01 * np.eye(6), 100, rng=0)
    >>> cloud.update_vector((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), sigma=0.1)
    >>> q, y = cloud.mean()
    >>> q.shape, y.shape
    ((4,), (3,))
    """

    def __init__(
        self, q: ArrayLike, y: ArrayLike, *, rng: Any = None, threshold: float = 0.5
    ) -> None:
        start = checks.attitudes("q", q, "(M, 4)")
        auxiliary = checks.array("y", y, "(M, K)", [(len(start), -1)])
        self.q = unit_rows(start, len(start))
        self.y = rows_of(auxiliary, auxiliary.shape)
        self.weights = np.full(len(start), 1.0 / len(start))
        self._rng = random_generator(rng)
        self._threshold = checks.real("threshold", threshold)
        if not 0.0 <= self._threshold <= 1.0:
            raise ValueError(f"threshold: found {threshold}; accepted: 0 to 1")

    @classmethod
    def around(
        cls, q: ArrayLike, y: ArrayLike, covariance: ArrayLike, n: int, *, rng: Any = None
    ) -> ParticleFilter:
        """Draw particles around an estimate.

        Parameters
        ----------
        q : array_like of shape (4,)
            Attitude, body to inertial.
        y : array_like of shape (K,)
            Auxiliary state.
        covariance : array_like of shape (D, D)
            Covariance of (δθ, δy).
        n : int
            Number of particles.
        rng : numpy.random.Generator or int, optional
            Random generator, or a seed for one.

        Returns
        -------
        ParticleFilter
            The filter.
        """
        generator = random_generator(rng)
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
        """Move each particle by a random error (δθ, δy).

        Parameters
        ----------
        covariance : array_like of shape (D, D)
            Covariance of the errors.
        """
        size = 3 + self.y.shape[1]
        P = covariances("covariance", covariance, f"({size}, {size})")
        d = self._rng.standard_normal((len(self.q), size)) @ root(P).T
        self.q = np.asarray(quat_multiply(self.q, rotation_vector_to_quat(d[:, :3])))
        self.y = self.y + d[:, 3:]

    def predict(self, motion: Motion, noise: ArrayLike | None = None) -> None:
        """Move all particles.

        Parameters
        ----------
        motion : callable
            ``motion(q, y) -> (q, y)``, as for :meth:`UKF.predict`.
        noise : array_like of shape (D, D), optional
            Covariance of random errors that are added afterwards.
        """
        size = 3 + self.y.shape[1]
        P = None if noise is None else covariances("noise", noise, f"({size}, {size})")
        self.q, self.y = moved_rows(motion, self.q, self.y)
        if P is not None:
            self.scatter(P)

    def update(self, log_likelihood: ArrayLike) -> None:
        """Weight the particles by a likelihood.

        Parameters
        ----------
        log_likelihood : array_like of shape (M,)
            Logarithm of the likelihood for each particle, up to a constant.

        Raises
        ------
        ValueError
            If no particle has a finite one.
        """
        shape = f"({len(self.weights)},)"
        self._weigh(
            "log_likelihood", checks.array("log_likelihood", log_likelihood, shape, flag=True)
        )

    def _weigh(self, name: str, log_likelihood: NDArray[Any]) -> None:
        """Weight the particles by a likelihood of the argument ``name``."""
        with np.errstate(divide="ignore"):
            logs = np.log(self.weights) + log_likelihood
        top = logs.max()
        if not math.isfinite(top):
            what = "" if name == "log_likelihood" else " of the log likelihood"
            raise ValueError(f"{name}: its maximum{what} is {top}; accepted: a finite one")
        weights = np.exp(logs - top)
        self.weights = weights / weights.sum()
        if self.effective_number < self._threshold * len(self.weights):
            self.resample()

    def update_vector(self, measured: ArrayLike, reference: ArrayLike, sigma: float) -> None:
        """Update with a measured vector.

        Parameters
        ----------
        measured : array_like of shape (3,)
            Vector along body axes.
        reference : array_like of shape (3,)
            The same vector along inertial axes.
        sigma : float
            Standard deviation of each component, in the unit of the vectors.
        """
        seen = checks.array("measured", measured, "(3,)")
        fixed = checks.array("reference", reference, "(3,)")
        weight = -0.5 / variance("sigma", sigma)
        away = quat_rotate_inverse(self.q, fixed) - seen
        self._weigh("measured", np.einsum("ij,ij->i", away, away) * weight)

    def update_attitude(self, measured: ArrayLike, sigma: ArrayLike) -> None:
        """Update with a measured attitude.

        Parameters
        ----------
        measured : array_like of shape (4,)
            Unit quaternion, body to inertial.
        sigma : array_like
            Standard deviation, as in :meth:`MEKF.update_attitude`.
        """
        error = attitude_error(self.q, checks.attitudes("measured", measured, "(4,)"))
        self._weigh("measured", -0.5 * normalised_square(error, attitude_covariance(sigma)))

    @property
    def effective_number(self) -> float:
        """Effective number of particles, 1/Σw²."""
        return float(1.0 / np.dot(self.weights, self.weights))

    def resample(self) -> None:
        """Resample the particles, each as often as its weight says, to within one."""
        n = len(self.weights)
        ends = np.cumsum(self.weights)
        ends[-1] = 1.0
        chosen = np.searchsorted(ends, (np.arange(n) + self._rng.random()) / n)
        self.q, self.y = self.q[chosen], self.y[chosen]
        self.weights = np.full(n, 1.0 / n)

    def mean(self) -> tuple[Floats, Floats]:
        """Mean of the particles.

        Returns
        -------
        q : ndarray of shape (4,)
            :func:`mean_attitude` of the particles.
        y : ndarray of shape (K,)
            Weighted mean of the auxiliary states.
        """
        return mean_attitude(self.q, self.weights), self.weights @ self.y

    def covariance(self) -> Floats:
        """Covariance of the errors (δθ, δy) about the mean.

        Returns
        -------
        ndarray of shape (D, D)
            The covariance.
        """
        q, y = self.mean()
        d = np.hstack([attitude_error(q, self.q), self.y - y])
        return np.asarray((d * self.weights[:, None]).T @ d)

    def nees(self, q: ArrayLike, y: ArrayLike) -> float:
        """Normalised estimation error squared of the mean against the truth.

        Parameters
        ----------
        q : array_like of shape (4,)
            True attitude.
        y : array_like of shape (K,)
            True auxiliary state.

        Returns
        -------
        float
            χ² with D degrees of freedom, if the filter is consistent.
        """
        mean, centre = self.mean()
        away = checks.array("y", y, f"({len(centre)},)") - centre
        d = np.concatenate([attitude_error(mean, checks.attitudes("q", q, "(4,)")), away])
        return float(normalised_square(d, self.covariance()))
