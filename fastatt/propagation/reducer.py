"""User-defined functions that are evaluated after every step of every body, within the loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.engine.double_states import PARTS, split_array
from fastatt.scene.models import Packed, resources_of
from fastatt.tracing.user import UserFunction, user_function


@dataclass(frozen=True, eq=False)
class Reducer:
    """A function with its initial state; :func:`reducer` makes it.

    Attributes
    ----------
    function : UserFunction
        The function; ``function.straight`` says whether it is traced.
    start : ndarray, shape (k,) or (N, k)
        The initial state.
    """

    function: UserFunction
    start: NDArray[np.float64]

    def begin(self, kind: np.dtype[Any]) -> NDArray[Any]:
        """The initial state, as a run of a precision holds it."""
        return self.start if kind == np.float64 else split_array(self.start)

    def columns(self, kind: np.dtype[Any]) -> int:
        """The number of values with which a run of a precision holds the state."""
        return int(self.start.shape[-1]) * (1 if kind == np.float64 else PARTS)

    def watching(self, packed: Packed, kind: np.dtype[Any]) -> Packed:
        """The structure and parameters of a scene, with the reducer."""
        fields = {"reducer": self.function, "reduced": self.columns(kind)}
        return packed._replace(
            structure=packed.structure._replace(**fields),
            resources={**packed.resources, **resources_of(self.function)},
        )


def reducer(function: Callable[..., Any], *, start: ArrayLike) -> Reducer:
    """Accumulate numbers with a user-defined function after every step of every body.

    ``fastatt.propagate(..., reduce=...)`` accepts the result, and ``Trajectory.reduced`` is the
    last state. The function is traced, as rates and torques are, so that it becomes part of the
    compiled loop.

    Parameters
    ----------
    function : callable
        ``f(t, q, w, s)``, plain or jitted, which is called after every step and returns the next
        state. Its arguments are the time, s, the unit quaternion, body to inertial, the angular
        velocity along body axes, rad/s, and the state that it returned before, as tuples. The next
        state is a tuple as long as ``start``, or a number if that has one number.
    start : array_like, shape (k,) or (N, k)
        The state before the first step, for all bodies or for each. It may also carry constants of
        each body.

    Returns
    -------
    Reducer
        For the argument ``reduce`` of :func:`fastatt.propagate`.

    Raises
    ------
    TypeError
        If ``function`` is not such a function.
    ValueError
        If ``start`` is not finite or has no numbers.

    Notes
    -----
    The function computes in double precision in a float32 run too, which holds numbers up to
    3.4e38, the largest of float32. A state that becomes infinite or NaN sets the status
    ``NON_FINITE``.

    Examples
    --------
    The largest rate, and the first time within 0.2 rad of the inertial frame:

    >>> import fastatt as fa
    >>> def watch(t, q, w, s):
    ...     rate = (w[0] ** 2 + w[1] ** 2 + w[2] ** 2) ** 0.5
    ...     near = q[0] * q[0] > 0.990033288920621 and s[1] < 0.0  # cos² 0.1
    ...     return max(rate, s[0]), t if near else s[1]
    >>> body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> run = fa.propagate(
    ...     body, [0, 1, 0, 0], [1.0, 0.3, 0.0], dt=0.01, n_steps=400,
    ...     reduce=fa.reducer(watch, start=(0.0, -1.0)),
    ... )
    >>> run.reduced.round(2).tolist()
    [1.05, 2.91]
    """
    found = np.atleast_1d(checks.numbers("start", start, "numbers")).astype(np.float64)
    if found.ndim > 2 or not found.size:
        raise ValueError(f"start: {checks.shape(found)}; accepted: (k,) or (N, k)")
    checks.finite("start", found)
    return Reducer(user_function(function, "reducer", found.shape[-1]), found)
