"""Laws: the formulas of rates, torques and forces without their numbers, and what they read.

A law is made of terms, models whose numbers come from flat parameters, from tables, or from what
another term shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from fastatt._cached import cached_property
from fastatt.scene.time_series import TableLayout, recorded
from fastatt.tracing.formulas import Vector

# those that are due are the bits of a number
_MOST_JUMPS = 63


class Sampling(NamedTuple):
    """Times at which states jump: start + k period for all whole k, s."""

    period: float
    start: float


#: when a state changes that is set where a switch crosses, in place of a sampling
AT_CROSSINGS = Sampling(math.inf, 0.0)


class LookUp(NamedTuple):
    """A field that is a table: its array's number, its layout, whether slopes are needed."""

    number: int
    layout: TableLayout
    slopes: bool

    def numbers(self, t: Any, p: Any, shown: Any = None) -> tuple[Any, ...]:
        """The values that a formula receives for the field; p is the row, if there are several."""
        numbers, size = recorded(self.number, self.layout, t, *p), self.layout.size
        return (numbers[:size], numbers[size:]) if self.slopes else numbers[:size]


class Reading(NamedTuple):
    """A field whose numbers are those of another term, by its name."""

    name: str
    slopes: bool

    def numbers(self, t: Any, p: Any, shown: Any) -> Any:
        """The numbers that a formula receives for the field."""
        return (shown(self.name), ()) if self.slopes else shown(self.name)


@dataclass(frozen=True)
class Term:
    """A model with None in place of its numbers, with the size of each field.

    ``look_ups`` has an entry for each field, None if it is not a table.
    """

    model: Any
    sizes: tuple[int, ...]
    look_ups: tuple[LookUp | Reading | None, ...]
    name: str = ""

    def numbers(self, t: Any, p: Any, shown: Any = None) -> Any:
        """The model at a time, with fields from flat parameters, tables or other terms."""
        start, values = 0, {}
        fields = self.model.fields.items()
        for (name, field), size, look_up in zip(fields, self.sizes, self.look_ups, strict=True):
            parameters = p[start : start + size]
            values[name] = (
                field.shaped(parameters)
                if look_up is None
                else look_up.numbers(t, parameters, shown)
            )
            start += size
        return replace(self.model, **values)


class Place(NamedTuple):
    """A term of a law, and where its parameters and its states are among those of the law."""

    term: Term
    params: slice
    states: slice


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

    def having(self, name: str, t: Any, p: Any, shown: Any = None) -> list[Any]:
        """The models that have a method of a name, with their numbers at a time."""
        return [
            term.numbers(t, p[params], shown)
            for term, params, _ in self.places
            if getattr(term.model, name) is not None
        ]

    @cached_property
    def places(self) -> list[Place]:
        """The terms, and where each has its parameters and its states."""
        places, params, states = [], 0, 0
        for term in self.terms:
            ends = params + sum(term.sizes), states + term.model.states
            places.append(Place(term, slice(params, ends[0]), slice(states, ends[1])))
            params, states = ends
        return places

    @cached_property
    def states(self) -> int:
        """The number of its states."""
        return sum(model.states for model in self.models)

    def shown(self, pose: Any, name: str, t: Any, p: Any, states: Vector) -> Any:
        """What a term shows at a pose, by its name."""
        owner, _, what = name.partition(".")
        place = next(x for x in self.places if x.term.name == owner)
        model = place.term.numbers(t, p[place.params], pose.shown)
        return model.show(what, t, pose, states[place.states])

    def formula(self, *arguments: Any, states: Vector = ()) -> Any:
        """The sum of the models' formulas at a time and further arguments, parameters last.

        For a law with ``states``, their time derivatives follow the three components.
        """
        *state, p = arguments
        shown = state[1].shown if len(state) > 1 else None
        results = []
        for term, params, part in self.places:
            model = term.numbers(state[0], p[params], shown)
            results.append(model.evaluate(*state, *((states[part],) if model.states else ())))
        columns = zip(*(result[:3] for result in results), strict=True)
        acting = tuple(sum(column[1:], column[0]) for column in columns) or (0.0, 0.0, 0.0)
        return (*acting, *(slope for result in results for slope in result[3:]))

    def sides(self, t: Any, pose: Any, p: Any, states: Vector) -> list[Vector]:
        """On which side of their jumps the models of a torque are, at a pose."""
        return [
            side
            for term, params, part in self.places
            for side in term.numbers(t, p[params], pose.shown).sides(t, pose, states[part])
        ]

    @cached_property
    def clocks(self) -> tuple[Sampling | None, ...]:
        """When each of its states changes, None for one that changes at all times."""
        return tuple(x for model in self.models for x in model.clocks)

    @cached_property
    def switches(self) -> dict[str, int]:
        """Where the sides are among the states, by the names of their terms."""
        switches: dict[str, int] = {}
        for term, _, part in self.places:
            for k, clock in enumerate(term.model.clocks, part.start):
                if clock == AT_CROSSINGS:
                    name = term.name or type(term.model).__name__
                    switches[f"{name}.{k}" if name in switches else name] = k
        return switches

    def crossed(self, t: Any, pose: Any, p: Any, states: Vector) -> list[Any]:
        """The functions whose signs are the sides, at a pose."""
        return [
            function
            for term, params, part in self.places
            if AT_CROSSINGS in term.model.clocks
            for function in term.numbers(t, p[params], pose.shown).crossed(t, pose, states[part])
        ]

    @cached_property
    def samplings(self) -> tuple[Sampling, ...]:
        """When its states jump, in order."""
        return tuple(sorted({x for model in self.models for x in model.samplings}))

    @cached_property
    def jumps(self) -> tuple[tuple[int, Sampling], ...]:
        """What happens at sample times, in this order: (number of a term, its sampling).

        A term reads what those before it have just computed.
        """
        jumps = tuple((i, x) for i, model in enumerate(self.models) for x in model.samplings)
        if len(jumps) > _MOST_JUMPS:
            raise ValueError(
                f"torque: found {len(jumps)} sampled controllers; accepted: up to {_MOST_JUMPS}"
            )
        return jumps

    def updated(
        self, t: Any, pose: Any, p: Any, states: Vector, which: int | None, sampling: Sampling
    ) -> Vector:
        """The states after a sample time of a term, or of all terms, of those before."""
        for k, (term, params, part) in enumerate(self.places):
            if which in (None, k) and sampling in term.model.samplings:
                model = term.numbers(t, p[params], pose.shown)
                after = model.update(t, pose, states[part], sampling)
                states = (*states[: part.start], *after, *states[part.stop :])
        return states

    @cached_property
    def is_constant(self) -> bool:
        """Whether it is a rate that is constant along its axes."""
        return all(model.is_constant for model in self.models)

    @cached_property
    def reads_sign(self) -> bool:
        """Whether it depends on the sign of the quaternion."""
        return any(model.reads_sign for model in self.models)

    @cached_property
    def reads_position(self) -> bool:
        """Whether it depends on the position."""
        return any(model.reads_position for model in self.models)
