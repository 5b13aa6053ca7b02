"""Initial states: what a user gives, looked at and laid out for the engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.scene.scene import Scene


class Given(NamedTuple):
    """Initial states in a run's precision: attitudes, and what is carried beside them, by rows."""

    q: NDArray[Any]
    y: NDArray[Any]
    rows_q: int
    rows_y: int
    one_body: bool

    @property
    def bodies(self) -> int:
        """How many there are."""
        return max(self.rows_q, self.rows_y)

    @classmethod
    def of(cls, start: NDArray[Any], beside: Mapping[str, NDArray[Any]], kind: Any) -> Given:
        """The same from attitudes (4,) or (N, 4) and vectors (3,) or (N, 3)."""
        values = list(beside.values())
        one_body = start.ndim == 1 and all(value.ndim == 1 for value in values)
        rows = max((1 if value.ndim == 1 else len(value) for value in values), default=1)
        with np.errstate(over="ignore"):
            if len(values) == 1:
                y = np.ascontiguousarray(values[0], dtype=kind)
            else:
                columns = [column for value in values for column in value.T]
                y = np.empty((rows, len(columns)), dtype=kind)
                for i, column in enumerate(columns):  # ten times as fast as whole rows
                    y[:, i] = column
            q = np.ascontiguousarray(start, dtype=kind)
        return cls(q, y, 1 if q.ndim == 1 else len(q), rows, one_body)

    @property
    def rows(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Both with an axis of bodies, which is of length 1 where all share a row."""
        return self.q.reshape(self.rows_q, -1), self.y.reshape(self.rows_y, self.y.shape[-1])


def initial(
    scene: Scene, values: Sequence[Any], *, flag: bool
) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    """Attitudes, and what is carried beside them in the order of the state.

    ``values`` are (q0, w0, v0, r0); with ``flag`` numbers that are not finite pass.

    Raises ``ValueError`` and ``TypeError`` for what the scene does not take, and for numbers of
    bodies that do not fit each other.
    """
    q0, w0, v0, r0 = values
    start = checks.attitudes("q0", q0, flag=flag)
    has_inertia = scene.kind != "rate"
    found = {}
    for name, value, wanted, needed in (
        ("w0", w0, has_inertia, True),
        ("v0", v0, scene.moves, True),
        ("r0", r0, scene.moves, scene.needs_position),
    ):
        if value is None:
            if wanted and needed:
                raise ValueError(f"{name}: is missing; {_taken(name, scene)}")
        elif wanted:
            found[name] = checks.array(name, value, "(3,) or (N, 3)", flag=flag)
        else:
            raise ValueError(f"{name}: found, but this scene has none; {_taken(name, scene)}")
    same_number({**found, "q0": start})
    return start, found


def _taken(name: str, scene: Scene) -> str:
    """Which scenes take an initial value, and how it is given."""
    placed = "whose torque or force reads it needs" if scene.needs_position else "with mass takes"
    which, unit = {
        "w0": ("with inertia needs", "rad/s"), "v0": ("with mass needs", "m/s"), "r0": (placed, "m")
    }[name]  # fmt: skip
    return f"a scene {which} (3,) or (N, 3), {unit}"


def same_number(values: Mapping[str, NDArray[Any]]) -> None:
    """Refuse rows of different numbers of bodies."""
    rows = {name: len(value) for name, value in values.items() if value.ndim == 2}
    if len(set(rows.values()) - {1}) > 1:
        told = ", ".join(f"{name} {n}" for name, n in rows.items())
        raise ValueError(f"{next(iter(rows))}: found rows {told}; accepted: one number of bodies")
