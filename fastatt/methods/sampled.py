"""What a method for sampled rates is: a window of samples in, attitudes relative to its start out.

A window covers ``span`` intervals and looks ``history`` intervals back. Of rates it holds the
samples at the ends of all these intervals, of increments the angles over them. Beyond the ends of a
log the window holds samples extrapolated by the polynomial that the method fits, which makes the
first and last fit that of the nearest whole window.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from numba import types

from fastatt._jit import hook
from fastatt.columns import load, repeat, store
from fastatt.kernels import quat
from fastatt.methods.method import Method
from fastatt.representations import QuatShort

LANES = 16
_QUATERNION = (0.0, 0.0, 0.0, 0.0)


class Rates(NamedTuple):
    """Tag: samples are rates, rad/s, at instants."""


class Increments(NamedTuple):
    """Tag: samples are angle increments, rad, over intervals."""


class Window(NamedTuple):
    """Shape of a method's window and its kernels by kind of samples.

    Each kernel takes ``Quat`` or ``QuatShort``, for ``exponential``, and the flat samples and the
    intervals (s) as tuples, and gives the flat unit quaternions from the window's start to the end
    of each interval. A method whose work does not
    fit a scalar kernel has a ``tile`` routine in place of them.
    """

    history: int
    span: int
    rates: Callable[..., Any] | None = None
    increments: Callable[..., Any] | None = None
    tile: Callable[..., Any] | None = None
    work_rows: int = 0

    @property
    def near(self) -> float:
        """Angle (rad) of the largest component over an interval below which no turn passes π."""
        # a polynomial through samples stays below 4 times the largest where it is used
        return 3.0 / (8.0 * (self.span + self.history))

    def samples(self, kind: type) -> int:
        """Number of samples in the window."""
        return self.history + self.span + (kind is Rates)


WINDOWS: dict[type, Window] = {}


def exponential(rep: Any, u: Any) -> Any:
    """Unit quaternion of a rotation vector, at any angle or, with the short tag, up to π."""
    raise NotImplementedError(rep)


@hook(exponential)
def _exponential(rep: types.BaseNamedTuple, u: types.BaseTuple) -> Any:
    exp = quat.exp_short if rep.instance_class is QuatShort else quat.exp
    return lambda rep, u: exp(u)


def intervals_at(spans: Any, h: Any, first: Any, j: Any, shape: Any) -> Any:
    """The window's intervals in lane j: rows of h, or one number for all.

    Of one number every division by an interval leaves the loops.
    """
    raise NotImplementedError


@hook(intervals_at)
def _intervals_at(
    spans: types.Type, h: types.Type, first: types.Type, j: types.Type, shape: types.BaseTuple
) -> Any:
    if isinstance(spans, types.Array):
        return lambda spans, h, first, j, shape: load(h, first, j, shape)
    return lambda spans, h, first, j, shape: repeat(spans, shape)


def advance(
    method: Any,
    kind: Any,
    rep: Any,
    v: Any,
    base: Any,
    spans: Any,
    h: Any,
    first: Any,
    out: Any,
    row: Any,
    work: Any,
) -> None:
    """One window on all lanes: attitudes in rows row + 4 … of ``out`` from the one in row ``row``.

    Samples start in row ``base`` of v, intervals in row ``first`` of h, or all are ``spans``.
    """
    raise NotImplementedError(method)


@hook(advance)
def _advance(
    method: types.BaseNamedTuple,
    kind: types.BaseNamedTuple,
    rep: types.BaseNamedTuple,
    v: types.Type,
    base: types.Type,
    spans: types.Type,
    h: types.Type,
    first: types.Type,
    out: types.Type,
    row: types.Type,
    work: types.Type,
) -> Any:
    window = WINDOWS[method.instance_class]
    is_rates = kind.instance_class is Rates
    if window.tile is not None:
        tile = window.tile
        if rep.instance_class is QuatShort:  # never asked for: there is one routine for all angles
            return lambda method, kind, rep, v, base, spans, h, first, out, row, work: None

        def all_lanes(method, kind, rep, v, base, spans, h, first, out, row, work):
            tile(is_rates, v, base, h, first, out, row, work, LANES)

        return all_lanes
    kernel: Any = window.rates if is_rates else window.increments
    samples = (0.0,) * (3 * window.samples(kind.instance_class))
    intervals = (0.0,) * (window.history + window.span)

    def lane_by_lane(method, kind, rep, v, base, spans, h, first, out, row, work):
        for j in range(LANES):
            t = intervals_at(spans, h, first, j, intervals)
            d = kernel(rep, load(v, base, j, samples), t)
            store(out, row + 4, j, products(load(out, row, j, _QUATERNION), d))

    return lane_by_lane


def products(q: Any, d: Any) -> Any:
    """q∘d of each of the flat quaternions d, flat."""
    raise NotImplementedError


@hook(products)
def _products(q: types.BaseTuple, d: types.BaseTuple) -> Any:
    if len(d) == 4:
        return lambda q, d: quat.mul(q, d)
    return lambda q, d: quat.mul(q, d[:4]) + products(q, d[4:])


def sampled_method(
    tag: Any,
    window: Window,
    *,
    order: int,
    of_rates: float = math.inf,
    of_increments: float = math.inf,
    **fields: Any,
) -> Method:
    """Record of a method for samples, with its largest |w| over an interval, rad, for each kind."""
    WINDOWS[type(tag)] = window
    kinds = []
    if window.rates or window.tile:
        kinds.append("sampled rates")
    if window.increments or window.tile:
        kinds.append("increments")
    return Method(
        tag=tag,
        order=order,
        scenes=tuple(kinds),
        representations=("quat",),
        conserves=("norm",),
        rate_calls=1,
        limits={"rates": of_rates, "increments": of_increments},
        **fields,
    )
