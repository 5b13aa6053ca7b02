"""Force on a body, for Newton's equation in body axes μ(V̇ + Ω×V) = F.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Forces are in N along
body axes; weights and other forces fixed in space are given along inertial axes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from fastatt.flat.formulas import quat, scale
from fastatt.models import (
    Field,
    Model,
    Packed,
    Record,
    Sum,
    no_model,
    pack_fields,
    pack_sum,
    pack_user,
)
from fastatt.tables import Table


class Constant(NamedTuple):
    """A force along body axes, such as a thrust: (3,), (N, 3) or a table, N."""

    force: ArrayLike | Table


class ConstantInertial(NamedTuple):
    """A force along inertial axes, such as a weight: (3,), (N, 3) or a table, N."""

    force: ArrayLike | Table


class Drag(NamedTuple):
    """Linear drag F = −c V. ``coefficient`` c: a number or (N,), kg/s."""

    coefficient: ArrayLike


class Custom(NamedTuple):
    """A user's ``@njit`` function ``force(t, q, w, v, p) -> (f1, f2, f3)``, N along body axes.

    t in s; q, w and v (m/s, body axes) as tuples, p the tuple of ``params``, (P,) or (N, P).
    """

    function: Callable[..., Any]
    params: ArrayLike | None = None


# formulas of (t, q, w, v, p): force (N) along body axes at an attitude, a rate and a velocity
_VECTOR = Field((3,), table="values")
_ALL = (
    Record(Constant, (_VECTOR,), lambda t, q, w, v, p: p),
    Record(ConstantInertial, (_VECTOR,), lambda t, q, w, v, p: quat.rotate_inverse(q, p)),
    Record(Drag, (Field(),), lambda t, q, w, v, p: scale(-p[0], v)),
)
RECORDS: dict[type, Record] = {r.model: r for r in _ALL if r.model is not None}
USER = Record(None, (), lambda *given: given[-1])


def pack(model: Model, n_bodies: int | None, argument: str = "force") -> Packed:
    """Check a model's numbers and lay them out flat.

    Raises ``TypeError`` for something that is no model, ``ValueError`` for numbers that are not
    finite or of the wrong shape.
    """
    if type(model) is Sum:
        return pack_sum(model, pack, n_bodies, argument)
    if type(model) is Custom:
        return pack_user(model.function, "force", USER, model.params, n_bodies)
    if type(model) not in RECORDS:
        raise no_model(model, argument, "forces", (*RECORDS, Custom, Sum))
    return pack_fields(model, RECORDS[type(model)], n_bodies, argument)


__all__ = ["Constant", "ConstantInertial", "Custom", "Drag", "Sum"]


def __dir__() -> list[str]:
    return __all__
