"""Initial states: the user's arrays, checked and brought into the layout of the engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt.scene.law import AT_CROSSINGS
from fastatt.scene.scene import Scene

#: initial values of a scene, in the order of the state
INITIAL = ("q0", "w0", "v0", "r0", "s0")


class Initial(NamedTuple):
    """Initial states in the precision of a run: attitudes (N, 4), and the other values (N, k).

    A single row is shared by all bodies.
    """

    q: NDArray[Any]
    y: NDArray[Any]
    one_body: bool

    @property
    def bodies(self) -> int:
        """The number of bodies."""
        return max(len(self.q), len(self.y))

    @classmethod
    def of(cls, start: NDArray[Any], carried: Mapping[str, NDArray[Any]], dtype: Any) -> Initial:
        """Initial states from attitudes (4,) or (N, 4) and vectors (k,) or (N, k)."""
        values = list(carried.values())
        one_body = start.ndim == 1 and all(value.ndim == 1 for value in values)
        if len(values) == 1:
            return cls(_rows(start, dtype), _rows(values[0], dtype), one_body)
        rows = max((1 if value.ndim == 1 else len(value) for value in values), default=1)
        columns = [column for value in values for column in value.T]
        y = np.empty((rows, len(columns)), dtype=dtype)
        with np.errstate(over="ignore"):
            for i, column in enumerate(columns):  # ten times as fast as row by row
                y[:, i] = column
        return cls(_rows(start, dtype), y, one_body)


def initial(scene: Scene, values: Sequence[Any]) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    """Attitudes, and the other initial values in the order of the state.

    ``values`` are in the order of ``INITIAL``.

    Raises ``ValueError`` and ``TypeError`` for values that do not fit the scene, and for different
    numbers of bodies.
    """
    q0, w0, v0, r0, s0 = values
    columns = [k for k, clock in enumerate(scene.clocks) if clock == AT_CROSSINGS]
    if isinstance(s0, Mapping):
        s0 = _states(scene, s0)
    elif s0 is None and 0 < scene.states == len(columns):
        s0 = np.zeros(scene.states)
    start = checks.attitudes("q0", q0)
    rotates, moves, n, carried = scene.kind != "rate", scene.moves, scene.states, {}
    for name, value, size, wanted, needed in (
        ("w0", w0, 3, rotates, rotates),
        ("v0", v0, 3, moves, moves),
        ("r0", r0, 3, moves, scene.needs_position),
        ("s0", s0, n, n > 0, n > 0),
    ):
        if value is not None and wanted:
            carried[name] = checks.array(name, value, f"({size},) or (N, {size})")
        elif value is not None or needed:
            raise _refused(scene, name, value)
    rows = {name: len(x) for name, x in {**carried, "q0": start}.items() if x.ndim == 2}
    if len(rows) > 1 and len(set(rows.values()) - {1}) > 1:
        told = ", ".join(f"{name} {n}" for name, n in rows.items())
        raise ValueError(f"{next(iter(rows))}: found rows {told}; accepted: one number of bodies")
    if "s0" in carried:
        side = carried["s0"][..., columns]
        is_none = (side != 0.0) & (np.abs(side) != 1.0)
        checks.refuse("s0 of a Switch", side, is_none, "1, -1 or 0")
        _warn_of_speeds(scene, carried["s0"], carried.get("w0"))
    return start, carried


def _rows(values: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Contiguous rows (N, k) of a precision, one of a vector (k,)."""
    if values.dtype != dtype:
        with np.errstate(over="ignore"):
            values = values.astype(dtype)
    return np.ascontiguousarray(values).reshape(-1, values.shape[-1])


def _refused(scene: Scene, name: str, value: Any) -> ValueError:
    """The error of initial values that are missing, or that the scene has not."""
    n = scene.states or "n"
    placed = "whose torque or force reads it needs" if scene.needs_position else "with mass takes"
    takes = {
        "w0": "with inertia needs (3,) or (N, 3), rad/s",
        "v0": "with mass needs (3,) or (N, 3), m/s",
        "r0": f"{placed} (3,) or (N, 3), m",
        "s0": f"with states needs ({n},) or (N, {n})",
    }
    what = "is missing" if value is None else "found, but this scene has none"
    return ValueError(f"{name}: {what}; a scene {takes[name]}")


def _warn_of_speeds(scene: Scene, s0: NDArray[Any], w0: Any) -> None:
    """Warn of wheels that start beyond the speed to which their motors accelerate them."""
    for model, part in scene.wheels:
        if model.max_speed is None:
            continue
        count = np.shape(model.axes)[-2]
        speeds = np.atleast_2d(np.abs(model.speeds(s0[..., part][..., :count], w0)))
        most = np.broadcast_to(model.max_speed, speeds.shape)
        over = speeds > 1.01 * most
        if over.any():
            b, k = np.argwhere(over)[0]
            rounding.warn(
                f"s0: wheel {k} of body {b} starts at {speeds[b, k]:.6g} rad/s, beyond its "
                f"max_speed {most[b, k]:g}; s0 takes angular momenta, N·m·s, not speeds: "
                "ReactionWheels.momenta(speeds, w0) gives them",
                RuntimeWarning,
            )


def _states(scene: Scene, by_name: Mapping[str, Any]) -> NDArray[np.float64]:
    """States from those of the terms, by their names; 0 of those that only samples set."""
    parts, clocks = scene.parts, scene.clocks
    for name in by_name.keys() - parts.keys():
        known = ", ".join(map(repr, parts)) or "an array, since no term has a name"
        raise ValueError(f"s0: found {name!r}; accepted: {known}")
    columns = {}
    for name, part in parts.items():
        size = part.stop - part.start
        if name in by_name:
            wanted = f"({size},) or (N, {size})" + (", or a number" if size == 1 else "")
            tails = [(size,), (-1, size), *([()] if size == 1 else [])]
            columns[name] = checks.array(f"s0[{name!r}]", by_name[name], wanted, tails)
        elif None in clocks[part]:
            raise ValueError(f"s0[{name!r}]: is missing; accepted: ({size},) or (N, {size})")
    unnamed = scene.states - sum(part.stop - part.start for part in parts.values())
    if unnamed:
        raise ValueError(f"s0: found names, but {unnamed} states have none; accepted: an array")
    rows = max((len(x) for x in columns.values() if x.ndim == 2), default=0)
    s0 = np.zeros((rows, scene.states) if rows else scene.states)
    for name, column in columns.items():
        s0[..., parts[name]] = column
    return s0
