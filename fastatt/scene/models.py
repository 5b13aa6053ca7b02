"""The base of rates, torques and forces: models with parameters that are checked and laid out flat.

A model is a frozen dataclass of numbers, or of arrays with one row per body, and has its formula as
a method. Packing it gives a law (the model without its numbers, with the sizes of its fields, on
which alone a formula depends) and an array of parameters, (P,) shared by all bodies or (N, P).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Annotated, Any, ClassVar, NamedTuple, Self, dataclass_transform, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.scene.time_series import TableLayout, TimeSeries, recorded
from fastatt.tracing.formulas import Vector
from fastatt.tracing.user import FORMS, UserFunction, user_function

Resources = dict[tuple[str, Any], Any]
#: a law with its parameters, (P,) or (N, P)
PackedLaw = tuple["Law", NDArray[np.float64]]


class Field(NamedTuple):
    """One field of a model: its shape for one body (−1: any length) and whether it must be above 0.

    ``table`` says whether the field may be a table, and what the formula then receives: "values",
    or "slopes" for the pair of the values and their time derivatives, which are () for constants.
    """

    shape: tuple[int, ...] = ()
    above_zero: bool = False
    table: str = ""

    def shaped(self, numbers: Any) -> Any:
        """The field as a formula takes it: a number, a tuple, or a tuple of rows."""
        if not self.shape:
            return numbers[0]
        if len(self.shape) == 2:
            n = self.shape[1]
            return tuple(numbers[k : k + n] for k in range(0, len(numbers), n))
        return (numbers, ()) if self.table == "slopes" else numbers

    def flat(self, name: str, value: ArrayLike) -> NDArray[np.float64]:
        """The numbers in rows, (n,) or (N, n).

        Raises ``ValueError`` for other shapes, and for numbers that must be above 0 and are not.
        """
        array, shape = numbers(name, value), self.shape
        bodies = array.shape[: max(array.ndim - len(shape), 0)]
        tail = array.shape[len(bodies) :]
        fits = array.size > 0 and len(bodies) <= 1 and len(tail) == len(shape)
        if not fits or any(n not in (m, -1) for m, n in zip(tail, shape, strict=True)):
            lengths = ", ".join("K" if n == -1 else str(n) for n in shape)
            one = f"({lengths},)" if len(shape) == 1 else f"({lengths})"
            each = f"(N, {lengths})" if shape else "(N,)"
            raise ValueError(f"{name} {checks.shape(array)}; accepted are {one} and {each}")
        if self.above_zero:
            checks.refuse(name, array, array <= 0.0, "above 0")
        return array.reshape((*bodies, -1))

    def check_table(self, name: str, table: TimeSeries) -> None:
        """Refuse a table that does not fit this field."""
        if not self.table or (table.form.size,) != self.shape:
            accepted = f"values of {self.shape[0]} numbers" if self.table else "numbers, no table"
            raise ValueError(f"{name}: found {table!r}; accepted: {accepted}")
        if self.table == "slopes" and not table.form.cubic:
            kind = "previous" if table.form.steps else "linear"
            raise ValueError(f'{name}: found a table of kind "{kind}"; accepted: "cubic"')


# annotations of a model's fields
Number = Annotated[ArrayLike, Field()]
PositiveNumber = Annotated[ArrayLike, Field(above_zero=True)]
Vector3 = Annotated[ArrayLike, Field((3,))]
TabledVector = Annotated[ArrayLike | TimeSeries, Field((3,), table="values")]
TabledMomentum = Annotated[ArrayLike | TimeSeries, Field((3,), table="slopes")]


class Sampling(NamedTuple):
    """Times at which states jump: start + k period for all whole k, s."""

    period: float
    start: float


@dataclass_transform(frozen_default=True)
class Model:
    """Base of all models; fields that are annotated with a ``Field`` are parameters.

    ``formula`` is called on an instance whose fields are traced numbers, or tuples of them.
    """

    #: "rate", "torque" or "force"
    kind: ClassVar[str]
    fields: ClassVar[Mapping[str, Field]]
    #: whether a rate is constant along its axes
    is_constant: ClassVar[bool] = False
    #: whether a torque or a force depends on the position
    reads_position: ClassVar[bool] = False
    #: number of states of a rate or a torque. Its formula takes them last, and returns their time
    #: derivatives after the rate or torque, in one tuple
    states: ClassVar[int] = 0
    #: when its states jump, by ``update``, of one whose states do
    sampling: ClassVar[Sampling | None] = None

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True)(cls)
        hints = get_type_hints(cls, include_extras=True)
        cls.fields = {
            name: hint.__metadata__[0]
            for name, hint in hints.items()
            if hasattr(hint, "__metadata__")
        }

    def formula(self, *state: Any) -> Any:
        """The rate, torque or force."""
        raise NotImplementedError

    def evaluate(self, *state: Any) -> Any:
        """The formula along the axes of the state."""
        return self.formula(*state)

    def update(self, t: Any, pose: Any, states: Vector) -> Any:
        """The states after a sample time, of those before."""
        return states

    def corners(self) -> NDArray[np.float64]:
        """Times, s, at which it jumps or has a corner for all bodies.

        They are those of tables that are not cubic, and of tables whose slopes it takes.
        """
        times = [np.zeros(0)]
        for name, field in self.fields.items():
            value = getattr(self, name)
            if isinstance(value, TimeSeries) and (not value.form.cubic or field.table == "slopes"):
                times.append(value.t)
        return np.concatenate(times)

    def check(self, name: str) -> None:
        """Refuse impossible numbers; fields are NumPy arrays with the body's index last."""

    @property
    def values(self) -> tuple[Any, ...]:
        """The arguments of the constructor."""
        return tuple(getattr(self, field.name) for field in dataclasses.fields(self))  # type: ignore[arg-type]

    @classmethod
    def of(cls, values: Iterable[Any]) -> Self:
        """A model with other ``values``."""
        return cls(*values)

    def pack(self, n_bodies: int | None, argument: str, resources: Resources) -> PackedLaw:
        """Check the parameters and lay them out flat; tables are added to ``resources``.

        Raises ``ValueError`` or ``TypeError`` for numbers that are not finite or of the wrong
        shape.
        """
        name = f"{argument}: {type(self).__name__}"
        columns: list[NDArray[np.float64]] = []
        look_ups: list[LookUp | None] = []
        for key, field in self.fields.items():
            value, label = getattr(self, key), f"{name}.{key}"
            if isinstance(value, TimeSeries):
                field.check_table(label, value)
                rows = np.arange(float(value.rows))[:, None] if value.form.own else np.zeros(0)
                columns.append(rows)
                look_ups.append(LookUp(len(resources), value.form, field.table == "slopes"))
                resources["table", len(resources)] = value.data
            else:
                columns.append(field.flat(label, value))
                look_ups.append(None)
        params = join(columns, n_bodies, name)
        empty = replace(self, **dict.fromkeys(self.fields))  # type: ignore[type-var]
        law = Law(empty, tuple(column.shape[-1] for column in columns), tuple(look_ups))
        if not any(look_ups):
            law.numbers(None, np.moveaxis(params, -1, 0)).check(name)
        return law, params


class Sum(Model):
    """The sum of several models of one kind.

    Parameters
    ----------
    terms : sequence of models
        The rates, torques or forces to be added.

    Examples
    --------
    >>> import fastatt as fa
    >>> both = fa.torques.Sum((fa.torques.Constant((0.1, 0.0, 0.0)), fa.torques.Damping(0.02)))
    """

    terms: Sequence[Model]

    @property
    def values(self) -> tuple[Any, ...]:
        """The terms."""
        return tuple(self.terms)

    @classmethod
    def of(cls, values: Iterable[Any]) -> Self:
        """A sum of other terms."""
        return cls(tuple(values))

    def corners(self) -> NDArray[np.float64]:
        """Those of the terms."""
        return np.concatenate([term.corners() for term in self.terms])


class UserModel(Model):
    """A model given by a user-defined function."""

    function: Callable[..., Any]
    params: Annotated[ArrayLike | None, Field((-1,))] = None

    @property
    def reads_position(self) -> bool:  # type: ignore[override]
        """Whether the function depends on the position."""
        return checks.flag("uses_position", getattr(self, "uses_position", False))

    @property
    def taken(self) -> int:
        """Number of states that the function takes."""
        return self.states

    @property
    def form(self) -> str:
        """The signature of the function, a key of ``FORMS``."""
        return f"{self.kind} at position" if self.reads_position else self.kind

    def formula(self: Any, *state: Any) -> Any:
        return self.function.given(*state, self.params)

    def pack(self, n_bodies: int | None, argument: str, resources: Resources) -> PackedLaw:
        """The law of a function, followed or compiled, and its parameters, (P,) or (N, P)."""
        params = join([parameters("params", self.params)], n_bodies, "params")
        n = params.shape[-1]
        function = user_function(self.function, self.form, n, params, self.taken)
        resources.update(resources_of(function))
        return Law(replace(self, function=function, params=None), (n,), (None,)), params


class LookUp(NamedTuple):
    """A field that is a table: its array's number, its layout, whether slopes are needed."""

    number: int
    form: TableLayout
    slopes: bool

    def numbers(self, t: Any, p: Any) -> tuple[Any, ...]:
        """The values that a formula receives for the field; p is the row, if there are several."""
        values, slopes = recorded(self.number, self.form, t, *p)
        return (values, slopes) if self.slopes else values


@dataclass(frozen=True)
class Law:
    """A model without its numbers, with the size of each field.

    ``look_ups`` has an entry for each field, None if it is not a table; ``parts`` are the laws of a
    sum's terms.
    """

    model: Any
    sizes: tuple[int, ...] = ()
    look_ups: tuple[LookUp | None, ...] = ()
    parts: tuple[Law, ...] = ()

    @cached_property
    def count(self) -> int:
        """Number of parameters."""
        return sum(self.sizes) + sum(part.count for part in self.parts)

    def terms(self, p: Any) -> Iterator[tuple[Law, Any]]:
        """The laws of a sum's terms, or this law, each with its parameters."""
        start = 0
        for leaf in self.leaves():
            yield leaf, p[start : start + leaf.count]
            start += leaf.count

    def having(self, name: str, t: Any, p: Any) -> list[Any]:
        """The models of terms that have a method of a name, with their numbers at a time."""
        return [
            leaf.numbers(t, parameters)
            for leaf, parameters in self.terms(p)
            if getattr(leaf.model, name) is not None
        ]

    def numbers(self, t: Any, p: Any) -> Any:
        """The model at a time, with fields from flat parameters or from tables."""
        start, values = 0, {}
        fields = self.model.fields.items()
        for (name, field), size, look_up in zip(fields, self.sizes, self.look_ups, strict=True):
            parameters = p[start : start + size]
            values[name] = (
                field.shaped(parameters) if look_up is None else look_up.numbers(t, parameters)
            )
            start += size
        return replace(self.model, **values)

    @cached_property
    def states(self) -> int:
        """The number of its states."""
        return sum(leaf.model.states for leaf in self.leaves())

    def formula(self, *arguments: Any, states: Vector = ()) -> Any:
        """The model's formula at a time and further arguments, parameters last.

        For a law with ``states``, their time derivatives follow the three components.
        """
        *state, p = arguments
        start, terms = 0, []
        for law, parameters in self.terms(p):
            states_of_term = (states[start : start + law.states],) if law.states else ()
            terms.append(law.numbers(state[0], parameters).evaluate(*state, *states_of_term))
            start += law.states
        columns = zip(*(term[:3] for term in terms), strict=True)
        acting = tuple(sum(column[1:], column[0]) for column in columns)
        return (*acting, *(slope for term in terms for slope in term[3:]))

    @cached_property
    def sampling(self) -> Sampling | None:
        """When its states jump.

        Raises ``ValueError`` for parts whose states jump at different times.
        """
        clocks = {leaf.model.sampling for leaf in self.leaves()} - {None}
        if len(clocks) > 1:
            listed = ", ".join(f"{x.period} s from {x.start} s" for x in sorted(clocks))
            raise ValueError(
                f"torque: found controllers that are sampled every {listed}; accepted: one period "
                "and one start of all"
            )
        return clocks.pop() if clocks else None

    def updated(self, t: Any, pose: Any, p: Any, states: Vector) -> Vector:
        """The states after a sample time, of those before."""
        after: list[Any] = []
        for law, parameters in self.terms(p):
            before = states[len(after) : len(after) + law.states]
            after += law.numbers(t, parameters).update(t, pose, before) if before else ()
        return tuple(after)

    @cached_property
    def reads_position(self) -> bool:
        """Whether it depends on the position."""
        return any(leaf.model.reads_position for leaf in self.leaves())

    def leaves(self) -> Iterable[Law]:
        """The laws of a sum's terms, or this law."""
        if not self.parts:
            yield self
        for part in self.parts:
            yield from part.leaves()


class Packed(NamedTuple):
    """Models of a scene in the form that the engine takes."""

    #: a law, or the ``fastatt.scene.equations.Structure`` of a scene
    structure: Any
    #: flat parameters, (P,) shared or (N, P)
    params: NDArray[np.float64]
    #: tables, by the names that graphs have for them: numbers for fields of models, the objects
    #: themselves for those in a user-defined function
    resources: Resources

    @property
    def tables(self) -> dict[Any, NDArray[np.float64]]:
        """The tables alone."""
        return {x: array for (kind, x), array in self.resources.items() if kind == "table"}


def resources_of(function: UserFunction) -> Resources:
    """The tables in the graph of a user-defined function, by their names there."""
    return {("table", x): array for x, array in function.tables.items()}


def pack(
    model: Any,
    base: type[Model],
    n_bodies: int | None,
    resources: Resources | None = None,
    argument: str = "",
) -> Packed:
    """Check the parameters of a model, a subclass of ``base``, and lay them out flat.

    ``argument`` names it in messages; the default is its kind.

    Raises ``TypeError`` if it is not a model, ``ValueError`` for numbers that are not finite or of
    the wrong shape.
    """
    resources = {} if resources is None else resources
    return Packed(*_pack(model, base, n_bodies, argument or base.kind, resources), resources)


def _pack(
    model: Any, base: type[Model], n_bodies: int | None, argument: str, resources: Resources
) -> PackedLaw:
    if isinstance(model, Sum):
        name = f"{argument}: Sum"
        if not isinstance(model.terms, (tuple, list)) or not model.terms:
            raise ValueError(f"{name}.terms is empty; accepted is a tuple of models")
        terms = [_pack(term, base, n_bodies, name, resources) for term in model.terms]
        laws, columns = zip(*terms, strict=True)
        return Law(Sum(()), parts=laws), join(columns, n_bodies, name)
    if isinstance(model, base):
        return model.pack(n_bodies, argument, resources)
    names = import_module(f"fastatt.scene.{base.kind}s").__all__
    raise TypeError(
        f"{argument}: found {type(model).__name__}; accepted is a model of fastatt.{base.kind}s "
        f"({', '.join(names)}) or a function {FORMS[base.kind].call}"
    )


def numbers(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """A finite float64 array of any shape."""
    array = checks.numbers(name, value, "finite numbers")
    checks.finite(name, array)
    return array.astype(np.float64, copy=False)


def parameters(name: str, value: ArrayLike | None) -> NDArray[np.float64]:
    """The argument p of a user-defined function, (P,) or (N, P); (0,) for None."""
    rows = np.atleast_1d(numbers(name, () if value is None else value))
    if rows.ndim > 2 or (rows.ndim == 2 and not len(rows)):
        raise ValueError(f"{name}: {checks.shape(rows)}; accepted are (P,) and (N, P)")
    return rows


def along_axes(name: str, value: ArrayLike, axes: int = 3) -> NDArray[np.float64]:
    """A number, or one of each axis, for all bodies or each: (), (1,), (3,), (N, 1) or (N, 3)."""
    array = numbers(name, value)
    if array.ndim > 2 or not array.size or array.shape[-1:] not in ((), (1,), (axes,)):
        raise ValueError(
            f"{name} {checks.shape(array)}; accepted: a number, ({axes},) per axis, (N, 1) or "
            f"(N, {axes}) per body"
        )
    return array


def row_count(n_bodies: int | None, rows: int) -> str:
    """Name the numbers of bodies that a scene may have, for a message; it has ``rows``."""
    if n_bodies is None:
        return "one number of rows"
    if n_bodies == 1:
        return f"1, as the initial values have, or {rows} with q0 of shape ({rows}, 4)"
    return f"{n_bodies} bodies"


def join(columns: Sequence[NDArray[np.float64]], n_bodies: int | None, name: str) -> Any:
    """Join columns of parameters: (P,) if all are shared, else (N, P)."""
    rows = {c.shape[0] for c in columns if c.ndim == 2}
    if not rows:
        return np.concatenate([np.zeros(0), *columns])
    if len(rows) > 1 or (n_bodies is not None and rows != {n_bodies}):
        counts, accepted = " and ".join(map(str, sorted(rows))), row_count(n_bodies, max(rows))
        raise ValueError(f"{name}: found parameters for {counts} bodies; accepted: {accepted}")
    n = rows.pop()
    together = np.concatenate([np.broadcast_to(c, (n, c.shape[-1])) for c in columns], axis=1)
    return np.ascontiguousarray(together)
