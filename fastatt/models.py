"""What models of rates and of torques share: their numbers checked and laid out flat, user's tags.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Packed, it is the same
class with zeros in place of the numbers (a tag, whose type chooses the kernels) and an array of
parameters, (P,) shared by all bodies or (N, P).
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterable, Sequence
from types import FunctionType
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numba import types
from numba.core.errors import NumbaError
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._jit import recompile

Model = Any  # an instance of a model's class


class Sum(NamedTuple):
    """Sum of other models of its kind, ``Sum((Constant(...), Damping(...)))``."""

    terms: Sequence[Model]


class Field(NamedTuple):
    """One field of a model: the shape for one body (−1: any length) and whether it must be > 0."""

    shape: tuple[int, ...] = ()
    above_zero: bool = False


class Packed(NamedTuple):
    """A model ready for the engine: its tag and flat parameters, (P,) shared or (N, P)."""

    tag: Any
    params: NDArray[np.float64]
    cacheable: bool


def pack_fields(
    model: Model, layout: Iterable[Field], n_bodies: int | None, argument: str
) -> Packed:
    """Check a model's numbers and lay them out flat.

    Raises ``ValueError`` or ``TypeError`` for numbers that are not finite or of the wrong shape.
    """
    cls = type(model)
    zeros, columns = [], []
    for name, value, (shape, above_zero) in zip(model._fields, model, layout, strict=True):
        label = f"{argument}: {cls.__name__}.{name}"
        array = numbers(label, value)
        one = array.ndim == len(shape)
        tail = array.shape[array.ndim - len(shape) :]
        fits = array.size > 0 and (one or array.ndim == len(shape) + 1)
        if not fits or any(n not in (m, -1) for m, n in zip(tail, shape, strict=True)):
            sizes = ["K" if n == -1 else str(n) for n in shape]
            accepted = f"{_tuple(sizes)} and {_tuple(['N', *sizes])}"
            raise ValueError(f"{label} has shape {array.shape}; accepted are {accepted}")
        if above_zero and (array <= 0.0).any():
            first = np.argwhere(np.atleast_1d(array) <= 0.0)[0, 0]
            where = f"[{first}]" if array.ndim else ""
            found = np.atleast_1d(array)[first]
            raise ValueError(f"{label}{where} is {found}; accepted: above 0")
        zeros.append(_zeros(tail))
        columns.append(array.reshape((*array.shape[: array.ndim - len(shape)], -1)))
    return Packed(cls(*zeros), join(columns, n_bodies, f"{argument}: {cls.__name__}"), True)


def pack_sum(
    model: Sum,
    pack: Callable[[Model, int | None, str], Packed],
    n_bodies: int | None,
    argument: str,
) -> Packed:
    """The same for a sum, whose terms ``pack`` packs."""
    if not isinstance(model.terms, (tuple, list)) or not model.terms:
        raise ValueError(f"{argument}: Sum.terms is empty; accepted is a tuple of models")
    packed = [pack(term, n_bodies, f"{argument}: Sum") for term in model.terms]
    params = join([p.params for p in packed], n_bodies, f"{argument}: Sum")
    return Packed(Sum(tuple(p.tag for p in packed)), params, all(p.cacheable for p in packed))


def no_model(
    model: Model, argument: str, module: str, known: Iterable[type], call: str
) -> TypeError:
    """The refusal of something that is no model."""
    names = ", ".join(sorted(c.__name__ for c in known))
    return TypeError(
        f"{argument}: found {type(model).__name__}; accepted is a model of fastatt.{module} "
        f"({names}) or an @njit function {call}"
    )


class UserFunctions:
    """The tags of users' functions of one kind, such as ``rate(t, p)``.

    ``before`` are the types of the arguments before ``p``, ``n_results`` the numbers given back
    (1: a single float).
    """

    def __init__(
        self, argument: str, call: str, before: Sequence[types.Type], n_results: int, unit: str
    ) -> None:
        self._argument, self._call, self._unit = argument, call, unit
        self._before, self._n_results = before, n_results
        self._functions: dict[type, Any] = {}
        self._tags: WeakKeyDictionary[Any, type] = WeakKeyDictionary()

    def __contains__(self, cls: type) -> bool:
        return cls in self._functions

    def __getitem__(self, cls: type) -> Any:
        return self._functions[cls]

    def tag(self, function: Callable[..., Any], n_params: int) -> Any:
        """Tag of a user's function: its class exists in this process only.

        Raises ``TypeError`` when the function does not compile or returns something else.
        """
        if not isinstance(getattr(function, "py_func", function), FunctionType):
            raise TypeError(
                f"{self._argument}: found {checks.brief(function)}; accepted: a function "
                f"{self._call}"
            )
        if function not in self._tags:
            # symbols carry the class's name: of two with one name the linker keeps the first
            name = f"User{self._argument.title()}{len(self._functions)}"
            made: type = _new_tag(name, ["p"])
            self._functions[made] = recompile(function)
            self._tags[function] = made
        cls = self._tags[function]
        self._compile(cls, getattr(function, "__name__", repr(function)), n_params)
        return cls((0.0,) * n_params)

    def _compile(self, cls: type, name: str, n_params: int) -> None:
        signature = (*self._before, types.UniTuple(types.float64, n_params))
        given = self._call.replace(self._argument, name, 1)
        try:
            self._functions[cls].compile(signature)
        except (NumbaError, TypeError) as error:  # numba's, or its word on the number of arguments
            first = next((ln for ln in str(error).splitlines() if ln.strip()), "")
            raise TypeError(
                f"{self._argument}: {given} does not compile for floats, with p a tuple of "
                f"{n_params} floats: {first}; accepted is a function that numba.njit compiles"
            ) from error
        returned = self._functions[cls].overloads[signature].signature.return_type
        if self._n_results == 1:
            fits = isinstance(returned, types.Number)
        else:
            fits = isinstance(returned, types.BaseTuple) and len(returned) == self._n_results
            fits = fits and all(isinstance(t, types.Number) for t in returned)
        if not fits:
            accepted = "a float" if self._n_results == 1 else "a tuple of three floats"
            raise TypeError(
                f"{self._argument}: {given} returns {returned}; accepted is {accepted}, "
                f"{self._unit}"
            )


def count(tag: Any) -> int:
    """How many parameters a tag, or its type as the compiler sees it, stands for."""
    if isinstance(tag, (types.Array, np.ndarray)):
        return 0
    return sum(count(t) for t in tag) if isinstance(tag, (types.BaseTuple, tuple)) else 1


def numbers(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """A finite float64 array of any shape."""
    array = checks.numbers(name, value, "finite numbers")
    checks.finite(name, array)
    return array.astype(np.float64, copy=False)


def join(columns: Sequence[NDArray[np.float64]], n_bodies: int | None, name: str) -> Any:
    """Columns of parameters side by side: (P,) when all are shared, else (N, P)."""
    rows = {c.shape[0] for c in columns if c.ndim == 2}
    if not rows:
        return np.concatenate([np.zeros(0), *columns])
    if len(rows) > 1 or (n_bodies is not None and rows != {n_bodies}):
        expected = "one number of rows" if n_bodies is None else f"{n_bodies} bodies"
        raise ValueError(
            f"{name}: found parameters for {sorted(rows)} bodies; accepted: {expected}"
        )
    n = rows.pop()
    return np.concatenate([np.broadcast_to(c, (n, c.shape[-1])) for c in columns], axis=1)


def params_of(value: ArrayLike | None) -> NDArray[np.float64]:
    """A user's parameters, (P,) shared or (N, P).

    Raises ``ValueError`` for other shapes.
    """
    array = np.atleast_1d(np.zeros(0) if value is None else numbers("params", value))
    if array.ndim > 2 or (len(array.shape) == 2 and not len(array)):
        raise ValueError(f"params: has shape {array.shape}; accepted are (P,) and (N, P)")
    return array


_new_tag: Callable[..., type] = namedtuple  # noqa: PYI024 (a class for each function)


def _zeros(shape: tuple[int, ...]) -> Any:
    return tuple(_zeros(shape[1:]) for _ in range(shape[0])) if shape else 0.0


def _tuple(sizes: Sequence[str]) -> str:
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"
