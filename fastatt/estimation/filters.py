"""Common parts of filters: errors, means, updates."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, rounding
from fastatt.arrays import check_broadcast, floats, normalised, on_rows
from fastatt.codegen.rows import RowFunction
from fastatt.estimation.amounts import (
    attitude_covariance,
    common_number,
    covariances,
    largest_square,
    root,
    variance,
)
from fastatt.estimation.updates import operation
from fastatt.tracing.formulas import quat

Floats = NDArray[np.float64]

#: measurements that a filter refuses in a row before it warns
MOST_REFUSED = 10
# rows of arrays that a filter keeps from call to call; those of many filters take much memory
_KEPT = 10_000


def attitude_error(q: ArrayLike, q_true: ArrayLike) -> Floats:
    """Error δθ of attitudes, q_true = q∘exp(δθ).

    Parameters
    ----------
    q : array_like of shape (..., 4)
        Estimated attitudes, of any norm above zero.
    q_true : array_like of shape (..., 4)
        True attitudes, of any norm above zero.

    Returns
    -------
    ndarray of shape (..., 3)
        δθ along body axes, rad.

    Raises
    ------
    ValueError, TypeError
        If a shape is another one, or a quaternion is zero.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.estimation.attitude_error([1, 0, 0, 0], [1, 0, 0, 0.001]).round(6).tolist()
    [0.0, 0.0, 0.002]
    """
    rows, true = _not_zero("q", q), _not_zero("q_true", q_true)
    check_broadcast("q", rows, "q_true", true)
    return on_rows(_between, rows, true, after=3)


def _between(q: Any, p: Any) -> Any:
    return quat.log(quat.mul(quat.conj(q), p))


def turned(q: Floats, d: Floats) -> Floats:
    """Attitudes q∘exp(d), of angles d that are not large."""
    return on_rows(_turned, q, d, after=4)


def _turned(q: Any, d: Any) -> Any:
    return quat.mul(q, quat.exp(d))


def _not_zero(name: str, q: ArrayLike) -> Floats:
    attitudes = floats(name, q, (4,)).astype(np.float64)
    if not attitudes.any(axis=-1).all():
        raise ValueError(f"{name}: found a zero quaternion; accepted: of any other length")
    return attitudes


def normalised_square(d: Floats, P: Floats) -> Floats:
    """dᵀ P⁻¹ d of rows d (..., D) and covariances (..., D, D), as ``|L⁻¹ d|²``."""
    L, size = root(P), d.shape[-1]
    squares = np.zeros(np.broadcast_shapes(d.shape[:-1], P.shape[:-2]))
    left = np.array(np.broadcast_to(d, (*squares.shape, size)))
    for k in range(size):
        x, pivot = left[..., k], L[..., k, k]
        u = np.divide(x, pivot, where=pivot != 0.0, out=np.zeros(squares.shape))
        # without variance the result is 0 or infinite
        with np.errstate(over="ignore"):
            squares += np.where((pivot == 0.0) & (x != 0.0), np.inf, u * u)
        left -= L[..., :, k] * u[..., None]
    return squares


def mean_attitude(q: ArrayLike, weights: ArrayLike | None = None) -> Floats:
    """Weighted mean of attitudes, which minimises the weighted sum of squared matrix distances.

    Parameters
    ----------
    q : array_like of shape (..., M, 4)
        Attitudes, of any norm above zero; q and −q are equivalent.
    weights : array_like of shape (..., M), optional
        Weights of at least 0; the default is equal weights.

    Returns
    -------
    ndarray of shape (..., 4)
        Unit quaternions with q0 ≥ 0: the eigenvector of Σ w q qᵀ with the largest eigenvalue.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, a quaternion is zero, weights are negative or all zero, or the mean
        is not unique.

    References
    ----------
    Markley, Cheng, Crassidis and Oshman, *Journal of Guidance, Control, and Dynamics* 30 (2007)
    1193, equation 12.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.estimation.mean_attitude([[1.0, 0.1, 0.0, 0.0], [1.0, -0.1, 0.0, 0.0]]).round(6).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    rows = _not_zero("q", q)
    if rows.ndim < 2 or rows.shape[-2] == 0:
        raise ValueError(f"q: has shape {rows.shape}; accepted: (..., M, 4)")
    checks.finite("q", rows)
    weighted = rows = normalised(rows)
    if weights is not None:
        w = checks.numbers("weights", weights, "real numbers").astype(np.float64)
        if w.shape[-1:] != rows.shape[-2:-1]:
            raise ValueError(f"weights: has shape {w.shape}; accepted: (..., {rows.shape[-2]})")
        check_broadcast("q", rows[..., 0], "weights", w)
        checks.finite("weights", w)
        if (w < 0.0).any() or not w.any(axis=-1).all():
            raise ValueError(
                f"weights: found {w.min():g} to {w.max():g}; accepted: at least 0, and some above"
            )
        weighted = rows * (w / w.max(axis=-1, keepdims=True))[..., None]
    values, vectors = np.linalg.eigh(np.swapaxes(weighted, -1, -2) @ rows)
    if (values[..., -1] - values[..., -2] <= 1e-14 * values[..., -1]).any():
        raise ValueError("q: has no one mean; accepted: attitudes that do not weigh each other out")
    mean = vectors[..., -1]
    return np.asarray(np.where(mean[..., :1] < 0.0, -mean, mean))


class _Bound(NamedTuple):
    """A formula of rows, and the arrays that it reads and writes."""

    run: Callable[[], object]
    inputs: list[Floats]
    outputs: list[Floats]


class Estimates:
    """Attitudes, auxiliary states and covariances of (δθ, δy), for one filter or N."""

    def __init__(
        self, q: ArrayLike, name: str, y: NDArray[Any], covariance: ArrayLike, invalid: str
    ) -> None:
        """``name`` is the name of the argument y, (K,) or (N, K)."""
        start, size = checks.attitudes("q", q), 3 + y.shape[-1]
        shapes = f"({size}, {size}) or (N, {size}, {size})"
        P = covariances("covariance", covariance, shapes)
        starts = {"q": (start, 1), name: (y, 1), "covariance": (P, 2)}
        many = {name: x for name, (x, one) in starts.items() if x.ndim > one}
        n = common_number("filters", **many) if many else 1
        self._one, self._name = not many, name
        # these arrays are changed in place, since calls hold their addresses
        self._q, self._y = _rows(normalised(start), (n, 4)), _rows(y, (n, size - 3))
        self._P = _rows(P, (n, size, size))
        self._skips = checks.choice("invalid", invalid, ("raise", "skip")) == "skip"
        self._refused = np.zeros(n, dtype=np.int64)
        self._bounds: dict[str, _Bound] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_bounds": {}}

    def _each(self, rows: Floats) -> Floats:
        """The rows or, for one filter, its row."""
        return np.asarray(rows[0]) if self._one else rows

    def _figures(self, numbers: Floats) -> Any:
        return float(numbers[0]) if self._one else numbers

    def _vectors(self, name: str, value: ArrayLike) -> NDArray[Any]:
        """Vectors (3,) or (N, 3), which need not be finite if filters skip such measurements."""
        return checks.array(name, value, f"(3,) or ({len(self._q)}, 3)", flag=self._skips)

    def _directions(self, name: str, value: ArrayLike) -> NDArray[Any]:
        """Vectors that are not zero, unless filters skip such measurements."""
        rows = self._vectors(name, value)
        if not self._skips and not (there := rows.any(axis=-1)).all():
            where = [int(i) for i in np.argwhere(~there)[0]] or ""
            raise ValueError(f"{name}{where} is the zero vector; accepted: any other")
        return rows

    def _operation(self, name: str, *numbers: Floats) -> _Bound:
        """An operation of ``updates``, with an array of each filter's numbers if it is kept."""
        if name in self._bounds:
            return self._bounds[name]
        state = [self._q, self._y, self._P.reshape(len(self._q), -1)]
        formula = operation(name, self._y.shape[1])
        return self._bound(name, formula, [*state, *numbers], outputs=state)

    def _bound(
        self, name: str, formula: RowFunction, inputs: list[Floats], outputs: Sequence[Floats] = (),
        n: int = 0,
    ) -> _Bound:  # fmt: skip
        """A formula of rows with its arrays, the first of which are given; n rows, or as filters.

        ``inputs`` and ``outputs`` of the result are the others.
        """
        n = n or len(self._q)
        widths = [*formula.inputs.items()][len(inputs) :]
        read = [np.empty((1 if key == "shared" else n, width or 1)) for key, width in widths]
        written = [np.empty((n, x)) if x else np.empty(n) for x in formula.outputs[len(outputs) :]]
        run = formula.bound([*inputs, *read], [*outputs, *written])
        bound = _Bound(run, read, written)
        if n <= _KEPT:
            self._bounds[name] = bound
        return bound

    def update_vector(
        self, measured: ArrayLike, reference: ArrayLike, sigma: float, *, gate: float | None = None
    ) -> Any:
        """Update with a measured vector, such as the direction of a star or the magnetic field.

        Parameters
        ----------
        measured : array_like of shape (3,) or (N, 3)
            Vectors along body axes, other than zero.
        reference : array_like of shape (3,) or (N, 3)
            The same vectors along inertial axes, of the same length: a RuntimeWarning tells of
            lengths that differ by a factor of 2 or more, as in other units.
        sigma : float
            Standard deviation of each component, in the unit of the vectors, above 0.
        gate : float, optional
            Largest normalised innovation squared of a measurement that is used.

        Returns
        -------
        float or ndarray of shape (N,)
            Normalised innovation squared (NIS); NaN if a measurement was ignored since it was not
            finite or zero.

        Raises
        ------
        ValueError
            If a shape does not fit, or a measurement is not finite or zero and ``invalid`` is
            "raise".
        """
        call = self._operation("vector")
        (pair, shared), (nis, nonlinearity) = call.inputs, call.outputs
        seen = self._directions("measured", measured)
        known = self._directions("reference", reference)
        _warn_of_lengths(seen, known)
        shared[:] = largest_square(gate), variance("sigma", sigma)
        pair[:, :3], pair[:, 3:] = seen, known
        call.run()
        return self._checked_nis(nis.copy(), gate, nonlinearity)

    def update_attitude(
        self, measured: ArrayLike, sigma: ArrayLike, *, gate: float | None = None
    ) -> Any:
        """Update with a measured attitude, such as that of a star tracker.

        Parameters
        ----------
        measured : array_like of shape (4,) or (N, 4)
            Unit quaternions, body to inertial.
        sigma : array_like
            Standard deviation about each body axis, rad, a number or (3,), or a covariance (3, 3),
            rad².
        gate : float, optional
            Largest normalised innovation squared of a measurement that is used.

        Returns
        -------
        float or ndarray of shape (N,)
            Normalised innovation squared (NIS); NaN if a measurement was ignored since it was not
            finite.

        Raises
        ------
        ValueError
            If a shape does not fit, or a measurement is not finite and ``invalid`` is "raise".
        """
        shapes = f"(4,) or ({len(self._q)}, 4)"
        rows = checks.attitudes("measured", measured, shapes, flag=self._skips)
        call = self._operation("attitude")
        (attitudes, shared), (nis, nonlinearity) = call.inputs, call.outputs
        shared[:] = largest_square(gate), *attitude_covariance(sigma)[np.triu_indices(3)]
        # a zero quaternion is not an attitude
        attitudes[:] = np.where((rows == 0.0).all(axis=-1, keepdims=True), np.nan, rows)
        call.run()
        return self._checked_nis(nis.copy(), gate, nonlinearity)

    def _checked_nis(self, nis: Floats, gate: float | None, nonlinearity: Floats) -> Any:
        """NIS; refuses measurements without one, and warns of updates that are too nonlinear."""
        if not self._skips and not checks.all_finite(nis):
            lost = ~np.isfinite(nis) if gate is None else np.isnan(nis)
            if lost.any():
                k = int(np.argmax(lost))
                raise ValueError(
                    f"measured{'' if self._one else [k]}: has a normalised innovation squared of "
                    f"{nis[k]}; accepted: finite ones; this estimate is as before"
                )
        limit = largest_square(gate)
        if ((nonlinearity > 1.0) & (nis <= limit)).any():
            warnings.warn(
                "measured: an attitude was known too little for vectors as precise as these: the "
                "covariance left may be too small; begin with an attitude that is known better, or "
                "use update_attitude first",
                stacklevel=3,
            )
        self._refused[nis <= limit] = 0
        if gate is not None:
            refused = nis > limit
            self._refused += refused
            if (locked := refused & (self._refused == MOST_REFUSED)).any():
                which = "the filter" if self._one else f"filter {int(np.argmax(locked))}"
                warnings.warn(
                    f"gate: {which} has refused {MOST_REFUSED} measurements in a row, as it does "
                    "if its covariance is far smaller than its error; a larger covariance lets it "
                    "use them again",
                    stacklevel=3,
                )
        return self._figures(nis)

    @property
    def q(self) -> Floats:
        """Attitudes, body to inertial: (4,) or (N, 4)."""
        return self._each(self._q)

    @property
    def covariance(self) -> Floats:
        """Covariances of the errors, which can be changed in place: (D, D) or (N, D, D)."""
        return self._each(self._P)

    def nees(self, q: ArrayLike, y: ArrayLike) -> Any:
        """Normalised estimation error squared against the truth.

        Parameters
        ----------
        q : array_like of shape (4,) or (N, 4)
            True attitudes.
        y : array_like of shape (K,) or (N, K)
            True auxiliary states; those of an MEKF are gyro biases, rad/s.

        Returns
        -------
        float or ndarray of shape (N,)
            χ² with D degrees of freedom, if the filter is consistent.

        Raises
        ------
        ValueError, TypeError
            If the truth has another shape, is not finite, or is a zero quaternion.
        """
        n, k = self._y.shape
        attitudes = checks.attitudes("q", q, f"(4,) or ({n}, 4)")
        y = checks.array(self._name, y, f"({k},) or ({n}, {k})")
        d = np.concatenate([attitude_error(self._q, attitudes), y - self._y], axis=-1)
        return self._figures(normalised_square(d, self._P))


def _rows(value: NDArray[Any], shape: tuple[int, ...]) -> Floats:
    """A new array of a shape, from one row or all of them."""
    return np.array(np.broadcast_to(value, shape), dtype=np.float64, order="C")


def _warn_of_lengths(measured: NDArray[Any], reference: NDArray[Any]) -> None:
    """Warn of measured vectors that are twice as long as their references, or half as long."""
    squares = [np.einsum("...i,...i", x, x) for x in (measured, reference)]
    with np.errstate(all="ignore"):
        ratio = squares[0] / squares[1]
    is_off = np.isfinite(ratio) & (ratio != 0.0) & ((ratio > 4.0) | (ratio < 0.25))
    if is_off.any():
        k = int(np.argmax(is_off))
        sizes = [float(np.sqrt(np.broadcast_to(x, np.shape(ratio)).ravel()[k])) for x in squares]
        rounding.warn(
            f"measured: found a vector of length {sizes[0]:.4g} with a reference of "
            f"{sizes[1]:.4g} (filter {k}); accepted: both in one unit, or both of length 1",
            RuntimeWarning,
        )
