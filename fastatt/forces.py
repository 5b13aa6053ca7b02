"""Force on a body, for Newton's equation in body axes μ(V̇ + Ω×V) = F.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Forces are in N along
body axes; weights and other forces fixed in space are given along inertial axes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from numba import types
from numpy.typing import ArrayLike

from fastatt._jit import hook
from fastatt.kernels import quat
from fastatt.kernels.vec3 import add
from fastatt.models import (
    Field,
    Model,
    Packed,
    Sum,
    UserFunctions,
    count,
    join,
    no_model,
    pack_fields,
    pack_sum,
    params_of,
)


class Constant(NamedTuple):
    """A force fixed in the body, such as a thrust. ``force``: (3,) or (N, 3), N."""

    force: ArrayLike


class ConstantInertial(NamedTuple):
    """A force fixed in space, such as a weight. ``force``: (3,) or (N, 3), N, inertial axes."""

    force: ArrayLike


class Drag(NamedTuple):
    """Linear drag F = −c V. ``coefficient`` c: a number or (N,), kg/s."""

    coefficient: ArrayLike


class Custom(NamedTuple):
    """A user's ``@njit`` function ``force(t, q, w, v, p) -> (f1, f2, f3)``, N along body axes.

    t in s; q, w and v (m/s, body axes) as tuples, p the tuple of ``params``, (P,) or (N, P).
    """

    function: Callable[..., Any]
    params: ArrayLike | None = None


_MODELS: dict[type, tuple[Field, ...]] = {
    Constant: (Field((3,)),),
    ConstantInertial: (Field((3,)),),
    Drag: (Field(),),
}
_CALL = "force(t, q, w, v, p)"
_F8 = types.float64
_TRIPLE = types.UniTuple(_F8, 3)
_FUNCTIONS = UserFunctions("force", _CALL, (_F8, types.UniTuple(_F8, 4), _TRIPLE, _TRIPLE), 3, "N")


def force(model: Any, t: Any, q: Any, w: Any, v: Any, p: Any) -> Any:
    """Force (N, body axes) of a model's tag with its flat parameters p."""
    raise NotImplementedError(model)


@hook(force)
def _force(
    model: types.BaseNamedTuple,
    t: types.Type,
    q: types.Type,
    w: types.Type,
    v: types.Type,
    p: types.BaseTuple,
) -> Any:
    cls = model.instance_class
    if cls is Sum and len(model.types[0]) > 1:
        n = count(model.types[0][0])
        return lambda model, t, q, w, v, p: add(
            force(model.terms[0], t, q, w, v, p[:n]),
            force(Sum(model.terms[1:]), t, q, w, v, p[n:]),
        )
    if cls is Sum:
        return lambda model, t, q, w, v, p: force(model.terms[0], t, q, w, v, p)
    if cls is Constant:
        return lambda model, t, q, w, v, p: p
    if cls is ConstantInertial:
        return lambda model, t, q, w, v, p: quat.rotate_inverse(q, p)
    if cls is Drag:
        return lambda model, t, q, w, v, p: (-p[0] * v[0], -p[0] * v[1], -p[0] * v[2])
    function = _FUNCTIONS[cls]

    def impl(model, t, q, w, v, p):
        F = type(w[0])
        a = function(t, q, w, v, p)
        return F(a[0]), F(a[1]), F(a[2])

    return impl


def pack(model: Model, n_bodies: int | None, argument: str = "force") -> Packed:
    """Check a model's numbers and lay them out flat.

    Raises ``TypeError`` for something that is no model, ``ValueError`` for numbers that are not
    finite or of the wrong shape.
    """
    if type(model) is Sum:
        return pack_sum(model, pack, n_bodies, argument)
    if type(model) is Custom:
        params = join([params_of(model.params)], n_bodies, "params")
        return Packed(_FUNCTIONS.tag(model.function, params.shape[-1]), params, False)
    if type(model) not in _MODELS:
        raise no_model(model, argument, "forces", (*_MODELS, Custom, Sum), _CALL)
    return pack_fields(model, _MODELS[type(model)], n_bodies, argument)


__all__ = ["Constant", "ConstantInertial", "Custom", "Drag", "Sum"]
