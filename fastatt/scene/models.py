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
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, NamedTuple, Self, dataclass_transform, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.scene.law import Law, LookUp, Reading, Sampling, Term
from fastatt.scene.time_series import TimeSeries
from fastatt.tracing.formulas import Vector
from fastatt.tracing.signature import SIGNATURES
from fastatt.tracing.user import user_function

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
    #: how many numbers the terms of the torque show, by their names
    shown: Mapping[str, int] = MappingProxyType({})

    def size_of(self, label: str, name: str) -> int:
        """How many numbers a name has; refuses one that no term has."""
        if name not in self.shown:
            known = ", ".join(map(repr, self.shown))
            accepted = known or 'names of terms that show numbers, of torques.Sum({"name": term})'
            raise ValueError(f"{label}: found {name!r}; accepted: {accepted}")
        return self.shown[name]


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
        if not self.table or (table.layout.size,) != self.shape:
            accepted = f"values of {self.shape[0]} numbers" if self.table else "numbers, no table"
            raise ValueError(f"{name}: found {table!r}; accepted: {accepted}")
        if self.table == "slopes" and not table.layout.cubic:
            kind = "previous" if table.layout.steps else "linear"
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
    #: whether a torque depends on the sign of the quaternion
    reads_sign: ClassVar[bool] = False
    #: number of states of a rate or a torque. Its formula takes them last, and returns their time
    #: derivatives after the rate or torque, in one tuple
    states: ClassVar[int] = 0
    #: when its states jump, by ``update``, of one whose states do
    samplings: ClassVar[tuple[Sampling, ...]] = ()

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

    def crossed(self, t: Any, pose: Any, states: Vector) -> Sequence[Any]:
        """The functions whose signs are the sides among its states."""
        return ()

    def update(self, t: Any, pose: Any, states: Vector, sampling: Sampling) -> Any:
        """The states after a sample time, of those before."""
        return states

    @property
    def clocks(self) -> tuple[Sampling | None, ...]:
        """When each of its states changes, None for one that changes at all times."""
        return (None,) * self.states

    def shown(self) -> Mapping[str, int]:
        """How many numbers other terms may read, by what follows the name of the term."""
        return {}

    def show(self, name: str, t: Any, pose: Any, states: Vector) -> Vector:
        """Numbers of a packed term that others read."""
        return states

    def corners(self) -> NDArray[np.float64]:
        """Times, s, at which it jumps or has a corner for all bodies.

        They are those of tables that are not cubic, and of tables whose slopes it takes.
        """
        times = [np.zeros(0)]
        for name, field in self.fields.items():
            value = getattr(self, name)
            if isinstance(value, TimeSeries) and (
                not value.layout.cubic or field.table == "slopes"
            ):
                times.append(value.t)
        return np.concatenate(times)

    def check(self, name: str) -> None:
        """Refuse impossible numbers; fields are NumPy arrays with the body's index last."""

    @property
    def values(self) -> tuple[Any, ...]:
        """The arguments of the constructor."""
        return tuple(getattr(self, field.name) for field in dataclasses.fields(self))  # type: ignore[arg-type]

    def of(self, values: Iterable[Any]) -> Self:
        """A model with other ``values``."""
        return type(self)(*values)

    def pack(self, packing: Packing) -> PackedTerm:
        """Check the parameters and lay them out flat.

        Raises ``ValueError`` or ``TypeError`` for numbers that are not finite or of the wrong
        shape.
        """
        name, tables = f"{packing.argument}: {type(self).__name__}", packing.tables
        columns: list[NDArray[np.float64]] = []
        look_ups: list[LookUp | Reading | None] = []
        for key, field in self.fields.items():
            value, label = getattr(self, key), f"{name}.{key}"
            if isinstance(value, str) and field.table and len(field.shape) == 1:
                columns.append(np.zeros(0))
                look_ups.append(_reading(field, label, value, packing))
            elif isinstance(value, TimeSeries):
                field.check_table(label, value)
                rows = np.arange(float(value.rows))[:, None] if value.layout.by_row else np.zeros(0)
                columns.append(rows)
                look_ups.append(LookUp(len(tables), value.layout, field.table == "slopes"))
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


def _reading(field: Field, label: str, name: str, packing: Packing) -> Reading:
    """What a field reads; refuses what does not fit it."""
    size = packing.size_of(label, name)
    if (size,) != field.shape:
        raise ValueError(
            f"{label}: found {name!r}, which has {size or 1} numbers; accepted: {field.shape[0]}"
        )
    return Reading(name, field.table == "slopes")


class Sum(Model):
    """The sum of several models of one kind.

    Parameters
    ----------
    terms : sequence or mapping of models
        The rates, torques or forces to be added; of torques also a mapping of names to them, by
        which terms read each other.

    Attributes
    ----------
    names : tuple of str
        The names of the terms, none of a sequence.

    Raises
    ------
    ValueError
        If there are no terms, or a name is no identifier or that of a Sum.

    Notes
    -----
    Terms of a mapping show numbers under their names: ``torques.Custom`` its states,
    ``SampledControl`` what it holds, ``ReactionWheels`` the angular momenta and, as
    ``"name.speeds"``, the speeds. The functions of ``torques.Custom``, ``SampledControl`` and
    ``forces.Custom`` take those that their ``reads`` names, and a vector that may be a table may be
    a name: ``MagneticDipole("bdot", field)``. Terms read states, and what follows from states and
    w, never torques, so that the order of the terms matters at sample times only. There, those
    that are due compute in the order of the terms; each reads what those before it have just
    computed, and of later ones what they have held until then.

    Examples
    --------
    >>> import fastatt as fa
    >>> both = fa.torques.Sum((fa.torques.Constant((0.1, 0.0, 0.0)), fa.torques.Damping(0.02)))

    A dipole that is computed once a second and held, and the torque on it:

    >>> def bdot(t, q, w, p):
    ...     return [-p[0] * x for x in w]
    >>> held = fa.torques.SampledControl(bdot, 1.0, params=(2.0,), holds=3)
    >>> rods = fa.torques.MagneticDipole("bdot", (0.0, 2e-5, 0.0))
    >>> scene = fa.Scene(inertia=(1, 1, 1), torque=fa.torques.Sum({"bdot": held, "rods": rods}))
    >>> scene.parts
    {'bdot': slice(0, 3, None)}
    """

    terms: Sequence[Model] | Mapping[str, Model]
    names: tuple[str, ...] = dataclasses.field(default=(), init=False)

    def __post_init__(self) -> None:
        terms = self.terms
        if isinstance(terms, Mapping):
            object.__setattr__(self, "names", tuple(terms))
            for name, term in terms.items():
                if not str(name).isidentifier():
                    raise ValueError(f"Sum.terms: found the name {name!r}; accepted: identifiers")
                if isinstance(term, Sum):
                    raise ValueError(  # noqa: TRY004
                        f"Sum.terms: found a Sum with the name {name!r}; accepted: its terms, each "
                        "with its name"
                    )
            terms = tuple(terms.values())
        terms = checks.several("Sum.terms", terms, "models")
        if not terms:
            raise ValueError("Sum.terms: is empty; accepted: one model or more")
        object.__setattr__(self, "terms", tuple(terms))

    @property
    def values(self) -> tuple[Any, ...]:
        """The terms."""
        return tuple(self.terms)

    def of(self, values: Iterable[Any]) -> Self:
        """A sum of other terms with the same names."""
        terms = tuple(values)
        return type(self)(dict(zip(self.names, terms, strict=True)) if self.names else terms)

    @property
    def named(self) -> list[tuple[str, Model]]:
        """The terms with their names, "" for those without."""
        return list(zip(self.names or ("",) * len(self.values), self.values, strict=True))

    def corners(self) -> NDArray[np.float64]:
        """Those of the terms."""
        return np.concatenate([term.corners() for term in self.values])


class UserModel(Model):
    """A model given by a user-defined function."""

    function: Callable[..., Any]
    params: Parameters = None
    #: names of terms whose numbers the function takes, before its states
    reads = ()

    def __post_init__(self) -> None:
        if self.reads != ():
            object.__setattr__(self, "reads", names_in(f"{type(self).__name__}.reads", self.reads))

    def shown(self) -> Mapping[str, int]:
        return {"": self.states} if self.states else {}

    @property
    def reads_position(self) -> bool:  # type: ignore[override]
        """Whether the function depends on the position."""
        return checks.flag("uses_position", getattr(self, "uses_position", False))

    def takes(self, states: int) -> int:
        """Number of states that the function takes, its own or those of a scene."""
        return self.states

    @property
    def role(self) -> str:
        """The signature of the function, a key of ``SIGNATURES``."""
        return f"{self.kind} at position" if self.reads_position else self.kind

    def formula(self: Any, *state: Any) -> Any:
        return self.function.call(*state, self.params)

    def pack(self, packing: Packing) -> PackedTerm:
        """The term of a function, followed or compiled, and its parameters, (P,) or (N, P)."""
        params = join([parameters("params", self.params)], packing.n_bodies, "params")
        n, states = params.shape[-1], self.takes(packing.states)
        function = user_function(
            self.function, self.role, n, params, states, reads=readings(self.reads, packing)
        )
        packing.tables.update(function.tables)
        return Term(replace(self, function=function, params=None), (n,), (None,)), params


def names_in(label: str, reads: Any) -> tuple[str, ...]:
    """The names of what a function reads, of one or of several."""
    names = (reads,) if isinstance(reads, str) else reads
    if not isinstance(names, (tuple, list)) or not all(isinstance(x, str) for x in names):
        raise TypeError(
            f"{label}: found {checks.brief(reads)}; accepted: a name or a tuple of them"
        )
    return tuple(names)


def readings(names: Iterable[str], packing: Packing) -> tuple[tuple[str, int], ...]:
    """What a function reads, with the size of each."""
    return tuple((x, packing.size_of(f"{packing.argument}: reads", x)) for x in names)


def terms_of(model: Any) -> list[Any]:
    """The models whose sum a model is, those of sums in it included; none of None."""
    if isinstance(model, Sum):
        return [x for term in model.values for x in terms_of(term)]
    return [] if model is None else [model]


def shown_in(model: Any) -> dict[str, int]:
    """How many numbers the terms of a sum show, by their names."""
    shown: dict[str, int] = {}
    for name, term in model.named if isinstance(model, Sum) else ():
        of_term = {name + key: n for key, n in term.shown().items()} if name else shown_in(term)
        for twice in sorted(shown.keys() & of_term.keys()):
            raise ValueError(f"Sum.terms: found the name {twice!r} twice; accepted: once")
        shown |= of_term
    return shown


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
    packing = Packing(n_bodies, base.kind, **{"tables": {}, "shown": shown_in(model)} | others)
    return Packed(*packed_law(model, base, packing), packing.tables)


def packed_law(model: Any, base: type[Model], packing: Packing) -> PackedLaw:
    """The law of a model or of a sum of them, and its parameters."""
    argument = packing.argument
    if isinstance(model, Sum):
        if model.names and base.kind != "torque":
            raise ValueError(
                f"{argument}: found a Sum with names, {', '.join(model.names)}; accepted: a "
                "sequence of terms, since only terms of a torque read each other"
            )
        packing = packing._replace(argument=f"{argument}: Sum")
        laws, columns = zip(*(packed_law(x, base, packing) for x in model.terms), strict=True)
        terms = tuple(
            replace(term, name=term.name or name)
            for law, (name, _) in zip(laws, model.named, strict=True)
            for term in law.terms
        )
        return Law(terms), join(columns, packing.n_bodies, packing.argument)
    if isinstance(model, base):
        term, params = model.pack(packing)
        return Law((term,)), params
    names = import_module(f"fastatt.scene.{base.kind}s").__all__
    raise TypeError(
        f"{argument}: found {type(model).__name__}; accepted: a model of fastatt.{base.kind}s "
        f"({', '.join(names)}) or a function {SIGNATURES[base.kind].call}"
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
