"""The base of rates, torques and forces: models with parameters that are checked and laid out flat.

A model is a frozen dataclass of numbers, or of arrays with one row per body, and has its formula as
a method. Packing it gives a law (the model without its numbers, with the sizes of its fields, on
which alone a formula depends) and an array of parameters, (P,) shared by all bodies or (N, P).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Annotated, Any, ClassVar, NamedTuple, Self, dataclass_transform, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.scene.time_series import TableLayout, TimeSeries, recorded
from fastatt.tracing.formulas import Vector
from fastatt.tracing.user import FORMS, user_function

#: numbers of tables, by the names that graphs have for them
Tables = dict[Any, NDArray[np.float64]]
#: a term or a law with its parameters, (P,) or (N, P)
PackedTerm = tuple["Term", NDArray[np.float64]]
PackedLaw = tuple["Law", NDArray[np.float64]]


class Packing(NamedTuple):
    """What a model is packed for.

    The number of bodies if it is known, the model's name in messages, the tables, to which those of
    the model are added, and the number of states that a scene has for its force.
    """

    n_bodies: int | None
    argument: str
    tables: Tables
    states: int = 0


@dataclass(frozen=True)
class Field:
    """One parameter of a model: its shape for one body (−1: any length) and what it may be.

    ``accepted`` are the shapes that it may have, if these are not that of one body and rows of it.
    ``table`` says whether it may be a table, and what the formula then receives: "values", or
    "slopes" for the pair of the values and their time derivatives, which are () for constants.
    """

    shape: tuple[int, ...] = ()
    above_zero: bool = False
    table: str = ""
    accepted: str = ""
    optional: bool = False

    def shaped(self, numbers: Any) -> Any:
        """The field as a formula takes it: a number, a tuple, or a tuple of rows."""
        if not self.shape:
            return numbers[0]
        if len(self.shape) == 2:
            n = self.shape[1]
            return tuple(numbers[k : k + n] for k in range(0, len(numbers), n))
        return (numbers, ()) if self.table == "slopes" else numbers

    def flat(self, name: str, value: ArrayLike | None) -> NDArray[np.float64]:
        """The numbers in rows, (n,) or (N, n); (0,) for an optional field without a value.

        Raises ``ValueError`` for other shapes, and for numbers that must be above 0 and are not.
        """
        if value is None and self.optional:
            return np.zeros(0)
        array = numbers(name, value, self.accepted or self._shapes())
        if self.above_zero:
            checks.refuse(name, array, array <= 0.0, "above 0")
        return array.reshape((*array.shape[: max(array.ndim - len(self.shape), 0)], -1))

    def _shapes(self) -> str:
        """The shape of one body and that of N, in the words of a message."""
        if not self.shape:
            return "a number or (N,)"
        lengths = ", ".join("K" if n == -1 else str(n) for n in self.shape)
        return f"({lengths}{',' if len(self.shape) == 1 else ''}) or (N, {lengths})"

    def check_table(self, name: str, table: TimeSeries) -> None:
        """Refuse a table that does not fit this field."""
        if not self.table or (table.form.size,) != self.shape:
            accepted = f"values of {self.shape[0]} numbers" if self.table else "numbers, no table"
            raise ValueError(f"{name}: found {table!r}; accepted: {accepted}")
        if self.table == "slopes" and not table.form.cubic:
            kind = "previous" if table.form.steps else "linear"
            raise ValueError(f'{name}: found a table of kind "{kind}"; accepted: "cubic"')


#: shapes of a number for all axes or one of each
PER_AXIS = "a number, (1,) or (3,) per axis, (N, 1) or (N, 3) per body"

# annotations of a model's fields
Number = Annotated[ArrayLike, Field()]
PositiveNumber = Annotated[ArrayLike, Field(above_zero=True)]
Vector3 = Annotated[ArrayLike, Field((3,))]
NumberOrVector = Annotated[ArrayLike, Field((3,), accepted=PER_AXIS)]
Parameters = Annotated[ArrayLike | None, Field((-1,), optional=True)]
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

    def pack(self, packing: Packing) -> PackedTerm:
        """Check the parameters and lay them out flat.

        Raises ``ValueError`` or ``TypeError`` for numbers that are not finite or of the wrong
        shape.
        """
        name, tables = f"{packing.argument}: {type(self).__name__}", packing.tables
        columns: list[NDArray[np.float64]] = []
        look_ups: list[LookUp | None] = []
        for key, field in self.fields.items():
            value, label = getattr(self, key), f"{name}.{key}"
            if isinstance(value, TimeSeries):
                field.check_table(label, value)
                rows = np.arange(float(value.rows))[:, None] if value.form.own else np.zeros(0)
                columns.append(rows)
                look_ups.append(LookUp(len(tables), value.form, field.table == "slopes"))
                tables[len(tables)] = value.data
            else:
                columns.append(field.flat(label, value))
                look_ups.append(None)
        params = join(columns, packing.n_bodies, name)
        sizes = tuple(column.shape[-1] for column in columns)
        fields = zip(self.fields.items(), sizes, strict=True)
        empty = {key: field.shaped((None,) * size) for (key, field), size in fields}
        term = Term(replace(self, **empty), sizes, tuple(look_ups))  # type: ignore[type-var]
        if not any(look_ups):
            term.numbers(None, np.moveaxis(params, -1, 0)).check(name)
        return term, params


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

    def __post_init__(self) -> None:
        terms = checks.several("Sum.terms", self.terms, "models")
        if not terms:
            raise ValueError("Sum.terms: is empty; accepted: one model or more")
        object.__setattr__(self, "terms", tuple(terms))

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
    params: Parameters = None

    @property
    def reads_position(self) -> bool:  # type: ignore[override]
        """Whether the function depends on the position."""
        return checks.flag("uses_position", getattr(self, "uses_position", False))

    def takes(self, states: int) -> int:
        """Number of states that the function takes, its own or those of a scene."""
        return self.states

    @property
    def form(self) -> str:
        """The signature of the function, a key of ``FORMS``."""
        return f"{self.kind} at position" if self.reads_position else self.kind

    def formula(self: Any, *state: Any) -> Any:
        return self.function.call(*state, self.params)

    def pack(self, packing: Packing) -> PackedTerm:
        """The term of a function, followed or compiled, and its parameters, (P,) or (N, P)."""
        params = join([parameters("params", self.params)], packing.n_bodies, "params")
        n, states = params.shape[-1], self.takes(packing.states)
        function = user_function(self.function, self.form, n, params, states)
        packing.tables.update(function.tables)
        return Term(replace(self, function=function, params=None), (n,), (None,)), params


class LookUp(NamedTuple):
    """A field that is a table: its array's number, its layout, whether slopes are needed."""

    number: int
    form: TableLayout
    slopes: bool

    def numbers(self, t: Any, p: Any) -> tuple[Any, ...]:
        """The values that a formula receives for the field; p is the row, if there are several."""
        numbers, size = recorded(self.number, self.form, t, *p), self.form.size
        return (numbers[:size], numbers[size:]) if self.slopes else numbers[:size]


@dataclass(frozen=True)
class Term:
    """A model with None in place of its numbers, with the size of each field.

    ``look_ups`` has an entry for each field, None if it is not a table.
    """

    model: Any
    sizes: tuple[int, ...]
    look_ups: tuple[LookUp | None, ...]

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


@dataclass(frozen=True)
class Law:
    """The models whose sum acts, without their numbers; none for a free body."""

    terms: tuple[Term, ...]

    @cached_property
    def models(self) -> list[Any]:
        """The models of the terms."""
        return [term.model for term in self.terms]

    @cached_property
    def count(self) -> int:
        """Number of parameters."""
        return sum(sum(term.sizes) for term in self.terms)

    def having(self, name: str, t: Any, p: Any) -> list[Any]:
        """The models that have a method of a name, with their numbers at a time."""
        start, having = 0, []
        for term in self.terms:
            n = sum(term.sizes)
            if getattr(term.model, name) is not None:
                having.append(term.numbers(t, p[start : start + n]))
            start += n
        return having

    @cached_property
    def states(self) -> int:
        """The number of its states."""
        return sum(model.states for model in self.models)

    def formula(self, *arguments: Any, states: Vector = ()) -> Any:
        """The sum of the models' formulas at a time and further arguments, parameters last.

        For a law with ``states``, their time derivatives follow the three components.
        """
        *state, p = arguments
        start, results = 0, []
        for model in self.having("formula", state[0], p):
            states_of_model = (states[start : start + model.states],) if model.states else ()
            results.append(model.evaluate(*state, *states_of_model))
            start += model.states
        columns = zip(*(result[:3] for result in results), strict=True)
        acting = tuple(sum(column[1:], column[0]) for column in columns) or (0.0, 0.0, 0.0)
        return (*acting, *(slope for result in results for slope in result[3:]))

    @cached_property
    def sampling(self) -> Sampling | None:
        """When its states jump.

        Raises ``ValueError`` for models whose states jump at different times.
        """
        clocks = {model.sampling for model in self.models} - {None}
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
        for model in self.having("formula", t, p):
            before = states[len(after) : len(after) + model.states]
            after += model.update(t, pose, before) if before else ()
        return tuple(after)

    @cached_property
    def is_constant(self) -> bool:
        """Whether it is a rate that is constant along its axes."""
        return all(model.is_constant for model in self.models)

    @cached_property
    def reads_position(self) -> bool:
        """Whether it depends on the position."""
        return any(model.reads_position for model in self.models)


class Packed(NamedTuple):
    """Models of a scene in the form that the engine takes."""

    #: a law, or the ``fastatt.scene.equations.Structure`` of a scene
    structure: Any
    #: flat parameters, (P,) shared or (N, P)
    params: NDArray[np.float64]
    #: tables, by the names that graphs have for them: numbers for fields of models, the objects
    #: themselves for those in a user-defined function
    tables: Tables


def pack(model: Any, base: type[Model], n_bodies: int | None, **others: Any) -> Packed:
    """Check the parameters of a model, a subclass of ``base``, and lay them out flat.

    ``others`` are ``tables``, to which its own are added, and ``states`` of a scene.

    Raises ``TypeError`` if it is not a model, ``ValueError`` for numbers that are not finite or of
    the wrong shape.
    """
    packing = Packing(n_bodies, base.kind, **{"tables": {}} | others)
    return Packed(*packed_law(model, base, packing), packing.tables)


def packed_law(model: Any, base: type[Model], packing: Packing) -> PackedLaw:
    """The law of a model or of a sum of them, and its parameters."""
    argument = packing.argument
    if isinstance(model, Sum):
        packing = packing._replace(argument=f"{argument}: Sum")
        laws, columns = zip(*(packed_law(x, base, packing) for x in model.terms), strict=True)
        terms = tuple(term for law in laws for term in law.terms)
        return Law(terms), join(columns, packing.n_bodies, packing.argument)
    if isinstance(model, base):
        term, params = model.pack(packing)
        return Law((term,)), params
    names = import_module(f"fastatt.scene.{base.kind}s").__all__
    raise TypeError(
        f"{argument}: found {type(model).__name__}; accepted: a model of fastatt.{base.kind}s "
        f"({', '.join(names)}) or a function {FORMS[base.kind].call}"
    )


def numbers(name: str, value: Any, shapes: str) -> NDArray[np.float64]:
    """A finite float64 array of one of the shapes, as ``checks.array`` takes them."""
    return checks.array(name, value, shapes).astype(np.float64, copy=False)


def parameters(name: str, value: ArrayLike | None) -> NDArray[np.float64]:
    """The argument p of a user-defined function, (P,) or (N, P); (0,) for None."""
    tails = [(), (0,), (-1,), (-1, -1)]
    array = checks.array(name, () if value is None else value, "(P,) or (N, P)", tails)
    return np.atleast_1d(array.astype(np.float64, copy=False))


def on_each_axis(numbers: Vector) -> Vector:
    """One number of each axis, of those that ``PER_AXIS`` accepts."""
    return tuple(numbers) * 3 if len(numbers) == 1 else numbers


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
