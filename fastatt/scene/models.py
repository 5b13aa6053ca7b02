"""What models of rates, torques and forces share: their numbers checked and laid out flat.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Packed, it is a law (the
record of its class and how many numbers each field has, which is all that a formula depends on) and
an array of parameters, (P,) shared by all bodies or (N, P).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.scene.time_series import TableLayout, TimeSeries, recorded
from fastatt.tracing.user import FORMS, UserFunction, user_function

Model = Any  # an instance of a model's class


class Sum(NamedTuple):
    """Sum of other models of its kind, ``Sum((Constant(...), Damping(...)))``."""

    terms: Sequence[Model]


class Field(NamedTuple):
    """One field of a model: the shape for one body (−1: any length) and whether it must be > 0.

    ``table`` says whether it may be a table, and what a formula then finds in its place: "values",
    or "slopes", the pair of the values and their time derivatives, () of numbers that stay.
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


@dataclass(frozen=True, eq=False)
class Record:
    """What every kind of model says of its class: its fields and its formula.

    The formula's last argument is an instance of ``model`` whose fields are recorded numbers, or
    tuples of them.
    """

    model: type | None
    fields: tuple[Field, ...]
    formula: Callable[..., Any]
    _: KW_ONLY
    #: ``check(name, model, numbers)`` refuses a user's model that cannot be, by its name;
    #: ``numbers`` is the same with numpy's arrays as fields, the body's index last
    check: Callable[[str, Any, Any], None] | None = None
    #: of a torque or a force: whether it takes the position that the scene carries
    reads_position: bool = False


class LookUp(NamedTuple):
    """A field that is a table: the number of its array, how it is read, whether slopes too."""

    number: int
    form: TableLayout
    slopes: bool

    def numbers(self, t: Any, p: Any) -> tuple[Any, ...]:
        """What a formula finds in place of the field; p is the row, if there are some."""
        values, slopes = recorded(self.number, self.form, t, *p)
        return (values, slopes) if self.slopes else values


@dataclass(frozen=True)
class Law:
    """A model without its numbers: which formula, of how many numbers.

    ``parts`` are the laws of a sum's terms.
    """

    record: Any
    sizes: tuple[int, ...] = ()
    parts: tuple[Law, ...] = ()
    #: a user's functions: what is traced or called, and the potential, if there is one
    function: Any = None
    potential: Any = None
    #: of each field what it looks up, if there is one that does
    look_ups: tuple[LookUp | None, ...] = ()

    @cached_property
    def count(self) -> int:
        """Number of parameters."""
        return sum(self.sizes) + sum(part.count for part in self.parts)

    def split(self, p: Any) -> list[tuple[Law, Any]]:
        """Each part with its own parameters, which follow this law's."""
        at, found = sum(self.sizes), []
        for part in self.parts:
            found.append((part, p[at : at + part.count]))
            at += part.count
        return found

    def numbers(self, t: Any, p: Any) -> Any:
        """The model at a time, its fields from flat parameters or looked up in tables."""
        if self.record.model is None:
            return p
        at, found = 0, []
        look_ups = self.look_ups or (None,) * len(self.sizes)
        for field, size, look_up in zip(self.record.fields, self.sizes, look_ups, strict=True):
            own = p[at : at + size]
            found.append(field.shaped(own) if look_up is None else look_up.numbers(t, own))
            at += size
        return self.record.model(*found)

    def formula(self, *given: Any) -> Any:
        """The record's formula of what is given, parameters last; of a sum that of its terms."""
        *before, p = given
        if self.record is SUM:
            terms = [law.formula(*before, own) for law, own in self.split(p)]
            return tuple(sum(column[1:], column[0]) for column in zip(*terms, strict=True))
        if self.function is not None:
            return self.function.given(*given)
        return self.record.formula(*before, self.numbers(before[0], p))

    @cached_property
    def reads_position(self) -> bool:
        """Whether it takes the position that the scene carries."""
        return any(leaf.record.reads_position for leaf in self.leaves())

    def with_tables_from(self, k: int) -> Law:
        """The same, its tables numbered from k on."""
        parts = tuple(part.with_tables_from(k) for part in self.parts)
        moved = tuple(x and x._replace(number=x.number + k) for x in self.look_ups)
        return replace(self, parts=parts, look_ups=moved)

    def leaves(self) -> Iterable[Law]:
        """The laws of which a sum is one, or this one."""
        if not self.parts:
            yield self
        for part in self.parts:
            yield from part.leaves()


class Packed(NamedTuple):
    """What acts, ready for the engine."""

    #: a law, or a scene's ``fastatt.scene.equations.Structure`` of them
    structure: Any
    #: flat parameters, (P,) shared or (N, P)
    params: NDArray[np.float64]
    #: tables and opaque functions that formulas look up, by the names that graphs have for them:
    #: of fields of models by numbers, of a user's function by themselves
    resources: dict[tuple[str, Any], Any]

    @property
    def tables(self) -> dict[Any, NDArray[np.float64]]:
        """The tables alone."""
        return {x: array for (kind, x), array in self.resources.items() if kind == "table"}

    def with_tables_from(self, k: int) -> Packed:
        """That of a law, its tables numbered from k on."""
        moved = {
            (kind, x + k if isinstance(x, int) else x): found
            for (kind, x), found in self.resources.items()
        }
        return self._replace(structure=self.structure.with_tables_from(k), resources=moved)


def resources_of(function: UserFunction) -> dict[tuple[str, Any], Any]:
    """What a graph of a user's function looks up, by the names that it has there."""
    if not function.straight:
        return {("function", function): function.address}
    return {("table", x): array for x, array in function.tables.items()}


_Pack = Callable[[Any, int | None, str], Packed]


def pack(
    model: Model,
    n_bodies: int | None,
    argument: str,
    records: Mapping[type, Record],
    others: Mapping[type, _Pack] = MappingProxyType({}),
) -> Packed:
    """Check a model's numbers and lay them out flat.

    Models with a record are packed by their fields, ``others`` as these say.

    Raises ``TypeError`` for something that is no model, ``ValueError`` for numbers that are not
    finite or of the wrong shape.
    """
    cls = type(model)
    if cls is Sum:
        name = f"{argument}: Sum"
        if not isinstance(model.terms, (tuple, list)) or not model.terms:
            raise ValueError(f"{name}.terms is empty; accepted is a tuple of models")
        terms = [pack(term, n_bodies, name, records, others) for term in model.terms]
        params = join([term.params for term in terms], n_bodies, name)
        laws: list[Law] = []
        found: dict[tuple[str, Any], Any] = {}
        for term in terms:
            moved = term.with_tables_from(len(found))
            laws.append(moved.structure)
            found |= moved.resources
        return Packed(Law(SUM, (), tuple(laws)), params, found)
    if cls in others:
        return others[cls](model, n_bodies, argument)
    if cls in records:
        return pack_fields(model, records[cls], n_bodies, argument)
    kind = argument.partition(":")[0]
    names = ", ".join(sorted({c.__name__ for c in (*records, *others, Sum)}))
    raise TypeError(
        f"{argument}: found {cls.__name__}; accepted is a model of fastatt.{kind}s ({names}) or an "
        f"@njit function {FORMS[kind].call}"
    )


def pack_fields(model: Model, record: Record, n_bodies: int | None, argument: str) -> Packed:
    """Check a model's numbers and lay them out flat.

    Raises ``ValueError`` or ``TypeError`` for numbers that are not finite or of the wrong shape.
    """
    cls = type(model)
    sizes, columns = [], []
    look_ups: list[LookUp | None] = []
    tables: dict[tuple[str, Any], NDArray[np.float64]] = {}
    for name, value, field in zip(model._fields, model, record.fields, strict=True):
        label = f"{argument}: {cls.__name__}.{name}"
        if isinstance(value, TimeSeries):
            _check_table(label, value, field)
            rows = np.arange(float(value.rows))[:, None] if value.form.own else np.zeros(0)
            sizes.append(rows.shape[-1])
            columns.append(rows)
            look_ups.append(LookUp(len(tables), value.form, field.table == "slopes"))
            tables["table", len(tables)] = value.data
            continue
        shape, above_zero, _ = field
        look_ups.append(None)
        array = numbers(label, value)
        one = array.ndim == len(shape)
        tail = array.shape[array.ndim - len(shape) :]
        fits = array.size > 0 and (one or array.ndim == len(shape) + 1)
        if not fits or any(n not in (m, -1) for m, n in zip(tail, shape, strict=True)):
            sizes_ = ["K" if n == -1 else str(n) for n in shape]
            accepted = f"{_tuple(sizes_)} and {_tuple(['N', *sizes_])}"
            raise ValueError(f"{label} {checks.shape(array)}; accepted are {accepted}")
        if above_zero:
            checks.refuse(label, array, array <= 0.0, "above 0")
        sizes.append(int(np.prod(tail, dtype=int)))
        columns.append(array.reshape((*array.shape[: array.ndim - len(shape)], -1)))
    params = join(columns, n_bodies, f"{argument}: {cls.__name__}")
    law = Law(record, tuple(sizes), look_ups=tuple(look_ups) if tables else ())
    if record.check is not None:
        flat = replace(law, look_ups=()).numbers(None, np.moveaxis(params, -1, 0))
        record.check(f"{argument}: {cls.__name__}", model, flat)
    return Packed(law, params, tables)


def _check_table(label: str, table: TimeSeries, field: Field) -> None:
    if not field.table or (table.form.size,) != field.shape:
        accepted = f"values of {field.shape[0]} numbers" if field.table else "numbers, no table"
        raise ValueError(f"{label}: found {table!r}; accepted: {accepted}")
    if field.table == "slopes" and not table.form.cubic:
        raise ValueError(f'{label}: found a linear table; accepted: one of kind "cubic"')


def pack_user(
    function: Callable[..., Any],
    form: str,
    record: Record,
    params: ArrayLike | None,
    n_bodies: int | None,
) -> Packed:
    """The same for a user's function, of a form of ``FORMS``, with (P,) or (N, P) parameters."""
    form = f"{form} at position" if record.reads_position else form
    given = np.atleast_1d(np.zeros(0) if params is None else numbers("params", params))
    if given.ndim > 2 or (given.ndim == 2 and not len(given)):
        raise ValueError(f"params: {checks.shape(given)}; accepted are (P,) and (N, P)")
    joined = join([given], n_bodies, "params")
    n = joined.shape[-1]
    made = user_function(function, form, n, joined)
    return Packed(Law(record, (n,), function=made), joined, resources_of(made))


SUM = Record(Sum, (), sum)


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
    together = np.concatenate([np.broadcast_to(c, (n, c.shape[-1])) for c in columns], axis=1)
    return np.ascontiguousarray(together)


def _tuple(sizes: Sequence[str]) -> str:
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"
