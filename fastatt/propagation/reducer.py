"""A user's function that sees every step of every body, within the loop."""

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
    """A function with the state that it starts from: made by :func:`reducer`.

    ``function`` says whether it is traced (``straight``); ``start`` is (k,), or (N, k).
    """

    function: UserFunction
    start: NDArray[np.float64]

    def begin(self, kind: np.dtype[Any]) -> NDArray[Any]:
        """The state that it starts from, as a run of a precision holds it."""
        return self.start if kind == np.float64 else split_array(self.start)

    def columns(self, kind: np.dtype[Any]) -> int:
        """How many numbers of a run of a precision hold its state."""
        return int(self.start.shape[-1]) * (1 if kind == np.float64 else PARTS)

    def watching(self, packed: Packed, kind: np.dtype[Any]) -> Packed:
        """What moves, with the reducer, in a run of a precision."""
        fields = {"reducer": self.function, "reduced": self.columns(kind)}
        return packed._replace(
            structure=packed.structure._replace(**fields),
            resources={**packed.resources, **resources_of(self.function)},
        )


def reducer(function: Callable[..., Any], *, start: ArrayLike) -> Reducer:
    """Numbers that a user-defined function gathers from every step of each body.

    ``fastatt.propagate(..., reduce=...)`` takes it, and the trajectory's ``reduced`` is the last
    state. Functions are traced as rates and torques are, so that they are part of the loop.

    Parameters
    ----------
    function : ``f(t, q, w, s)``, plain or jitted, called after every step with the time, s, the
        attitude, unit, body to inertial, the angular velocity along body axes, rad/s, and the state
        that it gave before, tuples of numbers. It gives the next state: a tuple as long as
        ``start``, or a number where that is one.
    start : k numbers, (k,) for all bodies or (N, k): the state before the first step, in which a
        body's own numbers may be passed on. The function computes in double precision in a float32
        run too, which holds numbers up to float32's largest, 3.4e38. A state that becomes infinite
        or no number flags the body ``NON_FINITE``.

    Raises
    ------
    TypeError, ValueError : what is no such function; ``start`` that is not finite or has no number.

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
