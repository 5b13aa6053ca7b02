"""Angular velocity as a function of time: built-in models and a user's own function.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Rates are in rad/s,
along body axes unless the scene says ``frame="inertial"``; times in s, angles in rad.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numba import types
from numba.core.errors import NumbaError
from numpy.typing import ArrayLike, NDArray

from fastatt._jit import hook, kernel, recompile
from fastatt.columns import axpy
from fastatt.kernels.trig import sincos
from fastatt.kernels.vec3 import add, neg

Model = Any  # an instance of one of the classes below


class Constant(NamedTuple):
    """w(t) = w. ``w``: (3,) or (N, 3)."""

    w: ArrayLike


class Polynomial(NamedTuple):
    """w(t) = Σ c_k t^k. ``coefficients``: (K, 3) or (N, K, 3), the constant term first."""

    coefficients: ArrayLike


class Sinusoidal(NamedTuple):
    """w(t) = bias + amplitude sin(frequency t + phase), axis by axis; each (3,) or (N, 3)."""

    bias: ArrayLike
    amplitude: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = (0.0, 0.0, 0.0)


class Coning(NamedTuple):
    """The z axis sweeps a cone of half ``angle`` a at ``frequency`` Ω without turning round it.

    w = (−Ω sin a sin Ωt, Ω sin a cos Ωt, −2Ω sin²(a/2)), exact attitude
    q = (cos a/2, sin(a/2) cos Ωt, sin(a/2) sin Ωt, 0): Goodman and Robinson, ASME J. Appl. Mech.
    25 (1958) 210. Numbers or (N,).
    """

    angle: ArrayLike
    frequency: ArrayLike


class Precession(NamedTuple):
    """Rate of constant size whose transverse part turns in the body, as in a free symmetric top.

    w = (A cos(kt + φ0), A sin(kt + φ0), s). Numbers or (N,): ``transverse`` A, ``axial`` s,
    ``frequency`` k, ``phase`` φ0.
    """

    transverse: ArrayLike
    axial: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = 0.0


class Slew(NamedTuple):
    """Rest-to-rest turn by ``rotation`` (rad, (3,) or (N, 3)) in ``duration`` s from ``start`` on.

    w = rotation/T (1 − cos(2πs/T)) within the slew, 0 outside: rate and acceleration continuous.
    """

    rotation: ArrayLike
    duration: ArrayLike
    start: ArrayLike = 0.0


class Sum(NamedTuple):
    """Sum of other models, ``Sum((Constant(...), Sinusoidal(...)))``."""

    terms: tuple[Model, ...]


@kernel
def constant(t, p):
    """w = p."""
    return p


@kernel
def sinusoidal(t, p):
    """w_i = b_i + A_i sin(f_i t + φ_i); p = (b, A, f, φ)."""
    s0, _ = sincos(p[6] * t + p[9])
    s1, _ = sincos(p[7] * t + p[10])
    s2, _ = sincos(p[8] * t + p[11])
    return p[0] + p[3] * s0, p[1] + p[4] * s1, p[2] + p[5] * s2


@kernel
def coning(t, p):
    """Coning of half angle p[0] at p[1] rad/s."""
    F = type(p[0])
    s, c = sincos(p[1] * t)
    a, b = sincos(F(0.5) * p[0])
    k = F(2.0) * p[1] * a
    return -k * b * s, k * b * c, -k * a


@kernel
def precession(t, p):
    """(A cos(kt + φ0), A sin(kt + φ0), s); p = (A, s, k, φ0)."""
    s, c = sincos(p[2] * t + p[3])
    return p[0] * c, p[0] * s, p[1]


@kernel
def slew(t, p):
    """Versine rate profile; p = (rotation, T, start)."""
    F = type(p[0])
    x = (t - p[4]) / p[3]
    x = F(0.0) if x < F(0.0) else x
    x = F(1.0) if x > F(1.0) else x
    s, _ = sincos(F(3.141592653589793) * x)
    k = F(2.0) * s * s / p[3]
    return k * p[0], k * p[1], k * p[2]


# model class: (its kernel, the number of axes of each field for one body)
_MODELS: dict[type, tuple[Any, tuple[int, ...]]] = {
    Constant: (constant, (1,)),
    Polynomial: (None, (2,)),
    Sinusoidal: (sinusoidal, (1, 1, 1, 1)),
    Coning: (coning, (0, 0)),
    Precession: (precession, (0, 0, 0, 0)),
    Slew: (slew, (1, 0, 0)),
}
_ABOVE_ZERO = {"Slew.duration"}


class InertialAxes(NamedTuple):
    """Tag: the model's rates are along inertial axes; the flipped attitude turns at −w."""

    model: Model


def horner(t: Any, p: Any) -> Any:
    """Σ p_k t^k with vector coefficients p, flat, the constant term first."""
    raise NotImplementedError


@hook(horner)
def _horner(t: types.Type, p: types.BaseTuple) -> Any:
    if len(p) == 3:
        return lambda t, p: p
    return lambda t, p: axpy(t, horner(t, p[3:]), p[:3])


def rate(model: Any, t: Any, p: Any, like: Any) -> Any:
    """w(t) of a model's tag with its flat parameters p, as three floats of the type of ``like``."""
    raise NotImplementedError


@hook(rate)
def _rate(model: types.BaseNamedTuple, t: types.Type, p: types.BaseTuple, like: types.Type) -> Any:
    def impl(model, t, p, like):
        F = type(like)
        w = evaluate(model, t, p)
        return F(w[0]), F(w[1]), F(w[2])

    return impl


def evaluate(model: Any, t: Any, p: Any) -> Any:
    """w(t) in the precision of t and p, in the axes of the flipped state."""
    raise NotImplementedError


@hook(evaluate)
def _evaluate(model: types.BaseNamedTuple, t: types.Type, p: types.BaseTuple) -> Any:
    cls = model.instance_class
    if cls is InertialAxes:
        return lambda model, t, p: neg(evaluate(model.model, t, p))
    if cls is Polynomial:
        return lambda model, t, p: horner(t, p)
    if cls is Sum:
        sizes = [_count(ty) for ty in model.types[0]]
        return (
            _sum_of(sizes[0])
            if len(sizes) > 1
            else lambda model, t, p: evaluate(model.terms[0], t, p)
        )
    function = _MODELS[cls][0] if cls in _MODELS else _user_functions[cls]
    return lambda model, t, p: function(t, p)


def _sum_of(first: int) -> Any:
    return lambda model, t, p: add(
        evaluate(model.terms[0], t, p[:first]), evaluate(Sum(model.terms[1:]), t, p[first:])
    )


def _count(ty: types.Type) -> int:
    return sum(_count(t) for t in ty) if isinstance(ty, types.BaseTuple) else 1


_new_tag: Callable[..., type] = namedtuple  # noqa: PYI024 (a class for each function)
_user_functions: dict[type, Any] = {}
_user_tags: WeakKeyDictionary[Any, type] = WeakKeyDictionary()


def user_tag(function: Callable[..., Any], n_params: int) -> Any:
    """Tag of a user's ``rate(t, p)``: its class exists in this process only.

    Raises ``TypeError`` when the function does not compile or does not return three numbers.
    """
    if function not in _user_tags:
        # symbols carry the class's name: with one name for two functions the linker keeps the first
        made: type = _new_tag(f"UserRate{len(_user_functions)}", ["p"])
        _user_functions[made] = recompile(function)
        _user_tags[function] = made
    cls = _user_tags[function]
    signature = (types.float64, types.UniTuple(types.float64, n_params))
    name = getattr(function, "__name__", repr(function))
    try:
        _user_functions[cls].compile(signature)
    except (NumbaError, TypeError) as error:  # numba's own, or its word on the number of arguments
        first = next((ln for ln in str(error).splitlines() if ln.strip()), "")
        raise TypeError(
            f"rate: {name}(t, p) does not compile for a float t and a tuple p of {n_params} "
            f"floats: {first}; accepted is a function that numba.njit compiles"
        ) from error
    returned = _user_functions[cls].overloads[signature].signature.return_type
    numbers = isinstance(returned, types.BaseTuple) and len(returned) == 3
    if not numbers or not all(isinstance(t, types.Number) for t in returned):
        raise TypeError(
            f"rate: {name}(t, p) returns {returned}; accepted is a tuple of three floats, rad/s"
        )
    return cls((0.0,) * n_params)


class Packed(NamedTuple):
    """A model ready for the engine: its tag and flat parameters, (P,) shared or (N, P)."""

    tag: Any
    params: NDArray[np.float64]
    cacheable: bool


def pack(model: Model, n_bodies: int | None, argument: str = "rate") -> Packed:
    """Check a model's numbers and lay them out flat.

    Raises ``TypeError`` for something that is no model, ``ValueError`` for numbers that are not
    finite or of the wrong shape.
    """
    cls = type(model)
    if cls is Sum:
        return _pack_sum(model, n_bodies, argument)
    if cls not in _MODELS:
        names = ", ".join(sorted(c.__name__ for c in (*_MODELS, Sum)))
        raise TypeError(
            f"{argument}: found {cls.__name__}; accepted is a model of fastatt.rates ({names}) "
            "or an @njit function rate(t, p)"
        )
    zeros, columns = [], []
    for name, value, axes in zip(model._fields, model, _MODELS[cls][1], strict=True):
        array = _numbers(f"{argument}: {cls.__name__}.{name}", value)
        if array.ndim not in (axes, axes + 1) or (axes > 0 and array.shape[-1] != 3):
            one = {0: "()", 1: "(3,)", 2: "(K, 3)"}[axes]
            many = {0: "(N,)", 1: "(N, 3)", 2: "(N, K, 3)"}[axes]
            raise ValueError(
                f"{argument}: {cls.__name__}.{name} has shape {array.shape}; "
                f"accepted are {one} and {many}"
            )
        bad = np.argwhere(np.atleast_1d(array) <= 0.0)
        if f"{cls.__name__}.{name}" in _ABOVE_ZERO and bad.size:
            where = f"[{bad[0, 0]}]" if array.ndim else ""
            found = np.atleast_1d(array)[bad[0, 0]]
            raise ValueError(
                f"{argument}: {cls.__name__}.{name}{where} is {found}; accepted: above 0"
            )
        zeros.append(_zeros(array.shape[array.ndim - axes :]))
        columns.append(array.reshape((*array.shape[: array.ndim - axes], -1)))
    return Packed(cls(*zeros), _join(columns, n_bodies, f"{argument}: {cls.__name__}"), True)


def pack_user(
    function: Callable[..., Any], params: ArrayLike | None, n_bodies: int | None
) -> Packed:
    """The same for a user's function and its parameters, (P,) shared or (N, P)."""
    array = np.zeros(0) if params is None else _numbers("params", params)
    array = np.atleast_1d(array)
    if array.ndim > 2:
        raise ValueError(f"params: has shape {array.shape}; accepted are (P,) and (N, P)")
    joined = _join([array], n_bodies, "params")
    return Packed(user_tag(function, joined.shape[-1]), joined, False)


def _pack_sum(model: Model, n_bodies: int | None, argument: str) -> Packed:
    if not isinstance(model.terms, Sequence) or not model.terms:
        raise ValueError(f"{argument}: Sum.terms is empty; accepted is a tuple of models")
    packed = [pack(term, n_bodies, f"{argument}: Sum") for term in model.terms]
    params = _join([p.params for p in packed], n_bodies, f"{argument}: Sum")
    return Packed(Sum(tuple(p.tag for p in packed)), params, True)


def _numbers(name: str, value: ArrayLike) -> NDArray[np.float64]:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: found {value!r}; accepted are finite numbers") from None
    bad = ~np.isfinite(array)
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise ValueError(f"{name}{list(where)} is {array[where]}; accepted are finite numbers")
    return array


def _zeros(shape: tuple[int, ...]) -> Any:
    return tuple(_zeros(shape[1:]) for _ in range(shape[0])) if shape else 0.0


def _join(columns: list[NDArray[np.float64]], n_bodies: int | None, name: str) -> Any:
    rows = {c.shape[0] for c in columns if c.ndim == 2}
    if not rows:
        return np.concatenate(columns)
    if len(rows) > 1 or (n_bodies is not None and rows != {n_bodies}):
        expected = "one number of rows" if n_bodies is None else f"{n_bodies} bodies"
        raise ValueError(
            f"{name}: found parameters for {sorted(rows)} bodies; accepted: {expected}"
        )
    n = rows.pop()
    return np.concatenate([np.broadcast_to(c, (n, c.shape[-1])) for c in columns], axis=1)


__all__ = [
    "Coning",
    "Constant",
    "Polynomial",
    "Precession",
    "Sinusoidal",
    "Slew",
    "Sum",
]
